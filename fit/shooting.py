"""Windows of many runs, robots and restarts simulated side by side, with their sensitivities, on one compiled kernel.

Every window starts from a state of its own: from the data (multiple shooting), or from the end of the window before it
(a free run, whose windows then agree where they meet). States and their derivatives by the parameters travel together.
Where enough runs go side by side to fill a batch, free runs go on window after window and meet by themselves.
Whatever asks for windows is a generator that yields a `Request` and is sent an `Answer`; `together` runs many of them
in step, so that their windows fill one batch.
"""

from __future__ import annotations

import contextlib
import gc
import math
import os
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from ljjax import batch
from ljjax.fit.windows import STEPS, Windows
from ljjax.model import Model
from ljjax.step import Drive, How, Unrolled, advance, constants, in_balance

TILE, NARROW = 64, 32
"""Windows simulated in one call: wide enough for vector units, small enough for a core's cache. Where they go on from
each other there are as many as runs, and narrow tiles occupy all cores."""
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
        onward: free runs, each window from the end of the one before it; `starts` is then of no account.
    """

    windows: Windows
    model: Model
    slopes: Model
    offset: np.ndarray
    starts: Starts | None = None
    onward: bool = False


@dataclass(frozen=True, eq=False)
class Answer:
    """What came of a request.

    Attributes:
        predicted: (N, c) what the samples should read [rad].
        jacobian: (N, c, k + 1) its derivatives by the coordinates and by the starting angle.
        used, middle, end: where the windows started, where they were half-way, and where they ended.
        passed: (2, 2, n, W) how a change of a joint's start reaches its end, were it alike in all joints: [to q or z,
            from q or z].

    The last four are kept only where windows were not run onward.
    """

    predicted: np.ndarray
    jacobian: np.ndarray
    used: Starts | None = None
    middle: Starts | None = None
    end: Starts | None = None
    passed: np.ndarray | None = None


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
    split = [_parts(r) for r in requests]
    parts = [part for own in split for part in own]
    for i, r in enumerate(parts):
        form = jax.tree.structure(r.model), _padded(r), r.windows.y.shape[1] > 1, r.onward, r.windows.h
        groups.setdefault(form, []).append(i)
    answers: list[Any] = [None] * len(parts)
    for (_, width, joints, onward, _), members in groups.items():
        asked = [parts[i] for i in members]
        found = _onward(asked, width, joints) if onward else _answer(asked, width, joints)
        for i, answer in zip(members, found, strict=True):
            answers[i] = answer
    rest = iter(answers)
    return [_whole([next(rest) for _ in own]) for own in split]


LEAST, WIDER, ACROSS = 20, 8, 8
"""Derivatives that a kernel takes with effects, so that candidates share one compilation: of windows so many at least
and in steps of so many; of free runs so many, and the others beside them in the batch."""


def _derivatives(request: Request) -> int:
    return jax.tree.leaves(request.slopes)[0].shape[0]


def _padded(request: Request) -> int:
    """How many derivatives the kernel takes."""
    k = _derivatives(request)
    if request.onward:
        return ACROSS
    return LEAST + WIDER * max(0, math.ceil((k - LEAST) / WIDER)) if request.model.effects else k


def _parts(request: Request) -> list[Request]:
    """A request, or the requests for some of its derivatives each that a kernel can take."""
    if not request.onward or _derivatives(request) <= ACROSS:
        return [request]
    places = range(0, _derivatives(request), ACROSS)
    return [replace(request, slopes=jax.tree.map(lambda s, a=a: s[a : a + ACROSS], request.slopes)) for a in places]


def _whole(parts: Sequence[Answer]) -> Answer:
    if len(parts) == 1:
        return parts[0]
    own = [p.jacobian[..., :-1] for p in parts[:-1]]
    return replace(parts[0], jacobian=np.concatenate([*own, parts[-1].jacobian], axis=-1))


class _Batch:
    """The windows of several requests on one axis: robots, drives and first shapes."""

    def __init__(self, requests: Sequence[Request], width: int, dtype: Any = float):
        self.count = [len(r.windows) for r in requests]
        self.of = np.repeat(np.arange(len(requests)), self.count)
        self.model = jax.tree.map(lambda *x: np.array(x, float), *(r.model for r in requests))
        self.slopes = jax.tree.map(
            lambda *x: np.stack([np.pad(np.asarray(y), (0, width + 1 - len(y))) for y in x], axis=1),
            *(r.slopes for r in requests),
        )
        self.drive = jax.tree.map(
            lambda *x: np.concatenate(x, axis=-1), *(_drive(r.windows, r.model) for r in requests)
        )
        self.h = np.concatenate([np.full(len(r.windows), r.windows.h) for r in requests])
        self.q = tuple(np.concatenate([r.windows.q.T + r.offset for r in requests], axis=-1))
        self.v = tuple(np.concatenate([r.windows.v.T for r in requests], axis=-1))
        parts = self.model, self.slopes, self.drive, self.h, self.q, self.v
        parts = jax.tree.map(lambda x: np.asarray(x, dtype), parts)
        self.model, self.slopes, self.drive, self.h, self.q, self.v = parts

    def robots(self, windows: Any) -> tuple[Model, Model]:
        """Model of these windows (an index), and its slopes (k + 1, W), none along the starting angle."""
        mine = self.of[windows]
        return jax.tree.map(lambda x: x[..., mine], (self.model, self.slopes))

    def balance(self, windows: Any) -> Starts:
        """Where these windows start from the data."""
        take = lambda x: x[..., windows]  # noqa: E731
        q, v, first = jax.tree.map(take, (self.q, self.v, jax.tree.map(lambda x: x[0], self.drive)))
        return Starts(*_tiled(_balance, (*self.robots(windows), q, v, first), TILE))

    def shoot(self, windows: Any, starts: Starts, joints: bool, onward: bool = False) -> Any:
        """`_shoot` of these windows from `starts`; where they are not run onward also `Answer.passed`."""
        take = lambda x: x[..., windows]  # noqa: E731
        drive, h = jax.tree.map(take, (self.drive, self.h))
        (model, slopes), slope = self.robots(windows), starts.slope
        if not onward:
            slopes = jax.tree.map(lambda x: np.concatenate([x, np.zeros_like(x[:2])]), slopes)
            slope = jax.tree.map(lambda *x: np.concatenate(x), slope, _alike(slope))
        given = model, slopes, starts.state, slope, drive, h
        ends, end_slopes, path, path_slopes = _tiled(
            partial(_kernel, joints, onward), given, NARROW if onward else TILE
        )
        if onward:
            return ends, end_slopes, path, path_slopes, None
        passed = np.stack([np.stack([y[-2:] for y in x], axis=1) for x in (end_slopes[1].q, end_slopes[1].z)])
        end_slopes, path_slopes = jax.tree.map(lambda s: s[:-2], (end_slopes, path_slopes))
        return ends, end_slopes, path, path_slopes, passed


def _alike(slope: Unrolled) -> Unrolled:
    """Derivatives (2, W) of a start where all joints turn alike, and where all bristles stretch alike."""
    zero = jax.tree.map(lambda s: np.zeros((2, *s.shape[1:]), s.dtype), slope)
    turned, stretched = (tuple(x + np.eye(2, dtype=x.dtype)[:, [row]] for x in zero.q) for row in (0, 1))
    return zero._replace(q=turned, z=stretched, sensed=None if zero.sensed is None else turned)


def _answer(requests: Sequence[Request], width: int, joints: bool) -> list[Answer]:
    batch = _Batch(requests, width)
    everything = slice(None)
    used = batch.balance(everything)
    parts = np.cumsum([0, *batch.count])
    if any(r.starts is not None for r in requests):
        given = []
        for r, a, b in zip(requests, parts[:-1], parts[1:], strict=True):
            opening = jax.tree.map(lambda x, a=a, b=b: x[..., a:b], used)
            given.append(opening if r.starts is None else _where(r.windows.opens, opening, r.starts))
        used = jax.tree.map(lambda *x: np.concatenate(x, axis=-1), *given)
    (middle, end), (middle_slope, end_slope), path, path_slope, passed = batch.shoot(everything, used, joints)
    answers = []
    for r, a, b in zip(requests, parts[:-1], parts[1:], strict=True):

        def own(tree: Any, part: slice = slice(a, b)) -> Any:
            return jax.tree.map(lambda x: x[..., part], tree)

        samples = _Samples(r)
        samples.read(np.arange(b - a), own(path), own(path_slope))
        half, last = Starts(own(middle), own(middle_slope)), Starts(own(end), own(end_slope))
        answers.append(Answer(samples.predicted, samples.jacobian, own(used), half, last, own(passed)))
    return answers


def _onward(requests: Sequence[Request], width: int, joints: bool) -> list[Answer]:
    """Free runs: the first windows of all runs, then their second ones, and so on; in float32, whose rounding is far
    below any measurement's noise."""
    batch = _Batch(requests, width, np.float32)
    opens = np.concatenate([r.windows.opens for r in requests])
    index = np.arange(len(opens))
    place = index - np.maximum.accumulate(np.where(opens, index, 0))
    first = np.cumsum([0, *batch.count])
    samples = [_Samples(r) for r in requests]
    before, state = np.flatnonzero(place == 0), None
    for k in range(int(place.max()) + 1):
        now = np.flatnonzero(place == k)
        if state is None:
            state = batch.balance(now)
        else:
            kept = np.isin(before, now - 1)
            state = jax.tree.map(lambda x, kept=kept: x[..., kept], state)
        (_, end), (_, slope), path, path_slope, _ = batch.shoot(now, state, joints, True)
        for i in np.unique(batch.of[now]):
            mine = np.flatnonzero(batch.of[now] == i)
            take = lambda x, mine=mine: x[..., mine]  # noqa: E731
            samples[i].read(now[mine] - first[i], jax.tree.map(take, path), jax.tree.map(take, path_slope))
        before, state = now, Starts(end, slope)
    return [Answer(s.predicted, s.jacobian) for s in samples]


