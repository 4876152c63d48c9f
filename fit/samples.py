"""What samples should read, taken from simulated paths window by window."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from ljjax.effect import acting
from ljjax.fit.windows import STEPS

if TYPE_CHECKING:
    from ljjax.fit.shooting import Request

ON_STEP = 1e-6
"""The share of a step within which a sample lies on the step's start or end."""


def derivatives(request: Request) -> int:
    """By how many coordinates a request asks for derivatives."""
    return jax.tree.leaves(request.slopes)[0].shape[0]


@dataclass(frozen=True, eq=False)
class _Places:
    """Where samples lie: columns `rows` of what is compared, (N,) window, step in it, fraction of the step, and the
    samples window by window (`Windows.order_of`)."""

    rows: slice
    window: np.ndarray
    step: np.ndarray
    weight: np.ndarray
    order: np.ndarray
    bounds: np.ndarray

    def within(self, window: int) -> np.ndarray:
        """The samples (an index) that lie in one window."""
        return self.order[self.bounds[window] : self.bounds[window + 1]]


class Samples:
    """Predictions (N, c) and derivatives (N, c, k + 1) at the samples of a request, which `read` fills.

    Where the shape is stamped late a sample shows the path that much earlier, in the window before it if need be, and
    later where it is stamped early; what the tip's pose says beside it is not late.
    """

    def __init__(self, request: Request):
        w = self.windows = request.windows
        self.k = derivatives(request)
        self.predicted = np.full(w.y.shape, np.nan)
        self.jacobian = np.full((*w.y.shape, self.k + 1), np.nan, np.float32 if request.onward else float)
        effects, moved = request.model.effects, request.slopes.effects
        late = [(float(latency()), _along(effects[k], moved[k])) for k, latency in acting(effects, "latency_s")]
        latency, self.slope = sum(d for d, _ in late), np.asarray(sum(slope for _, slope in late)) if late else None
        self.shape = shape = w.shape(w.y).shape[1]
        every = w.y.shape[1]
        self.places = [_Places(slice(0, every), w.window, w.step, w.weight, *w.order)]
        if latency:
            place = w.window * STEPS + w.step + w.weight
            first = last = np.arange(len(w))  # the windows that a path goes on through
            if request.onward:
                first, ends = np.maximum.accumulate(np.where(w.opens, first, 0)), np.append(w.opens[1:], True)
                last = np.minimum.accumulate(np.where(ends, last, len(w))[::-1])[::-1]
            first, last = first[w.window], last[w.window]
            place = np.clip(place - latency / w.h, first * STEPS, (last + 1) * STEPS)
            window = np.minimum(place // STEPS, last).astype(int)
            step = np.minimum(np.floor(place - window * STEPS), STEPS - 1).astype(int)
            late_places = _Places(slice(0, shape), window, step, place - window * STEPS - step, *w.order_of(window))
            self.places = [late_places, replace(self.places[0], rows=slice(shape, every))][: 1 + (every > shape)]


def read(samples: Sequence[Samples], lanes: np.ndarray, of: np.ndarray, windows: np.ndarray, path: Any, slopes: Any):
    """Take what lies in these windows of samples (`of` says whose, and does not fall) from these lanes of the paths
    (K + 1, W), where all steps are as long."""
    for k in range(max(len(s.places) for s in samples)):
        some = np.flatnonzero([len(samples[i].places) > k for i in of])
        for rows in {samples[i].places[k].rows.start: samples[i].places[k].rows for i in of[some]}.values():
            same = some[[samples[i].places[k].rows == rows for i in of[some]]]
            _read(samples, k, rows, lanes[same], of[same], windows[same], path, slopes)


def _read(
    samples: Sequence[Samples],
    k: int,
    rows: slice,
    lanes: np.ndarray,
    of: np.ndarray,
    windows: np.ndarray,
    path: Any,
    slopes: Any,
):
    """`read` for the `k`-th of the samples' places, which are of these rows."""
    (q, v, seen), (dq, dv, dseen) = ([x[rows] for x in part] for part in (path, slopes))
    mine = [samples[i].places[k].within(w) for i, w in zip(of, windows, strict=True)]
    lane = np.repeat(lanes, [len(m) for m in mine])
    steps, w = (
        np.concatenate([getattr(samples[i].places[k], x)[m] for i, m in zip(of, mine, strict=True)])
        for x in ("step", "weight")
    )
    at = steps * q[0].shape[-1] + lane
    after = at + q[0].shape[-1]
    on_steps = bool(np.all(np.minimum(w, 1 - w) < ON_STEP))
    nearest = np.where(w > 0.5, after, at)
    w = w.astype(q[0].dtype)
    h = w.dtype.type(samples[of[0]].windows.h)
    cubic = (1 - w * w * (3 - 2 * w), w * w * (3 - 2 * w), h * w * (1 - w) ** 2, h * w * w * (w - 1))

    def pick(x: np.ndarray, index: np.ndarray) -> np.ndarray:
        return np.take(x.reshape(*x.shape[:-2], -1), index, axis=-1)

    def taken(x: np.ndarray, rate: np.ndarray, more: np.ndarray | None) -> np.ndarray:
        if on_steps:
            return pick(x, nearest) if more is None else pick(x, nearest) + pick(more, nearest)
        out = cubic[0] * pick(x, at) + cubic[1] * pick(x, after) + cubic[2] * pick(rate, at)
        out += cubic[3] * pick(rate, after)
        return out if more is None else out + (1 - w) * pick(more, at) + w * pick(more, after)

    none = [None] * len(q)
    value = np.stack([taken(*x) for x in zip(q, v, seen or none, strict=True)])
    derived = np.stack([taken(*x) for x in zip(dq, dv, dseen or none, strict=True)])
    begin = 0
    for i in dict.fromkeys(of.tolist()):
        s, own = samples[i], np.concatenate([m for m, o in zip(mine, of, strict=True) if o == i])
        part = slice(begin, begin := begin + len(own))
        s.predicted[own, rows] = value[:, part].T
        keep = slice(None) if derived.shape[1] == s.k + 1 else [*range(s.k), -1]
        slope = derived[:, keep, part].transpose(2, 0, 1)
        if s.slope is not None and k == 0:
            rate = np.stack([(1 - w[part]) * pick(x, at[part]) + w[part] * pick(x, after[part]) for x in v])
            if seen:
                rate += np.stack([(pick(x, after[part]) - pick(x, at[part])) / h for x in seen])
            rate[s.shape :] = 0.0
            slope[..., :-1] -= rate.T[..., None] * s.slope
        s.jacobian[own, rows] = slope


_latency_slopes = jax.jit(jax.grad(lambda effect: effect.latency_s()))


def _along(effect: Any, slopes: Any) -> np.ndarray:
    """(k,) derivatives of an effect's latency by coordinates, from those of its parameters."""
    moved = jax.tree.leaves(slopes)
    if not any(np.any(x) for x in moved):
        return np.zeros_like(moved[0])
    return np.asarray(sum(float(d) * x for d, x in zip(jax.tree.leaves(_latency_slopes(effect)), moved, strict=True)))
