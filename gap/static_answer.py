"""The diagnosis of steady data put together: verdict, gap, regions, ranking, warnings, overlays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import stats

from ljjax.fit.points import Points
from ljjax.fit.static import StaticFit
from ljjax.gap import static_next as following
from ljjax.gap.result import LAST, Diagnosis, Finding, Gap, Region
from ljjax.gap.static_runs import Apart
from ljjax.gap.static_search import LEVEL, Candidate, equivalent
from ljjax.gap.static_stage import Channel, probabilities
from ljjax.gap.static_words import beware, closing
from ljjax.gap.statics import Laws
from ljjax.gap.where import concentration
from ljjax.logs import Run, Signal
from ljjax.model import Model, get
from ljjax.modelfile import ModelFile

UNLISTED_RATIO = 1.5
"""Where the points stand still further off than this many times their scatter, something is left."""
CHANNEL = {"steady": "tension", "probe": "stiffness"}


def value(model: Model, name: str) -> float:
    return float(get(model, name))


@dataclass(frozen=True, eq=False)
class Found:
    """Everything the search found; what the report draws."""

    start: ModelFile
    start_from: str
    laws: Laws
    base: StaticFit
    x: np.ndarray
    active: tuple[str, ...]
    channels: Sequence[Channel]
    apart: Sequence[Apart]
    seed: int

    @property
    def selected(self) -> list[str]:
        return [e for c in self.channels for e in c.added]

    def report(self, result: Diagnosis, data: Mapping[str, Any]) -> str:
        from ljjax.gap.static_report import report

        return report(self, result, data)


def diagnosis(
    found: Found, runs: Sequence[Run], said: Sequence[str], short: Sequence[str], options: Mapping[str, Any]
) -> Diagnosis:
    """The answer."""
    main = next((c for c in found.channels if c.added), found.channels[0])
    share = _mixed(found.channels)
    verdict = _verdict(found)
    none = share.pop("")
    known = {e: share.get(e, 0.0) for e in found.laws.kinds}
    last = dict.fromkeys(LAST, 0.0)
    if verdict == "unlisted_effect":
        last["unlisted_effect"] = 0.9 * none
        last["parameters_only"] = 0.1 * none
    else:
        quiet = _given_suffices(found.channels)
        last["unlisted_effect"] = 0.02 * none
        last["no_gap" if quiet else "parameters_only"] = 0.9 * none
        last["parameters_only" if quiet else "no_gap"] = 0.08 * none
    findings = [_finding(found, e, p) for e, p in known.items()] + [Finding(e, p) for e, p in last.items()]
    findings.sort(key=lambda f: (-f.probability, f.id not in LAST, f.id))
    alike = [
        sets
        for c in found.channels
        for number, effect in enumerate(c.added)
        if len(sets := equivalent(c.rounds[number], effect)) > 1
    ]
    smallest: dict[str, Any] = {}
    for c in found.channels:
        for effect, about in following.detectable(found.laws, c).items():
            if effect not in smallest or about["value"] < smallest[effect]["value"]:
                smallest[effect] = about
    sds = _sds(found)
    model = found.laws.build(found.x, found.selected)
    file = replace(found.start, model=model, uncertainty={n: s for n, s in sds.items() if np.isfinite(s)})
    base = replace(found.start, model=found.base.model, uncertainty={})
    warnings = [*short, *beware(found, main, runs, said, model)]
    train = {int(i) for c in found.channels for i in np.unique(c.points.run)}
    return Diagnosis(
        verdict=verdict,
        gap=_gap(found, main, runs),
        where=[] if verdict in ("no_gap", "parameters_only") else _where(main, found),
        effects=findings,
        selected=found.selected,
        equivalent=alike,
        minimum_detectable=smallest,
        next_experiment=following.next_experiment(found.laws, found.channels),
        base=base,
        model=file,
        runs=runs,
        roles=["train" if i in train else "held_out" for i in range(len(runs))],
        said=list(said),
        warnings=warnings,
        seed=found.seed,
        options=options,
        story=found,
        overlays=[_overlay(found, i, run) for i, run in enumerate(runs)],
    )


def _mixed(channels: Sequence[Channel]) -> dict[str, float]:
    """Probability that each effect is the main one, none of them under "": each kind of points counts by how much its
    effects raise the score."""
    weights = np.array([c.gain for c in channels])
    if not weights.sum() > 0:
        rounds = [probabilities(c.rounds[0]) for c in channels]
        return min(rounds, key=lambda p: p[""])
    weights = weights / weights.sum()
    first = probabilities(channels[0].rounds[0])
    out: dict[str, float] = dict.fromkeys(["", *first], 0.0)
    for c, w in zip(channels, weights, strict=True):
        own = probabilities(c.rounds[0])
        nothing = own.pop("") if c is not channels[0] else 0.0  # nothing more than what came before
        for effect, p in own.items():
            out[effect] = out.get(effect, 0.0) + float(w * p)
        for effect, p in first.items():
            out[effect] += float(w * nothing * p)
    return out


def _given_suffices(channels: Sequence[Channel]) -> bool:
    """Whether refitting the base gains no more than its parameters must by chance."""
    gain = 0.0
    for c in channels:
        n, s2 = c.data.tested.independent, c.noise**2
        free = len(c.rounds[0].none.dropped) + sum(x in c.rounds[0].none.active for x in Laws.BASE)
        gain += 0.5 * n * np.log((np.mean(c.given**2) + s2) / (np.mean(c.base.error**2) + s2))
        gain -= 0.5 * free * np.log(n)
    return bool(gain < 0)


def _verdict(found: Found) -> str:
    if found.selected:
        return "listed_effect"
    for c in found.channels:
        if c.data.tested.stated:
            ratio = np.mean(c.base.error**2) / c.noise**2
            n = c.data.tested.independent
            if ratio > UNLISTED_RATIO**2 and stats.chi2.sf(ratio * n, n) < LEVEL:
                return "unlisted_effect"
    return "no_gap" if _given_suffices(found.channels) else "parameters_only"


def _candidate(found: Found, effect: str) -> tuple[Channel, Candidate] | None:
    """Where an effect shows most, and how."""
    seen = [
        (c.rounds[0].found[effect].score - c.rounds[0].none.score, i)
        for i, c in enumerate(found.channels)
        if effect in c.rounds[0].found
    ]
    for c in found.channels:
        if effect in c.added:
            return c, c.rounds[min(c.added.index(effect), len(c.rounds) - 1)].found[effect]
    if not seen:
        return None
    c = found.channels[max(seen)[1]]
    return c, c.rounds[0].found[effect]


def _finding(found: Found, effect: str, probability: float) -> Finding:
    where = _candidate(found, effect)
    if where is None:
        return Finding(effect, probability)
    channel, c = where
    number = channel.added.index(effect) if effect in channel.added else 0
    none = channel.rounds[min(number, len(channel.rounds) - 1)].none
    before, after = float(np.mean(none.fit[-1:])), float(np.mean(c.fit[-1:]))
    closed = 1 - (after - 1) / (before - 1) if before > 1.2 else None
    chosen = effect in found.selected
    x = found.x if chosen else c.x
    sds = _sds(found) if chosen else {}
    parameters = {}
    for name in (*found.laws.of(effect, "size"), *found.laws.of(effect, "form")):
        if name in c.active or chosen and name in found.active:
            sd = sds.get(name, float("nan"))
            parameters[name.split(".")[-1]] = {
                "value": float(x[found.laws.index([name])[0]]),
                "sd": sd if np.isfinite(sd) else None,
                "unit": found.laws.about[name]["unit"],
            }
    return Finding(effect, probability, closed, c.p_value, parameters)


def _sds(found: Found) -> dict[str, float]:
    """Standard deviations of what was fitted, widened where neighbours err alike."""
    out: dict[str, float] = {}
    for c in found.channels:
        wide = np.sqrt(len(c.points) / c.data.tested.independent)
        for name, sd in c.fitted.sd(wide).items():
            out[name] = sd
    return out


def _gap(found: Found, c: Channel, runs: Sequence[Run]) -> Gap:
    inner = c.inner
    before, after = c.base.rms(inner), c.model.rms(inner)
    given = float(np.sqrt(np.mean(c.given[inner] ** 2)))
    names = tuple(runs[int(i)].run_id for i in np.unique(c.points.run))
    closed, ci = closing(c, found.seed)
    return Gap(CHANNEL[c.kind], c.unit, before, after, c.noise, closed, ci, names, given)


def _where(c: Channel, found: Found) -> list[Region]:
    """Shares of the base model's squared error at left-out pressures along the axis on which the effect lies; where
    there is none, along that on which the error is most uneven, pressure (of what jams) or angle (of what bends)."""
    e = np.where(np.isfinite(c.base.left_out), c.base.left_out, 0.0)
    square, p, levels = e**2, c.points, c.points.levels
    total = float(square.sum()) or 1.0
    kind = found.laws.kinds.get(c.added[0]) if c.added else None
    bent, channel = np.ptp(p.theta) > 1e-6, CHANNEL[c.kind]
    known = kind.axes if kind else _loudest(p, e)
    axes = [a for a in known if a in ("pressure", "everywhere") or (a == "angle" and bent)]
    axis = axes[0] if axes else "pressure"
    block = kind.block if kind else {"pressure": "jamming", "angle": "structure"}[axis]
    if axis == "everywhere":
        even = float(np.mean(c.base.error) ** 2 / max(np.mean(c.base.error**2), 1e-300))
        return [
            Region(
                block, channel, "everywhere", (float(p.pressure_kpa.min()), float(p.pressure_kpa.max())), "kPa", even
            )
        ]
    out = []
    if axis == "pressure":
        for k, at in enumerate(p.level_pressures()):
            ends = (float(at), float(at))
            out.append(Region(block, channel, "pressure", ends, "kPa", _share(square, levels == k, total)))
    else:
        edges = np.quantile(p.theta, np.linspace(0, 1, 6))
        place = np.clip(np.searchsorted(edges, p.theta, side="right") - 1, 0, 4)
        for k in range(5):
            ends = (float(edges[k]), float(edges[k + 1]))
            out.append(Region(block, channel, "angle", ends, "rad", _share(square, place == k, total)))
    return sorted(out, key=lambda r: -r.share)


def _loudest(p: Points, error: np.ndarray) -> list[str]:
    """Pressure and angle, first the axis along which the error (n,) is the more uneven."""
    along = {"pressure": p.pressure_kpa, "angle": p.theta}
    return sorted(along, key=lambda a: -concentration(along[a], error[:, None]))


def _share(square: np.ndarray, mine: np.ndarray, total: float) -> float:
    return float(square[mine].sum() / total)


def _overlay(found: Found, index: int, run: Run) -> dict[str, dict[str, Signal]]:
    """What the extended model says in place of the measured tension and probe force of one log."""
    sim: dict[str, Signal] = {}
    residual: dict[str, Signal] = {}
    parts = [c.points for c in found.channels] + [a.points for a in found.apart]
    for points in parts:
        mine = points.take(points.run == index)
        if not len(mine):
            continue
        model = found.laws.values(found.x, mine)
        error = mine.value - model
        if mine.kind == "steady":
            other = run.signal("tendons", "cmd_tendons")
            right = other.held_at(mine.t)[:, 1]
            name, base = "tendons", np.stack([model + right, right], 1)
            difference = np.stack([error, np.zeros_like(error)], 1)
        else:
            other = run.signal("probe")
            depth = other.held_at(mine.t)[:, 0]
            name, base = "probe", np.stack([depth, model * depth], 1)
            difference = np.stack([np.zeros_like(depth), error * depth], 1)
        sim[name] = Signal(mine.t, base, other.columns, other.unit, "")
        residual[name] = Signal(mine.t, difference, other.columns, other.unit, "")
    return {"/sim": sim, "/residual": residual}


__all__ = ["CHANNEL", "Found", "diagnosis", "value"]
