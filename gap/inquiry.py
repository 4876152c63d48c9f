"""The inquiry: base, screen, leaders, forward selection, and the evidence that comes of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ljjax.fit import folds
from ljjax.fit.windows import Motion
from ljjax.gap import channels, judge, screening
from ljjax.gap.candidates import CAUTIOUS, Trial, cautious
from ljjax.gap.channels import Measured
from ljjax.gap.screening import Screen
from ljjax.gap.search import Refit, Study
from ljjax.gap.stand_ins import stand_in
from ljjax.logs import Run
from ljjax.modelfile import ModelFile

LEADERS, FEW, SECOND, MOST = 12, 4, 5, 3
"""How many candidates are refitted alone, how many where chance promises as much as they do, how many with those found
before, and how many are found at most."""
AFRESH = 0.3
"""Where the best candidate leaves more than this share of the gap, the leaders are begun from the given model too."""
HEARD = 3
"""How many effects that measured inputs show are begun as they show there."""
ASTRAY = 0.98
"""A candidate that leaves more than this share of the base's loss has found nothing, or not its way."""
LEFT_OVER = 0.1
"""The share of the gap that is worth telling of where the effects found leave it."""
FURTHER, PAIRS = 0.12, 0.25
"""Shares of the gap, left by one effect, from which a further one is looked for, and from which pairs of others are."""


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
    warnings: list[str] = field(default_factory=list)


@dataclass
class Found:
    """What the search found: each effect's best refit alone, joint refits by their effects, the best of all."""

    single: dict[str, Refit]
    joint: dict[tuple[str, ...], Refit]
    best: Refit

    @property
    def exchanged(self) -> list[tuple[str, str, Refit]]:
        """Of several effects found, one of them, another in its place, and the refit with that."""
        ids, out = set(self.best.ids), []
        for key, r in self.joint.items():
            new, gone = set(key) - ids, ids - set(key)
            if len(new) == len(gone) == 1:
                out.append((*gone, *new, r))
        return out


