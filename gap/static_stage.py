"""One stage of the diagnosis of steady data: rounds of looking, adding and pruning on one kind of points."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ljjax.fit.points import UNIT, Points
from ljjax.gap.static_cells import Block, Cells, Data, cells
from ljjax.gap.static_runs import roughness
from ljjax.gap.static_search import (
    LEVEL,
    Candidate,
    Fitted,
    Round,
    equivalent,
    look,
    neighbours,
    probabilities,
    refined,
)
from ljjax.gap.statics import Laws

MOST = 3
"""Effects looked for at most, all stages together."""
LEAST_LEVELS = 4
"""Pressures without which leaving one out says nothing."""


@dataclass(frozen=True, eq=False)
class Channel:
    """What was found on one kind of points.

    Attributes:
        kind: `steady` or `probe`; `data` what was looked at, its last block the kind's points.
        rounds: each look at the candidates; the first one's `none` is the base model.
        added: effects found here, in order.
        base, model: refined without and with them on these points: measured − model in the points' unit, of the fit
            (`error`) and of left-out levels (`left_out`), both (n,).
        given: (n,) measured − what the given model says.
        fitted: the model with them, refined; the parameters that these points decided.
    """

    kind: str
    data: Data
    rounds: Sequence[Round]
    added: Sequence[str]
    base: Errors
    model: Errors
    given: np.ndarray
    fitted: Fitted

    @property
    def points(self) -> Points:
        return self.data.tested.points

    @property
    def unit(self) -> str:
        return UNIT[self.kind]

    @property
    def noise(self) -> float:
        return self.data.tested.noise

    @property
    def gain(self) -> float:
        """By how much the effects found here raise the score."""
        last = self.rounds[len(self.added)] if len(self.rounds) > len(self.added) else None
        end = last.none.score if last else max(r.best.score for r in self.rounds if r.best)
        return max(0.0, end - self.rounds[0].none.score) if self.added else 0.0

    @property
    def inner(self) -> np.ndarray:
        """(n,) the points whose pressure lies between others that were fitted, where there are enough of them."""
        levels = self.points.levels
        if levels.max() + 1 < 5:
            return np.ones(len(levels), bool)
        return (levels > 0) & (levels < levels.max())


@dataclass(frozen=True, eq=False)
class Errors:
    """Measured − model (n,), of a fit to all points and of fits without each point's pressure, in the points' unit."""

    error: np.ndarray
    left_out: np.ndarray

    def rms(self, keep: np.ndarray | None = None) -> float:
        """RMS at left-out pressures."""
        e = self.left_out if keep is None else self.left_out[keep]
        e = e[np.isfinite(e)]
        return float(np.sqrt(np.mean(e**2))) if len(e) else float("nan")


def block(points: Points, base_error: np.ndarray) -> Block:
    """A block with its noise: stated, or else the points' scatter about their neighbours, or else what the base model
    leaves."""
    known = points.scatter or roughness(points)
    noise = known or float(np.sqrt(np.mean(base_error**2)))
    return Block(points, max(noise, 1e-6 * float(np.abs(points.value).max())), len(points), known > 0)


def counted(laws: Laws, data: Data, made: Mapping[str, list[Cells]], candidates: Sequence[str]) -> Data:
    """The data with the number of independent points in the tested block, from how alike the errors of neighbours are
    in whatever explains the points best."""
    first = look(laws, data, made, candidates, np.random.default_rng(0), draws=0)
    tries = [first.none, *first.found.values()]
    best = min((c for c in tries if np.isfinite(c.score)), key=lambda c: float(c.fit[-1]))
    b = data.tested
    error = best.rest[data.rows[-1]]
    alike = neighbours(b.points.theta, b.points.levels, error) if np.bincount(b.points.levels).min() > 3 else 0.0
    worth = len(b.points) * (1 - alike) / (1 + alike)
    return Data((*data.blocks[:-1], replace(b, independent=float(np.clip(worth, b.count, len(b.points))))))


def search(
    laws: Laws,
    data: Data,
    x: np.ndarray,
    active: Sequence[str],
    candidates: Sequence[str],
    room: int,
    rng: np.random.Generator,
) -> tuple[Data, list[Round], list[str], np.ndarray, tuple[str, ...]]:
    """The data with its independent points counted, the rounds, the effects added, the parameters and the names of what
    is free at the end: forward, with backward pruning."""
    rounds, added, names = [], [], tuple(active)
    made = cells(laws, data, x, names, candidates)
    data = counted(laws, data, made, candidates)
    known = None
    while True:
        left = [c for c in candidates if c not in added]
        found = look(laws, data, made, left, rng, known=known)
        rounds.append(found)
        best = found.best
        if best is None or len(added) >= room or not best.p_value <= LEVEL or not _likelier(found, best.effect):
            break
        better = next((c for c in _without_first(rounds, added, best)), None)
        if better is not None:  # what was found first is not needed beside what was found now
            added, best = [], better
            rounds = rounds[:1]
        x, names = refined(laws, data, best.x, best.active)[0], best.active
        known = best.left_out
        added.append(best.effect)
        made = cells(laws, data, x, names, [c for c in candidates if c not in added])
    return data, rounds, added, x, names


def _likelier(found: Round, effect: str) -> bool:
    """Whether an effect, with those that these data cannot tell from it, is likelier than none."""
    p = probabilities(found)
    return sum(p.get(e, 0.0) for e in equivalent(found, effect)) > p[""]


def _without_first(rounds: Sequence[Round], added: Sequence[str], best: Candidate) -> list[Candidate]:
    """The new candidate alone, where that scores as well as with what was added before."""
    if len(added) != 1:
        return []
    alone = rounds[0].found.get(best.effect)
    return [alone] if alone is not None and alone.score >= best.score else []


__all__ = ["Channel", "Errors", "Fitted", "LEAST_LEVELS", "MOST", "block", "counted", "probabilities", "search"]
