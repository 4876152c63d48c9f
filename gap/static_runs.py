"""Whether several logs of steady points tell of one robot: one is fitted, those that disagree are compared only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ljjax.fit.points import Points
from ljjax.logs import Run

DISAGREE = 3.0
"""Logs disagree where they differ by this many times their scatter."""


@dataclass(frozen=True, eq=False)
class Apart:
    """A log that is not fitted: its points, what the fitted log's measurements say there (NaN outside them), and the
    ratio of the two per pressure: `pressure` [kPa], `low` and `high` over its angles."""

    run: int
    name: str
    points: Points
    expected: np.ndarray
    pressure: np.ndarray
    low: np.ndarray
    high: np.ndarray

    @property
    def words(self) -> str:
        """The disagreement in a sentence."""
        worst, least = int(np.argmax(self.high)), int(np.argmin(self.low))
        at = ", ".join(
            f"{a:.2f}" + (f"–{b:.2f}" if b - a > 0.005 else "") + f" at {p:.3g} kPa"
            for p, a, b in zip(self.pressure, self.low, self.high, strict=True)
        )
        return (
            f"{self.name} is not fitted and not averaged in: it reads {self.low[least]:.2f} to {self.high[worst]:.2f} "
            f"times what the fitted log reads at the same angles and pressures ({at})"
        )


def sort(points: Points, runs: Sequence[Run]) -> tuple[Points, list[Apart]]:
    """The points to fit, of the log that has most of them and those that agree with it or have no pressure and angle in
    common with it to compare at, and the logs that do not agree."""
    if not len(points):
        return points, []
    ids, counts = np.unique(points.run, return_counts=True)
    order = ids[np.argsort(-counts, kind="stable")]
    kept, apart = points.run == order[0], []
    for run in order[1:]:
        first, other = points.take(kept), points.take(points.run == run)
        expected = between(first, other)
        known = np.isfinite(expected)
        difference = (other.value - expected)[known]
        one, two = (p.scatter or roughness(p) for p in (first, other))
        scatter = float(np.hypot(one, two))
        if not len(difference) or np.sqrt(np.mean(difference**2)) <= DISAGREE * max(scatter, 1e-9):
            kept |= points.run == run
            continue
        ratio = np.where(known & (np.abs(expected) > 0), other.value / np.where(known, expected, 1.0), np.nan)
        levels = [k for k in np.unique(other.levels) if np.any(np.isfinite(ratio[other.levels == k]))]
        of = [ratio[(other.levels == k) & np.isfinite(ratio)] for k in levels]
        pressure = np.array([other.pressure_kpa[other.levels == k].mean() for k in levels])
        low, high = np.array([r.min() for r in of]), np.array([r.max() for r in of])
        apart.append(Apart(int(run), runs[int(run)].run_id, other, expected, pressure, low, high))
    return points.take(kept), apart


def between(first: Points, other: Points) -> np.ndarray:
    """(N,) what the points `first` say at those of `other`: linear over angle at the same pressure; NaN elsewhere."""
    out = np.full(len(other), np.nan)
    levels, pressures = first.levels, first.level_pressures()
    for i in range(len(other)):
        near = int(np.argmin(np.abs(pressures - other.pressure_kpa[i])))
        if abs(pressures[near] - other.pressure_kpa[i]) > 0.5:
            continue
        mine = np.flatnonzero(levels == near)
        mine = mine[np.argsort(first.theta[mine])]
        angle = first.theta[mine]
        if len(mine) == 1 and abs(angle[0] - other.theta[i]) < 1e-6:
            out[i] = first.value[mine[0]]
        elif len(mine) > 1 and angle[0] - 1e-6 <= other.theta[i] <= angle[-1] + 1e-6:
            out[i] = np.interp(other.theta[i], angle, first.value[mine])
    return out


def roughness(points: Points) -> float:
    """Standard deviation of points at one pressure about their neighbours in angle; 0 where there are too few."""
    found = []
    for level in np.unique(points.levels):
        mine = np.flatnonzero(points.levels == level)
        mine = mine[np.argsort(points.theta[mine])]
        t, v = points.theta[mine], points.value[mine]
        for i in range(1, len(mine) - 1):
            if t[i + 1] > t[i - 1]:
                w = (t[i + 1] - t[i]) / (t[i + 1] - t[i - 1])
                found.append((v[i] - w * v[i - 1] - (1 - w) * v[i + 1]) ** 2 / (1 + w**2 + (1 - w) ** 2))
    return float(np.sqrt(np.median(found) / 0.455)) if len(found) > 2 else 0.0  # kinks and bends do not count


__all__ = ["Apart", "between", "roughness", "sort"]
