"""One step of the solver made for this model: SDIRK2, bristles eliminated, kinks handled.

Written once for one robot as plain arithmetic over unrolled joints: a vector over the joints is a tuple of scalars,
so that under `vmap` every scalar becomes one array over the batch and a compiler sees nothing but elementwise work.

SDIRK2 with γ = 1 − 1/√2 is L-stable and of second order. In a stage with base (q*, v*, z*) and s = γh, q = q* + sv;
ż is linear in z, so z = (z* + sv)/(1 + sσ₀|v|/ρ(v)), and only v is left to solve for:

    F(v) = M(v − v*) − s[g(u₁ − u₂) + τ_ext − ∇U(q) − τ_f(v, z) − C] = 0,

with M, C and g frozen at the shape predicted for the middle of the step. Newton's matrix, M plus a diagonal plus a
constant, is factored as LDLᵀ. Friction has its kink at v = 0: a joint whose rate an iteration would carry through 0
stops there and takes the slope of the other side.

Derivatives come from the implicit function theorem at each stage, F_v dv = −dF, with the factors at the solution;
they do not run through the iterations.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ljjax.chain import inertia_constants
from ljjax.friction import stribeck
from ljjax.model import Friction, Model

GAMMA = 1 - 1 / math.sqrt(2)

Vector = tuple[Array, ...]
"""One scalar a joint."""


class Unrolled(NamedTuple):
    """q [rad], v [rad/s], z [rad], one scalar a joint."""

    q: Vector
    v: Vector
    z: Vector


class Drive(NamedTuple):
    """What drives one step: net tension u₁ − u₂ [N], α₂ [N·m/rad], φ [N·m], external torques [N·m] or None."""

    tension: Array
    alpha2: Array
    phi: Array
    torque: Vector | None = None


class Constants(NamedTuple):
    """A and J of the inertia in absolute angles [kg·m²], as scalars."""

    a: tuple[Vector, ...]
    j: Vector


def constants(model: Model) -> Constants:
    """What a step needs of the chain and no step changes."""
    a, j = inertia_constants(model.chain)
    n = model.n
    return Constants(tuple(tuple(a[i, k] for k in range(n)) for i in range(n)), tuple(j[i] for i in range(n)))


def unroll(x: Array) -> Vector:
    """(n,) → n scalars."""
    return tuple(x[i] for i in range(x.shape[0]))


def _running(x: Sequence[Array]) -> list[Array]:
    out = list(x)
    for i in range(1, len(out)):
        out[i] = out[i] + out[i - 1]
    return out


def inertia_and_coriolis(c: Constants, q: Sequence[Array], v: Sequence[Array]) -> tuple[tuple[Vector, ...], Vector]:
    """M(q), its lower rows, and C(q, v)v, from 2n sines and cosines: sums of A_ab cos(ψ_a − ψ_b) from the end on."""
    n = len(q)
    psi, omega = _running(q), _running(v)
    cos, sin = [jnp.cos(x) for x in psi], [jnp.sin(x) for x in psi]
    m: list[list[Any]] = [[None] * n for _ in range(n)]
    for i in range(n - 1, -1, -1):
        for k in range(i, -1, -1):
            x = c.a[i][k] * (cos[i] * cos[k] + sin[i] * sin[k])
            if i == k:
                x = x + c.j[i]
            if i + 1 < n:
                x = x + m[i + 1][k] - m[i + 1][k + 1]
            if k < i:
                x = x + m[i][k + 1]
            elif i + 1 < n:
                x = x + m[i + 1][i]
            m[i][k] = x
    square = [w * w for w in omega]
    force = []
    for i in range(n):
        along = sum(c.a[i][k] * cos[k] * square[k] for k in range(n))
        across = sum(c.a[i][k] * sin[k] * square[k] for k in range(n))
        force.append(sin[i] * along - cos[i] * across)
    return tuple(tuple(row[: i + 1]) for i, row in enumerate(m)), tuple(_running(force[::-1])[::-1])


def _factor(matrix: Sequence[Sequence[Array]]) -> tuple[list[list[Any]], list[Any]]:
    """LDLᵀ of a symmetric matrix given by its lower rows: L and 1/D."""
    n = len(matrix)
    low: list[list[Any]] = [[None] * n for _ in range(n)]
    d: list[Any] = [None] * n
    inverse: list[Any] = [None] * n
    for j in range(n):
        scaled = [low[j][s] * d[s] for s in range(j)]
        d[j] = matrix[j][j] - sum(low[j][s] * scaled[s] for s in range(j)) if j else matrix[j][j]
        inverse[j] = 1 / d[j]
        for i in range(j + 1, n):
            rest = matrix[i][j]
            for s in range(j):
                rest = rest - low[i][s] * scaled[s]
            low[i][j] = rest * inverse[j]
    return low, inverse


def _substitute(factors: tuple[list[list[Any]], list[Any]], right: Sequence[Array]) -> Vector:
    low, inverse = factors
    y = list(right)
    n = len(y)
    for i in range(n):
        for s in range(i):
            y[i] = y[i] - low[i][s] * y[s]
    y = [y[i] * inverse[i] for i in range(n)]
    for i in range(n - 1, -1, -1):
        for s in range(i + 1, n):
            y[i] = y[i] - low[s][i] * y[s]
    return tuple(y)


class _Stage(NamedTuple):
    """One stage's equation F(v) = 0: its base, what is frozen, the parameters, and s = γh."""

    base: Unrolled
    m: tuple[Vector, ...]
    load: Vector
    s: Array
    alpha1: Array
    alpha2: Array
    phi: Array
    friction: Friction


