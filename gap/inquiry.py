"""The inquiry: base, screen, selection, and the evidence that comes of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ljjax.effect import Effect
from ljjax.effects.varying import ONSET, by_run
from ljjax.fit import folds
from ljjax.fit.coordinates import without_effects
from ljjax.fit.windows import Motion
from ljjax.gap import channels, judge
from ljjax.gap.candidates import Trial
from ljjax.gap.channels import Measured
from ljjax.gap.search import Refit, Study
from ljjax.gap.selection import Exchange, Selection
from ljjax.gap.stand_ins import QUICK, STAND_INS, stand_in
from ljjax.logs import Run
from ljjax.modelfile import ModelFile

HALF = 0.5
"""The share of an effect that begins at a moment from which it is told when."""
LEFT_OVER, SOME = 0.1, 0.01
"""The share of the gap that is worth telling of where the effects found leave it, and from which stand-ins of few terms
are asked."""
UNTRIED, BEHIND = 0.35, 1.5
"""The share that an effect not refitted to all runs is taken to leave at least, and how many times what the best one
leaves."""
SHOWN = 2.0
"""How many times the noise's variance the base leaves at least of unseen runs that can tell what carries over."""
FAINT = 0.5
"""The share of the fitted runs' gap, for their length, below which unseen runs hardly show it."""
CHANCE = 1.5
"""How many times a latency's standard deviation in the fitted runs it is taken to have in unseen ones at most."""
ELSEWHERE = 0.05
"""The share of what effects do outside a fold from which the other folds are taken to say all about them."""


@dataclass(frozen=True, eq=False)
class Setting:
    """What a diagnosis is given.

    Attributes:
        start, start_from: the model file and where it came from.
        options, seed, rng: what was asked for, and the source of what is random.
        runs: all logs; `train` and `test` the motions that are fitted and those on which the gap is measured.
        said: what each log gave.
        study: the base's parameters, the candidates and the fitted motions.
    """

    start: ModelFile
    start_from: str
    options: Mapping[str, Any]
    seed: int
    rng: np.random.Generator
    runs: Sequence[Run]
    train: Sequence[Motion]
    test: Sequence[Motion]
    said: list[str]
    study: Study


def fell_behind(promised: float, best: float) -> float:
    """The share of the gap that an effect leaves that was not refitted to all runs: what the Jacobian promises is the
    least of it, and where the best leaves much it was begun on a few runs and did worse there."""
    return max(promised, UNTRIED, min(BEHIND * best, 1.0))


def onset(effect: Effect) -> tuple[float, float] | None:
    """The slip at which an effect begins, and over which it does [rad]; None where it has always been."""
    share, at, over = (float(getattr(effect, n, 0.0)) for n in ONSET)
    return None if share < HALF else (at, over)


def unfixed(effects: Sequence[Effect], fitted: Sequence[Motion], others: Sequence[Motion]) -> np.ndarray:
    """(R,) of each of the others, whether the fitted runs do not say what one of the effects does in it: it begins
    between two of these, before, in or after the other, or is another in each run."""
    out = np.zeros(len(others), bool)
    for e in effects:
        out |= by_run(e)
        if (moment := onset(e)) is None:
            continue
        at, over = moment
        begin, end = (np.array([m.worn[k] for m in fitted]) for k in (0, -1))
        if not np.any((begin + over < at) & (at < end - over)):
            after = max(end[end - over <= at], default=-np.inf)
            before = min(begin[begin + over >= at], default=np.inf)
            out |= [after <= m.worn[0] and m.worn[-1] <= before for m in others]
    return out


def began(effect: Effect, fitted: Sequence[Motion], others: Sequence[Motion]) -> str:
    """When an effect begins, in words; empty where it does not."""
    if (moment := onset(effect)) is None:
        return ""
    at, _ = moment
    between = [m.run.run_id for m, x in zip(others, unfixed([effect], fitted, others), strict=True) if x]
    for m in fitted:
        if m.worn[0] < at < m.worn[-1] and not between:
            return f"{np.interp(at, m.worn, m.t) - m.t[0]:.1f} s into {m.run.run_id}"
    earlier = [m for m in fitted if m.worn.mean() < at]
    later = [m for m in fitted if m.worn.mean() >= at]
    said = [f"after {max(earlier, key=lambda m: m.worn[0]).run.run_id}"] if earlier else []
    said += [f"before {min(later, key=lambda m: m.worn[0]).run.run_id}"] if later else []
    those = ", ".join(between)
    doubt = (
        f" (before, in or after {those} the fitted runs do not say: no error here counts {those})" if between else ""
    )
    return " and ".join(said) + doubt


