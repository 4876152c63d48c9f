"""The search for what steady data need: candidates judged, tested against chance, added, pruned, refined."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ljjax.fit.least_squares import Solution, solve
from ljjax.gap.static_cells import Cells, Data, pilots
from ljjax.gap.static_regress import Judged, Solver
from ljjax.gap.statics import Laws

DRAWS = 199
"""Simulated data sets without an effect; the least p-value is 1/(DRAWS + 1)."""
LEVEL = 0.03
"""Chance at which an effect is taken where there is none."""
ALIKE, CLOSE = 0.9, 2.0
"""Effects count as one where what they change agrees this well (cosine) and their scores lie this close (a factor of
e² ≈ 7 in likelihood)."""
PRIOR_NONE = 0.5
"""Prior probability that no effect is there; the rest is shared by those that the data can show."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """One candidate as the data judge it, in its best variant.

    Attributes:
        effect: its id; "" for none more.
        score, p_value: S, and the share of data without it in which any candidate gains as much (NaN for none).
        dropped: base terms that it makes superfluous.
        x: (P,) parameters found; `change` (N,) what it changes in the fit, `rest` (N,) what it leaves, in
            units of the noise.
        fit, left_out: misfits of the blocks and of the tested block's left-out levels.
        k: parameters counted.
    """

    effect: str
    score: float
    p_value: float
    dropped: tuple[str, ...]
    x: np.ndarray
    change: np.ndarray
    rest: np.ndarray
    fit: np.ndarray
    left_out: np.ndarray
    k: int
    active: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Round:
    """One look at all candidates.

    Attributes:
        none: the model without more; `found` each candidate by id; `unseen` the ids without a trace.
        threshold: the gain S − S_none that chance alone passes in `LEVEL` of simulated data sets.
        cells: each candidate's cells with all base terms.
    """

    none: Candidate
    found: Mapping[str, Candidate]
    unseen: tuple[str, ...]
    threshold: float
    cells: Mapping[str, Cells]

    @property
    def best(self) -> Candidate | None:
        return max(self.found.values(), key=lambda c: c.score, default=None)


def look(
    laws: Laws,
    data: Data,
    made: Mapping[str, list[Cells]],
    candidates: Sequence[str],
    rng: np.random.Generator,
    draws: int = DRAWS,
    known: np.ndarray | None = None,
) -> Round:
    """Judge every candidate by its cells (`static_cells.cells`), beside the model without it, and against chance
    (`draws` simulated data sets without one). `known` (L,) are misfits of left-out levels of the model without it, for
    levels of which its cells do not tell."""
    y = data.y[None]
    tried = {effect: [Solver(c, data) for c in found] for effect, found in made.items()}
    judged = {effect: [s.judge(y) for s in solvers] for effect, solvers in tried.items()}
    fill = None if known is None else known[None]
    none = _best(laws, "", tried[""], judged[""], None, fill)
    fitted = y[0] - none.rest
    drawn = fitted + noise(data, none.rest, none.k, draws, rng)
    start, others = _scores(tried[""], [s.judge(drawn) for s in tried[""]], fill)
    gains = [_scores(s, [x.judge(drawn) for x in s], others)[0] - start for e, s in tried.items() if e]
    most = np.max(gains, axis=0) if gains else np.zeros(draws)
    found = {}
    for effect in candidates:
        if effect in tried:
            c = _best(laws, effect, tried[effect], judged[effect], none, none.left_out[None])
            p = (1 + np.sum(most >= c.score - none.score)) / (1 + draws)
            found[effect] = replace(c, p_value=float(p))
    unseen = tuple(e for e in candidates if e not in tried)
    threshold = float(np.quantile(most, 1 - LEVEL)) if draws else float("nan")
    return Round(none, found, unseen, threshold, {e: s[0].cells for e, s in tried.items()})


def _scores(solvers: Sequence[Solver], judged: Sequence[Judged], others: np.ndarray | None):
    """The best variant's score (B,), and its misfits of left-out levels (B, L)."""
    scores = np.array([s.score(j, others) for s, j in zip(solvers, judged, strict=True)])
    best = np.argmax(scores, axis=0)
    at = np.arange(scores.shape[1])
    left = np.array([j.left_out for j in judged])[best, at]
    return scores[best, at], np.where(np.isfinite(left), left, 1e12 if others is None else others)


