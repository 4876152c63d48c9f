"""How robust a law is: thousands of closed loops on robots, scenarios and noise as they may turn out to be.

A draw is one robot in one scenario; it goes to every target in a loop of its own. Draws come from the uncertainty of
the model, effects with their priors, and what `ljjax.control.vary` says.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

import jax
import numpy as np

from ljjax.control.chance import Index, design, sobol
from ljjax.control.loop import to_jax
from ljjax.control.robust_inputs import assumed, uncertain
from ljjax.control.robust_loop import OneLoop, Told
from ljjax.control.robust_result import Robust
from ljjax.control.robust_run import Kept, batch_size, digest, simulate
from ljjax.control.spec import MEASURES, Spec, default, refuse
from ljjax.control.uncertain import COURSE, draw, possible
from ljjax.control.vary import usual
from ljjax.control.worst import climb, usual_radius
from ljjax.errors import InputError
from ljjax.law.parts import Law
from ljjax.model import Model, astype, check

Tell = Callable[[str, int, int], None]


def robust(
    law: Law,
    model: Model,
    spec: Spec | None = None,
    *,
    uncertainty: Mapping[str, float] | None = None,
    correlation: Mapping[tuple[str, str], float] | None = None,
    priors: Mapping[str, tuple[float, float]] | None = None,
    effects: Sequence[str] = (),
    samples: int = 2000,
    sobol_rows: int = 128,
    steps: int = 20,
    radius: float | None = None,
    seed: int = 0,
    batch: int | None = None,
    precision: Literal["float64", "float32"] = "float64",
    out: str | Path | None = None,
    progress: Tell | None = None,
    where: str = "model",
    law_where: str = "law",
    spec_where: str = "specification",
) -> Robust:
    """Study a law on robots and scenarios as they may turn out to be.

    Args:
        spec: None for `spec.default` of the law's reach; its `vary` says what else differs.
        uncertainty: standard deviations by path (`ModelFile.uncertainty`, `fitted.read`).
        correlation: of pairs of paths.
        priors: mean and standard deviation of effects' parameters by path (`ModelFile.priors`).
        effects: ids of effects to add with their priors; those that the model has are simulated anyway.
        samples: draws; each is simulated at every target.
        sobol_rows: rows of the sensitivity study, 0 for none: rows × (groups + 2) further draws.
        steps, radius: of the ascent to the worst case; None for `worst.usual_radius`.
        batch: loops at a time; chosen from the free memory by default.
        precision: of the samples; the worst case is computed in JAX's default.
        out: a folder in which finished batches are kept until `robust_report.save` has written the study there.
        progress: `progress(stage, done, count)`.
        where, law_where, spec_where: what to call model, law and specification in messages.

    Raises:
        InputError: a law of another robot, targets out of reach, numbers out of range, distributions within which
            hardly any robot is possible, nothing to vary, an `out` that holds another study.
    """
    for name, value, least in (("samples", samples, 2), ("sobol_rows", sobol_rows, 0), ("steps", steps, 0)):
        if value < least:
            raise InputError(f"{name} = {value}: expected a whole number from {least} on")
    if radius is not None and not 0 < radius < math.inf:
        raise InputError(f"radius = {radius:g}: expected a number of standard deviations > 0")
    if batch is not None and batch < 1:
        raise InputError(f"batch = {batch}: expected a number of loops ≥ 1")
    if int(law.robot.segments) != model.n:
        raise InputError(f"{law_where}: is for {int(law.robot.segments)} segments, {where} has {model.n}")
    highest = float(law.limits.vacuum_max_kpa)
    check(model, (0.0, highest), where)
    spec = spec or default(law)
    refuse(spec, law, spec_where)
    vary = spec.vary or usual(spec.noise_rad, spec.compute_ticks, spec.sensor_s, float(law.period_s))
    if vary.push_n is not None and vary.push_at_s[1] >= spec.duration_s:
        raise InputError(
            f"{spec_where}: vary.push_at_s is up to {vary.push_at_s[1]:g} s, the loop ends at {spec.duration_s:g} s; "
            "lower it, or raise loop.duration_s"
        )
    given_sd = uncertainty or {}
    model, given = uncertain(astype(model, float), vary, effects, given_sd, correlation or {}, priors or {})
    noisy = (vary.noise_rad or (spec.noise_rad,))[-1] > 0
    if not given.entries:
        raise InputError(
            f"{where}: nothing is uncertain: it has no [uncertainty], no effect was named, and {spec_where} varies "
            "nothing; give standard deviations, or leave [vary] out"
        )
    kept_dtype = np.float32 if precision == "float32" else model.jamming.c4.dtype
    one = OneLoop(law, model, spec, vary, given, kept_dtype)
    xi, courses, redrawn = _draws(one, samples, seed, highest)
    groups = {**given.groups, **({COURSE: (len(given.entries),)} if noisy else {})}
    rows = None
    if sobol_rows:

        def real(x: np.ndarray) -> np.ndarray:
            return possible(model, given, x[:, :-1], highest)

        rows = design(np.random.default_rng([seed, 2]), sobol_rows, groups, len(given.entries) + 1, real)
    everything, every_course = xi, courses
    if rows is not None:
        flat = rows.reshape(-1, rows.shape[-1])
        everything = np.concatenate([xi, flat[:, :-1]])
        every_course = np.concatenate([courses, _course(flat[:, -1])])
    one.reach(everything)
    identity = {
        "ljjax": version("ljjax"),
        "law": [law.kind, digest(to_jax(law, float))],
        "model": [model.n, *(effect.id for effect in model.effects), digest(model)],
        "specification": spec.as_dict(),
        "inputs": [*map(list, given.entries), digest(given.factor)],
        "samples": samples,
        "sobol_rows": sobol_rows,
        "seed": seed,
        "precision": precision,
    }

    def tell(stage: str) -> Callable[[int, int], object]:
        return lambda done, count: progress(stage, done, count) if progress else None

    began = time.perf_counter()
    size = batch_size(one, len(everything), len(spec.targets), batch)
    kept = None if out is None else Kept(Path(out), _named(identity), size)
    if kept is not None and kept.finished is not None:
        told, fresh = kept.finished, 0
    else:
        told, fresh = simulate(one, everything, every_course, kept.batch if kept else size, kept, tell("closed loops"))
    seconds = time.perf_counter() - began
    own, rest = (Told(*(x[part] for x in told)) for part in (slice(0, samples), slice(samples, None)))
    found, used = _sensitivity(one, rest, rows, tuple(groups), seed, highest)
    climbing = one
    if precision == "float32":
        climbing = OneLoop(law, model, spec, vary, given, model.jamming.c4.dtype)
        climbing.kept = one.kept
    far = usual_radius(len(given.entries)) if radius is None else radius
    cost = np.where(own.ok, own.price, np.nan)
    worst = climb(climbing, xi, courses, cost, far, steps, highest, tell("worst case"))
    options = {"samples": samples, "sobol_rows": sobol_rows, "steps": steps, "radius": far, "seed": seed}
    options |= {"precision": precision, "effects": list(effects), "devices": jax.device_count()}
    said = assumed(model, given, spec, vary, noisy)
    return Robust(
        climbing, said, xi, courses, given.columns(xi), redrawn, own, found, (used, sobol_rows), rest, worst, options,
        identity, fresh, seconds,
    )  # fmt: skip


def _named(identity: Mapping[str, Any]) -> dict[str, Any]:
    """With JSON's numbers only: bounds that are not there are words."""
    return {k: str(x) if k == "inputs" else x for k, x in identity.items()}


