"""What a robustness study draws, gathered: parameters, effects, scenario; and what that assumes, in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ljjax import effects as known
from ljjax.control.spec import Spec
from ljjax.control.uncertain import COURSE, LOOSE, Input, Inputs, inputs
from ljjax.control.vary import Vary
from ljjax.effect import Effect
from ljjax.errors import InputError
from ljjax.model import Model, get, limits, replace, units

SHAPE = "initial shape"


def uncertain(
    model: Model,
    vary: Vary,
    effects: Sequence[str],
    sd: Mapping[str, float],
    correlation: Mapping[tuple[str, str], float],
    priors: Mapping[str, tuple[float, float]],
) -> tuple[Model, Inputs]:
    """The model with the effects that are added, and everything that is drawn.

    An effect's parameter is drawn as `[vary]` says; else with its standard deviation, or its prior in the model's
    `[fit.priors]`; else, where the effect is among `effects`, with what the registry calls a typical size around the
    value it has, or vanishes at. What form an effect has is drawn only where that is said.

    Raises:
        InputError: an unknown effect, a standard deviation of no parameter.
    """
    model = _with(model, [*effects, *(path.split(".")[1] for path in vary.effects)])
    bounds, unit = limits(model), units(model)
    normal = {path: (float(get(model, path)), s) for path, s in sd.items() if path in unit}
    if strange := [path for path in sd if path not in unit]:
        raise InputError(f"uncertainty: no parameter {strange[0]!r} in the model; add its effect, or leave it out")
    normal |= {p: x for p, x in priors.items() if p in bounds and p not in sd}
    for effect in model.effects:
        for name in effect.sizes() if effect.id in effects else ():
            path = f"effects.{effect.id}.{name}"
            normal.setdefault(path, (float(getattr(effect, name)), float(effect.fields()[name]["scale"])))
    normal |= vary.effects
    model = replace(model, {path: mean for path, (mean, s) in normal.items() if s == 0})
    free = (float("-inf"), float("inf"))
    entries = [Input(p, unit[p], "normal", m, s, *bounds.get(p, free)) for p, (m, s) in normal.items() if s > 0]
    for name, ends, of in (
        ("noise_rad", vary.noise_rad, "rad"),
        ("compute_ticks", vary.compute_ticks, "periods"),
        ("sensor_s", vary.sensor_s, "s"),
    ):
        entries += _range(name, ends, of)
    if vary.shape_rad > 0:
        entries += [Input(f"shape.q{i + 1}", "rad", "normal", 0.0, vary.shape_rad) for i in range(model.n)]
    if vary.push_n is not None:
        entries += _range("push_n", vary.push_n, "N")
        entries += _range("push_at_s", vary.push_at_s, "s") + _range("push_for_s", vary.push_for_s, "s")
    joined = {f"effects.{e.id}": tuple(f"effects.{e.id}.{name}" for name in e.fields()) for e in model.effects}
    joined[SHAPE] = tuple(f"shape.q{i + 1}" for i in range(model.n))
    return model, inputs(entries, correlation, joined)


def _range(name: str, ends: tuple[float, float] | None, unit: str) -> list[Input]:
    return [Input(name, unit, "uniform", *ends)] if ends is not None and ends[0] < ends[1] else []


def _with(model: Model, ids: Sequence[str]) -> Model:
    """The model with effects added, each at the values at which it vanishes."""
    there: list[Effect] = list(model.effects)
    for name in ids:
        if name not in known.REGISTRY:
            raise InputError(f"effects: no effect {name!r}; expected one of {', '.join(known.REGISTRY)}")
        if not any(e.id == name for e in there):
            there.append(known.REGISTRY[name]())
    order = list(known.REGISTRY)
    kept = tuple(sorted(there, key=lambda e: order.index(e.id)))
    return Model(
        model.chain, model.gravity, model.elastic, model.jamming, model.friction, kept, model.constant_mass, model.lever
    )


def assumed(model: Model, given: Inputs, spec: Spec, vary: Vary, noisy: bool) -> tuple[str, ...]:
    """What the study rests on, a line each."""
    lines = [f"{x.name}: {x.said}" for x in given.entries if not x.name.startswith("shape.")]
    if vary.shape_rad > 0:
        lines.append(f"{SHAPE}: every joint normal, 0 ± {vary.shape_rad:.4g} rad, at rest")
    fixed = {"noise_rad": "rad", "compute_ticks": "periods", "sensor_s": "s"}
    lines += [
        f"{name}: {(getattr(vary, name) or (getattr(spec, name),))[0]:.4g} {unit}, the same in every loop"
        for name, unit in fixed.items()
        if name not in given.names
    ]
    if vary.push_n is None:
        lines.append("no push from outside")
    else:
        where = {"push_n": "N", "push_at_s": "s", "push_for_s": "s"}
        lines += [f"{k}: {getattr(vary, k)[0]:.4g} {u} in every loop" for k, u in where.items() if k not in given.names]
    lines.append(f"{COURSE}: white, drawn anew for every draw" if noisy else "no noise")
    tied = [name for name in given.groups if " + " in name]
    lines += [f"correlated, one group in the sensitivity: {name}" for name in tied]
    if tied:
        lines.append(f"correlations below {LOOSE:g} between groups are taken as 0")
    if not any("." in x.name and not x.name.startswith("shape.") for x in given.entries):
        lines.append("the robot itself is taken as known: the model states no standard deviations")
    still = [e.id for e in model.effects if not any(x.name.startswith(f"effects.{e.id}.") for x in given.entries)]
    lines += [f"effect {name}: as in the model, in every loop" for name in still]
    if spec.vary is None:
        lines.append("the specification has no [vary]: the ranges of noise, delays and shape are defaults")
    return tuple(lines)
