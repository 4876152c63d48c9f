"""From a robot's model to a control law: tables of the model's coefficients, gains to begin with, what can be reached.

A stiffness is commanded by the vacuum at which K_T has it. `build` is arithmetic under JAX and may be differentiated by
the model's parameters and the gains; `design` checks what it makes.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ljjax.control import jax_ops
from ljjax.control.refusals import UNIQUE, largest_angle, plausible, positive, rising, routh, sampled, unique
from ljjax.control.sampled import most_damping
from ljjax.control.statics import ENTRIES, Hardware, Statics, start_of_rise, statics, tip_stiffness, uncounted
from ljjax.errors import InputError
from ljjax.law import ops
from ljjax.law.file import possible
from ljjax.law.parts import KINDS, Gains, Kind, Law, Limits, Robot, Tables
from ljjax.law.step import root_of, vacuum_of
from ljjax.model import Model, check


def default_gains(model: Model, at_rest: Statics, rate_hz: Array) -> Gains:
    """Gains to begin with, for tuning to better: γ at half of what uniqueness allows; K_D that damps the equal bend
    critically while it slides (`design` takes less where sampling does not carry it); integral action with a corner
    at 4 rad/s; a dead zone of 0.02° of θ."""
    n, alpha2 = model.n, at_rest.mean_alpha2
    gamma = 0.5 * UNIQUE * jnp.min(alpha2) / n
    k = n * (n * gamma + alpha2)
    viscous = n * model.friction.sigma2 * jnp.mean(at_rest.phi, axis=1)
    damping = jnp.max(2 * jnp.sqrt(at_rest.inertia * k) - viscous) / (n * model.chain.lever_arm_m) ** 2
    given = {"leak_per_s": 0.0, "dead_zone_rad": math.radians(0.02), "compensation": 0.7, "still_rad_s": 0.02}
    return Gains(
        gamma=gamma,
        damping=jnp.maximum(damping, 0.0),
        filter_s=2.0 / rate_hz,
        integral=4.0 * jnp.min(k) / n**2,
        **{name: jnp.asarray(value, gamma.dtype) for name, value in given.items()},
    )


def build(model: Model, kind: Kind, gains: Gains, hardware: Hardware) -> Law:
    """The law of a model, unchecked; to be differentiated by the model's parameters, the gains and the hardware's
    numbers, all of them arrays and `theta_max_rad` given."""
    return assemble(model, statics(model, hardware.vacuum_max_kpa, hardware.co_contraction_n), kind, gains, hardware)


def assemble(model: Model, at_rest: Statics, kind: Kind, gains: Gains, hardware: Hardware) -> Law:
    """`build` where the statics are known, which no gain changes."""
    stiffness = tip_stiffness(model, at_rest.alpha2 + model.friction.sigma0 * at_rest.phi, gains.gamma)
    first = start_of_rise(stiffness)
    low, high, entry = stiffness[first], stiffness[-1], jnp.arange(ENTRIES)
    wanted = low + jnp.linspace(0.0, 1.0, ENTRIES, dtype=stiffness.dtype) * (high - low)
    share = ((entry + 1) / (first + 1)).astype(stiffness.dtype)
    ordered = jnp.where(entry < first, low * share, stiffness)  # what lies before is never wanted
    f, n = model.friction, jnp.asarray(model.n, stiffness.dtype)
    robot = Robot(n, model.chain.lever_arm_m, model.gravity.alpha1, f.sigma0, f.sigma3, f.mu_c, f.mu_s, f.v_s)
    kept = {name: x for name, x in hardware._asdict().items() if name != "rate_hz"}
    limits = Limits(**kept, stiffness_min_n_m=low, stiffness_max_n_m=high)
    root = jnp.interp(wanted, ordered, root_of(jax_ops, at_rest.vacuum))
    tables = Tables(at_rest.mean_alpha2, jnp.mean(at_rest.phi, axis=1), root)
    return Law(kind, 1.0 / hardware.rate_hz, gains, robot, limits, tables)


_built, _gains = eqx.filter_jit(build), eqx.filter_jit(default_gains)


class Design(NamedTuple):
    """A law of Python floats, and what it reaches (`reach`, as in law.json): stiffness, vacuum, angle, how near γ is to
    where the equilibrium is not the only one, and which of the model's effects are in none of this."""

    law: Law
    reach: dict[str, Any]


