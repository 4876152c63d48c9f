"""The static form of a model with effects: what holds an angle at rest, and what a probe at the tip feels.

At rest q̇ = 0, lags have settled, memories of motion are empty, friction is averaged out. Then the mean joint's balance

    mean_i [load_i(u, q) − α₁ sin q_Σ − α₂,ᵢ qᵢ − torque_i(qᵢ)] = 0

gives the net tension u₁ − u₂ at an angle and a vacuum, and K = −∂[…]/∂q + σ₀ diag(φ) the probe's K_T = 1/(aᵀK⁻¹a), with
every effect's own hooks (`ljjax.effect`). An effect that needs motion leaves no trace here.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ljjax import batch, step
from ljjax.chain import lateral_jacobian
from ljjax.effect import Effect, Vector
from ljjax.fit.kernel import on_all_cores
from ljjax.fit.points import Points
from ljjax.model import Friction, Model, get, leaf, replace

LONG_S = 1e9
"""A step so long that every lag has settled."""
ITERATIONS, SETTLED_N = 20, 1e-12
TILE = 256
"""Operating points computed at once."""
SIZES = (0.1, 1e-3, 0.05, 1.0, 10.0, 3.0)
"""Typical α₁, c₁ … c₅, for steps of differences only."""
LEAST_SLOPE = 0.02
"""Where less than this share of the tension arrives (a deadband, a limit), Newton's step takes the whole arm."""


class Rest(NamedTuple):
    """What `Effect.torque` may ask of a stage, at rest."""

    time: Array
    alpha2: Vector
    bare: Array
    phi: Vector
    friction: Friction


class Balance(NamedTuple):
    """Torques that push each joint on at rest [N·m], and its friction scale [N·m]."""

    torque: Vector
    phi: Vector


def balance(model: Model, q: Vector, net: Array, vacuum: Array) -> Balance:
    """The torque balance of each joint at the shape q [rad] under u₁ − u₂ = `net` [N], without co-contraction."""
    zero = 0.0 * net
    still = tuple(zero for _ in q)
    drive = step.Drive(jnp.where(net > 0, net, zero), jnp.where(net < 0, -net, zero), vacuum)
    now = step._now(model, step.Unrolled(q, still, still), drive, LONG_S + zero)
    now, memory, alpha2, phi = step._inputs(model, now)
    now = now._replace(alpha2=alpha2, phi=phi)
    load = step._load(model, now, memory, drive)
    gravity = model.gravity.alpha1 * jnp.sin(sum(q))
    rest = Rest(zero, alpha2, model.elastic.c3, phi, model.friction)
    out = []
    for i, angle in enumerate(q):
        torque = load[i] - gravity - alpha2[i] * angle
        for effect, own in zip(model.effects, memory, strict=True):
            more = effect.torque(own, i, angle, zero, rest)
            torque = torque if more is None else torque - more
        out.append(torque)
    return Balance(tuple(out), phi)


def shape(model: Model, theta: Array) -> Vector:
    """The joints' angles [rad] where the mean angle is logged as θ [rad]."""
    q = (theta,) * model.n
    for effect in reversed(model.effects):
        q = effect.unsense(q)
    return q