def _best(
    laws: Laws,
    effect: str,
    solvers: Sequence[Solver],
    judged: Sequence[Judged],
    none: Candidate | None,
    others: np.ndarray | None,
) -> Candidate:
    scores = [float(s.score(j, others)[0]) for s, j in zip(solvers, judged, strict=True)]
    i = int(np.argmax(scores))
    j, c = judged[i], solvers[i].cells
    x = solvers[i].start(j, laws)
    active = tuple(dict.fromkeys([*c.free, *c.own]))
    change = (0.0 if none is None else none.rest) - j.rest[0]
    left = np.where(np.isfinite(j.left_out[0]), j.left_out[0], 1e12 if others is None else others[0])
    return Candidate(effect, scores[i], float("nan"), c.dropped, x, change, j.rest[0], j.fit[0], left, c.k, active)


def noise(data: Data, rest: np.ndarray, k: int, count: int, rng: np.random.Generator) -> np.ndarray:
    """(count, N) errors like those in `rest` (N,), drawn level by level: an offset and a slope over the angle of each
    pressure level, and a scatter whose neighbours over angle err alike."""
    grown = np.sqrt(len(rest) / max(len(rest) - k, 1))
    out = np.empty((count, len(rest)))
    for block, rows in zip(data.blocks, data.rows, strict=True):
        p, e = block.points, grown * rest[rows]
        levels = p.levels
        sizes = np.bincount(levels)
        if sizes.min() < 4:
            out[:, rows] = max(np.sqrt(np.mean(e**2)), 0.3) * rng.normal(size=(count, len(e)))
            continue
        top = max(np.abs(p.theta).max(), 1e-9)
        design = np.stack([np.ones(len(e)), p.theta / top], axis=1)
        pairs, left = [], np.empty(len(e))
        for level in range(len(sizes)):
            mine = levels == level
            pair = np.linalg.lstsq(design[mine], e[mine], rcond=None)[0]
            pairs.append(pair)
            left[mine] = e[mine] - design[mine] @ pair
        root = np.linalg.svd(np.array(pairs) / np.sqrt(len(pairs)), full_matrices=False)
        together = rng.normal(size=(count, len(sizes), 2)) @ (root[1][:, None] * root[2])
        size = max(float(np.sqrt(np.mean(left**2) * min(sizes) / (min(sizes) - 2))), 0.3)
        alike = neighbours(p.theta, levels, left)
        drawn = np.empty((count, len(e)))
        for level in range(len(sizes)):
            mine = np.flatnonzero(levels == level)
            mine = mine[np.argsort(p.theta[mine], kind="stable")]
            white = rng.normal(size=(count, len(mine)))
            for i in range(1, len(mine)):
                white[:, i] = alike * white[:, i - 1] + np.sqrt(1 - alike**2) * white[:, i]
            drawn[:, mine] = size * white
        out[:, rows] = drawn + np.einsum("bls,ns->bln", together, design)[:, levels, np.arange(len(e))]
    return out


def neighbours(theta: np.ndarray, levels: np.ndarray, error: np.ndarray) -> float:
    """Correlation in [0, 0.95] of errors at angles next to each other at one pressure."""
    product, square = 0.0, 0.0
    for level in np.unique(levels):
        mine = np.flatnonzero(levels == level)
        e = error[mine[np.argsort(theta[mine], kind="stable")]]
        product += float(np.sum(e[1:] * e[:-1]))
        square += float(np.sum(e[1:] ** 2 + e[:-1] ** 2)) / 2
    return float(np.clip(product / square, 0.0, 0.95)) if square > 0 else 0.0


def probabilities(look: Round) -> dict[str, float]:
    """Probability of each candidate, and of none of them under "", in one round."""
    seen = [c for c in look.found.values() if np.isfinite(c.score)]
    share = (1 - PRIOR_NONE) / max(len(look.found), 1)
    logs = {"": look.none.score + np.log(PRIOR_NONE), **{c.effect: c.score + np.log(share) for c in seen}}
    top = max(logs.values())
    weight = {e: np.exp(v - top) for e, v in logs.items()}
    total = sum(weight.values())
    return {e: float(w / total) for e, w in weight.items()}