jax.tree_util.register_dataclass(Starts, ["state", "slope"], [])


def _drive(windows: Windows, model: Model) -> Drive:
    late, left, right = None, windows.left, windows.right
    delays = [float(d) for e in model.effects if (d := e.delay_s()) is not None]
    if delays:
        left, right, slopes = windows.delayed(sum(delays))
        late = slopes[0].T, slopes[1].T
    warm, worn = (windows.warm.T, windows.worn.T) if model.effects else (None, None)
    arrays: Any = (left.T, right.T, windows.vacuum.T, None, warm, windows.t.T, worn, late)
    return Drive(*arrays)


def _where(mask: np.ndarray, yes: Starts, no: Starts) -> Starts:
    return jax.tree.map(lambda a, b: np.where(mask, a, b), yes, no)


def _tiled(kernel: Callable, arguments: Any, tile: int) -> Any:
    """A jitted kernel over arguments whose last axis is the windows, in tiles so wide, on all cores."""
    leaves = jax.tree.leaves(arguments)
    count = leaves[0].shape[-1]
    index = [np.minimum(np.arange(a, a + tile), count - 1) for a in range(0, count, tile)]

    def work(i: np.ndarray) -> Any:
        return jax.tree.map(np.asarray, kernel(*jax.tree.map(lambda x: np.ascontiguousarray(x[..., i]), arguments)))

    form = (getattr(kernel, "func", kernel), getattr(kernel, "args", ()), jax.tree.structure(arguments))
    shapes = (*form, *(x.shape[:-1] for x in leaves))
    parts = []
    if shapes not in _ready:  # compile once, not in every thread
        with _uncollected():
            parts = [work(index[0])]
        _ready.add(shapes)
    if len(index) == 1:
        parts = parts or [work(index[0])]
    else:
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            parts += pool.map(work, index[len(parts) :])
    return jax.tree.map(lambda *x: np.concatenate(x, axis=-1)[..., :count], *parts)