def tension(model: Model, theta: Array, vacuum: Array) -> Array:
    """u₁ − u₂ [N] that holds the logged mean angle θ [rad] at the vacuum [kPa]."""
    q = shape(model, theta)
    arm = model.chain.lever_arm_m if model.lever is None else model.lever(jnp.stack(q))

    def mean(net: Array) -> Array:
        return jnp.mean(jnp.stack(balance(model, q, net, vacuum).torque))

    def newton(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        net, _, count = carry
        value, change = jax.jvp(mean, (net,), (jnp.ones_like(net),))
        move = value / jnp.where(change > LEAST_SLOPE * arm, change, arm)
        return net - move, jnp.abs(move), count + 1

    def unsettled(carry: tuple[Array, Array, Array]) -> Array:
        return (carry[1] > SETTLED_N) & (carry[2] < ITERATIONS)

    start = 0.0 * theta
    return jax.lax.while_loop(unsettled, newton, (start, start + jnp.inf, jnp.zeros_like(theta, int)))[0]


def tip_stiffness(model: Model, theta: Array, vacuum: Array, net: Array) -> Array:
    """K_T [N/m] at rest at the logged mean angle θ [rad] and the vacuum [kPa], under the tension `net` [N] that holds
    it, which the probe does not change."""
    q = jnp.stack(shape(model, theta))

    def torque(q: Array) -> tuple[Array, Array]:
        felt = balance(model, tuple(q[i] for i in range(model.n)), net, vacuum)
        return jnp.stack(felt.torque), jnp.stack(felt.phi)

    slope, phi = jax.jacfwd(torque, has_aux=True)(q)
    a = lateral_jacobian(model.chain, q)
    return 1 / (a @ jnp.linalg.solve(jnp.diag(model.friction.sigma0 * phi) - slope, a))


@batch.compiled(static=(1, 2), **batch.SOON)
def _observed(model: Model, names: tuple[str, ...], steady: bool, x: Array, theta: Array, vacuum: Array) -> Array:
    def one(x: Array, theta: Array, vacuum: Array) -> Array:
        changed = eqx.tree_at(lambda m: [leaf(m, n) for n in names], model, [x[i] for i in range(len(names))])
        net = tension(changed, theta, vacuum)
        return net if steady else tip_stiffness(changed, theta, vacuum, net)

    return jax.vmap(one)(x, theta, vacuum)


class Laws:
    """A robot with every candidate effect in it, as functions of one vector of parameters.

    Attributes:
        names: the parameters by path; `x0` (P,) their values in the given model, effects that it lacks at null.
        low, high: (P,) bounds; `scale` (P,) typical sizes.
    """

    BASE = ("gravity.alpha1", "elastic.c1", "elastic.c2", "elastic.c3", "jamming.c4", "jamming.c5")

    def __init__(self, model: Model, kinds: Sequence[type[Effect]]):
        known = {e.id: e for e in model.effects}
        effects = tuple(known.pop(kind.id, None) or kind() for kind in kinds) + tuple(known.values())
        self.model: Model = dataclasses.replace(model, effects=effects)
        self.kinds = {e.id: type(e) for e in effects}
        about = {f"effects.{e.id}.{name}": a for e in effects for name, a in e.fields().items()}
        self.about: dict[str, Any] = about
        self.names = (*self.BASE, *about)
        self.x0 = np.array([float(get(self.model, name)) for name in self.names])
        self.low = np.array([about[n]["low"] if n in about else -np.inf for n in self.names])
        self.high = np.array([about[n]["high"] if n in about else np.inf for n in self.names])
        size = {n: SIZES[i] for i, n in enumerate(self.BASE)}
        self.scale = np.array([about[n]["scale"] if n in about else size[n] for n in self.names])

    def index(self, names: Sequence[str]) -> np.ndarray:
        """Places of the named parameters."""
        return np.array([self.names.index(n) for n in names], int)

    def of(self, effect: str, part: Literal["size", "form"]) -> list[str]:
        """Paths of an effect's parameters that say how large it is, or what form it has: the first of these only, since
        a few points at rest do not show how sharp an edge is."""
        sizes = self.kinds[effect].sizes()
        names = sizes if part == "size" else [n for n in self.kinds[effect].fields() if n not in sizes][:1]
        return [f"effects.{effect}.{n}" for n in names]

    def values(self, x: np.ndarray, points: Points) -> np.ndarray:
        """(…, N) what robots with the parameters x (…, P) do at the points: net tension [N] or tip stiffness [N/m]."""
        flat = x.reshape(-1, len(self.names))
        count = len(flat) * len(points)
        theta, vacuum = (np.tile(v, len(flat)) for v in (points.theta, points.pressure_kpa))
        owner = np.repeat(np.arange(len(flat)), len(points))
        steady = points.kind == "steady"

        def tile(start: int) -> np.ndarray:
            index = np.minimum(np.arange(start, start + TILE), count - 1)  # the last tile is filled up
            of = owner[index]
            return np.asarray(_observed(self.model, self.names, steady, flat[of], theta[index], vacuum[index]))

        form = "observed", steady, jax.tree.structure(self.model), self.names
        out = np.concatenate(on_all_cores(tile, range(0, count, TILE), form))[:count]
        return out.reshape(*x.shape[:-1], len(points))

    def slopes(self, x: np.ndarray, points: Points, active: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(…, N) the same, and its derivatives (…, N, k) by the parameters `active`, as differences over a millionth of
        a parameter's typical size, within its bounds: they need no program of their own."""
        k, at = len(active), np.arange(len(active))
        step = 1e-6 * self.scale[active]
        step = np.where(x[..., active] + step <= self.high[active], step, -step)
        moved = np.repeat(x[..., None, :], 1 + k, axis=-2)
        moved[..., 1 + at, active] += step
        out = self.values(moved, points)
        rise = np.swapaxes(out[..., 1:, :] - out[..., :1, :], -1, -2)
        return out[..., 0, :], rise / step[..., None, :]

    def build(self, x: np.ndarray, effects: Sequence[str]) -> Model:
        """The model with the parameters x that holds these effects only."""
        full = replace(self.model, dict(zip(self.names, x, strict=True)))
        return dataclasses.replace(full, effects=tuple(e for e in full.effects if e.id in effects))
