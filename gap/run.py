"""`diagnose(model, runs)`: the one verb of this room."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ljjax import effects, modelfile
from ljjax.data import OCTROBOT
from ljjax.effect import Effect
from ljjax.errors import InputError
from ljjax.fit.dynamic import Estimate
from ljjax.fit.points import collect
from ljjax.fit.result import NOMINAL
from ljjax.fit.run import prepared
from ljjax.fit.windows import Source, motion
from ljjax.gap import channels, judge, screening, where
from ljjax.gap.candidates import Trial
from ljjax.gap.data import in_order, role_of, span, unseen
from ljjax.gap.experiment import next_experiment
from ljjax.gap.result import Diagnosis, Finding, Gap
from ljjax.gap.screening import Screen
from ljjax.gap.search import Refit, Study
from ljjax.gap.story import Story
from ljjax.logs import Run, Signal
from ljjax.model import Model
from ljjax.modelfile import ModelFile

LEADERS, SECOND, MOST = 12, 8, 3
"""How many candidates are refitted alone, how many with those found before, and how many are found at most."""
ANGLE = {1: "theta"}


def diagnose(
    model: ModelFile | None,
    runs: Sequence[Run],
    *,
    held_out: Sequence[Run] = (),
    without: Sequence[str] = (),
    inputs: Source = "commands",
    seed: int = 0,
    model_from: str = "the given model",
    progress: Callable[[str, int, int], None] | None = None,
) -> Diagnosis:
    """Where the gap between a model and its robot lies, which effect causes it, how far it shrinks with that effect.

    Args:
        model: the robot's model; its base parameters are refitted. None for OctRobot-I's.
        runs: logs of one robot. Without any that moves, its steady points and probe presses are diagnosed.
        held_out: runs on which the gap is measured; a quarter of `runs` by default.
        without: effects that are not on trial, by id.
        inputs: drive the model by commands, or by measured tension and pressure.
        seed: of what is drawn at random.
        model_from: where the model came from, for the record.
        progress: called with a stage's name, how many problems are done, and of how many.

    Raises:
        InputError: no usable data, several robots, too few runs, unknown effects.
    """
    robots = sorted({r.robot_id for r in (*runs, *held_out)})
    if len(robots) > 1:
        raise InputError(f"logs of {len(robots)} robots ({', '.join(robots)}); diagnose one at a time")
    for name in without:
        if name not in effects.REGISTRY:
            raise InputError(f"--without {name}: no such effect; expected one of {', '.join(effects.REGISTRY)}")
    start = modelfile.load(OCTROBOT / "nominal.toml") if model is None else model
    said_from = NOMINAL if model is None else model_from
    if start.model.effects:
        raise InputError(
            f"{said_from}: has effects already; a diagnosis starts from a base model, so remove [[effects]]"
        )
    options = {"without": list(without), "inputs": inputs, "model": said_from}
    case = prepared(start, said_from, runs, (), start.frozen, inputs)
    if isinstance(case, list):
        from ljjax.gap.static import diagnose_static

        steady, probe, said = collect(runs)
        return diagnose_static(start, said_from, steady, probe, runs, said, without=without, seed=seed, options=options)
    return _Diagnosing(start, said_from, runs, held_out, case, without, inputs, seed, options, progress).result()


class _Diagnosing:
    def __init__(self, start, start_from, runs, held_out, case, without, inputs, seed, options, progress):
        self.start, self.start_from, self.options, self.seed = start, start_from, options, seed
        self.rng = np.random.default_rng(seed)
        self.said = list(case.said)
        self.warnings: list[str] = []
        motions = in_order(case.problem.motions)
        if held_out:
            tests = []
            for run in held_out:
                try:
                    tests.append(motion(run, start.model.n, inputs))
                except InputError as error:
                    self.said.append(f"left out: {error}")
            everything = in_order([*motions, *tests])
            self.train = [m for m in everything if not any(m.run is t.run for t in tests)]
            self.test = [m for m in everything if any(m.run is t.run for t in tests)]
            if not self.test:
                raise InputError("--held-out: none of these runs moves; give runs of moving tensions")
        else:
            keep = unseen(motions)
            self.train = [m for i, m in enumerate(motions) if i not in keep]
            self.test = [motions[i] for i in keep]
        self.runs = [*runs, *held_out]
        kinds: list[type[Effect]] = [k for i, k in effects.REGISTRY.items() if i not in without]
        c = case.problem.coordinates
        self.study = Study(
            start.model, c.names, kinds, self.train, c.pressure, span(self.train), start.bounds, start.priors, progress
        )
        self.case = case

    # --- the course

    def result(self) -> Diagnosis:
        study = self.study
        base = study.base()
        self.base_total = base.total
        given = self._given(base)
        screen = study.screen(base)
        measured = channels.look(self.train, study.kinds)
        singles = self._leaders(base, screen, measured)
        excess = base.total - study.floor(self._count)
        found = self._forward(base, screen, singles, measured, excess)
        self.warnings += measured.notes
        evidence = self._evidence(base, given, screen, found, measured, excess)
        probability = judge.probabilities(evidence)
        verdict = judge.verdict(probability)
        chosen = study.polished(found.best) if verdict == "listed_effect" else base
        return self._said(base, given, screen, found, measured, evidence, probability, verdict, chosen)

    @property
    def _count(self) -> int:
        return sum(len(m.t) for m in self.train)

    def _given(self, base: Refit) -> Refit:
        """The given model as it is, on the training runs."""
        like = Refit(Trial(), replace(base.estimate, model=self.study.start), base.loss)
        (seen,) = self.study.predict([like], self.train)
        return Refit(Trial(), seen, self.study.loss(seen))

    def _leaders(self, base: Refit, screen: Screen, measured: channels.Measured) -> list[Refit]:
        keys = sorted(screen.gains, key=lambda k: -screen.gains[k])
        first = [screen.best(i) for i in screen.ids]
        first = sorted(first, key=lambda k: -screen.gains[k])[:LEADERS]
        first += [screen.best(i) for i in measured.speaks if i in screen.ids and screen.best(i) not in first]
        more = [k for k in keys if k not in first and k[0] in {f[0] for f in first[:4]}][:4]
        trials, steps = [], {}
        for key in [*first, *more]:
            trial, step = self.study.trial(screen, key)
            trials.append(trial)
            steps[trial] = step
        return self.study.refit(base.model, trials, steps, finish=5)

    def _forward(self, base, screen, singles, measured, excess) -> _Found:
        """Forward selection with backward pruning, and all pairs among the leaders."""
        left = {}
        for r in singles:
            measured.listen((r.total - self.study.floor(self._count)) / max(excess, 1e-9), _chosen(r))
        for r in sorted(singles, key=lambda r: self._left(r, excess, measured)):
            left.setdefault(r.ids[0], r)
        if not left:
            raise FloatingPointError("no candidate simulates on these runs")
        found = _Found(left, {}, next(iter(left.values())))
        unit = self._unit(found.best, excess)
        while len(found.best.ids) < MOST:
            share = self._left(found.best, excess, measured)
            if share < max(0.05, 15 * unit):
                break
            on_top = self.study.screen(found.best)
            keys = sorted((on_top.best(i) for i in on_top.ids), key=lambda k: -on_top.gains[k])[:SECOND]
            trials, steps = [], {}
            for key in keys:
                trial, step = self.study.trial(on_top, key, found.best)
                trials.append(trial)
                steps[trial] = step
            if len(found.best.ids) == 1:
                leaders = [i for i in left if i != found.best.ids[0]][:4]
                for a, b in ((a, b) for k, a in enumerate(leaders) for b in leaders[k + 1 :]):
                    joint = {**self.study._physical(left[a]), **self.study._physical(left[b])}
                    trials.append(Trial((a, b), {p: x for p, x in joint.items() if p.startswith("effects.")}))
            more = self.study.refit(found.best.model, trials, steps, stage="several effects", finish=3)
            for r in more:
                key = tuple(sorted(r.ids))
                if key not in found.joint or r.total < found.joint[key].total:
                    found.joint[key] = r
            if not more:
                break
            better = min(more, key=lambda r: self._left(r, excess, measured))
            if not judge.pairs_worth(share, self._left(better, excess, measured), unit):
                break
            found.best = better
        if len(found.best.ids) > 2:
            found.best = self._pruned(found, excess, measured, unit)
        return found

    def _pruned(self, found, excess, measured, unit) -> Refit:
        """Backward: without each of the effects, where the others do nearly as well without it."""
        best, start = found.best, found.best.trial.start
        fewer = [
            Trial(tuple(i for i in best.ids if i != out), {p: x for p, x in start.items() if p.split(".")[1] != out})
            for out in best.ids
        ]
        for r in self.study.refit(best.model, fewer, stage="pruning"):
            if not judge.pairs_worth(self._left(r, excess, measured), self._left(best, excess, measured), unit):
                best = r
        return best

    def _left(self, refit: Refit, excess: float, measured: channels.Measured) -> float:
        """The share of the gap a refit leaves, the measured inputs' own gap among it."""
        own = (refit.total - self.study.floor(self._count)) / max(excess, 1e-9)
        return measured.joined(own, _chosen(refit))

    def _unit(self, refit: Refit, excess: float) -> float:
        """What a χ² of 1 is as a share of the excess: the variance that a refit leaves, its colour counted."""
        error = refit.estimate.error / self.study.unit
        wide = screening.colour(error, refit.estimate.windows.sample_run)
        return float(wide * np.mean(error**2) / max(excess, 1e-9))

    def _evidence(self, base, given, screen, found, measured, excess) -> judge.Evidence:
        left = {i: self._left(r, excess, measured) for i, r in found.single.items()}
        for i in screen.ids:
            if i not in left:  # not refitted: what the Jacobian promises, at best
                left[i] = max(measured.joined(1 - screen.gains[screen.best(i)] / max(excess, 1e-9), ()), 0.35)
        size = {i: found.single[i].trial.size if i in found.single else 1 for i in left}
        if len(found.best.ids) > 1:
            least = self._left(found.best, excess, measured)
            alone = min(left[i] for i in found.best.ids)
            for i in left:
                left[i] = least if i in found.best.ids else left[i] / max(alone, 1e-9) * max(alone, 0.5)
        unit = self._unit(found.best, excess)
        null = screen.null(self.rng) * unit * max(excess, 1e-9)  # in units of the loss
        self.gained = {i: base.total - r.total for i, r in found.single.items()}
        chance = judge.chance(null, max(self.gained.values(), default=0.0), unit * max(excess, 1e-9))
        count = len(self.study.names)
        floor = self.study.floor(self._count)
        own = self._unit(base, 1.0)
        worse = (given.total - base.total) / max(own, 1e-12)
        as_given = worse < count + 4 * np.sqrt(2 * count) or given.total < 1.01 * base.total
        relative = excess / max(floor, 1e-9)
        self.one = unit * max(excess, 1e-9)
        self.null = null
        return judge.Evidence(
            relative, left, size, unit, chance, bool(as_given), float(np.sqrt(max(base.total, 0.0) / floor))
        )

    # --- what is said of it

    def _said(self, base, given, screen, found, measured, evidence, probability, verdict, chosen) -> Diagnosis:
        study = self.study
        refits = [base, chosen] if chosen is not base else [base]
        seen = study.predict([*refits, given], self.test)
        gap, shares = self._gap(base, chosen, seen)
        main = judge.main_of(probability, list(evidence.left))
        equivalent = self._equivalent(found, screen, evidence, chosen) if verdict == "listed_effect" else []
        order = list(effects.REGISTRY)
        selected = list(chosen.ids)
        if equivalent and len(selected) == 1:
            group = equivalent[0]
            simplest = min(group, key=lambda i: (found.single[i].trial.size, order.index(i)))
            if simplest != selected[0] and found.single[simplest].total <= 1.02 * chosen.total:
                chosen, selected = found.single[simplest], [simplest]
                seen[1] = study.predict([chosen], self.test)[0]
                gap, shares = self._gap(base, chosen, seen)
        findings = self._findings(screen, found, evidence, probability)
        places = self._where(base, chosen, verdict, found, main)
        rivals = self._rivals(found, selected, probability)
        plan = next_experiment(study, [found.single[i] for i in rivals], rivals)
        detectable = {}
        for i in screen.ids:
            name, value = screen.detectable(screen.best(i), np.sqrt(self.one))
            kind = next(k for k in study.kinds if k.id == i)
            if np.isfinite(value):
                detectable[i] = {"parameter": name, "value": value, "unit": kind.fields()[name]["unit"]}
        self._warn(evidence, verdict, base)
        story = Story(self, base, given, screen, found, measured, evidence, chosen, seen, shares)
        overlays = [self._overlay(r, chosen, seen) for r in self.runs]
        roles = [role_of(r, self.train, self.test) for r in self.runs]
        return Diagnosis(
            verdict=verdict,
            gap=gap,
            where=places,
            effects=findings,
            selected=selected,
            equivalent=equivalent,
            minimum_detectable=detectable,
            next_experiment=plan,
            base=self._file(base),
            model=self._file(chosen),
            runs=self.runs,
            roles=roles,
            said=self.said,
            warnings=self.warnings,
            seed=self.seed,
            options=self.options,
            story=story,
            overlays=overlays,
        )

    def _gap(self, base: Refit, chosen: Refit, seen: Sequence[Estimate]) -> tuple[Gap, dict[str, np.ndarray]]:
        """The gap on the unseen runs, and the mean squares of every run: before, after, floor (R,), test runs last."""
        after = seen[1] if chosen is not base else seen[0]
        given = seen[-1]
        parts = {"before": [], "after": [], "floor": []}
        for source, (b, a) in (("train", (base.estimate, chosen.estimate)), ("test", (seen[0], after))):
            for i, m in enumerate(self.train if source == "train" else self.test):
                mine = b.windows.sample_run == i
                parts["before"].append(np.mean(b.error[mine] ** 2))
                parts["after"].append(np.mean(a.error[mine] ** 2))
                parts["floor"].append(np.mean(m.noise**2))
        shares = {name: np.array(x) for name, x in parts.items()}
        count = len(self.test)
        before, end = (float(np.sqrt(np.mean(e.error**2))) for e in (seen[0], after))
        floor = float(np.sqrt(np.mean([np.mean(m.noise**2) for m in self.test])))
        fraction = judge.closed(before, end, floor)
        if chosen is base and fraction is not None:
            fraction = 0.0
        ci = None
        if fraction is not None and chosen is not base:
            ci = judge.interval(shares["before"], shares["after"], shares["floor"], count, self.rng)
            if ci is not None:
                ci = (min(ci[0], fraction), max(ci[1], fraction))
        elif fraction is not None:
            ci = (0.0, 0.0)
        channel = ANGLE.get(base.estimate.windows.y.shape[1], "joints")
        error = float(np.sqrt(np.mean(given.error**2)))
        ids = tuple(m.run.run_id for m in self.test)
        return Gap(channel, "rad", before, end, floor, fraction, ci, ids, error), shares

    def _equivalent(self, found, screen, evidence, chosen) -> list[list[str]]:
        if len(chosen.ids) > 1:
            return []
        alone = {i: evidence.left[i] for i in found.single}
        group = judge.equivalents(alone, chosen.ids[0], evidence.unit)
        return [group] if len(group) > 1 else []

    def _findings(self, screen, found, evidence, probability) -> list[Finding]:
        out = []
        for i in probability:
            if i not in evidence.left:
                out.append(Finding(i, probability[i]))
                continue
            gain = self.gained.get(i, screen.gains[screen.best(i)])
            p = judge.chance(self.null, gain, self.one)
            source = found.best if i in found.best.ids else found.single.get(i)
            parameters = {}
            if source is not None:
                kind = next(k for k in self.study.kinds if k.id == i)
                unit = {n: about["unit"] for n, about in kind.fields().items()}
                parameters = {n: {"value": v, "sd": s, "unit": unit[n]} for n, (v, s) in source.values(i).items()}
            closes = None if evidence.excess < judge.MATTERS else 1 - self._own_left(found, i, evidence)
            out.append(Finding(i, probability[i], closes, p, parameters))
        return sorted(out, key=lambda f: -f.probability)

    def _own_left(self, found, effect: str, evidence) -> float:
        if effect in found.single:
            r = found.single[effect]
            floor = self.study.floor(self._count)
            return float((r.total - floor) / max(self.base_total - floor, 1e-9))
        return float(min(evidence.left[effect], 1.0))

    def _where(self, base, chosen, verdict, found, main):
        channel = ANGLE.get(base.estimate.windows.y.shape[1], "joints")
        if verdict == "listed_effect":
            contributions = []
            for i in chosen.ids:
                kind = effects.REGISTRY[i]
                alone = found.single.get(i)
                other = (alone if alone is not None and len(chosen.ids) > 1 else chosen).estimate.predicted
                contributions.append((kind.block, kind.axes, other - base.estimate.predicted))
            return where.places(base.estimate, channel, contributions)
        if verdict == "unlisted_effect":
            gap = base.estimate.error
            block = effects.REGISTRY[main].block
            return where.places(base.estimate, channel, [(block, where.loudest(base.estimate, gap)[:2], gap)])
        return []

    def _rivals(self, found, selected, probability) -> list[str]:
        """The main effect and the most probable other that has been refitted."""
        known = sorted(found.single, key=lambda i: -probability.get(i, 0.0))
        first = [i for i in selected if i in found.single][:1] or known[:1]
        return [*first, *[i for i in known if i not in first]][:2]

    def _warn(self, evidence, verdict, base) -> None:
        if self.start_from == NOMINAL:
            self.warnings.append("no model given: geometry and mass are OctRobot-I's; give yours with --model")
        if verdict == "unlisted_effect":
            self.warnings.append(
                f"the best listed effect leaves {100 * min(min(evidence.left.values()), 1.0):.0f} % of the gap: "
                "what causes it is none of those known here"
            )
        if not base.estimate.converged:
            self.warnings.append("the base fit stopped before it converged; take the answer with care")
        moved = float(np.max([np.ptp(m.y) for m in self.train]))
        if moved < 10 * float(np.max(self.study.noise)):
            self.warnings.append("the robot hardly moves in these runs: little can be told from them")

    def _overlay(self, run: Run, chosen: Refit, seen: Sequence[Estimate]):
        for motions, estimate in ((self.train, chosen.estimate), (self.test, seen[min(1, len(seen) - 2)])):
            for i, m in enumerate(motions):
                if m.run is run:
                    mine = estimate.windows.sample_run == i
                    shape = run.signal("shape")
                    t = estimate.windows.sample_t[mine]
                    sim = Signal(t, estimate.predicted[mine], shape.columns, "rad", "")
                    residual = Signal(t, estimate.error[mine], shape.columns, "rad", "")
                    return {"/sim": {"shape": sim}, "/residual": {"shape": residual}}
        return {"/sim": {}, "/residual": {}}

    def _file(self, refit: Refit) -> ModelFile:
        """A refit as a model.toml holds it, only the chosen effects in it."""
        kept = tuple(e for e in refit.model.effects if e.id in refit.ids)
        c = refit.estimate.problem.coordinates
        slope = c.jacobian(refit.estimate.x)
        sd = np.sqrt(np.maximum(np.diag(slope @ refit.estimate.covariance @ slope.T), 0.0))
        uncertainty = {n: float(s) for n, s in zip(c.names, sd, strict=True) if np.isfinite(s)}
        model: Model = replace(refit.model, effects=kept)
        return replace(self.start, model=model, uncertainty=uncertainty)


def _chosen(refit: Refit) -> list[Effect]:
    """The effects of a refit, as fitted."""
    return [e for e in refit.model.effects if e.id in refit.ids]


@dataclass
class _Found:
    """What the search found: each effect's best refit alone, joint refits by their effects, the best of all."""

    single: dict[str, Refit]
    joint: dict[tuple[str, ...], Refit]
    best: Refit