def _joint(stage: _Stage, i: int, v: Array, side: Array) -> tuple[Array, Array]:
    """Torque that depends on joint i alone (friction and elasticity) [N·m], and z [rad], at the rate v; `side` is the
    sign of v, or at 0 the side whose slope to take."""
    f = stage.friction
    start = stage.base.z[i]
    z = (start + stage.s * v) / (1 + stage.s * f.sigma0 * (side * v) / stribeck(f, v))
    friction = stage.phi * (f.sigma0 * z + f.sigma1 * (z - start) / stage.s + f.sigma2 * v)
    return friction + stage.alpha2 * (stage.base.q[i] + stage.s * v), z


def _residual(stage: _Stage, v: Sequence[Array], side: Sequence[Array]) -> list[Array]:
    n = len(v)
    change = [v[i] - stage.base.v[i] for i in range(n)]
    gravity = stage.alpha1 * jnp.sin(sum(stage.base.q) + stage.s * sum(v))
    out = []
    for i in range(n):
        inertia = sum((stage.m[i][k] if k <= i else stage.m[k][i]) * change[k] for k in range(n))
        out.append(inertia - stage.s * (stage.load[i] - gravity - _joint(stage, i, v[i], side[i])[0]))
    return out


def _matrix(stage: _Stage, v: Sequence[Array], side: Sequence[Array]) -> list[list[Array]]:
    """∂F/∂v, its lower rows."""
    n = len(v)
    common = stage.s * stage.s * stage.alpha1 * jnp.cos(sum(stage.base.q) + stage.s * sum(v))
    rows = []
    for i in range(n):
        _, slope = jax.jvp(lambda x, i=i: _joint(stage, i, x, side[i])[0], (v[i],), (jnp.ones_like(v[i]),))
        row = [stage.m[i][k] + common for k in range(i + 1)]
        row[i] = row[i] + stage.s * slope
        rows.append(row)
    return rows


def _newton(iterations: int, start: Vector, stage: _Stage) -> tuple[Vector, Vector]:
    v, side = list(start), [jnp.sign(x) for x in start]
    for _ in range(iterations):
        right = [-r for r in _residual(stage, v, side)]
        step = _substitute(_factor(_matrix(stage, v, side)), right)
        for i in range(len(v)):
            new = v[i] + step[i]
            crossed = side[i] * new < 0
            side[i] = jnp.where(crossed, -side[i], jnp.where(side[i] == 0, jnp.sign(step[i]), side[i]))
            v[i] = jnp.where(crossed, jnp.zeros_like(new), new)
    return tuple(v), tuple(side)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _solve(iterations: int, start: Vector, stage: _Stage) -> Vector:
    return _newton(iterations, start, stage)[0]


@_solve.defjvp
def _solve_jvp(iterations, primals, tangents):
    (start, stage), (_, moved) = primals, tangents
    v, side = _newton(iterations, start, stage)
    side = tuple(jnp.where(x == 0, s, jnp.sign(x)) for x, s in zip(v, side, strict=True))
    factors = _factor(_matrix(stage, v, side))
    _, change = jax.jvp(lambda given: _residual(given, v, side), (stage,), (moved,))
    return v, _substitute(factors, [-x for x in change])


def advance(model: Model, c: Constants, state: Unrolled, drive: Drive, h: Any, iterations: int) -> Unrolled:
    """The state a step h [s] later.

    Args:
        c: `constants(model)`.
        drive: mean inputs over the step.
        iterations: Newton iterations a stage; two simulate well, derivatives want three or more.
    """
    n = len(state.q)
    s = GAMMA * h * jnp.ones_like(drive.tension)
    still = tuple(jnp.zeros_like(x) for x in state.q)
    middle = tuple(state.q[i] + 0.5 * h * state.v[i] for i in range(n))
    m, coriolis = inertia_and_coriolis(c, still if model.constant_mass else middle, state.v)
    arm = model.chain.lever_arm_m if model.lever is None else model.lever(jnp.stack(middle))
    load = [arm * drive.tension] * n
    if not model.constant_mass:
        load = [load[i] - coriolis[i] for i in range(n)]
    if drive.torque is not None:
        load = [load[i] + drive.torque[i] for i in range(n)]

    def solve(base: Unrolled, start: Vector) -> Unrolled:
        stage = _Stage(base, m, tuple(load), s, model.gravity.alpha1, drive.alpha2, drive.phi, model.friction)
        v = _solve(iterations, start, stage)
        z = tuple(_joint(stage, i, v[i], jnp.sign(v[i]))[1] for i in range(n))
        return Unrolled(tuple(base.q[i] + s * v[i] for i in range(n)), v, z)

    first = solve(state, state.v)
    onward = (1 - GAMMA) / GAMMA
    base = Unrolled(
        *(tuple(x[i] + onward * (y[i] - x[i]) for i in range(n)) for x, y in zip(state, first, strict=True))
    )
    guess = [state.v[i] + (first.v[i] - state.v[i]) / GAMMA for i in range(n)]
    start = tuple(jnp.where(guess[i] * first.v[i] < 0, first.v[i], guess[i]) for i in range(n))
    return solve(base, start)
