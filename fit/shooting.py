"""Windows of many runs, robots and restarts simulated side by side, with their sensitivities, on one compiled kernel.

Every window starts from a state of its own: from the data (multiple shooting), or from the end of the window before it
(a free run, whose windows then agree where they meet). States and their derivatives by the parameters travel together.
Whatever asks for windows is a generator that yields a `Request` and is sent an `Answer`; `together` runs many of them
in step, so that their windows fill one batch.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from ljjax import batch, fast
from ljjax.fit.windows import Windows
from ljjax.model import Model
from ljjax.step import Drive, How, Unrolled, in_balance

TILE = 64
"""Windows simulated in one call: wide enough for vector units, small enough for a core's cache."""
T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Starts:
    """Where W windows start: scalars (W,) of the state, and their derivatives (k + 1, W) by the k coordinates and by
    the angle at which the window's run (or the window itself) starts."""

    state: Unrolled
    slope: Unrolled

    def moved(self, dx: np.ndarray) -> Starts:
        """The starts after steps dx (k + 1, W), to first order."""
        state = jax.tree.map(lambda a, s: a + np.einsum("kw,kw->w", dx, s), self.state, self.slope)
        return Starts(state, self.slope)


@dataclass(frozen=True, eq=False)
class Request:
    """Simulate windows.

    Attributes:
        windows: what drives them, and the samples in them.
        model: the robot; `slopes` (k leaves stacked) its derivatives by the coordinates.
        offset: (W,) added to the angle at which each window starts from the data [rad].
        starts: where windows start that do not start from the data; None if all do.
    """

    windows: Windows
    model: Model
    slopes: Model
    offset: np.ndarray
    starts: Starts | None = None


@dataclass(frozen=True, eq=False)
class Answer:
    """What came of a request.

    Attributes:
        predicted: (N, c) what the samples should read [rad].
        jacobian: (N, c, k + 1) its derivatives by the coordinates and by the starting angle.
        used, middle, end: where the windows started, where they were half-way, and where they ended.
        passed: (2, 2, n, W) how a change of a joint's start reaches its end, were it alike in all joints: [to q or z,
            from q or z].
    """

    predicted: np.ndarray
    jacobian: np.ndarray
    used: Starts
    middle: Starts
    end: Starts
    passed: np.ndarray


Asking = Generator[Request, Answer, T]


def together(asking: Sequence[Asking[T]], progress: Callable[[int, int], None] | None = None) -> list[T | Exception]:
    """Run generators side by side, their requests in shared batches; their results, or the error each ended in.

    `progress(done, all)` is called after every round.
    """
    results: list[Any] = [None] * len(asking)
    pending: dict[int, Request] = {}

    def resume(i: int, answer: Answer | None) -> None:
        try:
            pending[i] = next(asking[i]) if answer is None else asking[i].send(answer)
        except StopIteration as stop:
            results[i] = stop.value
        except Exception as error:  # one bad element never loses the batch
            results[i] = error

    for i in range(len(asking)):
        resume(i, None)
    while pending:
        requests, pending = pending, {}
        for i, answer in zip(requests, answer_all(list(requests.values())), strict=True):
            resume(i, answer)
        if progress:
            progress(len(asking) - len(pending), len(asking))
    return results


def answer_all(requests: Sequence[Request]) -> list[Answer]:
    """Simulate the windows of all requests, those of one form in shared tiles."""
    groups: dict[Any, list[int]] = {}
    for i, r in enumerate(requests):
        form = jax.tree.structure(r.model), jax.tree.leaves(r.slopes)[0].shape[0], r.windows.y.shape[1] > 1
        groups.setdefault(form, []).append(i)
    answers: list[Any] = [None] * len(requests)
    for (_, _, joints), members in groups.items():
        for i, answer in zip(members, _answer([requests[i] for i in members], joints), strict=True):
            answers[i] = answer
    return answers


