"""Effects let vary: in strength with what acts on them, from a moment of the session on, from run to run."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ljjax.effect import Effect
from ljjax.effects import REGISTRY
from ljjax.effects.varying import EACH, PILOTS, onsets, steady, varies, varying, ways
from ljjax.fit import folds
from ljjax.gap import judge
from ljjax.gap.candidates import Trial, either_side, path, still
from ljjax.gap.screening import Screen, ahead
from ljjax.gap.search import Refit, Study
from ljjax.model import Model
from ljjax.model import replace as at

FURTHER = 0.12
"""The share of the gap, left by one effect, from which the others are begun otherwise."""
VARYING, VARIED, NEARBY, HOPELESS, NOTABLY = 3, 0.02, 2.5, 0.9, 0.75
"""How many effects alone are let vary, where the best leaves more than this share of the gap: those that leave no more
than so many times as much, nor nearly all of it; and the share of what each left that is less by enough."""
TOGETHER = 2
"""How many of several effects together are let vary."""
TOLD = 0.005
"""The share that cannot be told from nothing on most robots: where the best leaves more, effects that may be others in
each run are tried."""
SOME = 0.1
"""The share of what an effect that is another in each run does in the most telling one that it begins with at least, as
it may have no slope where there is none of it."""
MOUNTED = 0.5
"""The share, of what the best leaves, that an effect must promise to leave at most where it is another in each run, to
be tried so though the best explains the gap."""
ONSETS = 24
"""How many moments of the session a sudden effect is tried to begin at, where nothing explains the gap."""


def shares_of(kind: type[Effect], values: Mapping[str, float], count: int) -> np.ndarray:
    """(R,) the share of an effect that is there in each run, by values of its parameters by path."""
    return np.array([1 + values.get(path(kind, EACH.format(k + 1)), 0.0) for k in range(count)])


def level(kind: type[Effect], model: Model, count: int) -> Model:
    """The model with the same share of an effect in each run."""
    return at(model, {path(kind, EACH.format(k + 1)): 0.0 for k in range(count)})


def freely(kind: type[Effect], values: Mapping[str, float], shares: np.ndarray) -> dict[str, float]:
    """Values by path, with the share of one of the effects in each run."""
    return {**values, **{path(kind, EACH.format(k + 1)): float(x) - 1 for k, x in enumerate(shares)}}


def anchored(kind: type[Effect], values: Mapping[str, float], shares: np.ndarray) -> dict[str, float]:
    """The same, but its sizes those of the run in which it is largest, if it is in any, with no share of its own."""
    most = int(np.argmax(np.abs(shares)))
    if shares[most] == 0:
        return freely(kind, values, shares)
    out = freely(kind, values, shares / shares[most])
    del out[path(kind, EACH.format(most + 1))]
    for n in kind.sizes():
        if (p := path(kind, n)) in out:
            null = float(kind.fields()[n]["null"])
            out[p] = null + float(shares[most]) * (out[p] - null)
    return out


@dataclass
class Variation:
    """The single effects of a search, free to vary.

    Attributes:
        study: whose kinds come to be those that vary, where these are better.
        base, screen: refitted without an effect, and what is promised on top of it.
        left: the share of the gap that a refit leaves.
        gap: the loss that such shares are of.
        plain: of effects that stay varying, those found before they were free to vary with what acts on them too.
        steady: of effects that vary, those found before they were free to vary at all; the base of those not found.
    """

    study: Study
    base: Refit
    screen: Screen
    left: Callable[[Refit], float]
    gap: float
    plain: dict[str, Refit] = field(default_factory=dict)
    steady: dict[str, Refit] = field(default_factory=dict)

    def let(self, single: dict[str, Refit]) -> None:
        """The best effects once more, free to vary in strength with what acts on them, where they leave much: a true
        cause seldom has the library's form. Those that then leave notably less stay so, if they also leave less of
        conditions left out: what varies much carries over badly. Then those that may be others in each run, which one
        that begins at a moment can stand in for."""
        before = dict(single)
        if self._least(single) > VARIED:
            self._with_what_acts(single)
        least, best = self._least(single), min(single.values(), key=self.left)
        if least > TOLD or any(p.endswith(".by_onset") for p in best.free_effects):
            self._by_run(single, np.inf if least > FURTHER else MOUNTED * least)
        self.steady = {i: before.get(i, self.base) for i, r in single.items() if r is not before.get(i)}

    def _with_what_acts(self, single: dict[str, Refit]) -> None:
        """Those that come near the best with what acts on them; where much is left, others so, or from a moment on."""
        ordered, least = sorted(single.values(), key=self.left), self._least(single)
        near = [r for r in ordered if self.left(r) < NEARBY * least and self.left(r) < HOPELESS][:VARYING]
        kinds = {k.id: varying(k) for k in self.study.kinds if varies(k) and any(r.ids == (k.id,) for r in near)}
        varied = self.only(kinds).varied([single[i] for i in kinds], "varying effects")
        better = self._better(single, varied)
        if kept := {i: r for i, r in better.items() if self._left_out(r) < self._left_out(single[i])}:
            self.keep({i: kinds[i] for i in kept})
            self.plain |= {i: single[i] for i in kept}
            single |= kept
        if self._least_cause(single) > FURTHER:
            begun = onsets(self.study.span["slip"], ONSETS)
            self._others(single, self._sudden(), lambda kind: begun, "effects that begin at once")
        if self._least_cause(single) > FURTHER:
            others = {k.id: varying(k) for k in self.study.kinds if varies(k) and k.id not in kinds}
            self._others(
                single,
                others,
                lambda kind: [{way: much} for way, much in PILOTS if way in ways(kind)],
                "others that vary",
            )

    def of_several(self, refits: Sequence[Refit]) -> list[Refit]:
        """Of several effects refitted together the best once more, each free to vary in strength with what acts on it;
        those that then leave notably less, of conditions left out too, and stay so."""
        if not refits:
            return []
        best: dict[tuple[str, ...], Refit] = {}
        for r in sorted(refits, key=self.left):
            best.setdefault(tuple(sorted(r.ids)), r)
        least = min(map(self.left, best.values()))
        near = [r for r in best.values() if self.left(r) < min(NEARBY * least, HOPELESS)][:TOGETHER]
        those = [k for k in self.study.kinds if any(k.id in r.ids for r in near)]
        kinds = {k.id: varying(k) for k in those if varies(k)}
        varied = self.only({k.id: kinds.get(k.id, k) for k in those}).varied(near, "several that vary")
        before = {r.ids: r for r in near}
        less = [r for r in varied if self.left(r) < NOTABLY * self.left(before[r.ids])]
        kept = [r for r in less if self._left_out(r) < self._left_out(before[r.ids])]
        self.keep({i: kinds[i] for r in kept for i in r.ids if i in kinds})
        return kept

    def by_run(self) -> dict[str, type[Effect]]:
        """What is put on, moved or set, as it may be another in each run, but for what varies otherwise already."""
        sudden = [k for k in self.study.kinds if k.sudden]
        each = {k.id: k for k in sudden if EACH.format(1) in k.fields()}
        return each | {k.id: varying(k, self._until) for k in sudden if steady(k)}

    @cached_property
    def _until(self) -> tuple[float, ...]:
        """The slip that parts the starts of runs [rad]."""
        starts = [float(m.worn[0]) for m in self.study.motions]
        return tuple((a + b) / 2 for a, b in itertools.pairwise(starts))

    def keep(self, kinds: Mapping[str, type[Effect]]) -> None:
        """These effects stay so."""
        self.study.kinds = self.free(kinds).kinds

    def _left_out(self, refit: Refit) -> float:
        """The loss of a refit where each condition is left out, to first order."""
        return float(self.study.cost(folds.left_out(refit.estimate, self._fold)).sum())

    @cached_property
    def _fold(self) -> np.ndarray:
        return folds.conditions(self.study.motions)[1]

    def _least(self, single: Mapping[str, Refit]) -> float:
        return min(map(self.left, single.values()))

    def _least_cause(self, single: Mapping[str, Refit]) -> float:
        """The same without those that often are stand-ins, which end no search."""
        causes = [r for i, r in single.items() if i not in judge.MIMICS]
        return min(map(self.left, causes), default=self._least(single))

    def _sudden(self, until: tuple[float, ...] | None = None) -> dict[str, type[Effect]]:
        """What is put on, moved or set, as it may begin at a moment, or change from run to run."""
        return {k.id: varying(REGISTRY.get(k.id, k), until) for k in self.study.kinds if k.sudden}

    def _others(
        self,
        single: dict[str, Refit],
        kinds: Mapping[str, type[Effect]],
        pilots: Callable[[type[Effect]], list[dict[str, float]]],
        stage: str,
    ) -> None:
        """Effects that promise most where they vary in one of the ways `pilots`: what varies much may do nothing as it
        stands."""
        if not kinds:
            return
        screen = self._screened(kinds, pilots)
        first = ahead(screen, VARYING)
        free, steps = self.only({i: kinds[i] for i, _ in first}), {}
        for key in first:
            trial, step = free.trial(screen, key)
            steps[Trial(trial.ids, {**still(kinds[key[0]], trial.start), **trial.start})] = step
        found = free.refit(self.base.model, list(steps), screen, steps, stage, finish=VARYING)
        around = [t for trial in steps for t in either_side(trial, free.kinds)]
        found += free.refit(self.study.start, around, None, stage=f"{stage}, from the given model", finish=VARYING)
        self._keep(single, found, kinds, stage)

    def _by_run(self, single: dict[str, Refit], within: float) -> None:
        """Effects that promise most where they are others in each run, and to leave less than such a share of the gap,
        or come near the best as they are: of each size by the run in which it is largest, in the others as much of it
        as goes along with that."""
        kinds, runs = self._sudden(self._until), range(len(self.study.motions))
        if not kinds:
            return
        alone = [{EACH.format(r + 1): float(k == r) - 1 for r in runs} for k in runs]
        screen = self._screened(kinds, lambda kind: alone)
        gain = {i: sum(screen.gains[i, k] for k in runs) for i in kinds}
        near = {i for i, r in single.items() if self.left(r) < NEARBY * self._least(single)}
        gain = {i: x for i, x in gain.items() if i in near or 1 - x / self.gap < within}
        trials = []
        for i in sorted(gain, key=lambda i: -gain[i])[:VARYING]:
            step = np.array([list(screen.steps[i, k].values()) for k in runs])
            most = int(np.argmax(np.sum(step**2, axis=1)))
            along = step @ step[most] / max(float(step[most] @ step[most]), 1e-300)
            along = np.where(np.abs(along) < SOME, SOME, along)
            sizes = {path(kinds[i], n): x for n, x in screen.steps[i, most].items()}
            shares = {path(kinds[i], EACH.format(k + 1)): float(along[k]) - 1 for k in runs if k != most}
            forms = {path(kinds[i], n): x for n, x in self.screen.forms[self.screen.best(i)].items()}
            trials.append(Trial((i,), {**sizes, **shares, **forms}))
        if not trials:
            return
        free = self.only({i: kinds[i] for trial in trials for i in trial.ids})
        stage = "effects that change from run to run"
        found = free.refit(self.base.model, trials, None, stage=stage, finish=VARYING)
        found += free.refit(self.study.start, trials, None, stage=f"{stage}, from the given model", finish=VARYING)
        self.plain |= self._keep(single, found, kinds, stage)

    def _screened(
        self, kinds: Mapping[str, type[Effect]], pilots: Callable[[type[Effect]], list[dict[str, float]]]
    ) -> Screen:
        """The screen of the base where these effects are tried as `pilots` say, but for that as they did best."""

        def forms(kind: type[Effect]) -> list[dict[str, float]]:
            return [{**self.screen.forms[self.screen.best(kind.id)], **way} for way in pilots(kind)]

        return self.only(kinds).screen(self.base, forms)

    def _keep(
        self, single: dict[str, Refit], found: Sequence[Refit], kinds: Mapping[str, type[Effect]], stage: str
    ) -> dict[str, Refit]:
        """Of effects found to vary those that leave notably less stay so, and are taken further; as they were found."""
        if kept := self._better(single, found):
            self.keep({i: kinds[i] for i in kept})
            again = self.only({i: kinds[i] for i in kept}).varied(list(kept.values()), f"{stage}, once more")
            single |= self._better(single, again)
        return kept

    def only(self, kinds: Mapping[str, type[Effect]]) -> Study:
        """The study of these effects alone, which takes less time."""
        return replace(self.study, kinds=[kinds[k.id] for k in self.study.kinds if k.id in kinds])

    def free(self, kinds: Mapping[str, type[Effect]]) -> Study:
        """The study with these effects in place of those of the same ids."""
        return replace(self.study, kinds=[kinds.get(k.id, k) for k in self.study.kinds])

    def _better(self, single: Mapping[str, Refit], found: Sequence[Refit]) -> dict[str, Refit]:
        """Of refits of effects that vary the best of each that leaves notably less than it did before."""
        best: dict[str, Refit] = {}
        for r in sorted(found, key=self.left):
            if self.left(r) < NOTABLY * (self.left(single[r.ids[0]]) if r.ids[0] in single else 1.0):
                best.setdefault(r.ids[0], r)
        return best
