"""What a reader of a diagnosis of steady data must know: what closes, what stays unexplained, what to beware of."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import stats

from ljjax.errors import InputError
from ljjax.fit.points import beware_of
from ljjax.gap.static_stage import Channel
from ljjax.logs import Run
from ljjax.model import Model, check

RESAMPLES = 2000


def closing(c: Channel, seed: int) -> tuple[float | None, tuple[float, float] | None]:
    """Closed fraction at left-out pressures and its 95 % interval over the pressures, drawn anew."""
    inner = c.inner
    before, after, floor = c.base.rms(inner), c.model.rms(inner), c.noise
    if not before > 1.1 * floor:
        return None, None
    levels = c.points.levels
    which = np.unique(levels[inner])
    sums = np.array([[np.sum(e.left_out[inner & (levels == k)] ** 2) for k in which] for e in (c.base, c.model)])
    counts = np.array([np.sum(inner & (levels == k)) for k in which])
    drawn = np.random.default_rng(seed).integers(0, len(which), size=(RESAMPLES, len(which)))
    b, a = (s[drawn].sum(axis=1) / counts[drawn].sum(axis=1) for s in sums)
    keep = b > 1.21 * floor**2
    closed = 1 - (a[keep] - floor**2) / (b[keep] - floor**2)
    whole = 1 - (after**2 - floor**2) / (before**2 - floor**2)
    low, high = np.quantile(closed, [0.025, 0.975]) if np.any(keep) else (float("nan"), float("nan"))
    return float(whole), (float(min(low, whole)), float(max(high, whole)))


def starts(c: Channel, error: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where the line through each pressure's errors meets θ = 0 (L,), and its standard deviation (L,)."""
    at, sd = [], []
    for k in range(c.points.levels.max() + 1):
        mine = c.points.levels == k
        theta, e = c.points.theta[mine], error[mine]
        if len(theta) < 4 or np.ptp(theta) < 1e-6:
            at.append(np.nan)
            sd.append(np.nan)
            continue
        design = np.stack([np.ones(len(theta)), theta], axis=1)
        found = np.linalg.lstsq(design, e, rcond=None)[0]
        rest = e - design @ found
        cov = np.linalg.inv(design.T @ design) * max(rest @ rest / (len(theta) - 2), 1e-300)
        at.append(found[0])
        sd.append(np.sqrt(cov[0, 0]))
    return np.array(at), np.array(sd)


def unexplained(found: Any) -> list[str]:
    """What the final model leaves, in words and numbers."""
    out = []
    for c in found.channels:
        error = c.model.error
        rms = float(np.sqrt(np.mean(error**2)))
        out.append(
            f"{c.kind} points: {rms:.3g} {c.unit} RMS remain in the fit, {rms / c.noise:.2g} times the measurements' "
            f"scatter of {c.noise:.3g} {c.unit}"
        )
        if c.kind != "steady":
            continue
        at, sd = starts(c, error)
        pressures = c.points.level_pressures()
        known = np.isfinite(at)
        if known.sum() < 3 or np.sqrt(np.nanmean((at / sd) ** 2)) < 2:
            continue
        line: Any = stats.linregress(pressures[known], at[known])
        slope, r, p = float(line.slope), float(line.rvalue), float(line.pvalue)
        listed = ", ".join(f"{a:+.2f} at {q:.3g} kPa" for a, q in zip(at[known], pressures[known], strict=True))
        trend = (
            f"they {'fall' if slope < 0 else 'rise'} with pressure by {abs(slope) * np.ptp(pressures):.2g} N over "
            f"{np.ptp(pressures):.3g} kPa (r = {r:.2f})"
            if p < 0.1
            else "without a trend over pressure"
        )
        out.append(
            "the intercepts of tension over angle are not explained: the lines through each pressure's points meet "
            f"θ = 0 off the model by {listed} [N]; {trend}"
        )
    out += [a.words for a in found.apart]
    return out


def beware(found: Any, main: Channel, runs: Sequence[Run], said: Sequence[str], model: Model) -> list[str]:
    """One line for each thing that a reader must know, from the search and the logs."""
    out = beware_of(runs, said)
    for c in found.channels:
        if c is main:
            continue
        closed, _ = closing(c, found.seed)
        if not c.added and closed is not None and abs(closed) < 0.05:
            closed = None
        out.append(
            f"{c.kind}: error at left-out pressures {c.base.rms():.3g} {c.unit} with the base model, "
            f"{c.model.rms():.3g} with {' and '.join(found.selected) or 'no effect'} (scatter {c.noise:.3g})"
            + (f"; {100 * min(closed, 1.0):z.0f} % closed at inner pressures" if closed is not None else "")
        )
    out += [f"unexplained: {line}" for line in unexplained(found)]
    inner = np.unique(main.points.levels[main.inner])
    if found.selected and len(inner) < 6:
        out.append(f"the interval of the closed fraction rests on {len(inner)} pressures only")
    for c in found.channels:
        if np.any(c.points.hold):
            out.append(
                f"{int(np.sum(c.points.hold))} steady points are holds in moving runs: each carries friction left at "
                "rest; it averages out only if holds are approached from both sides"
            )
    try:
        check(model, [float(p) for c in found.channels for p in c.points.pressure_kpa], "the extended model")
    except InputError as error:  # said, not raised: the diagnosis stands
        out.append(str(error))
    return out