_ready: set[Any] = set()


@contextlib.contextmanager
def _uncollected() -> Iterator[None]:
    """Without the garbage collector, which takes a quarter of the time of tracing, and finds nothing."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()


def _options() -> dict[str, Any]:
    """Compiler options of the kernels here, which are compiled once a fit: less is optimised, and they run as fast."""
    return {**batch.options(), "xla_backend_optimization_level": 1} if batch.options() else {}


def _quick() -> dict[str, Any]:
    """Compiler options of what takes longer to compile than to run: as little work of the compiler as there is."""
    least = {"xla_backend_optimization_level": 0, "xla_cpu_use_fusion_emitters": False}
    return {**batch.options(), **least} if batch.options() else {}


def _push(f: Callable, primals: Any, tangents: Any) -> Any:
    """f at the primals, and its derivatives along tangents stacked along a new first axis."""

    def along(t: Any) -> Any:
        return jax.jvp(f, primals, t)

    return jax.vmap(along, out_axes=(None, 0))(tangents)


@partial(jax.jit, compiler_options=_quick())
def _balance(model, slopes, q, v, drive):
    """Starting states from the data, (W,), and their derivatives (k + 1, W)."""

    def f(model, q):
        def one(m, q, v, d):
            for effect in reversed(m.effects):
                q = effect.unsense(q)
            return in_balance(m, q, v, d)

        return jax.vmap(one)(model, q, v, drive)

    along = jnp.zeros_like(jax.tree.leaves(slopes)[0]).at[-1].set(1.0)
    return _push(f, (model, q), (slopes, tuple(along for _ in q)))


@partial(jax.jit, compiler_options=_quick())
def _constants(model, slopes):
    """What no step changes, and its derivatives."""
    return _push(constants, (model,), (slopes,))


def _kernel(joints: bool, onward: bool, model, slopes, *rest):
    """`_shoot`, with the constants it needs."""
    return _shoot(joints, onward, model, slopes, *_constants(model, slopes), *rest)


@partial(jax.jit, static_argnums=(0, 1), compiler_options=_options())
def _shoot(joints: bool, onward: bool, model, slopes, c, c_slopes, state, slope, drive, h):
    """Middles and ends of the windows, the path (q, v, what is seen − q) from start to end, and all derivatives."""

    how = How(2 if onward else 3, loops=True)

    def one(model, c, state, drive, h):
        return advance(model, c, state, drive, h, how)

    if model.effects or model.lever:  # which know of one robot only
        one = jax.vmap(one)  # the model itself is arithmetic on whole batches, traced sooner so

    def step(both, d):  # derivatives inside the loop, not of the loop: it is traced once
        state, slope = both
        new = _push(lambda m, c, s: one(m, c, s, d, h), (model, c, state), (slopes, c_slopes, slope))
        return new, new

    def read(first, after):
        full = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, after)
        seen = () if full.sensed is None else tuple(a - b for a, b in zip(full.sensed, full.q, strict=True))
        path = (full.q, full.v, seen)
        if not joints:
            path = tuple((sum(x) / len(x),) if x else () for x in path)
        half = len(drive.left) // 2
        middle_and_end = jax.tree.map(lambda x: x[half - 1 :: half], after)
        return tuple(jax.tree.map(lambda x, i=i: x[i], middle_and_end) for i in (0, 1)), path

    after, after_slopes = jax.lax.scan(step, (state, slope), drive)[1]
    ends, path = read(state, after)
    end_slopes, path_slopes = jax.vmap(read, in_axes=(0, 1))(slope, after_slopes)
    return ends, end_slopes, path, path_slopes


ON_STEP = 1e-6
"""The share of a step within which a sample lies on the step's start or end."""


