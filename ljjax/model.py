"""The robot as a pytree: one module a table of `model.toml`, one leaf a parameter.

A parameter is named by its path, such as `"friction.mu_s"`, everywhere: files, results, the command line.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from ljjax._types import Joints, Scalar
from ljjax.effect import Effect
from ljjax.errors import InputError


def _to_array(value: Any) -> Any:
    """A Python number becomes an array of JAX's default precision; an array keeps its own."""
    return value if isinstance(value, jax.Array) else jnp.asarray(np.asarray(value), dtype=float)


def _parameter(unit: str) -> Any:
    return eqx.field(converter=_to_array, metadata={"unit": unit})


class Chain(eqx.Module):
    """The rigid-link chain (model section 2): n segments, each two half-links with a joint in the middle."""

    half_length_m: Scalar = _parameter("m")
    radius_m: Scalar = _parameter("m")
    lever_arm_m: Scalar = _parameter("m")
    segment_mass_kg: Scalar = _parameter("kg")
    segments: int = eqx.field(static=True, default=6)


class Gravity(eqx.Module):
    """U_g = α₁ (1 − cos q_Σ)."""

    alpha1: Scalar = _parameter("N·m")


class Elastic(eqx.Module):
    """α₂(u_P) = c₁u_P² + c₂u_P + c₃ [N·m/rad], u_P in kPa."""

    c1: Scalar = _parameter("N·m/rad/kPa²")
    c2: Scalar = _parameter("N·m/rad/kPa")
    c3: Scalar = _parameter("N·m/rad")


class Jamming(eqx.Module):
    """φ(u_P) = c₄ + c₅√u_P [N·m], in the gauge of `Friction.sigma0`."""

    c4: Scalar = _parameter("N·m")
    c5: Scalar = _parameter("N·m/√kPa")


class Friction(eqx.Module):
    """LuGre parameters (model section 4). The data fix them only up to a scale; the gauge is σ₀ = 1 rad⁻¹."""

    sigma1: Scalar = _parameter("s/rad")
    sigma2: Scalar = _parameter("s/rad")
    sigma3: Scalar = _parameter("1")
    mu_c: Scalar = _parameter("1")
    mu_s: Scalar = _parameter("1")
    v_s: Scalar = _parameter("rad/s")
    sigma0: Scalar = eqx.field(converter=_to_array, metadata={"unit": "1/rad"}, default=1.0)


class Model(eqx.Module):
    """A layer-jamming continuum robot: parameters in, equations in `ljjax.dynamics` and its neighbours.

    Attributes:
        chain, gravity, elastic, jamming, friction: the tables of `model.toml`.
        constant_mass: use M(0) for every shape (faster, no Coriolis forces). Off by default.
        lever: g(q) in G(q) = g(q)[1, −1] [m], from q (n,) to a scalar; None means g = `chain.lever_arm_m`.
        effects: unmodelled effects added to the model, in the order in which they hook in (`ljjax.effect`).
    """

    chain: Chain
    gravity: Gravity
    elastic: Elastic
    jamming: Jamming
    friction: Friction
    effects: tuple[Effect, ...] = ()
    constant_mass: bool = eqx.field(static=True, default=False)
    lever: Callable[[Joints], Scalar] | None = eqx.field(static=True, default=None)

    @property
    def n(self) -> int:
        return self.chain.segments


TABLES: Mapping[str, type[eqx.Module]] = {
    "chain": Chain,
    "gravity": Gravity,
    "elastic": Elastic,
    "jamming": Jamming,
    "friction": Friction,
}

UNITS: Mapping[str, str] = {
    f"{table}.{name}": f.metadata["unit"]
    for table, kind in TABLES.items()
    for name, f in kind.__dataclass_fields__.items()
    if "unit" in f.metadata
}
"""The unit of every parameter of the base model, by path."""


def units(model: Model) -> dict[str, str]:
    """The unit of every parameter of a model by path, those of its effects (`effects.<id>.<name>`) included; its keys
    are all the parameters there are."""
    return dict(_units(tuple(type(effect) for effect in model.effects)))


@cache
def _units(kinds: tuple[type[Effect], ...]) -> dict[str, str]:
    of_effects = {f"effects.{k.id}.{name}": about["unit"] for k in kinds for name, about in k.fields().items()}
    return {**UNITS, **of_effects}


def limits(model: Model) -> dict[str, tuple[float, float]]:
    """Lowest and highest value of the parameters of a model's effects, by path."""
    return {
        f"effects.{effect.id}.{name}": (about["low"], about["high"])
        for effect in model.effects
        for name, about in effect.fields().items()
    }


def get(model: Model, path: str) -> jax.Array:
    """The parameter at `path`: a scalar, or an array over the elements of a batched model. Raises InputError for a name
    that is none."""
    _known(model, path)
    return leaf(model, path)


def leaf(model: Model, path: str) -> Any:
    """What stands at a parameter's path, whatever it is (for `equinox.tree_at`)."""
    table, *between, name = path.split(".")
    if between:
        return next(getattr(effect, name) for effect in model.effects if effect.id == between[0])
    return getattr(getattr(model, table), name)


