"""The runs of one robot as a diagnosis takes them: which are fitted, which are kept unseen."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ljjax.errors import InputError
from ljjax.fit.windows import Motion
from ljjax.logs import Run

FITTED = 2
"""The least number of runs that are fitted, as what is fitted to one must hold for another."""


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
        rest = [i for i in range(count) if i not in chosen]
        chosen.append(min(rest, key=lambda i: (_outside(motions, [*chosen, i]), abs(i - place))))
    return sorted(chosen)


def _outside(motions: Sequence[Motion], kept: Sequence[int]) -> float:
    """How far the pressures and tensions of runs that are kept lie outside those of the others, as a share of all there
    are."""
    worst = 0.0
    for pick in (lambda m: m.vacuum, lambda m: m.tendons[:, 0] - m.tendons[:, 1]):
        lows, highs = (np.array([float(end(pick(m))) for m in motions]) for end in (np.min, np.max))
        low, high = np.delete(lows, kept).min(), np.delete(highs, kept).max()
        span = highs.max() - lows.min() + 1e-9
        worst = max(worst, (low - lows[kept].min()) / span, (highs[kept].max() - high) / span)
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


def role_of(run: Run, train: Sequence[Motion]) -> str:
    """Whether a run was fitted (`train`) or kept from every fit (`held_out`), those among them that say nothing."""
    return "train" if any(m.run is run for m in train) else "held_out"
