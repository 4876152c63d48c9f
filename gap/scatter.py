"""A delay that is another one for every frame: what of a leftover that accounts for.

No fit foretells a delay d + δ whose δ is drawn by chance, frame by frame or spell by spell. It leaves errors −ẏ δ:
along the rate ẏ of the shape as it is logged, of a variance s² ẏ² beside the noise's, the same s slow and fast, bent
and straight, and in every run; and δ is 0 on average, whichever way the shape goes. What of the errors' squares keeps
to that is the scatter's; what does not is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ljjax.effect import Effect
from ljjax.fit.problem import Estimate
from ljjax.gap.screening import rates

MOST = 0.6
"""The standard deviation of a delay at most, as a share of it: one that is 0 mostly and long at times is no delay."""
ITERATIONS, BINS = 20, 8
"""Of the search for the standard deviation; and groups of as many samples each, by the rate and by the bend."""


@dataclass(frozen=True)
class Scatter:
    """A scattered delay: its standard deviation [s], and the share of what is left that is not the scatter's."""

    sd_s: float
    left: float


NO_SCATTER = Scatter(0.0, 1.0)


def scatter(
    estimate: Estimate,
    effects: Sequence[Effect],
    unit: np.ndarray,
    noise: np.ndarray,
    runs: np.ndarray | None = None,
    most_s: float = np.inf,
) -> Scatter:
    """How the latency of effects, if they have one, scatters in the runs of an estimate.

    Args:
        unit, noise: (c,) of the residuals, and standard deviation of the white noise [rad].
        runs: (R,) which of the runs are asked; all by default.
        most_s: its standard deviation at most [s].
    """
    delays = [d for e in effects if (d := e.latency_s()) is not None]
    w = estimate.windows
    asked = slice(None) if runs is None else runs[w.sample_run]
    error, predicted, run = estimate.error[asked], w.shape(estimate.predicted)[asked], w.sample_run[asked]
    if not delays or not len(error) or not np.all(np.isfinite(error)):
        return NO_SCATTER
    c = predicted.shape[1]  # the tip beside the shape is not late
    floor = noise / unit
    whole = float(np.sum((error / unit) ** 2) - len(error) * np.sum(floor**2))
    rate = rates(w.sample_t[asked], predicted, run) / unit[:c]
    square = np.sum(rate**2, axis=1)
    along = np.sum(error[:, :c] / unit[:c] * rate, axis=1)
    size = np.maximum(square, 1e-12)
    noisy = np.sum((rate * floor[:c]) ** 2, axis=1) / size
    more, s2 = along**2 / size - noisy, 0.0
    most = min(MOST * max(float(sum(delays)), 0.0), most_s) ** 2
    for _ in range(ITERATIONS):  # by the likelihood of squares, of which large ones are the less certain
        weight = square / np.maximum(noisy + s2 * square, 1e-12) ** 2
        s2 = float(np.clip(weight @ more / max(weight @ square, 1e-300), 0.0, most))
    if s2 == 0 or whole <= 0:
        return NO_SCATTER
    bend = predicted.mean(axis=1)
    way = 2 * (bend > 0) + (rate.sum(axis=1) > 0)
    amiss = max(np.abs(np.bincount(g, more - s2 * square)).sum() for g in (_binned(square), _binned(np.abs(bend)), run))
    steady = max(np.sum(np.bincount(g, along) ** 2 / np.maximum(np.bincount(g, square), 1e-12)) for g in (way, run))
    across = max(whole - float(more.sum()), 0.0)
    return Scatter(s2**0.5, min((across + float(amiss) + float(steady)) / whole, 1.0))


def _binned(x: np.ndarray) -> np.ndarray:
    """(N,) the group of each value, of `BINS` of as many."""
    return np.searchsorted(np.quantile(x, np.linspace(0, 1, BINS + 1)[1:-1]), x)
