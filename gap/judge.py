"""From refits to an answer: probabilities, what cannot be told apart, and whether there is an effect at all.

Two things part candidates. Chance: a gain must exceed the largest one that any candidate makes of data without an
effect. And form: no effect has quite the form it has here, so that even the true cause leaves a share of the gap; what
it leaves is taken to be spread as a power of 1/share, whatever the number of samples. A cause acts alike where it was
not fitted, a stand-in for it seldom does: the share is the geometric mean of what is left where all conditions are
fitted and of what is left elsewhere, where each is left out and on runs that no fit has seen; and no less than what is
left of the latter, but for a tenth of the gap. Whatever the data say, something stays with what nobody has thought of.
How much of each is in `Weights`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import stats


@dataclass(frozen=True)
class Weights:
    """How what candidates leave becomes probabilities.

    Attributes:
        sharpness: power of 1/share.
        outside: odds of one outside the library against one listed effect, before looking.
        leaves: share of a gap that an effect outside the library is taken to leave by the best one inside it.
        ahead: share of what the second best leaves below which the best is ahead of all others, as few stand-ins are.
        unforeseen: what stays, whatever the data say, with what nobody has thought of.
        simpler: odds for one parameter less in use, where two effects leave as much; what is outside the library is
            taken to need as many as the most probable effect inside it, or as a flexible stand-in.
    """

    sharpness: float
    outside: float
    leaves: float
    ahead: float
    unforeseen: float
    simpler: float


WEIGHTS = Weights(4.0, 0.5, 0.08, 0.6, 0.05, 1.2)
"""Chosen by hand, five by fresh robots. What stays with the unforeseen by how often answers were wrong that had nothing
else in doubt: 6 of 116. The odds of what is outside the library, what the best inside it leaves of that, and what a
parameter costs by the 106 robots of `benchmarks.blind.calibrate` before seed 4501, near what it fitted to them: their
right answers had a mean log of -0.36 by these, of -0.44 by 0.3, 0.25 and 1.5. The power, 5 before, by its 246 robots
to seed 5601, to which it fits one of 2.8: between the two, as shapes that nobody has met are more than they were."""
NONE = 8.0
"""Odds before looking that no effect is there: a gain that chance makes once in a hundred leaves them even."""
MATTERS, OPEN = 0.02, 0.21
"""A gap below this share of the noise's variance is none; above the second one, a tenth in RMS, it is one that chance
does not make, whether or not a candidate explains any of it. In between the noise's variance itself is in doubt: what
counts there is what the best candidate takes away."""
ASIDE, SURELY = 0.015, 0.985
"""Of no effect's probability, the share of the less likely of `no_gap` and `parameters_only`, and that probability
where the gap does not matter: none of 45 fresh robots so told had an effect, or the other of the two."""
TERMS = 8
"""How many parameters a flexible stand-in is taken to have."""
MIMICS = frozenset({"actuator_ripple", "nonuniform_stiffness"})
"""Effects that do nearly what much outside the library does, so that they are as far ahead of all others as a true
cause is, and stand-ins of few terms are asked beside them however little they leave: a tendon's ripple over the bend,
of any length, makes up for a body that snaps in waves over its own; and for what is amiss in one joint of many only a
stiffness that differs from joint to joint makes up at all."""
SAME = (
    {"actuator_delay", "actuator_lag", "sensor_delay", "sensor_filter"},
    {"rest_curvature", "base_tilt", "sensor_bias"},
    {"layer_wear", "thermal_drift"},
)
"""Effects of which each does nearly what the others do (docs/effects.md), so that none is far ahead of the others."""
STRANGE = 0.1
"""The share of what `unlisted_effect` is ahead of every listed one by that goes to them all alike: to a listed cause in
a form that nobody has thought of the data point no more than to what is outside the library. Of 63 fresh robots so
answered, at 0.89 on average, 13 were that."""
FLOOR = 0.04
"""Relative standard deviation that the noise's variance is taken to have; chosen by hand."""
KEPT = 0.1
"""The share of unseen runs' gap that true causes may keep, whatever they leave of fitted ones: of 82 fresh robots that
were named rightly 75 kept less, and none more than 0.19."""
NEARLY_NONE = 0.25
"""The share of what one effect leaves that a further one leaves at most, where it takes little of the gap."""
ALIKE, TELLS = 1.25, 10.0
"""Candidates whose leftovers are within this factor cannot be told apart, nor those whose odds are: below ten to one
evidence is not called strong (Jeffreys)."""