def _answer(requests: Sequence[Request], joints: bool) -> list[Answer]:
    count = [len(r.windows) for r in requests]

    def each(pick: Callable[[Request], Any]) -> Any:
        """A pytree per request, its last axis the request's windows → one pytree over all windows."""
        return jax.tree.map(lambda *x: np.concatenate(x, axis=-1), *(pick(r) for r in requests))

    model = each(lambda r: jax.tree.map(lambda x: np.full(len(r.windows), x), r.model))
    slopes = each(lambda r: jax.tree.map(lambda x: np.repeat(np.asarray(x)[:, None], len(r.windows), 1), r.slopes))
    drive = each(lambda r: _drive(r.windows))
    h = each(lambda r: np.full(len(r.windows), r.windows.h))
    q = each(lambda r: tuple(r.windows.q.T + r.offset))
    v = each(lambda r: tuple(r.windows.v.T))
    state, slope = _tiled(_balance, (model, slopes, q, v, jax.tree.map(lambda x: x[0], drive)))
    used = Starts(state, slope)
    if any(r.starts is not None for r in requests):
        parts = np.cumsum([0, *count])
        given = []
        for r, a, b in zip(requests, parts[:-1], parts[1:], strict=True):
            opening = jax.tree.map(lambda x, a=a, b=b: x[..., a:b], used)
            given.append(opening if r.starts is None else _where(r.windows.opens, opening, r.starts))
        used = jax.tree.map(lambda *x: np.concatenate(x, axis=-1), *given)
    (middle, end), (middle_slope, end_slope), path, path_slope, passed = _tiled(
        partial(_shoot, joints), (model, slopes, used.state, used.slope, drive, h)
    )
    answers, a = [], 0
    for r, w in zip(requests, count, strict=True):
        part = slice(a, a + w)

        def own(tree: Any, part: slice = part) -> Any:
            return jax.tree.map(lambda x: x[..., part], tree)

        predicted, jacobian = _at_samples(r.windows, own(path), own(path_slope))
        half, last = Starts(own(middle), own(middle_slope)), Starts(own(end), own(end_slope))
        answers.append(Answer(predicted, jacobian, own(used), half, last, own(passed)))
        a += w
    return answers


jax.tree_util.register_dataclass(Starts, ["state", "slope"], [])


def _drive(windows: Windows) -> Drive:
    arrays: Any = (windows.left.T, windows.right.T, windows.vacuum.T, None, None, windows.t.T)
    return Drive(*arrays)


def _where(mask: np.ndarray, yes: Starts, no: Starts) -> Starts:
    return jax.tree.map(lambda a, b: np.where(mask, a, b), yes, no)


def _tiled(kernel: Callable, arguments: Any) -> Any:
    """A jitted kernel over arguments whose last axis is the windows, in tiles of `TILE`, on all cores."""
    leaves = jax.tree.leaves(arguments)
    count = leaves[0].shape[-1]
    index = [np.minimum(np.arange(a, a + TILE), count - 1) for a in range(0, count, TILE)]

    def work(i: np.ndarray) -> Any:
        return jax.tree.map(np.asarray, kernel(*jax.tree.map(lambda x: np.ascontiguousarray(x[..., i]), arguments)))

    if len(index) == 1:
        parts = [work(index[0])]
    else:
        form = (getattr(kernel, "func", kernel), getattr(kernel, "args", ()), jax.tree.structure(arguments))
        shapes = (*form, *(x.shape[:-1] for x in leaves))
        parts = [work(index[0])] if shapes not in _ready else []  # compile once, not in every thread
        _ready.add(shapes)
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            parts += pool.map(work, index[len(parts) :])
    return jax.tree.map(lambda *x: np.concatenate(x, axis=-1)[..., :count], *parts)


_ready: set[Any] = set()


def _push(f: Callable, primals: Any, tangents: Any) -> Any:
    """f at the primals, and its derivatives along tangents stacked along a new first axis."""

    def along(t: Any) -> Any:
        return jax.jvp(f, primals, t)

    return jax.vmap(along, out_axes=(None, 0))(tangents)


