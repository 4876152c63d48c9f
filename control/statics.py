"""What a law needs of a model at rest: α₂ and φ over the vacuum, the tip's stiffness, the bend with equal joints.

The closed loop's stiffness at z = 0 is K = γ 1_{n×n} + diag(α₂ + σ₀φ), and a probe at the tip feels K_T = 1/(aᵀK⁻¹a)
(model sections 2, 6). Everything is arithmetic under JAX.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ljjax import step
from ljjax.chain import lateral_jacobian, mass_matrix
from ljjax.control import jax_ops
from ljjax.law.step import root_of, vacuum_of
from ljjax.model import Model, replace

ENTRIES = 65
"""Entries of each of the law's tables."""
LEAST_RISE = 1e-6
"""Share by which a stiffness must rise from one entry to the next to be told from one that does not."""
LONG_S = 1e9
"""Long enough for lags and leaks to have settled."""


class Hardware(NamedTuple):
    """What the rig can do: tensions [N] and their rate [N/s], co-contraction [N], vacuum [kPa] and its rate [kPa/s],
    the loop's rate [Hz], and the largest segment angle to command [rad] (None: as far as the tensions reach).
    Floats; arrays to differentiate by."""

    tension_min_n: Any = 0.5
    tension_max_n: Any = 60.0
    co_contraction_n: Any = 2.0
    tension_slew_n_s: Any = 400.0
    vacuum_max_kpa: Any = 40.0
    vacuum_slew_kpa_s: Any = 50.0
    rate_hz: Any = 200.0
    theta_max_rad: Any = None


class Statics(NamedTuple):
    """A robot at rest at the vacuums of the tables, unbent, with the effects on α₂, φ and the vacuum.

    Attributes:
        vacuum: (V,) vacuums commanded [kPa], evenly spaced in w(u_P), held for long.
        alpha2, phi: (V, n) of each joint [N·m/rad, N·m].
        inertia: 1ᵀM(0)1 of the bend with all joints equal [kg·m²].
    """

    vacuum: Array
    alpha2: Array
    phi: Array
    inertia: Array

    @property
    def mean_alpha2(self) -> Array:
        """(V,) harmonic mean over the joints [N·m/rad]: one torque bends each by its own share, and these add up."""
        return 1 / jnp.mean(1 / self.alpha2, axis=1)


@eqx.filter_jit
def statics(model: Model, vacuum_max_kpa: Array, tension: Array) -> Statics:
    """`Statics` up to a vacuum [kPa], under `tension` [N] in both tendons."""

    def one(u_p: Array) -> tuple[Array, Array]:
        straight = (jnp.zeros_like(u_p),) * model.n
        alpha2, phi = step.settled(model, straight, step.Drive(tension, tension, u_p), LONG_S)
        return jnp.stack(alpha2), jnp.stack(phi)

    most = root_of(jax_ops, vacuum_max_kpa)
    vacuum = vacuum_of(jax_ops, jnp.linspace(0.0, 1.0, ENTRIES, dtype=most.dtype) * most)
    inertia = jnp.sum(mass_matrix(model.chain, jnp.zeros((model.n,), most.dtype)))
    return Statics(vacuum, *jax.vmap(one)(vacuum), inertia)


def tip_stiffness(model: Model, joint: Array, gamma: Any) -> Array:
    """(V,) K_T [N/m] for K = γ 1_{n×n} + diag(joint), joint (V, n) [N·m/rad]: Sherman and Morrison's formula."""
    a = lateral_jacobian(model.chain, jnp.zeros((model.n,), joint.dtype))
    give = 1 / joint
    lateral, common = jnp.sum(a[None] ** 2 * give, axis=1), jnp.sum(a[None] * give, axis=1)
    return 1 / (lateral - gamma * common**2 / (1 + gamma * jnp.sum(give, axis=1)))


def felt(robot: Model, level: Array, vacuum: Array, gamma: Any) -> Array:
    """K_T [N/m] of a robot, unbent, under `level` [N] in both tendons and a vacuum [kPa] held for long."""
    straight = (jnp.zeros_like(vacuum),) * robot.n
    alpha2, phi = step.settled(robot, straight, step.Drive(level, level, vacuum), LONG_S)
    joint = jnp.stack(alpha2) + robot.friction.sigma0 * jnp.stack(phi)
    return tip_stiffness(robot, joint[None], gamma)[0]


def falls(stiffness: Any) -> Any:
    """(V − 1,) whether the stiffness (V,) does not rise to the next vacuum."""
    return stiffness[1:] - stiffness[:-1] <= LEAST_RISE * stiffness[:-1]


def start_of_rise(stiffness: Array) -> Array:
    """The entry from which the stiffness (V,) rises up to the last: commands are found in that part."""
    return jnp.max(jnp.where(falls(stiffness), jnp.arange(1, len(stiffness)), 0))


def uncounted(model: Model, at_rest: Statics, vacuum_max_kpa: Array, tension: Array) -> list[str]:
    """The ids of a model's effects that change nothing in its statics, and so nothing in a law made from them: what
    loads the body or remembers, delays, sensors. Effects at the values at which they vanish are none.

    Args:
        at_rest: `statics(model, vacuum_max_kpa, tension)`.
    """
    out = []
    for effect in model.effects:
        about = effect.fields()
        sizes = [name for name in effect.sizes() if float(getattr(effect, name)) != about[name]["null"]]
        if not sizes:
            continue
        without = replace(model, {f"effects.{effect.id}.{name}": about[name]["null"] for name in sizes})
        other = statics(without, vacuum_max_kpa, tension)
        pairs = (at_rest.alpha2, other.alpha2), (at_rest.phi, other.phi)
        if all(np.array_equal(a, b) for a, b in pairs):
            out.append(effect.id)
    return out