@dataclass(frozen=True)
class Evidence:
    """What the judgement rests on.

    Attributes:
        excess: of the base's loss over the noise's.
        left: by effect, share of it that is left with this effect, alone or with others (the least).
        parameters: by effect, how many were free.
        unit: what a χ² of 1 is, as a share of the excess (the residuals' colour counted).
        chance: probability that data without an effect gain as much.
        as_given: whether the given model explains the runs no worse than the refitted base does.
        unseen: by effect refitted, the share left by the same refit where each condition is left out of the fits (to
            first order).
        flexible: by place, the share that a stand-in of many terms there leaves (`ljjax.gap.stand_ins`); empty where
            the effects leave too little to ask.
        used: by effect, how many of its parameters are told from doing nothing, where known.
        held_out: by effect refitted, the share that it leaves of the gap of runs that no fit has seen, 0 where these
            show none.
        steady: by effect that varies where it need not (`ljjax.effects.varying`), the share left where it does not.
    """

    excess: float
    left: Mapping[str, float]
    parameters: Mapping[str, int]
    unit: float
    chance: float
    as_given: bool
    unseen: Mapping[str, float] = field(default_factory=dict)
    flexible: Mapping[str, float] = field(default_factory=dict)
    used: Mapping[str, int] = field(default_factory=dict)
    held_out: Mapping[str, float] = field(default_factory=dict)
    steady: Mapping[str, float] = field(default_factory=dict)


def probabilities(e: Evidence, by: Weights = WEIGHTS) -> dict[str, float]:
    """Of every candidate, `no_gap`, `parameters_only` and `unlisted_effect`; they sum to 1."""
    out = dict.fromkeys((*e.left, "no_gap", "parameters_only", "unlisted_effect"), 0.0)
    p = min(max(e.chance, 1e-12), 1 / np.e)
    odds = -NONE * np.e * p * np.log(p)  # the least Bayes factor for chance that p allows (Sellke, Bayarri and Berger)
    none = odds / (1 + odds) if e.chance < 1 / np.e else 0.95
    told = e.excess if e.excess > OPEN else e.excess * (1 - min(e.left.values(), default=1.0))
    small = max(told, 0.0) < MATTERS
    none = max(none, SURELY) if small else none
    if e.excess > OPEN:
        out["unlisted_effect"], none = none, 0.0
    right, other = ("no_gap", "parameters_only") if e.as_given else ("parameters_only", "no_gap")
    out[right], out[other] = (1 - ASIDE) * none, ASIDE * none
    blur = blurred(0.0, e.unit)
    least = min([0.0, *e.left.values()])  # what is left is told from the best: the noise is known to `FLOOR` only
    share = {}
    for i, left in e.left.items():
        elsewhere = [by[i] - least + blur for by in (e.unseen, e.held_out) if by.get(i)]
        share[i] = max(_carried(left - least + blur, elsewhere), min(e.held_out.get(i, 0.0), 1.0) - KEPT)
    used = {i: e.used.get(i, e.parameters[i]) for i in share}
    weight = {
        i: worth(x + 2 * e.unit * e.parameters[i], used[i], by) * max(1 - x, 0.0)  # what leaves nearly all is no cause
        for i, x in share.items()
    }
    best = main_of(weight, list(weight)) if weight else None
    simplest, carries = (used[best], share[best] / (e.left[best] - least + blur)) if best else (1, 1.0)
    leaves = _outside(e, least, by)
    weight["unlisted_effect"] = by.outside * by.simpler ** -min(simplest, TERMS) * (leaves + blur) ** -by.sharpness
    if e.flexible:  # it is taken to carry over as the best effect does
        decoy = carries * (max(min(e.flexible.values()) - least, 0.0) + blur) + 2 * e.unit * TERMS
        weight["unlisted_effect"] += by.simpler**-TERMS * decoy**-by.sharpness
    total = sum(weight.values())
    rest = 1 - sum(out.values())
    for i, w in weight.items():
        surprise = 0.5 if i == "unlisted_effect" else 0.5 / max(len(weight) - 1, 1)
        out[i] += rest * ((1 - by.unforeseen) * w / total + by.unforeseen * surprise)
    strange = STRANGE * max(out["unlisted_effect"] - max((out[i] for i in e.left), default=1.0), 0.0)
    for i in e.left:
        out[i] += strange / len(e.left)
    out["unlisted_effect"] -= strange
    return out


def worth(share: float, used: int, by: Weights = WEIGHTS) -> float:
    """Of what leaves such a share of the gap and uses so many parameters, up to a factor that all candidates have."""
    return by.simpler**-used * share**-by.sharpness


def blurred(share: float, unit: float) -> float:
    """A share of the gap and what nobody can tell from nothing."""
    return share + 0.004 + 8 * unit


def _outside(e: Evidence, least: float, by: Weights) -> float:
    """The share that the best listed effect is taken to leave of one outside the library: more where that is far ahead
    of all others but those that do what it does, as a stand-in is not unless it is one of `MIMICS`; in full where it
    leaves half of what would make it so. One that varies is not, however little it leaves: the others may not vary, or
    not as much."""
    left = {i: min(x - least, 1.0) for i, x in e.left.items()}
    if not left:
        return by.leaves
    best = min(left, key=lambda i: left[i])
    if best in e.steady or MIMICS & {i for i, x in left.items() if x <= left[best]}:
        return by.leaves
    like = next((group for group in SAME if best in group), {best})
    second = min((x for i, x in left.items() if i not in like), default=1.0)
    far = max(2 - 2 * left[best] / (by.ahead * second), 0.0) if second > 0 else 0.0
    return by.leaves + min(far, 1.0) * max(by.ahead * second - by.leaves, 0.0)


