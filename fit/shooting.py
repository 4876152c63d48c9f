"""Windows of many runs, robots and restarts simulated side by side, with their sensitivities, on one compiled kernel.

Every window starts from a state of its own: from the data (multiple shooting), or from the end of the window before it
(a free run, whose windows then agree where they meet). States and their derivatives by the parameters travel together.
Where enough runs go side by side to fill a batch, free runs go on window after window and meet by themselves.
Whatever asks for windows is a generator that yields a `Request` and is sent an `Answer`; `together` runs many of them
in step, so that their windows fill one batch.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import jax
import numpy as np

from ljjax.effect import acting
from ljjax.fit import native
from ljjax.fit.kernel import balance, on_all_cores, onward, shoot, tiled
from ljjax.fit.samples import Samples, derivatives, read
from ljjax.fit.windows import Logged, Windows
from ljjax.model import Model
from ljjax.step import Drive, Unrolled

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
        form = jax.tree.structure(r.model), _padded(r), r.windows.logged, r.onward, r.windows.h
        groups.setdefault(form, []).append(i)
    answers: list[Any] = [None] * len(parts)
    for (_, width, logged, free, _), members in groups.items():
        members.sort(key=lambda i: derivatives(parts[i]))  # so that tiles have as many as they need
        asked = [parts[i] for i in members]
        found = _onward(asked, width, logged) if free else _answer(asked, width, logged)
        for i, answer in zip(members, found, strict=True):
            answers[i] = answer
    rest = iter(answers)
    return [_whole([next(rest) for _ in own]) for own in split]


LEAST, WIDER, ACROSS = 20, 8, 8
"""Derivatives that a kernel takes with effects, so that candidates share one compilation: of windows so many at least
and in steps of so many; of free runs so many, and the others beside them in the batch."""


def _padded(request: Request) -> int:
    """How many derivatives the kernel takes; 0 for as many as there are."""
    k = derivatives(request)
    if request.onward:
        return 0 if native.available() else ACROSS
    return LEAST + WIDER * max(0, math.ceil((k - LEAST) / WIDER)) if request.model.effects else k


def _parts(request: Request) -> list[Request]:
    """A request, or the requests for some of its derivatives each that a kernel can take."""
    if not request.onward or derivatives(request) <= ACROSS or native.available():
        return [request]
    places = range(0, derivatives(request), ACROSS)
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
        self.slopes = jax.tree.map(partial(_padded_to, width + 1), *(r.slopes for r in requests))
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

    def data(self, windows: Any) -> tuple[Any, Any, Any]:
        """Shapes, rates and first drives of these windows, from the data."""
        return jax.tree.map(lambda x: x[..., windows], (self.q, self.v, jax.tree.map(lambda x: x[0], self.drive)))

    def driven(self, windows: Any) -> tuple[Any, Any]:
        """What drives these windows, and the lengths of their steps."""
        return jax.tree.map(lambda x: x[..., windows], (self.drive, self.h))

    def balance(self) -> Starts:
        """Where all windows start from the data."""
        every = slice(None)
        return Starts(*tiled(balance, (*self.robots(every), *self.data(every)), TILE))

    def shoot(self, starts: Starts, logged: Logged) -> Any:
        """All windows from `starts`: middles and ends, path, their derivatives, and `Answer.passed`."""
        every = slice(None)
        (model, slopes), slope = self.robots(every), starts.slope
        slopes = jax.tree.map(lambda x: np.concatenate([x, np.zeros_like(x[:2])]), slopes)
        slope = jax.tree.map(lambda *x: np.concatenate(x), slope, _alike(slope))
        given = model, slopes, starts.state, slope, *self.driven(every)
        ends, end_slopes, path, path_slopes = tiled(partial(shoot, logged), given, TILE)
        passed = np.stack([np.stack([y[-2:] for y in x], axis=1) for x in (end_slopes[1].q, end_slopes[1].z)])
        end_slopes, path_slopes = jax.tree.map(lambda s: s[:-2], (end_slopes, path_slopes))
        return ends, end_slopes, path, path_slopes, passed


def _padded_to(length: int, *slopes: np.ndarray) -> np.ndarray:
    """(length, requests) of one leaf's slopes, no longer each, zeros after them."""
    out = np.zeros((length, len(slopes)))
    for i, x in enumerate(slopes):
        out[: len(x), i] = x
    return out


