"""Base and candidates refitted side by side: singles, pairs, a third effect; and what they say of runs not fitted."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial

import jax
import numpy as np

from ljjax.effect import Effect
from ljjax.effects.varying import HALFWAY, WAYS, steady
from ljjax.fit.coordinates import Coordinates
from ljjax.fit.dynamic import HUBER, Search, estimate
from ljjax.fit.problem import Estimate, Problem, Round
from ljjax.fit.shooting import TILE, Answer, Asking, Request, Starts, together
from ljjax.fit.windows import Motion, Windows, cut
from ljjax.gap import screening
from ljjax.gap.candidates import Trial, path, pilots, still, universal
from ljjax.gap.channels import Fitted
from ljjax.gap.scatter import NO_SCATTER, Scatter, scatter
from ljjax.gap.screening import Screen
from ljjax.model import Model, limits, replace

BASE = (Round(0.01, False, np.inf, 2 * TILE, 0.1, 1e-2), Round(0.01, True, 1e-4, 1_000_000, 0.5, 3e-4))
QUICK = Round(0.01, True, np.inf, 1_000_000, 0.5, 2e-4, onward=True)
"""How candidates are compared: free runs one window after the other, at the longest step that is as good as noise."""
SOON, FIRST, LAST, WHOLE = 2, 4, 5, 8
"""Iterations after which many candidates are weeded; for all, by derivatives of the base that stay as they were; of the
best; and for the answer."""
EACH = 2
"""How many trials of the same effects are taken further."""
AGAIN, FALLING = 3, 0.1
"""How often the best are taken on, and the share of the loss by which they must still fall for another time."""
TOLD = 2.0
"""Standard deviations from which a parameter counts as told from its null, or a form from its usual value."""
Tell = Callable[[str, int, int], None]


@dataclass(frozen=True, eq=False)
class Refit:
    """A trial refitted.

    Attributes:
        trial: which effects were free.
        estimate: what came of it.
        loss: (R,) sum of squared residuals of each run in units of the noise, gross outliers counted less.
        scatter: of a latency set free, if there is one.
    """

    trial: Trial
    estimate: Estimate
    loss: np.ndarray
    scatter: Scatter = NO_SCATTER

    @property
    def total(self) -> float:
        return float(self.loss.sum())

    @property
    def ids(self) -> tuple[str, ...]:
        return self.trial.ids

    @property
    def model(self) -> Model:
        return self.estimate.model

    @property
    def effects(self) -> list[Effect]:
        """The effects set free, as fitted."""
        return [e for e in self.model.effects if e.id in self.ids]

    @cached_property
    def fitted(self) -> list[Fitted]:
        """The effects set free, as fitted, with the covariance of their parameters."""
        return [Fitted(e, *self._spread(e.id)) for e in self.effects]

    @property
    def free_effects(self) -> dict[str, float]:
        """The free parameters of effects by path, as fitted."""
        c = self.estimate.problem.coordinates
        values = zip(c.names, c.physical(self.estimate.x), strict=True)
        return {p: float(x) for p, x in values if p.startswith("effects.")}

    @cached_property
    def sides(self) -> tuple[bool, ...]:
        """Of each effect set free, whether its largest size, by its own scale, has come above where it vanishes."""
        out = []
        for e in self.effects:
            about = e.fields()
            sizes = [(float(getattr(e, n)) - about[n]["null"]) / about[n]["scale"] for n in e.sizes()]
            out.append(max(sizes, key=abs, default=0.0) > 0)
        return tuple(out)

    def used(self, free: float) -> dict[str, int]:
        """How many parameters of each effect are told from their null, or usual value, and are of account, as those are
        not that together are worth a χ² of `free` at most: what it needs, whatever was free; all ways in which it
        varies count for one. One at least."""
        out = {}
        for e in self.effects:
            told = _told(e, *self._spread(e.id), free) - HALFWAY.keys()
            out[e.id] = max(len(told - WAYS.keys()) + bool(told & WAYS.keys()), 1)
        return out

    def idle(self, free: float) -> list[int]:
        """The coordinates of the effects' parameters that are not so used."""
        c, told = self.estimate.problem.coordinates, {e.id: _told(e, *self._spread(e.id), free) for e in self.effects}
        slope = c.jacobian(self.estimate.x)
        mine = [(i, n.split(".")) for i, n in enumerate(c.names) if n.startswith("effects.")]
        return [int(np.argmax(slope[i] != 0)) for i, (_, effect, n) in mine if n not in told.get(effect, {n})]

    def needless(self, free: float) -> dict[str, float]:
        """The nulls, by path, of the sizes that are not so used, what forms they have as it is; none of an effect of
        which no size is used."""
        out: dict[str, float] = {}
        for e in self.effects:
            names, covariance = self._spread(e.id)
            sd = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
            own = [i for i, n in enumerate(names) if n in e.sizes()]
            known = np.linalg.pinv(covariance / np.outer(sd, sd), rcond=1e-10, hermitian=True)[np.ix_(own, own)]
            spread = np.linalg.pinv(known, rcond=1e-10, hermitian=True) * np.outer(sd[own], sd[own])
            told = _told(e, [names[i] for i in own], spread, free)
            if told:
                null = {names[i]: float(e.fields()[names[i]]["null"]) for i in own if names[i] not in told}
                out |= {f"effects.{e.id}.{n}": x for n, x in null.items()}
        return out

    def _spread(self, effect: str) -> tuple[list[str], np.ndarray]:
        """An effect's free parameters (p names) and their covariance (p, p)."""
        c = self.estimate.problem.coordinates
        slope = c.jacobian(self.estimate.x)
        start = f"effects.{effect}."
        mine = [i for i, n in enumerate(c.names) if n.startswith(start)]
        return [c.names[i].removeprefix(start) for i in mine], slope[mine] @ self.estimate.covariance @ slope[mine].T

    def values(self, effect: str) -> dict[str, tuple[float, float]]:
        """Value and standard deviation of an effect's free parameters, by name."""
        free, covariance = self._spread(effect)
        sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        (found,) = (e for e in self.effects if e.id == effect)
        return {n: (float(getattr(found, n)), float(s)) for n, s in zip(free, sd, strict=True)}