def _carried(fitted: float, elsewhere: Sequence[float]) -> float:
    """Geometric mean of the share left where all is fitted and of that left elsewhere: the mean of that where each
    condition is left out, of first order only, and of that on runs that no fit has seen, so far as known. None of these
    counts for less than the former nor beyond the base's own."""
    other = [max(fitted, min(x, 1.0)) for x in elsewhere] or [fitted]
    return float(np.sqrt(fitted * np.mean(other)))


def chance(null: np.ndarray, gain: float, unit: float) -> float:
    """Probability that data without an effect gain as much, from draws (D,) of their largest gain; beyond all draws
    the tail of χ², whose unit is given."""
    p = (1 + np.sum(null >= gain)) / (1 + len(null))
    return float(p * np.exp(-0.5 * max(gain - null.max(), 0.0) / unit))


def verdict(probability: Mapping[str, float], named: Collection[str]) -> str:
    """The answer that the probabilities give where the effects `named`, those found and those that cannot be told from
    them, are what a listed one would be: others that are probable too do not speak for them."""
    last = {i: probability[i] for i in ("no_gap", "parameters_only", "unlisted_effect")}
    name, most = max(last.items(), key=lambda x: x[1])
    return "listed_effect" if sum(probability[i] for i in named) > most else name


def equivalents(
    left: Mapping[str, float], main: str, unit: float, odds: Mapping[str, float] | None = None
) -> list[str]:
    """The candidates that leave no more than chance and `ALIKE` above what the main one leaves, or where odds are
    given, all against the same, have a tenth of its own; itself first."""
    least, odds = max(left[main], 0.0), odds or {}
    near = {i for i, x in left.items() if i != main and max(x, 0.0) <= as_little(least, unit)}
    near |= {i for i in left if i != main and TELLS * odds.get(i, 0.0) >= odds.get(main, np.inf)}
    return [main, *sorted(near, key=lambda i: left[i])]


def as_little(least: float, unit: float) -> float:
    """The share up to which a leftover cannot be told from the least one."""
    return ALIKE * least + 0.004 + 12 * unit


def pairs_worth(first: float, second: float, unit: float) -> bool:
    """Whether a further effect is worth having: it takes most of what is left, and a share of the gap that matters; a
    smaller share does where it takes nearly all of what is left, as what mends a form seldom does."""
    taken = first - second
    return taken > max(0.6 * first, least_worth(unit)) and (taken > 0.1 or second < NEARLY_NONE * first)


def least_worth(unit: float) -> float:
    """The share of the gap that a further effect takes at least; where less is left none is looked for."""
    return max(0.05, 15 * unit)


def closed(before: float, after: float, floor: float) -> float | None:
    """1 − (after² − floor²)/(before² − floor²); None where `before` is within a tenth of the floor."""
    return None if before <= 1.1 * floor else float(1 - (after**2 - floor**2) / (before**2 - floor**2))


def interval(
    before: np.ndarray, after: np.ndarray, floor: np.ndarray, picked: int, rng: np.random.Generator, draws: int = 4000
) -> tuple[float, float] | None:
    """95 % interval of the closed fraction on `picked` runs that no fit has seen, from the squared errors (R,) of all
    runs, the last `picked` of them unseen: what fitted runs keep is raised to what unseen ones do on average, and the
    floor is known to `FLOOR` of itself. What is drawn from few runs spreads too little: the quantiles are moved away
    from the median by what Student's t asks of R runs for the mean of `picked` further ones."""
    runs = len(before)
    fitted = np.arange(runs) < runs - max(picked, 1)
    kept = after - floor
    if fitted.any():
        kept = np.where(fitted, kept + max(kept[~fitted].mean() - kept[fitted].mean(), 0.0), kept)
    index = rng.integers(0, runs, (draws, max(picked, 1)))
    doubt = FLOOR * rng.standard_normal(draws) * floor.mean() * max(picked, 1)
    gap = (before - floor)[index].sum(axis=1) - doubt
    left = kept[index].sum(axis=1) - doubt
    good = gap > 0
    if good.sum() < draws // 2:
        return None
    low, middle, high = np.quantile(1 - left[good] / gap[good], [0.025, 0.5, 0.975])
    few = 1.0
    if runs > 1:
        scale = (runs / (runs - 1)) ** 0.5 * (1 + max(picked, 1) / runs) ** 0.5
        few = float(stats.t.ppf(0.975, runs - 1) / stats.norm.ppf(0.975)) * scale
    return float(middle + few * (low - middle)), float(middle + few * (high - middle))


def main_of(probability: Mapping[str, float], candidates: Sequence[str]) -> str:
    """The most probable of them."""
    return max(candidates, key=lambda i: probability[i])