def cosine(a: np.ndarray, b: np.ndarray) -> float:
    size = np.linalg.norm(a) * np.linalg.norm(b)
    return float(a @ b / size) if size > 0 else 0.0


def equivalent(found: Round, effect: str) -> list[str]:
    """The effect and those that one round's data cannot tell from it."""
    mine = found.found[effect]
    others = [
        c.effect
        for c in sorted(found.found.values(), key=lambda c: -c.score)
        if c.effect != effect and mine.score - c.score < CLOSE and abs(cosine(mine.change, c.change)) > ALIKE
    ]
    return [effect, *others]


@dataclass(frozen=True, eq=False)
class Fitted:
    """A model refined on one stage's data: names that were free, all parameters x (P,), how it went, measured − model
    (N,) and, of the tested block, of left-out levels (n,), both in units of the noise."""

    active: tuple[str, ...]
    x: np.ndarray
    solution: Solution
    error: np.ndarray
    left_out: np.ndarray

    def sd(self, widening: float) -> dict[str, float]:
        """Standard deviations of the free parameters; NaN at a bound."""
        with np.errstate(all="ignore"):
            try:
                unit = self.solution.unit_covariance()
            except np.linalg.LinAlgError:
                return dict.fromkeys(self.active, float("nan"))
            sd = np.sqrt(np.diag(unit) * self.solution.variance) * widening
        return dict(zip(self.active, sd.tolist(), strict=True))


def refined(
    laws: Laws, data: Data, x: np.ndarray, active: Sequence[str], keep: np.ndarray | None = None
) -> tuple[np.ndarray, Solution]:
    """Least squares from x over all that is free, on the points of the mask `keep` (N,): the parameters (P,) and how it
    went."""
    index, y = laws.index(active), data.y
    kept = np.ones(len(y), bool) if keep is None else keep

    def residuals(v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        full = x.copy()
        full[index] = v
        value, slope = data.slopes(laws, full, index)
        return (value - y)[kept], slope[kept]

    found = solve(residuals, x[index], laws.low[index], laws.high[index], max_iterations=60)
    full = x.copy()
    full[index] = found.x
    return full, found


def refine(laws: Laws, data: Data, x: np.ndarray, active: Sequence[str]) -> Fitted:
    """Least squares over all that is free, on all data and without each level of the tested block.

    What is found on all data starts no fit that is to know nothing of a level; those start with the effects at null, in
    each of the forms from which searches begin.
    """
    whole, solution = refined(laws, data, x, active)
    rows, left = data.rows[-1], np.empty(len(data.tested.points))
    begun = starts(laws, data, x, active)
    for keep in data.folds():
        found = [refined(laws, data, one, active, keep) for one in begun]
        one, _ = min(found, key=lambda f: float(f[1].residual @ f[1].residual))
        left[~keep[rows]] = (data.y - data.values(laws, one))[rows][~keep[rows]]
    return Fitted(tuple(active), whole, solution, data.y - data.values(laws, whole), left)


def starts(laws: Laws, data: Data, x: np.ndarray, active: Sequence[str]) -> list[np.ndarray]:
    """Where searches that know nothing begin: effects that are free at null, what gives them their form at each of its
    pilots."""
    begun = x.copy()
    forms = []
    for name in active:
        if name in laws.about:
            begun[laws.index([name])[0]] = laws.x0[laws.index([name])[0]]
            if laws.about[name]["pilots"]:
                forms.append(name)
    out = []
    for values in itertools.product(*(pilots(laws.about[n], data.extent) for n in forms)):
        one = begun.copy()
        one[laws.index(forms)] = values
        out.append(one)
    return out


__all__ = [
    "Candidate",
    "Cells",
    "Fitted",
    "Round",
    "equivalent",
    "look",
    "neighbours",
    "noise",
    "probabilities",
    "refine",
    "refined",
]
