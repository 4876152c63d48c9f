"""The search: the leaders refitted alone, forward selection among them, pruning, and exchanges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ljjax.effect import Effect
from ljjax.effects.varying import EACH
from ljjax.gap import judge, screening
from ljjax.gap.candidates import CAUTIOUS, Trial, cautious, either_side, path
from ljjax.gap.channels import Measured
from ljjax.gap.screening import Screen, ahead
from ljjax.gap.search import Refit, Study
from ljjax.gap.variation import FURTHER, VARIED, Variation, anchored, freely, level, shares_of

LEADERS, FEW, SECOND, MOST = 12, 4, 5, 3
"""How many candidates are refitted alone, how many where chance promises as much as they do, how many with those found
before, and how many are found at most."""
TELLING, NOTABLE = 2, 0.9
"""On how many runs, those that show most of the gap, the effects not begun from the given model yet are begun there,
where no other explains it, and pairs; and the share, of what the best so far leaves there, that one worth going on with
leaves at most. An effect that leaves more than that of the whole gap is no ground to add a further one to."""
WIDE, FORMS, NEAR, NEARER = 6, 9, 4.0, 0.3
"""How many leaders are wherever there is a gap; in all their forms, if they have no more than that; and taken further
where they come within so many times the least loss, or leave no more than this share of the gap."""
WELL, ANEW = 0.05, 3
"""Where the best, alone or of two, leaves more than this share of the gap, more is tried; how many of the best are
begun at the given model once more."""
HEARD = 3
"""How many effects that measured inputs show are begun as they show there."""
LITTLE = 0.001
"""The share of the gap up to which all that parameters take together does not count for their effect."""
ALIKE = 0.005
"""The share of the gap, left by a leader, from which it is begun with other parameters that do much the same."""
ASTRAY, LOST = 0.98, 8
"""A candidate that leaves more than this share of the base's loss has found nothing, or not its way; how many of those
are begun once more."""
PAIRS, LEADING, PROMISED = 0.25, 5, 5
"""The share of the gap, left by one effect, from which all pairs of so many leaders are tried; and how many of the
pairs that promise most are tried."""
GROUNDS, MOUNTS = 2, 3
"""Beside how many leaders, as they were before they varied, what promises most is looked for where the best does not
lead to a pair that explains the runs: it may be the best as it varies, or begins at once, in another's stead; and
beside how many what may be another in each run."""
CLOSE, CLOSER, OFF = 3, 2.0, 0.6
"""How many single effects are taken to their end before they are judged, none that leaves so many times the least, nor
where that is so large a share of the gap that no effect explains it."""

Exchange = tuple[str, str, Refit]


@dataclass
class Found:
    """What the search found: each effect's best refit alone, joint refits by their effects, the best of all."""

    single: dict[str, Refit]
    joint: dict[tuple[str, ...], Refit]
    best: Refit

    @property
    def exchanged(self) -> list[Exchange]:
        """Of several effects found, one of them, another in its place, and the refit with that."""
        ids, out = set(self.best.ids), list[Exchange]()
        for key, r in self.joint.items():
            new, gone = set(key) - ids, ids - set(key)
            if len(new) == len(gone) == 1:
                out.append((gone.pop(), new.pop(), r))
        return out


def pairs(leaders: Sequence[Refit], kinds: Sequence[type[Effect]]) -> list[Trial]:
    """All pairs of them, to be begun at the given model, as the bases refitted with one of two went astray: one as it
    was found alone, the other cautiously beside it, as each alone did what both are to do; with the first of them
    either way round."""
    out = []
    for k, a in enumerate(leaders):
        for b in leaders[k + 1 :]:
            for one, other in ((a, b), (b, a))[: 2 if k == 0 else 1]:
                less = cautious(Trial(other.ids, other.free_effects), kinds)
                out.append(Trial((*one.ids, *other.ids), {**one.free_effects, **less.start}))
    return out


def _leading(refits: Sequence[Refit], count: int) -> list[Refit]:
    """The best of each effect, or effects, of those that leave least."""
    best: dict[tuple[str, ...], Refit] = {}
    for r in sorted(refits, key=lambda r: r.total):
        best.setdefault(r.ids, r)
    return list(best.values())[:count]