def design(
    model: Model,
    kind: Kind = "integral",
    *,
    gains: Mapping[str, float] | None = None,
    hardware: Hardware | None = None,
    where: str = "model",
) -> Design:
    """A law for a robot; of its effects those that act on α₂, φ or the vacuum.

    Args:
        kind: `"passivity"` (the paper's), `"integral"` or `"observer"`.
        gains: those to set, by name (`ljjax.law.Gains`); the others are `default_gains`.
        where: what to call the model in messages.

    Raises:
        InputError: an unknown law or gain, limits or gains out of range, α₂ ≤ 0 or φ ≤ 0 at a vacuum in use, a
            stiffness that does not rise with the vacuum, a desired potential with more than one critical point,
            integral action that the damping does not carry, damping that sampling does not carry, tensions that do
            not reach the angle asked for.
    """
    hardware = hardware or Hardware()
    if kind not in KINDS:
        raise InputError(f"law is {kind!r}; expected one of {', '.join(KINDS)}")
    plausible(hardware)
    if model.lever is not None:
        raise InputError(f"{where}: the model has a lever arm of its own over the shape; a law takes chain.lever_arm_m")
    check(model, (0.0, hardware.vacuum_max_kpa), where)
    asked = hardware.theta_max_rad
    dtype = model.jamming.c4.dtype
    limit = math.pi / 2 / model.n if asked is None else asked
    numbers = Hardware(*(jnp.asarray(x, dtype) for x in hardware._replace(theta_max_rad=limit)))
    at_rest = statics(model, numbers.vacuum_max_kpa, numbers.co_contraction_n)
    positive(at_rest, where)
    chosen = _gains(model, at_rest, numbers.rate_hz)._asdict()
    for name, value in (gains or {}).items():
        if name not in chosen:
            raise InputError(f"no gain {name!r}; the gains are {', '.join(chosen)}")
        if not math.isfinite(value):
            raise InputError(f"gains.{name} = {value}: must be a finite number")
        chosen[name] = jnp.asarray(value, chosen[name].dtype)
    reachable = largest_angle(model, at_rest, hardware, limit)
    if asked is not None and asked > reachable * (1 + 1e-9):
        raise InputError(
            f"{where}: theta_max_rad = {asked:.4g}: {hardware.tension_max_n:g} N hold no more than {reachable:.4g} rad "
            f"({math.degrees(reachable):.3g}°) at every vacuum up to {hardware.vacuum_max_kpa:g} kPa; raise "
            "tension_max_n, or ask for less"
        )
    theta_max = reachable if asked is None else asked
    numbers = numbers._replace(theta_max_rad=jnp.asarray(theta_max, dtype))
    law = plain(_built(model, kind, Gains(**chosen), numbers))
    rising(model, at_rest, law, where)
    possible(law, "law")
    ratio = unique(law)
    if "damping" not in (gains or {}):
        carried = 0.5 * most_damping(model, at_rest, law.gains, law.period_s)
        law = dataclasses.replace(law, gains=law.gains._replace(damping=min(law.gains.damping, carried)))
    routh(model, at_rest, law)
    sampled(model, at_rest, law)
    limits = law.limits
    return Design(
        law,
        {
            "stiffness_n_m": [limits.stiffness_min_n_m, limits.stiffness_max_n_m],
            "vacuum_kpa": [vacuum_of(ops, law.tables.root[0]), limits.vacuum_max_kpa],
            "theta_rad": [-theta_max, theta_max],
            "uniqueness": {"n_gamma_over_alpha2": ratio, "below": UNIQUE},
            "effects_not_counted": uncounted(model, at_rest, numbers.vacuum_max_kpa, numbers.co_contraction_n),
        },
    )


def plain(law: Law) -> Law:
    """The same law in Python floats, tables in tuples."""

    def floats(group: Any) -> list[float]:
        return [float(x) for x in group]

    tables = Tables(*(tuple(np.asarray(x, float).tolist()) for x in law.tables))
    return Law(
        law.kind,
        float(law.period_s),
        Gains(*floats(law.gains)),
        Robot(*floats(law.robot)),
        Limits(*floats(law.limits)),
        tables,
    )