def _draws(one: OneLoop, samples: int, seed: int, highest: float) -> tuple[np.ndarray, np.ndarray, int]:
    rng = np.random.default_rng([seed, 1])
    xi, redrawn = draw(one.model, one.given, samples, rng, highest)
    return xi, _course(rng.standard_normal(samples)), redrawn


def _course(x: np.ndarray) -> np.ndarray:
    """A whole number from each standard normal one, for the noise's course: bits of its fraction."""
    return ((np.ascontiguousarray(x, np.float64).view(np.uint64) >> np.uint64(8)) & np.uint64(0xFFFFFFFF)).astype(
        np.uint32
    )


def _sensitivity(
    one: OneLoop, told: Told, rows: np.ndarray | None, groups: tuple[str, ...], seed: int, highest: float
) -> tuple[dict[str, dict[str, Index]], int]:
    """Indices of what the worst target costs and of its measures, from the rows of the design that are whole: all
    their robots possible, all their loops finite."""
    if rows is None:
        return {}, 0
    shape = rows.shape[:2]
    real = possible(one.model, one.given, rows.reshape(-1, rows.shape[-1])[:, :-1], highest)
    whole = np.all((real & np.all(told.ok, axis=1)).reshape(shape), axis=0)
    results = {"cost": np.asarray(told.price).max(axis=1)}
    for i, name in enumerate(MEASURES):
        if name in one.spec.require and one.spec.require[name].weight > 0:
            results[name] = np.asarray(told.smooth)[..., i].max(axis=1)
    found = {}
    for name, values in results.items():
        y = np.where(whole[None], values.reshape(shape).astype(float), np.nan)
        found[name] = sobol(y, groups, np.random.default_rng([seed, 3]))
    return found, int(whole.sum())