def _alike(slope: Unrolled) -> Unrolled:
    """Derivatives (2, W) of a start where all joints turn alike, and where all bristles stretch alike."""
    zero = jax.tree.map(lambda s: np.zeros((2, *s.shape[1:]), s.dtype), slope)
    turned, stretched = (tuple(x + np.eye(2, dtype=x.dtype)[:, [row]] for x in zero.q) for row in (0, 1))
    return zero._replace(q=turned, z=stretched, sensed=None if zero.sensed is None else turned)


def _answer(requests: Sequence[Request], width: int, logged: Logged) -> list[Answer]:
    batch = _Batch(requests, width)
    used = batch.balance()
    parts = np.cumsum([0, *batch.count])
    if any(r.starts is not None for r in requests):
        given = []
        for r, a, b in zip(requests, parts[:-1], parts[1:], strict=True):
            opening = jax.tree.map(lambda x, a=a, b=b: x[..., a:b], used)
            given.append(opening if r.starts is None else _where(r.windows.opens, opening, r.starts))
        used = jax.tree.map(lambda *x: np.concatenate(x, axis=-1), *given)
    (middle, end), (middle_slope, end_slope), path, path_slope, passed = batch.shoot(used, logged)
    samples, every = [Samples(r) for r in requests], np.arange(parts[-1])
    read(samples, every, batch.of, every - parts[batch.of], path, path_slope)
    answers = []
    for s, a, b in zip(samples, parts[:-1], parts[1:], strict=True):

        def own(tree: Any, part: slice = slice(a, b)) -> Any:
            return jax.tree.map(lambda x: x[..., part], tree)

        half, last = Starts(own(middle), own(middle_slope)), Starts(own(end), own(end_slope))
        answers.append(Answer(s.predicted, s.jacobian, own(used), half, last, own(passed)))
    return answers


def _onward(requests: Sequence[Request], width: int, logged: Logged) -> list[Answer]:
    """Free runs, in tiles of many, each through all its windows one after the other; in float32, whose rounding is far
    below any measurement's noise."""
    count = np.array([width or derivatives(r) for r in requests])
    batch = _Batch(requests, int(count.max()), np.float32)
    opens = np.flatnonzero(np.concatenate([r.windows.opens for r in requests]))
    last = np.append(opens[1:], len(batch.of)) - 1
    first = np.cumsum([0, *batch.count])
    samples = [Samples(r) for r in requests]
    wide = NARROW
    if not width:  # a tile for every core, of two blocks at most
        wide = native.LANES * min(math.ceil(len(opens) / native.LANES / (os.cpu_count() or 1)), 2)

    def tile(begin: int) -> None:
        runs = np.arange(begin, begin + wide)
        real, runs = runs < len(opens), np.minimum(runs, len(opens) - 1)
        at, until = opens[runs], last[runs]
        of, (model, slopes) = batch.of[at], batch.robots(at)
        asked = [*range(count[of].max()), -1]
        state, slope, shoot_on = onward(logged, model, jax.tree.map(lambda s: s[asked], slopes), batch.data(at))
        for _ in range(int(np.max(until - at)) + 1):
            state, slope, *paths = shoot_on(state, slope, *batch.driven(at))
            mine = np.flatnonzero(real)
            read(samples, mine, of[mine], at[mine] - first[of[mine]], *paths)
            real, at = real & (at < until), np.minimum(at + 1, until)

    form = "onward", jax.tree.structure(batch.model), logged, width, len(batch.q)
    on_all_cores(tile, range(0, len(opens), wide), form)
    return [Answer(s.predicted, s.jacobian) for s in samples]


jax.tree_util.register_dataclass(Starts, ["state", "slope"], [])


def _drive(windows: Windows, model: Model) -> Drive:
    late, left, right = None, windows.left, windows.right
    delays = [float(delay_s()) for _, delay_s in acting(model.effects, "delay_s")]
    if delays:
        left, right, slopes = windows.delayed(sum(delays)) if sum(delays) else windows.undelayed
        late = slopes[0].T, slopes[1].T
    warm, worn = (windows.warm.T, windows.worn.T) if model.effects else (None, None)
    arrays: Any = (left.T, right.T, windows.vacuum.T, None, warm, windows.t.T, worn, late)
    return Drive(*arrays)


def _where(mask: np.ndarray, yes: Starts, no: Starts) -> Starts:
    return jax.tree.map(lambda a, b: np.where(mask, a, b), yes, no)
