"""The answer to a diagnosis that has run: the gap on unseen runs, places, findings, what to do next, and files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ljjax import effects
from ljjax.effects.varying import by_run
from ljjax.errors import InputError
from ljjax.fit.points import beware_of
from ljjax.fit.problem import Estimate
from ljjax.fit.result import NOMINAL
from ljjax.fit.session import by_start
from ljjax.gap import judge, screening, where
from ljjax.gap.data import role_of
from ljjax.gap.experiment import next_experiment
from ljjax.gap.inquiry import LEFT_OVER, Inquiry, began, onset, unfixed
from ljjax.gap.result import Diagnosis, Finding, Fold, Gap, Region
from ljjax.gap.search import Refit
from ljjax.gap.stand_ins import BLOCKS
from ljjax.gap.story import Story
from ljjax.logs import Run, Signal
from ljjax.modelfile import ModelFile

ANGLE = {1: "theta"}
COLOURED, POORER = 3.0, 0.4
"""What a reader is told of: leftovers so coloured; a condition that closes by so much less than most."""
SCATTERS = 0.02
"""A latency is said to scatter where that makes more than this share of the gap and half of what is left."""
SEES = 0.8
"""A stand-in that leaves more than this share of the gap points nowhere."""


def answer(inquiry: Inquiry) -> Diagnosis:
    """What an inquiry found, with all that is reported of it."""
    setting, study, base, chosen = inquiry.setting, inquiry.setting.study, inquiry.base, inquiry.chosen
    refits = [base, chosen] if chosen is not base else [base]
    seen = study.predict([*refits, inquiry.given], setting.test)
    for i, m in enumerate(setting.test):
        if not all(np.isfinite(e.predicted[e.windows.sample_run == i]).all() for e in seen[:-1]):
            raise InputError(
                f"{m.run.path}: kept unseen, and the fitted model's motion under its commands is not finite; leave it "
                "out, or give runs to fit that come nearer to it"
            )
    rivals, gap = _rivals(inquiry, chosen), _gap(inquiry, chosen, seen)
    return Diagnosis(
        verdict=inquiry.verdict,
        gap=gap,
        folds=_folds(inquiry, chosen),
        where=[_numbered(inquiry, r) if r.axis == "run" else r for r in _where(inquiry, chosen)],
        effects=_findings(inquiry, chosen),
        selected=list(chosen.ids),
        equivalent=inquiry.equivalent,
        minimum_detectable=_detectable(inquiry),
        next_experiment=next_experiment(study, list(rivals.values()), list(rivals)),
        base=_file(inquiry, base),
        model=_file(inquiry, chosen),
        runs=setting.runs,
        roles=[role_of(r, setting.train) for r in setting.runs],
        said=setting.said,
        evidence=inquiry.evidence,
        warnings=[
            *beware_of(setting.runs, setting.said),
            *(*inquiry.measured.notes, *_warnings(inquiry), *worse(gap, chosen.ids)),
        ],
        seed=setting.seed,
        options=setting.options,
        story=Story(inquiry, chosen, seen),
        overlays=[_overlay(inquiry, r, chosen, seen) for r in setting.runs],
    )


def _channel(inquiry: Inquiry) -> str:
    return ANGLE.get(inquiry.setting.train[0].y.shape[1], "joints")


def _gap(inquiry: Inquiry, chosen: Refit, seen: Sequence[Estimate]) -> Gap:
    """The gap on the unseen runs, the tip's too where it counts; its interval from the mean squares of every run. An
    unseen run of which the fitted ones do not say what an effect does there counts only where there is no other, and
    tells no interval then."""
    base, setting = inquiry.base, inquiry.setting
    after = seen[1] if chosen is not base else seen[0]
    told = ~unfixed(chosen.effects, setting.train, setting.test)
    foretold = bool(told.any())
    told |= not foretold
    parts = {"before": [], "after": [], "floor": []}
    pairs = (base.estimate, chosen.estimate, setting.train), (seen[0], after, setting.test)
    for b, a, motions in pairs:
        for i, m in enumerate(motions):
            if motions is setting.test and not told[i]:
                continue
            mine = b.windows.sample_run == i
            parts["before"].append(np.mean(b.error[mine] ** 2))
            parts["after"].append(np.mean(a.error[mine] ** 2))
            parts["floor"].append(np.mean(m.seen_noise**2))
    shares = {name: np.array(x) for name, x in parts.items()}
    counted = [m for m, x in zip(setting.test, told, strict=True) if x]
    before, end, given = (
        float(np.sqrt(np.mean(e.error[told[e.windows.sample_run]] ** 2))) for e in (seen[0], after, seen[-1])
    )
    by = [len(m.t) for m in counted]
    floor = float(np.sqrt(np.average([np.mean(m.seen_noise**2) for m in counted], weights=by)))
    fraction = judge.closed(before, end, floor)
    ci = None
    if fraction is not None and chosen is base:
        fraction, ci = 0.0, (0.0, 0.0)
    elif fraction is not None and foretold:
        ci = judge.interval(shares["before"], shares["after"], shares["floor"], len(counted), setting.rng)
        if ci is not None:
            ci = (min(ci[0], fraction), max(ci[1], fraction))
    ids = tuple(m.run.run_id for m in counted)
    channel = _channel(inquiry) + " and tip" * (setting.test[0].tip is not None)
    return Gap(channel, "rad", before, end, floor, fraction, ci, ids, given)


def _folds(inquiry: Inquiry, chosen: Refit) -> list[Fold]:
    """Every condition, left out of the fits of base and chosen model."""
    if chosen is inquiry.base:
        return []
    by, fold = inquiry.folds
    out = []
    for k, closed in enumerate(inquiry.closes(chosen)):
        mine = [m for m, f in zip(inquiry.setting.train, fold, strict=True) if f == k]
        runs, vacuum = tuple(m.run.run_id for m in mine), float(np.mean([m.vacuum.mean() for m in mine]))
        out.append(Fold(by, runs, vacuum, float(closed) if np.isfinite(closed) else None))
    return out


def _findings(inquiry: Inquiry, chosen: Refit) -> list[Finding]:
    out, found, evidence = [], inquiry.found, inquiry.evidence
    kinds = {k.id: k for k in inquiry.setting.study.kinds}
    for i, probability in inquiry.probability.items():
        if i not in evidence.left:
            out.append(Finding(i, probability))
            continue
        gain = inquiry.gained.get(i, inquiry.screen.gains[inquiry.screen.best(i)])
        p = judge.chance(inquiry.null, gain, inquiry.one)
        source = next((r for r in (chosen, found.best) if i in r.ids), found.single.get(i))
        parameters = {}
        if source is not None:
            unit = {n: about["unit"] for n, about in kinds[i].fields().items()}
            parameters = {n: {"value": v, "sd": s, "unit": unit[n]} for n, (v, s) in source.values(i).items()}
        left = inquiry.own_left(found.single[i]) if i in found.single else float(min(evidence.left[i], 1.0))
        closes = None if evidence.excess < judge.MATTERS else 1 - left
        out.append(Finding(i, probability, closes, p, parameters))
    return sorted(out, key=lambda f: -f.probability)


def _where(inquiry: Inquiry, chosen: Refit) -> list[Region]:
    base, channel = inquiry.base, _channel(inquiry)
    if inquiry.verdict == "listed_effect":
        contributions = []
        for i in chosen.ids:
            kind = effects.REGISTRY[i]
            alone = inquiry.found.single.get(i)
            other = alone if alone is not None and len(chosen.ids) > 1 else chosen
            (effect,) = (e for e in chosen.effects if e.id == i)
            joints, axes = None, ["run"] * (onset(effect) is not None or by_run(effect)) + list(kind.axes)
            if channel == "theta" and "segment" in axes:
                joints = _in_joints(inquiry, other)
                axes = axes if joints is not None else [a for a in axes if a != "segment"]
            part = base.estimate.windows.shape(other.estimate.predicted - base.estimate.predicted)
            contributions.append(where.Contribution(kind.block, axes, part, joints))
        return where.places(base.estimate, channel, contributions)
    if inquiry.verdict == "unlisted_effect":
        gap = base.estimate.shape_error
        flexible = inquiry.evidence.flexible
        place = min(flexible, key=lambda p: flexible[p], default="")
        main = judge.main_of(inquiry.probability, list(inquiry.evidence.left))
        block = BLOCKS[place] if place and flexible[place] < SEES else effects.REGISTRY[main].block
        unknown = where.Contribution(block, where.loudest(base.estimate, gap)[:2], gap)
        return where.places(base.estimate, channel, [unknown])
    return []


def _numbered(inquiry: Inquiry, region: Region) -> Region:
    """A range of fitted runs, by which of all runs they are, from 1."""
    train = inquiry.setting.train
    order = [id(m) for m in by_start([*train, *inquiry.setting.test])]
    low, high = (1.0 + order.index(id(train[round(x)])) for x in region.range)
    return replace(region, range=(low, high))


def _in_joints(inquiry: Inquiry, refit: Refit) -> np.ndarray | None:
    """By how much a refit has every joint elsewhere than the base model (M, n), where their mean alone is measured;
    None where that cannot be simulated."""
    study, base = inquiry.setting.study, inquiry.base
    n = base.model.n
    unmeasured = [
        replace(m, y=np.zeros((len(m.t), n)), noise=np.repeat(m.noise, n), tip=None) for m in inquiry.setting.train
    ]
    before, after = study.predict([base, refit], unmeasured)
    moved = after.predicted - before.predicted
    return moved if np.isfinite(moved).all() else None


def _rivals(inquiry: Inquiry, chosen: Refit) -> dict[str, Refit]:
    """What an experiment should part, by name: the main effect and the most probable other that has been refitted; of
    several effects one, and what is most probable in its place."""
    found = inquiry.found
    if len(chosen.ids) > 1 and (rival := inquiry.rival()):
        out, new, other = rival
        return {out: chosen, new: other}
    known = sorted(found.single, key=lambda i: -inquiry.probability.get(i, 0.0))
    first = [i for i in chosen.ids if i in found.single][:1] or known[:1]
    return {i: found.single[i] for i in [*first, *[i for i in known if i not in first]][:2]}


def _detectable(inquiry: Inquiry) -> dict[str, dict[str, object]]:
    kinds, out = {k.id: k for k in inquiry.setting.study.kinds}, {}
    for i in inquiry.screen.ids:
        name, value = inquiry.screen.detectable(inquiry.screen.best(i), np.sqrt(inquiry.one))
        about = kinds[i].fields()[name]
        if np.isfinite(value) and about["null"] + value <= about["high"]:
            out[i] = {"parameter": name, "value": value, "unit": about["unit"]}
    return out


def _warnings(inquiry: Inquiry) -> list[str]:
    out, setting = [], inquiry.setting
    if setting.start_from == NOMINAL:
        out.append("no model given: geometry and mass are OctRobot-I's; give yours with --model")
    if inquiry.verdict == "unlisted_effect":
        out.append(
            f"{_leaves(inquiry.evidence)}: what causes it is none of those known here{_pointed(inquiry.evidence)}"
        )
    if inquiry.verdict == "listed_effect":
        out += _left_over(inquiry)
    if not inquiry.base.estimate.converged:
        out.append("the base fit stopped before it converged; take the answer with care")
    return out


def _leaves(evidence: judge.Evidence) -> str:
    """What the best listed effect leaves, in words; of runs not fitted too, where that is what speaks against it."""
    best = min(evidence.left, key=lambda i: evidence.left[i])
    fitted, held_out = (min(max(by.get(best, 0.0), 0.0), 1.0) for by in (evidence.left, evidence.held_out))
    share = f"{100 * fitted:.0f} % of the gap"
    if held_out > fitted + judge.KEPT:
        share = f"{100 * fitted:.0f} % of the fitted runs' gap, but {100 * held_out:.0f} % of that of runs no fit saw"
    return f"the best listed effect leaves {share}"


def worse(gap: Gap, chosen: Sequence[str]) -> list[str]:
    """What a reader must know where effects that fit the fitted runs make unseen ones worse."""
    if not chosen or gap.after <= max(gap.before, 1.1 * gap.noise_floor):
        return []
    return [
        f"on {', '.join(gap.held_out_runs)}, which no fit saw, {' and '.join(chosen)} make the error larger, not "
        "smaller: do not trust the fitted values; log more runs like these and diagnose again"
    ]


def _left_over(inquiry: Inquiry) -> list[str]:
    """When the selected effects begin, what they leave, and conditions to which they do not carry over."""
    chosen, setting, out = inquiry.chosen, inquiry.setting, []
    excused = inquiry.selection.excused(chosen)
    if excused > max(SCATTERS, 0.5 * inquiry.own_left(chosen)):
        out.append(
            f"the latency scatters by {1e3 * chosen.scatter.sd_s:.2g} ms (standard deviation) from frame to frame, "
            f"which makes {100 * excused:.0f} % of the gap and no model foretells; stamp each frame when it is taken"
        )
    for effect in chosen.effects:
        if when := began(effect, setting.train, setting.test):
            out.append(f"{effect.id} begins {when}")
        if by_run(effect):
            out.append(
                f"{effect.id} is another in each run: what it will be in a new one cannot be told from these data"
            )
    left, estimate = inquiry.own_left(chosen) - excused, chosen.estimate
    colour = screening.colour(estimate.error, estimate.windows.sample_run)
    who = " and ".join(chosen.ids)
    if left > LEFT_OVER and colour > COLOURED:
        axes = " and ".join(where.loudest(estimate, estimate.shape_error)[:2])
        out.append(
            f"with {who} {100 * left:.0f} % of the fitted runs' gap is left, and it is no noise (unevenly spread along "
            f"{axes}): the cause has another form here, or something else is missing too{_pointed(inquiry.evidence)}"
        )
    closes = inquiry.closes(chosen)
    known = closes[np.isfinite(closes)]
    if len(known) > 1 and known.min() < np.median(known) - POORER:
        k = int(np.nanargmin(closes))
        runs = [m.run.run_id for m, f in zip(inquiry.setting.train, inquiry.folds[1], strict=True) if f == k]
        out.append(
            f"left out of the fit, {', '.join(runs)} would close by {100 * known.min():z.0f} % alone (others "
            f"{100 * np.median(known):z.0f} %): {who} as fitted carries over badly to that condition"
        )
    held_out = max(inquiry.evidence.held_out.get(i, 0.0) for i in chosen.ids)
    if held_out > max(left, 0.0) + judge.KEPT:
        out.append(
            f"{who} leaves {100 * left:z.0f} % of the fitted runs' gap, but {100 * held_out:.0f} % of that of runs no "
            "fit saw: as fitted it carries over badly"
        )
    (told,) = inquiry.told_elsewhere([chosen])
    if told.min() <= 0.5:
        alone = inquiry.folds[1] == np.argmin(told)
        runs = [m.run.run_id for m, mine in zip(inquiry.setting.train, alone, strict=True) if mine]
        out.append(
            f"of the runs fitted hardly any but {', '.join(runs)} shows {who}: whether it carries over cannot be told "
            "from these data; log more like it"
        )
    return out


def _pointed(evidence: judge.Evidence) -> str:
    """Where flexible stand-ins see it, in words."""
    near = sorted((left, place) for place, left in evidence.flexible.items() if left < SEES)
    if not near:
        return ""
    places = ", ".join(f"{place} {100 * max(left, 0.0):.0f} %" for left, place in near[:3])
    return f". Flexible stand-ins (lags, curves, relays of no particular form) would leave, at the {places}"


def _overlay(inquiry: Inquiry, run: Run, chosen: Refit, seen: Sequence[Estimate]):
    """What the chosen model predicts of a run, and what it leaves, at the log's stamps."""
    setting = inquiry.setting
    for motions, estimate in ((setting.train, chosen.estimate), (setting.test, seen[min(1, len(seen) - 2)])):
        for i, m in enumerate(motions):
            if m.run is run:
                mine = estimate.windows.sample_run == i
                columns = run.signal("shape").columns
                t = estimate.windows.sample_t[mine]
                sim = Signal(t, estimate.windows.shape(estimate.predicted)[mine], columns, "rad", "")
                residual = Signal(t, estimate.shape_error[mine], columns, "rad", "")
                return {"/sim": {"shape": sim}, "/residual": {"shape": residual}}
    return {"/sim": {}, "/residual": {}}


def _file(inquiry: Inquiry, refit: Refit) -> ModelFile:
    """A refit as a model.toml holds it, only the chosen effects in it."""
    c = refit.estimate.problem.coordinates
    slope = c.jacobian(refit.estimate.x)
    sd = np.sqrt(np.maximum(np.diag(slope @ refit.estimate.covariance @ slope.T), 0.0))
    uncertainty = {n: float(s) for n, s in zip(c.names, sd, strict=True) if np.isfinite(s)}
    model = replace(refit.model, effects=tuple(refit.effects))
    return replace(inquiry.setting.start, model=model, uncertainty=uncertainty)