class Selection:
    """A search that has run.

    Attributes:
        study, base, given, screen, measured, seed: what it was given (see `ljjax.gap.inquiry.Inquiry`).
        floor, excess: of the base's loss, the noise's part and the rest.
        steady: of single effects that vary, those found before they did (`ljjax.gap.variation.Variation`).
        found: the candidates refitted.
    """

    def __init__(self, study: Study, base: Refit, given: Refit, screen: Screen, measured: Measured, seed: int):
        self.study, self.base, self.given = study, base, given
        self.screen, self.measured, self.seed = screen, measured, seed
        self._joined: dict[Refit, float] = {}
        self._from_given: Screen | None = None
        self.floor = float(study.floor(study.motions).sum())
        self.excess = base.total - self.floor
        self.found = self._forward(self._leaders())
        self._finish()

    @property
    def gap(self) -> float:
        """The excess of which leftovers are shares; where there is none, a thousandth of the floor."""
        return max(self.excess, 1e-3 * self.floor)

    def own_left(self, refit: Refit) -> float:
        """The share of the shape's gap that a refit leaves."""
        return float((refit.total - self.floor) / self.gap)

    def excused(self, refit: Refit) -> float:
        """The share of it that a latency's scatter accounts for, which no fit foretells."""
        return max(self.own_left(refit), 0.0) * (1 - refit.scatter.left)

    def left(self, refit: Refit) -> float:
        """The share of the gap a refit leaves, the measured inputs' own gap among it, but for what is excused."""
        if refit not in self._joined:
            own = self.own_left(refit) - self.excused(refit)
            self._joined[refit] = self.measured.joined(own, refit.fitted)
        return self._joined[refit]

    def unit_of(self, refit: Refit) -> float:
        """What a χ² of 1 is as a share of the gap, by what a refit leaves."""
        return self.variance_of(refit) / self.gap

    def variance_of(self, refit: Refit) -> float:
        """The variance that a refit leaves, its colour counted: the loss that a χ² of 1 stands for."""
        error = refit.estimate.error / self.study.unit
        return float(screening.colour(error, refit.estimate.windows.sample_run) * np.mean(error**2))

    def used(self, refit: Refit) -> dict[str, int]:
        """How many parameters each effect of a refit needs, but for those that take next to nothing of the gap."""
        return refit.used(self._little(refit))

    def idle(self, refit: Refit) -> list[int]:
        """The coordinates of its other ones."""
        return refit.idle(self._little(refit))

    def _little(self, refit: Refit) -> float:
        return LITTLE / max(self.unit_of(refit), 1e-300)

    def _leaders(self) -> list[Refit]:
        """The candidates that promise most, refitted alone."""
        screen, study = self.screen, self.study
        keys = sorted(screen.gains, key=lambda k: -screen.gains[k])
        first = ahead(screen, LEADERS if self._promising() else FEW)
        first += [screen.best(i) for i in self.measured.speaks if i in screen.ids and screen.best(i) not in first]
        more = [k for k in keys if k not in first and k[0] in {f[0] for f in first[:4]}][:4]
        steps = self._begun(screen, [*first, *more])
        trials = [*steps, *self._heard()]
        found = study.refit(self.base.model, trials, screen, steps, finish=4, sure=3)
        if self.excess <= judge.OPEN * self.floor or not np.isfinite(self.given.total):
            return found
        screen = self._from_given = study.screen(self.given)
        best_first = list(dict.fromkeys(r.ids[0] for r in sorted(found, key=lambda r: r.total)))
        promising = [i for i, _ in ahead(self.screen, WIDE)]
        begun = list(dict.fromkeys(i for both in zip(best_first, promising, strict=False) for i in both))[:WIDE]
        least = min((r.total for r in found), default=np.inf)
        found += self._around(screen, begun, max(NEAR * least, self.floor + NEARER * self.excess))
        found += self._with_care(trials, found)
        found += self._likewise(found)
        if self._least(found) > WELL:
            found += self._anew(_leading(found, ANEW))
            if self._least(found) > FURTHER:  # nothing explains it: then of those too that promise nothing
                rest = [t for i in screen.ids if i not in begun for t in self._trials_around(screen, i)]
                found += self._on_few(rest, found, "from the given model", finish=6)
        return found

    def _likewise(self, found: Sequence[Refit]) -> list[Refit]:
        """The leaders begun once more with other parameters that do much the same, if they have any; more of them where
        none explains the gap."""
        kinds, out = {k.id: k for k in self.study.kinds}, list[Refit]()
        for r in _leading(found, CLOSE if self._least(found) < WELL else WIDE):
            kind, values = kinds[r.ids[0]], {p.split(".")[2]: x for p, x in r.free_effects.items()}
            others = kind.likewise(values) if self.own_left(r) > ALIKE else []
            trials = [Trial(r.ids, {path(kind, n): x for n, x in other.items()}) for other in others]
            out += self.study.refit(r.model, trials, None, stage="likewise") if trials else []
        return out

    def _least(self, refits: Sequence[Refit]) -> float:
        return min((self.own_left(r) for r in refits), default=1.0)

    def _least_left(self, refits: Sequence[Refit]) -> float:
        return min(map(self.left, refits), default=1.0)

    def _anew(self, refits: Sequence[Refit]) -> list[Refit]:
        """The same once more, begun at the given model with the effects as they were found: the base's refit, which
        had to do without them, may have gone where they cannot bring it back from."""
        trials = [Trial(r.ids, r.free_effects) for r in refits]
        return self.study.refit(self.study.start, trials, None, stage="the best from the given model", finish=2)

    def _with_care(self, trials: Sequence[Trial], found: Sequence[Refit]) -> list[Refit]:
        """Effects no form of which has come below `ASTRAY` of the base's loss though they vanish at it: the first step
        has led them astray, so they are begun once more, at the base and nearer to it; where others explain much, those
        only that promised as much."""
        study, screen = self.study, self.screen
        least: dict[str, float] = {}
        for r in found:
            least[r.ids[0]] = min(r.total, least.get(r.ids[0], np.inf))
        lost = [t for t in trials if least.get(t.ids[0], np.inf) > ASTRAY * self.base.total]
        if self._least(found) < FURTHER:
            lost = [t for t in lost if screen.gains[screen.best(t.ids[0])] > (1 - NEARER) * self.gap]
        again = [cautious(t, study.kinds) for t in lost[:LOST]]
        return study.refit(self.base.model, again, self.screen, stage="with care", finish=2)

    def _on_few(self, trials: Sequence[Trial], found: Sequence[Refit], stage: str, finish: int) -> list[Refit]:
        """Trials begun at the given model on the few runs that show most of the gap; the best of those that leave
        notably less there than the best of `found`, refitted to all runs."""
        better = self._told_by_few(self.study, trials, found, stage)
        return self.study.taken_over(better, f"{stage}, all runs", finish, further=2)

    def _told_by_few(self, study: Study, trials: Sequence[Trial], found: Sequence[Refit], stage: str) -> list[Refit]:
        """Of trials begun at the given model those that leave notably less than the best of `found` on the few runs
        that show most of the gap, refitted to these."""
        screen, runs = self._from_given, self._telling
        assert screen is not None
        mine = np.isin(self.given.estimate.windows.sample_run, runs)
        there = replace(screen, base_jacobian=screen.base_jacobian[mine])
        begun = study.of(runs.tolist()).weeded(study.start, trials, there, f"{stage}, few runs")
        least = min((float(r.loss[runs].sum()) for r in found), default=np.inf)
        return [r for r in begun if r.total < NOTABLE * least]

    @property
    def _telling(self) -> np.ndarray:
        """The few runs that show most of the gap, in order."""
        return np.sort(np.argsort(-self.base.loss)[:TELLING])

    def _trials_around(self, screen: Screen, effect: str) -> list[Trial]:
        forms = [k for k in screen.forms if k[0] == effect]
        keys = forms if len(forms) <= FORMS else [screen.best(effect)]
        return [t for key in keys for t in self._either_side(screen, key)]

    def _either_side(self, screen: Screen, key: tuple[str, int]) -> list[Trial]:
        return either_side(self.study.trial(screen, key)[0], self.study.kinds)

    def _around(self, screen: Screen, ids: Sequence[str], within: float = np.inf) -> list[Refit]:
        """Effects begun from the given model, of which the screen is, in each of their forms and to either side of
        where they vanish: to first order the way to a large effect is not known, the less where the base has been
        bent to it."""
        study, trials = self.study, [t for i in ids for t in self._trials_around(screen, i)]
        return study.refit(study.start, trials, screen, stage="from the given model", finish=6, within=within)

    def _begun(
        self, screen: Screen, keys: Sequence[tuple[str, int]], onto: Refit | None = None
    ) -> dict[Trial, np.ndarray]:
        """The trials that start where a screen points, and how far the base moves along with each."""
        return dict(self.study.trial(screen, key, onto) for key in keys)

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
        gain, one = max(self.screen.gains.values()), self.variance_of(self.base)
        null = self.screen.null(np.random.default_rng(self.seed)) * one
        return self.excess > judge.MATTERS * self.floor and judge.chance(null, gain, one) < 0.2

    def _forward(self, singles: Sequence[Refit]) -> Found:
        """Forward selection with backward pruning, and all pairs among the leaders."""
        left: dict[str, Refit] = {}
        for r in singles:
            self.measured.listen(self.own_left(r), r.fitted)
        for r in sorted(singles, key=self.left):
            left.setdefault(r.ids[0], r)
        if not left:
            raise FloatingPointError("no candidate simulates on these runs")
        variation = Variation(self.study, self.base, self.screen, self.left, self.gap)
        if self.excess > judge.OPEN * self.floor:
            variation.let(left)
        self.steady = variation.steady
        found = Found(left, {}, min(left.values(), key=self.left))
        unit = self.unit_of(found.best)
        matters = self.excess > judge.MATTERS * self.floor  # else none is named, whatever several would explain
        while matters and len(found.best.ids) < MOST:
            share = self.left(found.best)
            if share < judge.least_worth(unit):
                break
            more = self._further(found.best, unit) if share < NOTABLE else []
            leaders = sorted(left.values(), key=self.left)
            told = judge.as_little(0.0, unit)  # which cannot be told from nothing, so that no other pair does better
            alone = len(found.best.ids) == 1
            for ground in self._grounds(leaders) if alone and share < NOTABLE else []:
                if self._least_left(more) > told:
                    more += self._further(ground, unit)
            if alone and share < NOTABLE and self._least_left(more) > told:
                more += self._promised()
            if alone and share > PAIRS and self._least_left(more) > told:
                more += self._pairs(leaders, hopeless=share > OFF)
            if alone and share < NOTABLE and self._least_left(more) > told:
                more += [r for r in self._mounted(variation, leaders, more) if self.left(r) < FURTHER]
            if self._least_left(more) > told:
                more += variation.of_several(more)
            for r in more:
                key = tuple(sorted(r.ids))
                if key not in found.joint or r.total < found.joint[key].total:
                    found.joint[key] = r
            better = min((*more, found.best), key=self.left)
            if not judge.pairs_worth(share, self.left(better), unit):
                break
            found.best = better
        self._prune(found, unit)
        if len(found.best.ids) > 1:
            self._exchange(found)
        return found

    def _grounds(self, leaders: Sequence[Refit]) -> list[Refit]:
        """Those of which the best, as they were before they varied, leave least, but for the best itself."""
        steady = sorted((self.steady.get(r.ids[0], r) for r in leaders), key=self.left)
        return [r for r in steady if r.ids and r is not leaders[0] and self.left(r) < NOTABLE][:GROUNDS]

    def _further(self, best: Refit, unit: float) -> list[Refit]:
        """What promises most on top of the best so far, refitted with it; begun anew where none of it is worth having,
        as the best had to do the others' part, and may have gone where they cannot bring it back from."""
        if len(best.ids) == len(self.study.kinds):
            return []
        on_top = self.study.screen(best)
        steps = self._begun(on_top, ahead(on_top, SECOND), best)
        trials = [*steps, *self._heard(best)]
        more = self.study.refit(best.model, trials, on_top, steps, stage="several effects", finish=2, sure=1)
        found = {id(r.trial) for r in more if r.total < best.total}
        less = {self._carefully(t, best): CAUTIOUS * x for t, x in steps.items() if id(t) not in found}
        more += self.study.refit(best.model, [*less], on_top, less, stage="several effects, with care", finish=2)
        if any(judge.pairs_worth(self.left(best), self.left(r), unit) for r in more):
            return more
        ordered = sorted(more, key=self.left)
        promised = [r for r in ordered if r.ids == trials[0].ids][:1]
        return more + self._anew(list(dict.fromkeys([*promised, *ordered]))[:ANEW])

    def _carefully(self, trial: Trial, onto: Refit) -> Trial:
        """A trial on top of a refit whose step has led it astray, begun nearer to that."""
        return Trial(trial.ids, {**cautious(trial, self.study.kinds).start, **onto.free_effects})

    def _pairs(self, singles: Sequence[Refit], hopeless: bool) -> list[Refit]:
        """All pairs of the leaders, from the given model; where no single effect comes near, on few runs first."""
        both = pairs(singles[:LEADING], self.study.kinds)
        if hopeless and self._from_given is not None:
            return self._on_few(both, singles, "pairs", finish=2)
        return self.study.refit(self.study.start, both, self._from_given, stage="pairs", finish=2)

    def _promised(self) -> list[Refit]:
        """The pairs that promise most together, whatever each does alone: begun at the base, where the promise was
        made, by whole steps and by cautious ones, and at the given model, as two may have bent the base away."""
        study, screen = self.study, self.screen
        trials = [
            Trial(ids, {f"effects.{i}.{n}": x for i in ids for n, x in values[i].items()})
            for ids, values in screen.promised(PROMISED)
        ]
        there = [*trials, *(cautious(t, study.kinds) for t in trials)]
        found = study.refit(self.base.model, there, screen, stage="promised pairs", finish=2)
        return found + study.refit(study.start, trials, self._from_given, stage="promised pairs", finish=2)

    def _mounted(self, variation: Variation, leaders: Sequence[Refit], pairs: Sequence[Refit]) -> list[Refit]:
        """What may be another effect in each run beside the two of the best pair so far, if that leaves little, and the
        first leaders, as they were before they varied; from the given model, on few runs first, in the others then
        begun between what it came to be there."""
        screen, count = self._from_given, len(self.study.motions)
        if screen is None or count <= TELLING:
            return []
        alone = {r.ids[0]: variation.plain.get(r.ids[0], r) for r in leaders}
        best = min(pairs, key=self.left, default=None)
        first = [i for i in best.ids if i in alone] if best and self.left(best) < FURTHER else []
        kinds, out = variation.by_run(), list[Refit]()
        grounds = [alone[i] for i in dict.fromkeys([*first, *alone])][:MOUNTS]
        under = {k.id: k for k in self.study.kinds if any(k.id in g.ids for g in grounds)}
        study, known = variation.only({**under, **kinds}), [int(r) for r in self._telling]
        other = min(known, key=lambda r: self.base.loss[r])
        for ground in grounds:
            both = [
                Trial((*ground.ids, i), {**ground.free_effects, **t.start, path(kinds[i], EACH.format(other + 1)): 0.0})
                for i in kinds
                if i not in ground.ids
                for t in self._either_side(screen, screen.best(i))
            ]
            few = self._told_by_few(study, both, [ground], "another in each run")
            for r in sorted(few, key=lambda r: r.total)[:2]:
                out += self._in_all_runs(study, kinds[r.ids[1]], r, known)
            if any(self.left(r) < VARIED for r in out):
                break
        variation.keep({r.ids[1]: kinds[r.ids[1]] for r in out if self.left(r) < FURTHER})
        return out

    def _in_all_runs(self, study: Study, kind: type[Effect], refit: Refit, known: list[int]) -> list[Refit]:
        """A refit to few runs with an effect that is another in each, refitted to all: its share in each free first,
        then but for that in the run where it is largest, which its sizes are of."""
        count = len(study.motions)
        shares = np.interp(range(count), known, shares_of(kind, refit.free_effects, count)[known])
        for free in (freely, anchored):
            trial = Trial(refit.ids, free(kind, refit.free_effects, shares))
            begun = level(kind, refit.model, count)
            found = study.refit(begun, [trial], None, stage="another in each run, all runs")
            if not found:
                return []
            (refit,) = found
            shares = shares_of(kind, refit.free_effects, count)
        return [refit]

    def _exchange(self, found: Found) -> None:
        """Each of several effects exchanged for those that promise most in its place, itself among them, as its form is
        told better beside the others: what was found first need not be what fits best beside the others,
        nor the simplest that does."""
        study, ids, unit = self.study, found.best.ids, self.unit_of(found.best)
        for out in ids:
            rest = tuple(sorted(i for i in ids if i != out))
            like = found.single.get(rest[0]) if len(rest) == 1 else found.joint.get(rest)
            if like is None:
                continue
            on_top = study.screen(like)
            steps = self._begun(on_top, ahead(on_top, SECOND), like)
            for r in study.refit(like.model, list(steps), on_top, steps, "exchanges", finish=2):
                key = tuple(sorted(r.ids))
                found.joint[key] = min(found.joint.get(key, r), r, key=lambda x: x.total)
        rivals = [r for key, r in found.joint.items() if len(key) == len(ids)]
        if self._least(rivals) > WELL:
            rivals += self._anew(sorted(rivals, key=self.left)[:ANEW])
            for r in rivals:
                key = tuple(sorted(r.ids))
                found.joint[key] = min(found.joint[key], r, key=lambda x: x.total)
        least = min(0.0, *(self.left(r) for r in rivals))
        worth = [judge.worth(judge.blurred(self.left(r) - least, unit), sum(self.used(r).values())) for r in rivals]
        found.best = rivals[int(np.argmax(worth))]

    def _finish(self) -> None:
        """What was found taken to its end; of single effects those that come near the best too. What a refit leaves
        where a condition is left out is known to first order only where it has come to rest."""
        found = self.found
        if len(found.best.ids) > 1:
            (found.best,) = self.study.polished([found.best])
            found.joint[tuple(sorted(found.best.ids))] = found.best
            return
        least = self.left(found.best)
        if least > OFF:
            return
        near = sorted(found.single.values(), key=self.left)[:CLOSE]
        near = [r for r in near if self.left(r) <= CLOSER * max(least, 0.01)]
        near = self._plainest(self.study.polished(near, "the best to their end"))
        found.single |= {r.ids[0]: r for r in near}
        found.best = min(found.single.values(), key=self.left)

    def _plainest(self, refits: Sequence[Refit]) -> list[Refit]:
        """The same without the sizes of their effects that take next to nothing of the gap, where that is so once the
        others are refitted: what forms such sizes would have says nothing."""
        gone = [(r, r.needless(self._little(r))) for r in refits]
        fewer = {r.ids: r for r in self.study.without([(r, x) for r, x in gone if x], "in their plainest form")}
        plain = [fewer.get(r.ids, r) for r in refits]
        return [p if self.own_left(p) < self.own_left(r) + LITTLE else r for p, r in zip(plain, refits, strict=True)]

    def _prune(self, found: Found, unit: float) -> None:
        """Backward: without each of several effects, where the others do nearly as well from where they came to."""
        best = found.best
        if len(best.ids) < 2:
            return
        fitted = best.free_effects
        fewer = [
            Trial(tuple(i for i in best.ids if i != out), {p: x for p, x in fitted.items() if p.split(".")[1] != out})
            for out in best.ids
        ]
        for r in self.study.refit(best.model, fewer, self.screen, stage="pruning"):
            place: dict[Any, Refit] = found.single if len(r.ids) == 1 else found.joint
            key = r.ids[0] if len(r.ids) == 1 else tuple(sorted(r.ids))
            if key not in place or r.total < place[key].total:
                place[key] = r
            if not judge.pairs_worth(self.left(r), self.left(best), unit) and (
                found.best is best or self.left(r) < self.left(found.best)
            ):
                found.best = r
