"""The runs of one robot as a diagnosis takes them: which are fitted, which are kept unseen, what carries over."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ljjax.errors import InputError
from ljjax.fit.windows import Motion
from ljjax.live import SELF_HEATING_K, SELF_HEATING_S
from ljjax.logs import Run, started_ns

FITTED = 2
"""The least number of runs that are fitted, as what is fitted to one must hold for another."""


def by_start(motions: Sequence[Motion]) -> list[Motion]:
    """The runs in the order in which they were made."""
    return sorted(motions, key=lambda m: (started_ns(m.run), m.run.t0_ns, m.run.path))


def in_order(motions: Sequence[Motion]) -> list[Motion]:
    """The runs by their start, each with the temperature's rise and the slip since the first one began."""
    ordered = by_start(motions)
    if not ordered:
        return []
    first, cold = started_ns(ordered[0].run), None
    slipped, heated, ended, out = 0.0, 0.0, 0.0, []
    for m in ordered:
        way = travel(m.y, m.noise)
        session = (started_ns(m.run) - first) * 1e-9 + m.t
        if "temperature" in m.run.signals:
            s = m.run.signals["temperature"]
            value = np.interp(m.t, s.t, s.value[:, 0])
            cold = float(value[0]) if cold is None else cold
            warm = value - cold
        else:
            heated *= np.exp(-max(session[0] - ended, 0.0) / SELF_HEATING_S)
            warm = SELF_HEATING_K - (SELF_HEATING_K - heated) * np.exp(-(m.t - m.t[0]) / SELF_HEATING_S)
            heated, ended = float(warm[-1]), float(session[-1])
        out.append(replace(m, warm=warm, worn=slipped + way))
        slipped += float(way[-1])
    return out


def travel(y: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """(T,) the way gone by the mean joint [rad], noise of the standard deviations (c,) left out by a play."""
    kernel = np.ones(5) / 5
    smooth = np.stack([np.convolve(np.pad(c, 2, mode="edge"), kernel, mode="valid") for c in y.T], axis=1)
    half = 3 * noise
    held, total, out = smooth[0].copy(), 0.0, np.empty(len(y))
    for k, x in enumerate(smooth):
        new = np.clip(held, x - half, x + half)
        total += float(np.mean(np.abs(new - held)))
        held, out[k] = new, total
    return out


def unseen(motions: Sequence[Motion]) -> list[int]:
    """Runs to keep out of every fit: a quarter of them, whose tensions and pressures the others cover, spread over the
    session."""
    count = len(motions)
    if count < FITTED + 1:
        raise InputError(
            f"cannot tell from {count} moving run{'s' * (count != 1)}: a diagnosis needs three or more, two to fit, "
            "each foretold by the other, one to check on; record others, of other tensions or another pressure"
        )
    wanted = max(1, round(count / 4))
    chosen: list[int] = []
    places = (np.arange(wanted) + 0.6) * count / wanted
    for place in places:
        order = sorted(
            (i for i in range(count) if i not in chosen), key=lambda i: (_outside(motions, i), abs(i - place))
        )
        chosen.append(order[0])
    return sorted(chosen)


def _outside(motions: Sequence[Motion], i: int) -> float:
    """How far a run's pressures and tensions lie outside those of the others, as a share of all there are."""
    others = [m for k, m in enumerate(motions) if k != i]
    worst = 0.0
    for pick in (lambda m: m.vacuum, lambda m: m.tendons[:, 0] - m.tendons[:, 1]):
        low, high = min(pick(m).min() for m in others), max(pick(m).max() for m in others)
        own = pick(motions[i])
        span = max(high, own.max()) - min(low, own.min()) + 1e-9
        worst = max(worst, (low - own.min()) / span, (own.max() - high) / span)
    return round(max(worst, 0.0), 1)


def span(motions: Sequence[Motion]) -> dict[str, float]:
    """The largest tension [N], angle of a joint, slip [rad] and warmth [K] there are, for the effects' pilots."""
    return {
        "tension": max(float(m.tendons.max()) for m in motions),
        "angle": max(float(np.abs(m.y).max()) for m in motions),
        "slip": max(float(m.worn.max()) for m in motions),
        "warmth": max(float(m.warm.max()) for m in motions),
        "": 1.0,
    }


def role_of(run: Run, train: Sequence[Motion], test: Sequence[Motion]) -> str:
    """What a run was used for."""
    if any(m.run is run for m in train):
        return "train"
    return "held_out" if any(m.run is run for m in test) else "left out"
