"""Where the gap lies: along pressure, angle, rate, direction, load, time, run and segment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ljjax.fit.problem import Estimate
from ljjax.gap.result import Region
from ljjax.logs import started_ns

UNITS = {
    "pressure": "kPa",
    "angle": "rad",
    "rate": "rad/s",
    "direction": "1",
    "load": "N",
    "time": "s",
    "run": "1",
    "segment": "1",
    "everywhere": "1",
}
BINS = 30
"""An axis is cut into so many bins of equally many samples; each of no more values than that is a bin of its own."""
SMOOTH_S = 0.09
"""Angles are smoothed over such a time, nine samples at least, before their rate is taken."""
HOLDS = (0.9, 0.75, 0.6)
"""A range is the shortest that holds so much of the gap: on the axis where an effect shows most plainly, on others."""


def coordinates(found: Estimate) -> dict[str, np.ndarray]:
    """(N,) where each sample lies along every axis but `segment`."""
    windows = found.windows
    motions = found.problem.motions
    theta = windows.shape(windows.y).mean(axis=1)
    out = {name: np.zeros(len(theta)) for name in UNITS if name not in ("segment", "everywhere")}
    first = min(started_ns(m.run) for m in motions)
    for i, m in enumerate(motions):
        mine = np.flatnonzero(windows.sample_run == i)
        t = windows.sample_t[mine]
        index = np.clip(np.searchsorted(m.input_t, t, side="right") - 1, 0, len(m.input_t) - 1)
        width = max(4, round(0.5 * SMOOTH_S / np.median(np.diff(t)))) * 2 + 1
        smooth = np.convolve(np.pad(theta[mine], width // 2, mode="edge"), np.ones(width) / width, mode="valid")
        rate = np.gradient(smooth, t)
        out["pressure"][mine] = m.vacuum[index]
        out["angle"][mine] = smooth
        out["rate"][mine] = np.abs(rate)
        out["direction"][mine] = np.where(np.abs(rate) < 0.005, 0.0, np.sign(rate * smooth))
        out["load"][mine] = np.abs(m.tendons[index, 0] - m.tendons[index, 1])
        out["time"][mine] = (started_ns(m.run) - first) * 1e-9 + t
        out["run"][mine] = i
    return out


def _binned(place: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The bin of each of samples along an axis (N,), and where each of B bins begins and ends (B,)."""
    values, index = np.unique(place, return_inverse=True)
    if len(values) <= BINS:
        return index, values, values
    edges = np.unique(np.quantile(place, np.linspace(0, 1, BINS + 1)))
    return np.clip(np.searchsorted(edges, place, side="right") - 1, 0, len(edges) - 2), edges[:-1], edges[1:]


def region(
    block: str, channel: str, axis: str, place: np.ndarray | None, gap: np.ndarray, share: float, holds: float
) -> Region:
    """The shortest range of an axis that holds so much of a gap (N, c), `place` (N,) its samples along it; `share` is
    the gap's own in the whole."""
    squared = gap**2
    if axis == "everywhere" or not squared.sum():
        return Region(block, channel, axis, (0.0, 0.0), UNITS[axis], share)
    if axis == "segment" or place is None:
        weight = squared.sum(axis=0)
        low, high, held = _shortest(weight, np.ones(len(weight)), holds)
        return Region(block, channel, "segment", (low + 1.0, high + 1.0), "1", share * held)
    index, begin, end = _binned(place)
    weight = np.bincount(index, squared.sum(axis=1), len(begin))
    low, high, held = _shortest(weight, end - begin if np.any(end > begin) else np.ones(len(begin)), holds)
    return Region(block, channel, axis, (float(begin[low]), float(end[high])), UNITS[axis], share * held)


def _shortest(weight: np.ndarray, width: np.ndarray, holds: float) -> tuple[int, int, float]:
    """First and last bin of the shortest stretch that holds so much of the weight, and what it holds."""
    best = (0, len(weight) - 1)
    for a in range(len(weight)):
        total = np.cumsum(weight[a:])
        enough = np.flatnonzero(total >= holds * weight.sum())
        if len(enough):
            b = a + int(enough[0])
            if width[a : b + 1].sum() < width[best[0] : best[1] + 1].sum():
                best = (a, b)
    return best[0], best[1], float(weight[best[0] : best[1] + 1].sum() / weight.sum())


def concentration(place: np.ndarray, gap: np.ndarray) -> float:
    """How much more of a gap (N, c) some bins of an axis hold than others: share of its squares' variance explained."""
    squared = (gap**2).sum(axis=1)
    if not squared.var():
        return 0.0
    index, begin, _ = _binned(place)
    count = np.bincount(index, minlength=len(begin))
    mean = np.bincount(index, squared, len(begin)) / np.maximum(count, 1)
    return float(np.sum(count * (mean - squared.mean()) ** 2) / (len(squared) * squared.var()))


class Contribution(NamedTuple):
    """What an effect changes: its block, its axes, the plainest first, its part `c` (N, c) of what is measured, and
    `joints` (M, n), of every joint's angle, where those say more of the segments than what is measured."""

    block: str
    axes: Sequence[str]
    c: np.ndarray
    joints: np.ndarray | None = None


def places(found: Estimate, channel: str, contributions: Sequence[Contribution]) -> list[Region]:
    """Regions of what effects contribute, the largest share first; everywhere, which holds all, only where no axis
    shows it more plainly, and any other axis only where part of it holds less than the plainer one's range."""
    along = coordinates(found)
    total = sum(float((x.c**2).sum()) for x in contributions) or 1.0
    out = []
    for block, axes, c, joints in contributions:
        share, least = float((c**2).sum()) / total, np.inf
        shown = axes if axes[0] == "everywhere" else [a for a in axes if a != "everywhere"]
        for axis, holds in zip(shown, HOLDS, strict=False):
            seen = c if axis != "segment" or joints is None else joints
            here = region(block, channel, axis, along.get(axis), seen, share, holds)
            if here.share < least:
                out.append(here)
                least = here.share
    return sorted(out, key=lambda r: -r.share)


def loudest(found: Estimate, gap: np.ndarray) -> list[str]:
    """Axes along which a gap (N, c) is most concentrated, the first the most."""
    along = coordinates(found)
    return sorted(along, key=lambda axis: -concentration(along[axis], gap))
