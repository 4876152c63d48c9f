"""What samples should read, taken from simulated paths window by window."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from ljjax.fit.windows import STEPS

if TYPE_CHECKING:
    from ljjax.fit.shooting import Request

ON_STEP = 1e-6
"""The share of a step within which a sample lies on the step's start or end."""


def derivatives(request: Request) -> int:
    """By how many coordinates a request asks for derivatives."""
    return jax.tree.leaves(request.slopes)[0].shape[0]


class Samples:
    """Predictions (N, c) and derivatives (N, c, k + 1) at the samples of a request, read off window by window.

    Where the shape is stamped late a sample shows the path that much earlier, in the window before it if need be.
    """

    def __init__(self, request: Request):
        w = self.windows = request.windows
        self.k = derivatives(request)
        self.predicted = np.full(w.y.shape, np.nan)
        self.jacobian = np.full((*w.y.shape, self.k + 1), np.nan, np.float32 if request.onward else float)
        late = [(float(d), s.latency_s()) for e, s in _effects(request) if (d := e.latency_s()) is not None]
        latency, self.slope = sum(d for d, _ in late), np.asarray(sum(slope for _, slope in late)) if late else None
        self.window, self.step, self.weight = w.window, w.step, w.weight
        if latency:
            place = w.window * STEPS + w.step + w.weight
            opening = (
                np.maximum.accumulate(np.where(w.opens, np.arange(len(w)), 0)) if request.onward else np.arange(len(w))
            )
            place = np.maximum(place - latency / w.h, opening[w.window] * STEPS)
            self.window = np.minimum(place // STEPS, w.window).astype(int)
            self.step = np.minimum(np.floor(place - self.window * STEPS), STEPS - 1).astype(int)
            self.weight = place - self.window * STEPS - self.step
        self.order, self.bounds = w.order_of(self.window) if latency else w.order

    def read(self, windows: np.ndarray, path: Any, slopes: Any) -> None:
        """Take what lies in these windows (an index) from their paths (K + 1, W)."""
        (q, v, seen), (dq, dv, dseen) = path, slopes
        a, b = self.bounds[windows], self.bounds[windows + 1]
        mine = np.concatenate([self.order[i:j] for i, j in zip(a, b, strict=True)])
        h, w = self.windows.h, self.weight[mine]
        at = self.step[mine] * len(windows) + np.repeat(np.arange(len(windows)), b - a)
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
