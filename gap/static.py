"""`diagnose_static`: where a robot at rest and its model part, which effect causes it, how far the gap closes.

Two stages, as in `ljjax.fit.static`: steady points first; then the probe's stiffness beside them, for what they did
not show. In each, every effect is judged together with the base parameters (`static_cells`), against chance
(`static_search`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ljjax.effects import REGISTRY
from ljjax.errors import InputError
from ljjax.fit.points import Points
from ljjax.fit.static import PARAMETERS, StaticFit, fit_static
from ljjax.gap import static_answer as answer
from ljjax.gap.result import Diagnosis
from ljjax.gap.static_cells import Data
from ljjax.gap.static_runs import sort
from ljjax.gap.static_search import refine
from ljjax.gap.static_stage import LEAST_LEVELS, MOST, Channel, Errors, block, search
from ljjax.gap.statics import Laws
from ljjax.logs import Run
from ljjax.modelfile import ModelFile


def diagnose_static(
    start: ModelFile,
    start_from: str,
    steady: Points,
    probe: Points,
    runs: Sequence[Run],
    said: Sequence[str],
    *,
    without: Sequence[str] = (),
    seed: int = 0,
    options: Mapping[str, Any] | None = None,
) -> Diagnosis:
    """Diagnose the gap on steady points and probe stiffness.

    Args:
        start: the given model, a base model.
        start_from: where it came from.
        steady, probe: the points, as `ljjax.fit.points.collect` gives them; either may be empty.
        runs, said: the logs, and what each gave.
        without: effects that are not candidates.
        seed: for simulated data without an effect.
        options: what was asked for, for the record.

    Raises:
        InputError: too few pressures or points to tell anything, with what to add.
    """
    rng = np.random.default_rng(seed)
    kinds = [kind for id, kind in REGISTRY.items() if id not in without]
    steady, apart = sort(steady, runs)
    steady, probe, short = _enough(steady, probe)
    base = fit_static(start.model, steady, probe, frozen=start.frozen)
    laws = Laws(base.model, kinds)
    channels, x, active = _channels(laws, base, start.model, steady, probe, [k.id for k in kinds], start.frozen, rng)
    found = answer.Found(start, start_from, laws, base, x, active, channels, apart, seed)
    return answer.diagnosis(found, runs, said, short, dict(options or {}))


def _enough(steady: Points, probe: Points) -> tuple[Points, Points, list[str]]:
    """The points of kinds that can be judged at pressures left out, and a line on each kind that cannot."""
    said, kept = [], []
    for points in (steady, probe):
        levels = points.level_pressures()
        if 0 < len(levels) < LEAST_LEVELS:
            at = ", ".join(f"{p:.3g}" for p in levels)
            said.append(
                f"cannot tell from the {points.kind} points: they are at {len(levels)} pressures ({at} kPa), and a law "
                f"over pressure is judged at pressures left out; add {points.kind} points at {LEAST_LEVELS} pressures "
                "or more"
            )
            points = Points.none(points.kind)
        kept.append(points)
    if not len(kept[0]) and not len(kept[1]):
        raise InputError("; ".join(said) or "no steady points and no probe stiffness to diagnose")
    return kept[0], kept[1], said


def _channels(
    laws: Laws,
    base: StaticFit,
    given: Any,
    steady: Points,
    probe: Points,
    candidates: Sequence[str],
    frozen: Sequence[str],
    rng: np.random.Generator,
) -> tuple[list[Channel], np.ndarray, tuple[str, ...]]:
    x, active, added, out = laws.x0.copy(), (), [], []
    start = laws.x0.copy()
    start[: len(laws.BASE)] = [float(answer.value(given, n)) for n in laws.BASE]
    blocks = ()
    for points in (steady, probe):
        if not len(points):
            continue
        stage = base.stages[points.kind]
        blocks = (*blocks, block(points, stage.error))
        own = tuple(n for n in PARAMETERS[points.kind] if n not in frozen)
        before = (x, active)
        rest = [c for c in candidates if c not in added]
        data, rounds, more, x, active = search(laws, Data(blocks), x, (*active, *own), rest, MOST - len(added), rng)
        blocks = data.blocks
        alone = Data(blocks[-1:])
        earlier = out[0].rounds[0].unseen if out else ()
        if out and all(e in earlier for e in more):  # the steady points keep what they alone say
            mine = tuple(n for n in active if n not in before[1])
            kept = x.copy()
            kept[laws.index(before[1])] = before[0][laws.index(before[1])]
            fitted = refine(laws, alone, kept, mine)
        else:
            fitted = refine(laws, data, x, active)
        x = fitted.x
        noise = data.tested.noise
        rows = slice(-len(points), None)
        model = Errors(fitted.error[rows] * noise, fitted.left_out * noise)
        errors = Errors(stage.error, stage.held_out)
        told = points.value - laws.values(start, points)
        added += more
        out.append(Channel(points.kind, data, rounds, more, errors, model, told, fitted))
    return out, x, active


__all__ = ["diagnose_static"]