def replace(model: Model, values: Mapping[str, Any]) -> Model:
    """The model with the parameters named in `values` (path → value) replaced. Raises InputError for unknown paths."""
    for path in values:
        _known(model, path)
    if not values:
        return model
    paths = list(values)
    new = [jnp.asarray(values[p], dtype=get(model, p).dtype) for p in paths]
    return eqx.tree_at(lambda m: [leaf(m, p) for p in paths], model, new)


def in_gauge(model: Model) -> Model:
    """The same robot with σ₀ = 1 rad⁻¹: c₄, c₅ times σ₀; σ₁, σ₂, μ_C, μ_S divided by it (model section 1)."""
    s0 = model.friction.sigma0
    grown = {path: get(model, path) * s0 for path in ("jamming.c4", "jamming.c5")}
    shrunk = {f"friction.{name}": getattr(model.friction, name) / s0 for name in ("sigma1", "sigma2", "mu_c", "mu_s")}
    return replace(model, {**grown, **shrunk, "friction.sigma0": jnp.ones_like(s0)})


def astype(model: Model, dtype: Any) -> Model:
    """The model with every parameter in `dtype` (float32 or float64)."""
    return jax.tree.map(lambda leaf: leaf.astype(dtype), model)


def _known(model: Model, path: str) -> None:
    if path not in UNITS and path not in units(model):
        raise InputError(f"no parameter {path!r}; the parameters are {', '.join(units(model))}")


def check(model: Model, pressures_kpa: Iterable[float] = (0.0,), where: str = "model") -> None:
    """Refuse what is physically impossible: masses, lengths and v_s ≤ 0, σ < 0, σ₃ < 1, μ_S < μ_C, μ_C ≤ 0, and
    α₂ ≤ 0 or φ ≤ 0 anywhere between the lowest and the highest of `pressures_kpa` (model section 8: the polynomial
    must not be extrapolated). Values under a JAX transformation are not known and not checked.

    Raises:
        InputError: naming `where`, the parameter, its value and the reason.
    """
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(model)):
        return
    value = {path: float(leaf(model, path)) for path in UNITS}
    for effect in model.effects:
        value |= {f"effects.{effect.id}.{name}": float(getattr(effect, name)) for name in effect.fields()}

    def refuse(path: str, reason: str) -> None:
        raise InputError(f"{where}: {path} = {value[path]:g}: {reason}")

    for path, x in value.items():
        if not np.isfinite(x):
            refuse(path, "must be a finite number")
    for path in ("half_length_m", "radius_m", "lever_arm_m", "segment_mass_kg"):
        if value[f"chain.{path}"] <= 0:
            refuse(f"chain.{path}", "must be > 0")
    for path in ("sigma0", "mu_c", "v_s"):
        if value[f"friction.{path}"] <= 0:
            refuse(f"friction.{path}", "must be > 0")
    for path in ("sigma1", "sigma2"):
        if value[f"friction.{path}"] < 0:
            refuse(f"friction.{path}", "must be ≥ 0")
    if value["friction.sigma3"] < 1:
        refuse("friction.sigma3", "must be ≥ 1, or the Stribeck curve has an infinite slope at rest")
    if value["friction.mu_s"] < value["friction.mu_c"]:
        refuse("friction.mu_s", f"must be ≥ friction.mu_c = {value['friction.mu_c']:g}")

    for path, (least, most) in limits(model).items():
        if not least <= value[path] <= most:
            refuse(path, f"must lie between {least:g} and {most:g}")
    low, high = _range(pressures_kpa)
    c1, c2, c3 = (value[f"elastic.c{i}"] for i in (1, 2, 3))
    corners = [low, high] + ([-c2 / (2 * c1)] if c1 > 0 and low < -c2 / (2 * c1) < high else [])
    for u in corners:
        alpha2 = c1 * u * u + c2 * u + c3
        if alpha2 <= 0:
            raise InputError(
                f"{where}: elastic.c1, c2, c3 give α₂ = {alpha2:.3g} N·m/rad at {u:.3g} kPa, which must be > 0; "
                "stay within the pressures the polynomial was fitted on, or refit it"
            )
    for u in (low, high):
        phi = value["jamming.c4"] + value["jamming.c5"] * np.sqrt(max(u, 0.0))
        if phi <= 0:
            raise InputError(f"{where}: jamming.c4, c5 give φ = {phi:.3g} N·m at {u:.3g} kPa, which must be > 0")


def _range(pressures_kpa: Iterable[float]) -> tuple[float, float]:
    p = np.asarray(list(pressures_kpa), dtype=float)
    return min(0.0, float(p.min())), max(0.0, float(p.max()))


def passivity_margin(model: Model) -> Scalar:
    """σ₂ − σ₁(μ_S − μ_C)/μ_C [s/rad]; v ↦ τ_f is passive on the invariant set where this is > 0 (model section 4)."""
    f = model.friction
    return f.sigma2 - f.sigma1 * (f.mu_s - f.mu_c) / f.mu_c