class Inquiry:
    """A diagnosis that has run.

    Attributes:
        setting: what it was given.
        base, given: the base refitted, and the given model as it is, on the training runs.
        screen, measured, found: candidates to first order; what measured inputs say; candidates refitted, as
            `selection` chose them.
        floor, excess: of the base's loss, the noise's part and the rest.
        evidence, probability, verdict, chosen, equivalent: what comes of it; of effects chosen, the groups of those
            that cannot be told from them.
        standing: of several effects found, the refit that speaks for each of them and for what stands in its place.
        gained, null, one: the loss that each refit takes away, the largest losses that chance takes away (D,), and the
            loss that a χ² of 1 stands for.
    """

    def __init__(self, setting: Setting):
        study = setting.study
        self.setting = setting
        with ThreadPoolExecutor(1) as beside:  # while the large programs are compiled
            measured = beside.submit(channels.look, setting.train, study.kinds, setting.start.model)
            self.base = study.base()
            self.given = self._given()
            self.screen = study.screen(self.base)
        self.measured: Measured = measured.result()
        self.selection = Selection(study, self.base, self.given, self.screen, self.measured, setting.seed)
        self.found, self.floor, self.excess = self.selection.found, self.selection.floor, self.selection.excess
        self.gained = {i: self.base.total - r.total for i, r in self.found.single.items()}
        self.one = self.unit * self.selection.gap
        self.null = self.screen.null(setting.rng) * self.one
        self._judge()
        best = self._best()
        alike = self._alike(best.ids, {})
        self.verdict = judge.verdict(self.probability, {*best.ids, *(i for group in alike for i in group)})
        listed = self.verdict == "listed_effect"
        if listed and not best.estimate.converged:
            (best,) = study.polished([best])
        self.chosen = best if listed else self.base
        self.equivalent = self._alike(best.ids, self.probability) if listed else []

    def _judge(self) -> None:
        """The probabilities; of several effects found, with the other in place of one that is more probable there."""
        self._weigh()
        if (rival := self.rival()) and self._odds(rival) > 1:
            self.found.best = rival[2]
            self._weigh()

    def _weigh(self) -> None:
        self.evidence = self._evidence()
        self.probability = judge.probabilities(self.evidence)

    def rival(self) -> Exchange | None:
        """Of several effects found, the other in place of one of them that is most probable there. It may be more so
        than that one: they were found by what they leave where all is fitted, which need not carry over."""
        known = [x for x in self.found.exchanged if self.standing.get(x[1]) is x[2]]
        return max(known, key=self._odds, default=None)

    def _odds(self, exchange: Exchange) -> float:
        gone, new, _ = exchange
        return self.probability[new] / max(self.probability[gone], 1e-300)

    def _best(self) -> Refit:
        """What was found; of effects that explain the runs alone, the most probable."""
        best, single = self.found.best, self.found.single
        return best if len(best.ids) > 1 else single[judge.main_of(self.probability, list(single))]

    def _alike(self, ids: Sequence[str], odds: Mapping[str, float]) -> list[list[str]]:
        """For each of the effects found that has any, itself and those that cannot be told from it, by what they leave
        and, of one effect, by their odds."""
        found, unit = self.found, self.evidence.unit
        if len(ids) == 1:
            groups = [judge.equivalents({i: self.evidence.left[i] for i in found.single}, ids[0], unit, odds)]
        else:
            least = {i: self.left(found.best) for i in ids}
            others = {i: {new: self.left(r) for out, new, r in found.exchanged if out == i} for i in ids}
            groups = [judge.equivalents({i: least[i], **others[i]}, i, unit) for i in ids]
        return [group for group in groups if len(group) > 1]

    def _given(self) -> Refit:
        study = self.setting.study
        like = Refit(Trial(), replace(self.base.estimate, model=study.start), self.base.loss)
        (seen,) = study.predict([like], self.setting.train, settle=True)
        return Refit(Trial(), seen, study.loss(seen))

    def own_left(self, refit: Refit) -> float:
        """The share of the shape's gap that a refit leaves."""
        return self.selection.own_left(refit)

    def left(self, refit: Refit) -> float:
        """The share of the gap a refit leaves, the measured inputs' own gap among it."""
        return self.selection.left(refit)

    @cached_property
    def folds(self) -> tuple[str, np.ndarray]:
        """What folds are made of, and (R,) the fold of each fitted run."""
        return folds.conditions(self.setting.train)

    def closes(self, refit: Refit) -> np.ndarray:
        """(F,) the share of the gap that a refit closes in each fold where that fold is left out of every fit, to first
        order; NaN where it shows no gap, or where the others cannot tell what its effects do there."""
        before, after, floor = self._unseen(self.base), self._unseen(refit), self._fold_floor
        known = (before > judge.MATTERS * floor) & (self.told_elsewhere([refit])[0] > 0.5)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(known, 1 - after / before, np.nan)

    def leave_unseen(self, refits: Sequence[Refit]) -> list[float]:
        """The shares of the gap that refits leave over all folds, the measured inputs' own gap among it. A fold counts
        as left out so far as the refit's effects act in others: of an obstacle that one run touches, the others say
        nothing, neither for it nor against it."""
        out = []
        for refit, told in zip(refits, self.told_elsewhere(refits), strict=True):
            after, before = (
                told * self._unseen(r) + (1 - told) * self._above(r.estimate.error) for r in (refit, self.base)
            )
            share = after.sum() / max(before.sum(), 1e-3 * self.selection.gap)
            share -= self.selection.excused(refit)
            out.append(self.measured.joined(float(share), refit.fitted))
        return out

    def leave_held_out(self, refits: Sequence[Refit]) -> list[float]:
        """The shares of the gap that refits leave over all runs that no fit has seen and of which the others tell; 0
        where the base leaves little there, which speaks neither for nor against any. Where it leaves less than `FAINT`
        of what it does in fitted runs, what is missing to that counts as left as in these: errors of form that are
        small beside the gap of most runs may be all that there is in one that hardly shows it."""
        study, motions = self.setting.study, self.setting.test
        seen = study.predict([self.base, *refits], motions)
        before, *after = (np.nan_to_num(study.loss(e), nan=np.inf) for e in seen)
        floor, out = study.floor(motions), []
        faint = FAINT * self.selection.excess / max(self.selection.floor, 1e-9)
        for refit, estimate, left in zip(refits, seen[1:], after, strict=True):
            told = ~unfixed(refit.effects, self.setting.train, motions)
            least, all_, some = (float(x[told].sum()) for x in (floor, before, left))
            missing = max(faint * least - (all_ - least), 0.0)
            as_fitted = missing * max(self.own_left(refit), 0.0)
            share = (some - least + as_fitted) / (all_ - least + missing) if all_ > SHOWN * least else 0.0
            if share > 0 and refit.scatter.left < 1:
                share *= study.scatter(estimate, refit.effects, told, CHANCE * refit.scatter.sd_s).left
            out.append(share)
        return out

    def told_elsewhere(self, refits: Sequence[Refit]) -> list[np.ndarray]:
        """(F,) of each refit, how far what its effects do in a fold can be told from the other folds, 0 to 1: they
        change the motion there too."""
        study, out = self.setting.study, []
        idle = [replace(r, estimate=replace(r.estimate, model=without_effects(r.model))) for r in refits]
        for refit, still in zip(refits, study.predict(idle, self.setting.train), strict=True):
            does = np.nan_to_num(study.cost(still.predicted - refit.estimate.predicted), posinf=0.0)
            does = np.bincount(self._sample_fold, does)
            out.append(np.clip((1 - does / max(does.sum(), 1e-12)) / ELSEWHERE, 0, 1))
        return out

    def _unseen(self, refit: Refit) -> np.ndarray:
        """(F,) loss above the floor of each fold where it is left out; what the effects do not need stays as all runs
        had it, or every form that they might have would speak against them."""
        return self._above(folds.left_out(refit.estimate, self.folds[1], self.selection.idle(refit)))

    def _above(self, error: np.ndarray) -> np.ndarray:
        """(F,) loss above the floor of errors (N, c) [rad] in each fold."""
        return np.bincount(self._sample_fold, self.setting.study.cost(error)) - self._fold_floor

    @cached_property
    def _sample_fold(self) -> np.ndarray:
        return self.folds[1][self.base.estimate.windows.sample_run]

    @cached_property
    def _fold_floor(self) -> np.ndarray:
        return np.bincount(self.folds[1], self.setting.study.floor(self.setting.train))

    @property
    def unit(self) -> float:
        """What a χ² of 1 is as a share of the excess, by what the best refit leaves."""
        return self.selection.unit_of(self.found.best)

    def _evidence(self) -> judge.Evidence:
        screen, found, measured = self.screen, self.found, self.measured
        self.standing: dict[str, Refit] = {}
        left = {i: self.left(r) for i, r in found.single.items()}
        several = [found.best] if len(found.best.ids) > 1 else []
        asked = [*found.single.values(), *several, *(r for *_, r in found.exchanged)]
        leave = [dict(zip(asked, self.leave_unseen(asked), strict=True))]
        leave.append(dict(zip(asked, self.leave_held_out(asked), strict=True)))
        unseen, held_out = ({i: by[r] for i, r in found.single.items()} for by in leave)
        best = min(left.values(), default=0.0)
        for i in screen.ids:
            if i not in left:
                promised = 1 - screen.gains[screen.best(i)] / self.selection.gap
                left[i] = fell_behind(measured.joined(promised, ()), best)
        size = {i: found.single[i].trial.size if i in found.single else 1 for i in left}
        used = {i: self.selection.used(r)[i] for i, r in found.single.items()}
        if len(found.best.ids) > 1:
            used |= self.selection.used(found.best)
            least = self.left(found.best)
            alone = {i: left[i] for i in found.best.ids}
            least_alone = min(alone.values())
            behind = {i: 0.15 * (x - least_alone) / max(max(alone.values()) - least, 1e-9) for i, x in alone.items()}

            def stands_for(i: str, refit: Refit, place: str) -> None:
                """What is said of effect i is what the refit says of all its effects, i in this place among them."""
                self.standing[i] = refit
                left[i] = self.left(refit) + behind[place]
                unseen[i], held_out[i] = (by[refit] + behind[place] for by in leave)

            for i in left:
                if i in alone:  # the main one is that without which most is left
                    stands_for(i, found.best, i)
                else:
                    unseen.pop(i, None)
                    held_out.pop(i, None)
                    left[i] = left[i] / max(least_alone, 1e-9) * max(least_alone, 0.5)
            for place, i, r in found.exchanged:
                if self.left(r) + behind[place] < left[i]:
                    stands_for(i, r, place)
                    used[i] = self.selection.used(r)[i]
                    size[i] = sum(p.startswith(f"effects.{i}.") for p in r.trial.start)
        chance = judge.chance(self.null, max(self.gained.values(), default=0.0), self.one)
        count = len(self.setting.study.names)
        worse = (self.given.total - self.base.total) / max(self.selection.variance_of(self.base), 1e-12)
        matters = judge.MATTERS * self.floor
        as_given = worse < count + 4 * np.sqrt(2 * count) or self.given.total < self.base.total + matters
        excess = self.excess / max(self.floor, 1e-9)
        steady = {i: self.left(r) for i, r in self.selection.steady.items()} if len(found.best.ids) == 1 else {}
        about = unseen, self.flexible, used, held_out, steady
        return judge.Evidence(excess, left, size, self.unit, chance, bool(as_given), *about)

    @cached_property
    def flexible(self) -> dict[str, float]:
        """By place, what a stand-in there leaves of the shape's gap; where the effects first found leave little,
        nothing, unless one of them mimics what a stand-in is for."""
        study, best = self.setting.study, self.found.best
        left = self.own_left(best)
        if self.excess < judge.OPEN * self.floor or (left < SOME and not judge.MIMICS & {*best.ids}):
            return {}
        found = stand_in(study, self.base, QUICK) | (stand_in(study, self.base, STAND_INS) if left > LEFT_OVER else {})
        return {place: min(self.own_left(r), 1.0) for place, r in found.items()}