class _Samples:
    """Predictions (N, c) and derivatives (N, c, k + 1) at the samples of a request, read off window by window.

    Where the shape is stamped late a sample shows the path that much earlier, in the window before it if need be.
    """

    def __init__(self, request: Request):
        w = self.windows = request.windows
        self.k = _derivatives(request)
        self.predicted = np.full(w.y.shape, np.nan)
        self.jacobian = np.full((*w.y.shape, self.k + 1), np.nan, np.float32 if request.onward else float)
        late = [(float(d), s.latency_s()) for e, s in _effects(request) if (d := e.latency_s()) is not None]
        self.window, self.step, self.weight, self.slope = w.window, w.step, w.weight, None
        if late:
            self.slope = np.asarray(sum(slope for _, slope in late))
            place = w.window * STEPS + w.step + w.weight
            opening = (
                np.maximum.accumulate(np.where(w.opens, np.arange(len(w)), 0)) if request.onward else np.arange(len(w))
            )
            place = np.maximum(place - sum(d for d, _ in late) / w.h, opening[w.window] * STEPS)
            self.window = np.minimum(place // STEPS, w.window).astype(int)
            self.step = np.minimum(np.floor(place - self.window * STEPS), STEPS - 1).astype(int)
            self.weight = place - self.window * STEPS - self.step

    def read(self, windows: np.ndarray, path: Any, slopes: Any) -> None:
        """Take what lies in these windows (an ascending index) from their paths (K + 1, W)."""
        (q, v, seen), (dq, dv, dseen) = path, slopes
        mine = np.flatnonzero(np.isin(self.window, windows))
        h, w = self.windows.h, self.weight[mine]
        at = self.step[mine] * len(windows) + np.searchsorted(windows, self.window[mine])
        after = at + len(windows)
        cubic = (1 - w * w * (3 - 2 * w), w * w * (3 - 2 * w), h * w * (1 - w) ** 2, h * w * w * (w - 1))
        on_steps = bool(np.all(np.minimum(w, 1 - w) < ON_STEP))
        nearest = np.where(w > 0.5, after, at)

        def pick(x: np.ndarray, index: np.ndarray) -> np.ndarray:
            return np.take(x.reshape(*x.shape[:-2], -1), index, axis=-1)

        def taken(x: np.ndarray, rate: np.ndarray, more: np.ndarray | None) -> np.ndarray:
            if on_steps:
                return pick(x, nearest) if more is None else pick(x, nearest) + pick(more, nearest)
            out = cubic[0] * pick(x, at) + cubic[1] * pick(x, after) + cubic[2] * pick(rate, at)
            out = out + cubic[3] * pick(rate, after)
            return out if more is None else out + (1 - w) * pick(more, at) + w * pick(more, after)

        none = [None] * len(q)
        width = self.k
        for c, (x, rate, more) in enumerate(zip(q, v, seen or none, strict=True)):
            self.predicted[mine, c] = taken(x, rate, more)
        for c, (x, rate, more) in enumerate(zip(dq, dv, dseen or none, strict=True)):
            keep = [*range(width), -1]
            self.jacobian[mine, c] = taken(x[keep], rate[keep], None if more is None else more[keep]).T
        if self.slope is not None:
            for c, rate in enumerate(v):
                rate = rate.reshape(-1)
                going = (1 - w) * rate[at] + w * rate[after]
                self.jacobian[mine, c, :width] -= np.outer(going, self.slope)


def _effects(request: Request) -> Any:
    return zip(request.model.effects, request.slopes.effects, strict=True)
