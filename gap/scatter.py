"""A delay that is another one for every frame: what of a leftover that accounts for.

No fit foretells a delay d + δ whose δ is drawn by chance, frame by frame or spell by spell. It leaves errors −ẏ δ:
along the rate ẏ of what is measured, of a variance s² ẏ² beside the noise's, the same s slow and fast, bent and
straight, and in every run. What of the errors' squares keeps to that is the scatter's; what does not is left.
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


@dataclass(frozen=True)
class Scatter:
    """A scattered delay: its standard deviation [s], and the share of what is left that is not the scatter's."""

    sd_s: float
    left: float


NO_SCATTER = Scatter(0.0, 1.0)


def scatter(estimate: Estimate, effects: Sequence[Effect], unit: np.ndarray, noise: np.ndarray) -> Scatter:
    """How the latency of effects, if they have one, scatters in the runs of an estimate.

    Args:
        unit, noise: (c,) of the residuals, and standard deviation of the white noise [rad].
    """
    delays = [d for e in effects if (d := e.latency_s()) is not None]
    if not delays or not np.all(np.isfinite(estimate.error)):
        return NO_SCATTER
    along, whole, square, floor = _parts(estimate, unit, noise)
    more, s2, most = along - floor, 0.0, (MOST * sum(map(float, delays))) ** 2
    for _ in range(ITERATIONS):  # by the likelihood of squares, of which large ones are the less certain
        weight = square / np.maximum(floor + s2 * square, 1e-12) ** 2
        s2 = float(np.clip(weight @ more / max(weight @ square, 1e-300), 0.0, most))
    if s2 == 0 or whole.sum() <= 0:
        return NO_SCATTER
    bend = np.abs(estimate.predicted.mean(axis=1))
    groups = _binned(square), _binned(bend), estimate.windows.sample_run
    amiss = max(float(np.abs(np.bincount(g, more - s2 * square)).sum()) for g in groups)
    across = max(float(whole.sum() - more.sum()), 0.0)
    return Scatter(s2**0.5, min((across + amiss) / float(whole.sum()), 1.0))


def _parts(estimate: Estimate, unit: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, ...]:
    """(N,) in units of the residuals: squares of the errors along the rate, of all of them beyond the noise, of the
    rate [1/s²], and of the noise along it."""
    w = estimate.windows
    error, rate = estimate.error / unit, rates(w.sample_t, estimate.predicted, w.sample_run) / unit
    square = np.sum(rate**2, axis=1)
    size = np.maximum(square, 1e-12)
    floor = np.sum(rate**2 * (noise / unit) ** 2, axis=1) / size
    whole = np.sum(error**2, axis=1) - np.sum((noise / unit) ** 2)
    return np.sum(error * rate, axis=1) ** 2 / size, whole, square, floor


def _binned(x: np.ndarray) -> np.ndarray:
    return np.searchsorted(np.quantile(x, np.linspace(0, 1, BINS + 1)[1:-1]), x)