class Inquiry:
    """A diagnosis that has run.

    Attributes:
        setting: what it was given.
        base, given: the base refitted, and the given model as it is, on the training runs.
        screen, measured, found: candidates to first order; what measured inputs say; candidates refitted.
        floor, excess: of the base's loss, the noise's part and the rest.
        evidence, probability, verdict, chosen: what comes of it.
        gained, null, one: the loss that each refit takes away, the largest losses that chance takes away (D,), and the
            loss that a χ² of 1 stands for.
    """

    def __init__(self, setting: Setting):
        study = setting.study
        self.setting = setting
        self._joined: dict[Refit, float] = {}
        self.base = study.base()
        self.given = self._given()
        self.screen = study.screen(self.base)
        self.measured: Measured = channels.look(setting.train, study.kinds)
        self.floor = study.floor(sum(len(m.t) for m in setting.train))
        self.excess = self.base.total - self.floor
        self.found = self._forward(self._leaders())
        self.gained = {i: self.base.total - r.total for i, r in self.found.single.items()}
        self.one = self.unit * self.gap
        self.null = self.screen.null(setting.rng) * self.one
        self.evidence = self._evidence()
        self.probability = judge.probabilities(self.evidence)
        self.verdict = judge.verdict(self.probability)
        self.chosen = study.polished(self.found.best) if self.verdict == "listed_effect" else self.base

    def _given(self) -> Refit:
        study = self.setting.study
        like = Refit(Trial(), replace(self.base.estimate, model=study.start), self.base.loss)
        (seen,) = study.predict([like], self.setting.train, settle=True)
        return Refit(Trial(), seen, study.loss(seen))

    # --- the search

    def _leaders(self) -> list[Refit]:
        """The candidates that promise most, refitted alone."""
        screen, study = self.screen, self.setting.study
        keys = sorted(screen.gains, key=lambda k: -screen.gains[k])
        first = self._ahead(screen, LEADERS if self._promising() else FEW)
        first += [screen.best(i) for i in self.measured.speaks if i in screen.ids and screen.best(i) not in first]
        more = [k for k in keys if k not in first and k[0] in {f[0] for f in first[:4]}][:4]
        trials, steps = [], {}
        for key in [*first, *more]:
            trial, step = study.trial(screen, key)
            trials.append(trial)
            steps[trial] = step
        trials += self._heard()
        found = study.refit(self.base.model, trials, screen, steps, finish=4, sure=3)
        least = min((self.own_left(r) for r in found), default=1.0)
        if self.excess > judge.OPEN * self.floor and least > FURTHER:
            found += self._with_care(trials, steps, found)
            found += self._afresh() if least > AFRESH else []
        return found

    def _with_care(
        self, trials: Sequence[Trial], steps: Mapping[Trial, np.ndarray], found: Sequence[Refit]
    ) -> list[Refit]:
        """Effects no form of which has come below `ASTRAY` of the base's loss though they vanish at it: the first step
        has led them astray, so they are begun once more, nearer to the base."""
        study = self.setting.study
        least: dict[str, float] = {}
        for r in found:
            least[r.ids[0]] = min(r.total, least.get(r.ids[0], np.inf))
        lost = [t for t in trials if least.get(t.ids[0], np.inf) > ASTRAY * self.base.total]
        again = {t: cautious(t, study.kinds) for t in lost}
        moves = {again[t]: CAUTIOUS * steps[t] for t in lost if t in steps}
        return study.refit(self.base.model, list(again.values()), self.screen, moves, "with care", finish=2)

    def _afresh(self) -> list[Refit]:
        """Leaders once more, begun from the given model: a large effect bends the base's refit so far that effects
        begun there may not find their way."""
        study, screen = self.setting.study, self.setting.study.screen(self.given)
        trials, steps = [], {}
        for key in self._ahead(screen, SECOND + 1):
            trial, step = study.trial(screen, key)
            trials.append(trial)
            steps[trial] = step
        return study.refit(study.start, trials, screen, steps, "candidates from the given model", finish=3, sure=3)

    @staticmethod
    def _ahead(screen: Screen, count: int) -> list[tuple[str, int]]:
        """Of each effect its best form: those that promise most, and those that promise most firmly, in turns."""
        best = [screen.best(i) for i in screen.ids]
        most, firm = (sorted(best, key=lambda k: -by[k]) for by in (screen.gains, screen.firm))
        return list(dict.fromkeys(k for pair in zip(most, firm, strict=True) for k in pair))[:count]

    def _heard(self, onto: Refit | None = None) -> list[Trial]:
        """Effects that measured inputs show, begun as they show there."""
        ids, before = (onto.ids, onto.free_effects) if onto else ((), {})
        return [
            Trial((*ids, i), {**before, **{f"effects.{i}.{n}": x for n, x in values.items()}})
            for i, values in self.measured.speaks.items()
            if i not in ids and i in self.screen.ids
        ][:HEARD]

    def _promising(self) -> bool:
        """Whether there is a gap and some candidate promises more than chance would."""
        gain, one = max(self.screen.gains.values()), self._variance(self.base)
        null = self.screen.null(np.random.default_rng(self.setting.seed)) * one
        return self.excess > judge.MATTERS * self.floor and judge.chance(null, gain, one) < 0.2

    def _forward(self, singles: Sequence[Refit]) -> Found:
        """Forward selection with backward pruning, and all pairs among the leaders."""
        study, left = self.setting.study, {}
        for r in singles:
            self.measured.listen(self.own_left(r), r.fitted)
        for r in sorted(singles, key=self.left):
            left.setdefault(r.ids[0], r)
        if not left:
            raise FloatingPointError("no candidate simulates on these runs")
        found = Found(left, {}, next(iter(left.values())))
        unit = self._unit(found.best)
        while len(found.best.ids) < MOST:
            share = self.left(found.best)
            if share < max(FURTHER, 15 * unit):
                break
            on_top = study.screen(found.best)
            keys = self._ahead(on_top, SECOND)
            trials, steps = [], {}
            for key in keys:
                trial, step = study.trial(on_top, key, found.best)
                trials.append(trial)
                steps[trial] = step
            trials += self._heard(found.best)
            if len(found.best.ids) == 1 and share > PAIRS:
                leaders = [i for i in left if i != found.best.ids[0]][:4]
                for a, b in ((a, b) for k, a in enumerate(leaders) for b in leaders[k + 1 :]):
                    joint = {**left[a].free_effects, **left[b].free_effects}
                    trials.append(Trial((a, b), joint))
            more = study.refit(found.best.model, trials, on_top, steps, stage="several effects", finish=2, sure=1)
            for r in more:
                key = tuple(sorted(r.ids))
                if key not in found.joint or r.total < found.joint[key].total:
                    found.joint[key] = r
            if not more:
                break
            better = min(more, key=self.left)
            if not judge.pairs_worth(share, self.left(better), unit):
                break
            found.best = better
        if len(found.best.ids) > 2:
            found.best = self._pruned(found.best, unit)
        if len(found.best.ids) > 1:
            self._exchange(found)
        return found

    def _exchange(self, found: Found) -> None:
        """Each of several effects exchanged for those that promise most in its place: what was found first need not be
        what fits best beside the others, nor the simplest that does."""
        study, ids, unit = self.setting.study, found.best.ids, self._unit(found.best)
        for out in ids:
            rest = tuple(sorted(i for i in ids if i != out))
            like = found.single.get(rest[0]) if len(rest) == 1 else found.joint.get(rest)
            if like is None:
                continue
            on_top = study.screen(like)
            begun = [study.trial(on_top, k, like) for k in self._ahead(on_top, SECOND)]
            begun = [(t, step) for t, step in begun if tuple(sorted(t.ids)) not in found.joint]
            for r in study.refit(like.model, [t for t, _ in begun], on_top, dict(begun), "exchanges", finish=2):
                found.joint[tuple(sorted(r.ids))] = r
        rivals = [r for key, r in found.joint.items() if len(key) == len(ids)]
        least = max(min(self.left(r) for r in rivals), 0.0)
        near = [r for r in rivals if self.left(r) <= judge.as_little(least, unit)]
        found.best = min(near, key=lambda r: (r.trial.size, self.left(r)))

    def _pruned(self, best: Refit, unit: float) -> Refit:
        """Backward: without each of the effects, where the others do nearly as well without it."""
        start = best.trial.start
        fewer = [
            Trial(tuple(i for i in best.ids if i != out), {p: x for p, x in start.items() if p.split(".")[1] != out})
            for out in best.ids
        ]
        for r in self.setting.study.refit(best.model, fewer, self.screen, stage="pruning"):
            if not judge.pairs_worth(self.left(r), self.left(best), unit):
                best = r
        return best

    # --- what it says

    @property
    def gap(self) -> float:
        """The excess of which leftovers are shares; where there is none, a thousandth of the floor."""
        return max(self.excess, 1e-3 * self.floor)

    def own_left(self, refit: Refit) -> float:
        """The share of the shape's gap that a refit leaves."""
        return float((refit.total - self.floor) / self.gap)

    def left(self, refit: Refit) -> float:
        """The share of the gap a refit leaves, the measured inputs' own gap among it."""
        if refit not in self._joined:
            self._joined[refit] = self.measured.joined(self.own_left(refit), refit.fitted)
        return self._joined[refit]

    @cached_property
    def folds(self) -> tuple[str, np.ndarray]:
        """What folds are made of, and (R,) the fold of each fitted run."""
        return folds.conditions(self.setting.train)

    def closes(self, refit: Refit) -> np.ndarray:
        """(F,) the share of the gap that a refit closes in each fold where that fold is left out of every fit, to first
        order; NaN where it shows no gap."""
        before, after, floor = self._unseen(self.base), self._unseen(refit), self._fold_floor
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(before > judge.MATTERS * floor, 1 - after / before, np.nan)

    def leaves_unseen(self, refit: Refit) -> float:
        """The share of the gap that a refit leaves over all folds."""
        return float(self._unseen(refit).sum() / max(self._unseen(self.base).sum(), 1e-3 * self.gap))

    def _unseen(self, refit: Refit) -> np.ndarray:
        """(F,) loss above the floor of each fold where it is left out."""
        fold = self.folds[1]
        cost = self.setting.study.cost(folds.left_out(refit.estimate, fold))
        return np.bincount(self._sample_fold, cost) - self._fold_floor

    @cached_property
    def _sample_fold(self) -> np.ndarray:
        return self.folds[1][self.base.estimate.windows.sample_run]

    @cached_property
    def _fold_floor(self) -> np.ndarray:
        return self.setting.study.floor(1) * np.bincount(self._sample_fold)

    @cached_property
    def unit(self) -> float:
        """What a χ² of 1 is as a share of the excess, by what the best refit leaves."""
        return self._unit(self.found.best)

    def _unit(self, refit: Refit) -> float:
        return self._variance(refit) / self.gap

    def _variance(self, refit: Refit) -> float:
        """The variance that a refit leaves, its colour counted: the loss that a χ² of 1 stands for."""
        error = refit.estimate.error / self.setting.study.unit
        return float(screening.colour(error, refit.estimate.windows.sample_run) * np.mean(error**2))

    def _evidence(self) -> judge.Evidence:
        screen, found, measured = self.screen, self.found, self.measured
        left = {i: self.left(r) for i, r in found.single.items()}
        for i in screen.ids:
            if i not in left:  # not refitted: what the Jacobian promises, at best
                promised = 1 - screen.gains[screen.best(i)] / self.gap
                left[i] = max(measured.joined(promised, ()), 0.35)
        size = {i: found.single[i].trial.size if i in found.single else 1 for i in left}
        if len(found.best.ids) > 1:
            least = self.left(found.best)
            alone = {i: left[i] for i in found.best.ids}
            least_alone = min(alone.values())
            behind = {i: 0.15 * (x - least_alone) / max(max(alone.values()) - least, 1e-9) for i, x in alone.items()}
            for i in left:
                if i in alone:  # the main one is that without which most is left
                    left[i] = least + behind[i]
                else:
                    left[i] = left[i] / max(least_alone, 1e-9) * max(least_alone, 0.5)
            for place, i, r in found.exchanged:
                left[i] = min(left[i], self.left(r) + behind[place])
                size[i] = sum(p.startswith(f"effects.{i}.") for p in r.trial.start)
        chance = judge.chance(self.null, max(self.gained.values(), default=0.0), self.one)
        count = len(self.setting.study.names)
        worse = (self.given.total - self.base.total) / max(self._variance(self.base), 1e-12)
        matters = judge.MATTERS * self.floor
        as_given = worse < count + 4 * np.sqrt(2 * count) or self.given.total < self.base.total + matters
        unseen = {i: self.leaves_unseen(r) for i, r in found.single.items()}
        excess = self.excess / max(self.floor, 1e-9)
        return judge.Evidence(excess, left, size, self.unit, chance, bool(as_given), unseen, self._flexible())

    def _flexible(self) -> dict[str, float]:
        """By place, what a stand-in there leaves of the shape's gap; where the effects found leave little, nothing."""
        if self.excess < judge.OPEN * self.floor or self.own_left(self.found.best) < LEFT_OVER:
            return {}
        found = stand_in(self.setting.study, self.base)
        return {place: min(self.own_left(r), 1.0) for place, r in found.items()}