def _told(effect: Effect, names: Sequence[str], covariance: np.ndarray, free: float) -> set[str]:
    """Which of an effect's parameters of a covariance are `needed`."""
    off = np.array([float(getattr(effect, n)) - float(effect.fields()[n]["null"]) for n in names])
    return {names[i] for i in needed(off, covariance, free)}


def units(left: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What errors are counted in, and beyond what they count linearly [rad], by what a model leaves (c,) of every
    channel and its noise (c,) [rad]: as many times the noise in each as is left on the whole, so that a gap in one
    joint of many counts for what it is."""
    left = np.maximum(left, noise)
    unit = noise * np.sqrt(np.mean((left / noise) ** 2))
    return unit, HUBER * np.maximum(left, unit)


def needed(off: np.ndarray, covariance: np.ndarray, free: float = 0.0) -> list[int]:
    """Which of parameters so far (p,) from their nulls, of a covariance (p, p), are told from them: those that remain
    where one after the other that costs least is put to its null, the others following it, until each would cost
    `TOLD` standard deviations and all together a χ² of more than `free`."""
    rest, off, covariance, cost = list(range(len(off))), off.copy(), covariance.copy(), 0.0
    while rest:
        variance = np.maximum(np.diag(covariance), 1e-300)
        i = int(np.argmin(off**2 / variance))
        cost += off[i] ** 2 / variance[i]
        if abs(off[i]) > TOLD * np.sqrt(variance[i]) and cost > free:
            break
        along = covariance[:, i] / variance[i]
        off, covariance = off - along * off[i], covariance - np.outer(along, covariance[i])
        rest.pop(i)
        off, covariance = np.delete(off, i), np.delete(np.delete(covariance, i, 0), i, 1)
    return rest


@dataclass(eq=False)
class Study:
    """One robot's training runs, its base parameters and the candidates.

    Attributes:
        names: the base's free parameters, by path.
        kinds: the effects on trial.
        noise: (c,) standard deviation of the measurements' white noise [rad].
        unit, gross: what `units` says of what the refitted base leaves.
    """

    start: Model
    names: tuple[str, ...]
    kinds: Sequence[type[Effect]]
    motions: Sequence[Motion]
    pressure: float
    span: Mapping[str, float]
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    priors: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    tell: Tell | None = None
    unit: np.ndarray | None = None
    gross: np.ndarray | None = None

    @cached_property
    def windows(self) -> Windows:
        """The training runs, cut as all candidates see them."""
        return cut(self.motions, QUICK.step_s)

    @property
    def noise(self) -> np.ndarray:
        by = [len(m.t) for m in self.motions]
        return np.sqrt(np.average([m.seen_noise**2 for m in self.motions], axis=0, weights=by))

    def base(self) -> Refit:
        """The base refitted from the given model, as `ljjax fit` does but for its last round."""
        problem = Problem(
            Coordinates(self.start, self.names, self.pressure), self.motions, (), self.priors, self.bounds
        )
        (found,) = together([estimate(problem, None, BASE)], self._tell("base"))
        if not isinstance(found, Estimate):
            raise found
        self.unit, self.gross = units(found.sigma, self.noise)
        return Refit(Trial(), found, self.loss(found))

    def refit(
        self,
        like: Model,
        trials: Sequence[Trial],
        screen: Screen | None,
        steps: Mapping[Trial, np.ndarray] | None = None,
        stage: str = "candidates",
        finish: int = 1,
        sure: int = 0,
        within: float = np.inf,
    ) -> list[Refit]:
        """Base and effects of each trial refitted together, all trials side by side, from the model `like`; `steps`
        are first moves of the base's coordinates. A few iterations for all of them, the base's derivatives those of
        the screen (their own where none is given); more, with derivatives of their own, for the `finish` best, `EACH`
        of the same effects at most and none of a loss beyond `within`, and the first `sure` of the list. Trials that
        fail are left out."""
        borrowed = None if screen is None else screen.base_jacobian[..., : len(self.names)]
        begun = [self._begun(like, t) for t in trials]
        first = self._refit(begun, trials, steps or {}, LAST if screen is None else FIRST, stage, borrowed)
        best = _best([r for r in first if r.total <= within], finish)
        best += [r for r in first if any(r.trial is t for t in trials[:sure]) and all(r is not b for b in best)]
        return self._further(first, best, stage)

    def _further(self, first: list[Refit], best: list[Refit], stage: str) -> list[Refit]:
        """Those of `first` that are the best taken further, as often as it helps."""
        for _ in range(AGAIN):
            if not best:
                break
            again = self._refit([r.model for r in best], [r.trial for r in best], {}, LAST, stage + ", the best")
            before = {id(r.trial): r.total for r in best}
            better = {id(r.trial): r for r in again}
            first = [min((r, better.get(id(r.trial), r)), key=lambda x: x.total) for r in first]
            best = [r for r in again if before[id(r.trial)] - r.total > FALLING * before[id(r.trial)]]
        return first

    def weeded(self, like: Model, trials: Sequence[Trial], screen: Screen, stage: str) -> list[Refit]:
        """The ninth of many trials that leave least, refitted from the model `like`: two thirds that fall behind in the
        first iterations, by the screen's derivatives of the base, go no further, nor two thirds of the rest in the
        next; the last ones go on by derivatives of their own, as the way from there may be long."""
        borrowed = screen.base_jacobian[..., : len(self.names)]
        best = self._refit([self._begun(like, t) for t in trials], trials, {}, SOON, stage, borrowed)
        for iterations, slopes in ((FIRST - SOON, borrowed), (LAST, None)):
            best = sorted(best, key=lambda r: r.total)[: -(-len(best) // 3)]
            best = self._refit([r.model for r in best], [r.trial for r in best], {}, iterations, stage, slopes)
        return best

    def of(self, runs: Sequence[int]) -> Study:
        """The study of some of its runs, residuals in the same unit."""
        return dataclasses.replace(self, motions=[self.motions[i] for i in runs])

    def taken_over(self, refits: Sequence[Refit], stage: str, finish: int, further: int) -> list[Refit]:
        """Of refits to some of the runs, the `finish` best refitted to all of them, and the best of these further."""
        best = _best(refits, finish)
        first = self._refit([r.model for r in best], [r.trial for r in best], {}, LAST, stage)
        return self._further(first, _best(first, further), stage)

    def polished(self, refits: Sequence[Refit], stage: str = "the answer") -> list[Refit]:
        """Refits taken to their end, side by side, the search begun anew at each: one that had crept to rest by ever
        shorter steps may have further to go."""
        found = self._refit([r.model for r in refits], [r.trial for r in refits], {}, WHOLE, stage)
        further = {id(r.trial): r for r in found}
        return [min((further.get(id(r.trial), r), r), key=lambda x: x.total) for r in refits]

    def without(self, gone: Sequence[tuple[Refit, Mapping[str, float]]], stage: str) -> list[Refit]:
        """Refits begun once more where some of their effects' parameters stay at given values, by path."""
        left = [{p: x for p, x in r.free_effects.items() if p not in nulls} for r, nulls in gone]
        trials = [Trial(r.ids, start) for (r, _), start in zip(gone, left, strict=True)]
        return self._refit([replace(r.model, nulls) for r, nulls in gone], trials, {}, WHOLE, stage)

    def varied(self, refits: Sequence[Refit], stage: str) -> list[Refit]:
        """Refits of effects that are let vary (`ljjax.effects.varying`) in this study, from where they were."""
        kinds = {k.id: k for k in self.kinds}

        def ways(r: Refit) -> dict[str, float]:
            return {p: x for i in r.ids if not steady(kinds[i]) for p, x in still(kinds[i], r.free_effects).items()}

        trials = [Trial(r.ids, {**ways(r), **r.free_effects}) for r in refits]
        begun = [self._begun(r.model, t) for r, t in zip(refits, trials, strict=True)]
        return self._refit(begun, trials, {}, WHOLE, stage)

    def _begun(self, like: Model, trial: Trial) -> Model:
        whole = universal(like, self.kinds)
        known, free = limits(whole), {f"effects.{e.id}.{n}": getattr(e, n) for e in like.effects for n in e.fields()}
        own = {p: float(x) for p, x in free.items() if p.split(".")[1] in trial.ids and p in known}
        return replace(whole, {**own, **_inside(trial.start, known)})

    def _refit(
        self,
        begun: Sequence[Model],
        trials: Sequence[Trial],
        steps: Mapping[Trial, np.ndarray],
        iterations: int,
        stage: str,
        borrowed: np.ndarray | None = None,
    ) -> list[Refit]:
        asked = []
        for model, trial in zip(begun, trials, strict=True):
            names = [*self.names, *trial.start]
            c = Coordinates(model, names, self.pressure)
            x = c.start.copy()
            if trial in steps:
                most = 0.25 * c.spread[: len(self.names)]
                x[: len(self.names)] += np.clip(steps[trial], -most, most)
            problem = Problem(c, self.motions, (), self.priors, self.bounds)
            x = x if c.admissible(x) else c.start
            asked.append(_searched(problem, self.windows, x, iterations, borrowed))
        found = together(asked, self._tell(stage))
        return [self._done(t, f) for t, f in zip(trials, found, strict=True) if isinstance(f, Estimate)]

    def _done(self, trial: Trial, found: Estimate) -> Refit:
        free = [e for e in found.model.effects if e.id in trial.ids]
        return Refit(trial, found, self.loss(found), self.scatter(found, free))

    def scatter(
        self, found: Estimate, effects: Sequence[Effect], runs: np.ndarray | None = None, most_s: float = np.inf
    ) -> Scatter:
        """How the latency of the effects, if they have one, scatters in an estimate's runs (`ljjax.gap.scatter`)."""
        assert self.unit is not None
        return scatter(found, effects, self.unit, self.noise, runs, most_s)

    def loss(self, found: Estimate) -> np.ndarray:
        """(R,) what `cost` adds up to in each run."""
        return np.bincount(found.windows.sample_run, self.cost(found.error), len(found.problem.motions))

    def cost(self, error: np.ndarray) -> np.ndarray:
        """(N,) squares of errors (N, c) [rad] in their unit, gross ones counted linearly."""
        assert self.unit is not None and self.gross is not None
        x, most = np.abs(error / self.unit), self.gross / self.unit
        return np.where(x <= most, x**2, 2 * most * x - most**2).sum(axis=1)

    def floor(self, motions: Sequence[Motion]) -> np.ndarray:
        """(R,) what `loss` would be for the white noise of each run's measurements alone."""
        assert self.unit is not None
        return np.array([len(m.t) * np.sum((m.seen_noise / self.unit) ** 2) for m in motions])

    def screen(self, from_: Refit, forms_of: Callable[[type[Effect]], list[dict[str, float]]] | None = None) -> Screen:
        """Every effect that is not in a refit, on top of it, in all `pilots` of its form or in those asked for."""
        chosen = [f"effects.{i}.{n}" for i in from_.ids for n in self._free(i, from_)]
        if forms_of is None:
            span, waves = {**self.span, **screening.clock_of(from_.estimate)}, screening.waves(from_.estimate)
            forms_of = partial(pilots, span=span, waves=waves)
        names, whole = [*self.names, *chosen], self._begun(from_.model, Trial(from_.ids, from_.free_effects))
        asked, said, forms = screening.screen(whole, names, self.kinds, self.motions, self.pressure, QUICK, forms_of)
        found = together(asked, self._tell("screening"))
        for f in found:
            if isinstance(f, Exception):
                raise f
        return screening.gather([f for f in found if isinstance(f, Search)], said, forms)

    def trial(self, screen: Screen, key: tuple[str, int], onto: Refit | None = None) -> tuple[Trial, np.ndarray]:
        """The trial that starts where a screen points, and how far the base moves along."""
        kind = next(k for k in self.kinds if k.id == key[0])
        start = {path(kind, n): x for n, x in screen.steps[key].items()}
        start |= {path(kind, n): x for n, x in screen.forms[key].items()}
        ids, before, count = (key[0],), {}, len(self.names)
        if onto is not None and onto.ids:
            ids = (*onto.ids, key[0])
            before = onto.free_effects
        return Trial(ids, {**before, **start}), screen.base_step[key][:count]

    def _free(self, effect: str, refit: Refit) -> list[str]:
        return [p.split(".")[2] for p in refit.trial.start if p.split(".")[1] == effect]

    def predict(self, refits: Sequence[Refit], motions: Sequence[Motion], settle: bool = False) -> list[Estimate]:
        """The estimates of refits, but of other runs (not finite where a model does not simulate), without fitting
        anything to them but, if asked for, where each run starts: what they predict is of these runs, what they know
        (covariance, scale of the residuals) of the runs fitted; no derivatives."""
        asked = []
        for r in refits:
            c = r.estimate.problem.coordinates
            problem = Problem(Coordinates(self._whole(r.model), c.names, self.pressure), motions)
            asked.append(_seen(Search(problem, cut(motions, QUICK.step_s), QUICK), settle, r.estimate))
        found = together(asked, self._tell("unseen runs"))
        for f in found:
            if isinstance(f, Exception):
                raise f
        return [f for f in found if isinstance(f, Estimate)]

    def _whole(self, model: Model) -> Model:
        return model if model.effects else universal(model, self.kinds)

    def _tell(self, stage: str) -> Callable[[int, int], None]:
        return lambda done, count: self.tell(stage, done, count) if self.tell else None


class _Chord(Search):
    """A search of effects whose derivatives by the base's parameters are `borrowed` (N, c, k₀) and stay as they are:
    half the work for nearly the same steps."""

    def __init__(self, problem: Problem, windows: Windows, borrowed: np.ndarray):
        super().__init__(problem, windows, QUICK)
        self.borrowed = borrowed

    def _ask(self, x: np.ndarray, offset: np.ndarray, starts: Starts | None) -> Asking[Answer]:
        c, count = self.problem.coordinates, self.borrowed.shape[-1]
        slopes = jax.tree.map(lambda s: s[count:], c.slopes(x))
        self.asked += 1
        answer = yield Request(self.windows, c.numbers(x), slopes, offset[self.group], onward=True)
        return dataclasses.replace(answer, jacobian=np.concatenate([self.borrowed, answer.jacobian], axis=-1))


def _searched(
    problem: Problem, windows: Windows, x: np.ndarray, iterations: int, borrowed: np.ndarray | None
) -> Asking[Estimate]:
    search = Search(problem, windows, QUICK) if borrowed is None else _Chord(problem, windows, borrowed)
    history: list = []
    yield from search.run(x, iterations, history, 0)
    found = search.result(history)
    return found if borrowed is None else dataclasses.replace(found, converged=False)


def _seen(search: Search, settle: bool, fitted: Estimate) -> Asking[Estimate]:
    yield from (search.settle if settle else search.look)(search.problem.coordinates.start)
    point = search.point
    assert point is not None
    return dataclasses.replace(
        fitted,
        problem=search.problem,
        x=point.x,
        model=search.problem.coordinates.model(point.x),
        windows=search.windows,
        predicted=point.answer.predicted,
        jacobian=np.zeros((*point.answer.predicted.shape, 0)),
        offset=point.offset,
    )


def _best(refits: Sequence[Refit], count: int) -> list[Refit]:
    """The best of them, `EACH` of the same effects at most; the second of these from another side than the first, if
    there is one, as what came to the same side mostly ends where the first does."""
    ordered, taken = sorted(refits, key=lambda r: r.total), list[Refit]()
    for r in ordered:
        same = [t for t in taken if t.ids == r.ids]
        other = any(s.ids == r.ids and s.sides != same[0].sides for s in ordered) if same else False
        if len(taken) < count and len(same) < EACH and (not other or r.sides != same[0].sides):
            taken.append(r)
    return taken


def _inside(values: Mapping[str, float], within: Mapping[str, tuple[float, float]]) -> dict[str, float]:
    return {p: float(np.clip(x, *within[p])) if p in within else x for p, x in values.items()}