@partial(jax.jit, compiler_options=batch.options())
def _balance(model, slopes, q, v, drive):
    """Starting states from the data, (W,), and their derivatives (k + 1, W)."""

    def f(model, q):
        return jax.vmap(in_balance)(model, q, v, drive)

    k = jax.tree.leaves(slopes)[0].shape[0]
    along = jnp.zeros((k + 1, q[0].shape[0])).at[k].set(1.0)
    with_angle = jax.tree.map(lambda s: jnp.concatenate([s, jnp.zeros_like(s[:1])]), slopes)
    return _push(f, (model, q), (with_angle, tuple(along for _ in q)))


@partial(jax.jit, static_argnums=0, compiler_options=batch.options())
def _shoot(joints: bool, model, slopes, state, slope, drive, h):
    """Middles and ends of the windows, the path (q, v, what is seen − q) from start to end, and all derivatives."""

    def f(model, state):
        def one(m, s, d, h):
            return fast.path(m, s, d, h, How(loops=True))

        after = jax.vmap(one, in_axes=(0, 0, 1, 0), out_axes=1)(model, state, drive, h)
        full = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), state, after)
        seen = () if full.sensed is None else tuple(a - b for a, b in zip(full.sensed, full.q, strict=True))
        path = (full.q, full.v, seen)
        if not joints:
            path = tuple((sum(x) / len(x),) if x else () for x in path)
        half = drive.left.shape[0] // 2 - 1
        return (jax.tree.map(lambda x: x[half], after), jax.tree.map(lambda x: x[-1], after)), path

    with_angle = jax.tree.map(lambda s: jnp.concatenate([s, jnp.zeros_like(s[:1])]), slopes)
    alike = jax.tree.map(lambda s: jnp.zeros((2, *s.shape[1:]), s.dtype), slope)
    shifts = [tuple(x.at[i].set(1.0) for x in part) for i, part in enumerate((alike.q, alike.z))]
    alike = alike._replace(q=shifts[0], z=shifts[1])
    if alike.sensed is not None:
        alike = alike._replace(sensed=shifts[0])
    slope, with_angle = (
        jax.tree.map(lambda a, b: jnp.concatenate([a, b]), slope, alike),
        jax.tree.map(lambda s: jnp.concatenate([s, jnp.zeros_like(s[:2])]), with_angle),
    )
    (ends, path), (end_slopes, path_slopes) = _push(f, (model, state), (with_angle, slope))
    passed = jnp.stack([jnp.stack([y[-2:] for y in x], axis=1) for x in (end_slopes[1].q, end_slopes[1].z)])
    end_slopes, path_slopes = jax.tree.map(lambda s: s[:-2], (end_slopes, path_slopes))
    return ends, end_slopes, path, path_slopes, passed


def _at_samples(windows: Windows, path: Any, slopes: Any) -> tuple[np.ndarray, np.ndarray]:
    """Predictions (N, c) and derivatives (N, c, k + 1) at the samples, from paths (K + 1, W) by cubic Hermite."""
    (q, v, seen), (dq, dv, dseen) = path, slopes
    w, h = windows.weight, windows.h
    at = windows.step * len(windows) + windows.window
    after = at + len(windows)
    cubic = (1 - w * w * (3 - 2 * w), w * w * (3 - 2 * w), h * w * (1 - w) ** 2, h * w * w * (w - 1))

    def read(x: np.ndarray, rate: np.ndarray, more: np.ndarray | None) -> np.ndarray:
        x, rate = x.reshape(*x.shape[:-2], -1), rate.reshape(*rate.shape[:-2], -1)
        out = cubic[0] * x[..., at] + cubic[1] * x[..., after] + cubic[2] * rate[..., at] + cubic[3] * rate[..., after]
        if more is not None:
            more = more.reshape(*more.shape[:-2], -1)
            out = out + (1 - w) * more[..., at] + w * more[..., after]
        return out

    none = [None] * len(q)
    predicted = [read(*x) for x in zip(q, v, seen or none, strict=True)]
    jacobian = [read(*x) for x in zip(dq, dv, dseen or none, strict=True)]
    return np.stack(predicted, axis=1), np.stack([j.T for j in jacobian], axis=1)
