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

The model's effects hook in as `ljjax.effect` says.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ljjax import energy
from ljjax.effect import Effect, Memory, Now, Vector, acting
from ljjax.friction import stribeck
from ljjax.model import Friction, Model

GAMMA = 1 - 1 / math.sqrt(2)
MOMENT_S = 1e-6
"""What effects are told is the step while a run begins, so that none divides by 0."""
LEAST = 0.02
"""The share of a stiffness or friction that effects leave at least."""
SELF_HEATING_K, SELF_HEATING_S = 10.0, 600.0
"""What a robot warms to while it runs, and how fast, as the effect `thermal_drift` has it where no temperature is
logged; between two runs it cools as fast."""


class Unrolled(NamedTuple):
    """q [rad], v [rad/s], z [rad], one scalar a joint; what each effect remembers; the joint angles as logged, where
    they are not q."""

    q: Vector
    v: Vector
    z: Vector
    memory: tuple[Memory, ...] = ()
    sensed: Vector | None = None


class Drive(NamedTuple):
    """What drives one step: mean tensions u₁, u₂ [N], vacuum [kPa], external torques [N·m] or None; where effects ask
    for them the temperature's rise [K] (without it that of a robot that warms while it runs, from its start at 0 s),
    the step's start [s], the slip of earlier runs [rad], and the slopes [N/s] of u₁, u₂ over a further delay, where
    they are delayed already."""

    left: Array
    right: Array
    vacuum: Array
    torque: Vector | None = None
    warm: Array | None = None
    t: Array | None = None
    worn: Array | None = None
    late: tuple[Array, Array] | None = None


class Constants(NamedTuple):
    """The inertia in absolute angles [kg·m²], as scalars: A_ab = `off`[max(a, b)] where a ≠ b, and `own` A_aa + J_a."""

    off: Vector
    own: Vector


def constants(model: Model) -> Constants:
    """What a step needs of the chain and no step changes: `ljjax.chain.inertia_constants` in closed form."""
    chain, n = model.chain, model.n
    link = 4 * chain.segment_mass_kg * chain.half_length_m**2
    thick = chain.segment_mass_kg * chain.radius_m**2 / 4
    off, own = [link / 8, link], [link / 24 + thick / 2, 5 / 6 * link + thick]  # from the last link on
    for _ in range(2, n):
        off.append(apart(off[-1] + link))
        own.append(apart(own[-1] + link))
    return Constants(tuple(off[:n][::-1]), tuple(own[:n][::-1]))


def unroll(x: Array) -> Vector:
    """(n,) → n scalars."""
    return tuple(x[i] for i in range(x.shape[0]))


apart = jax.lax.optimization_barrier
"""Keeps XLA from computing anew, inside each result that needs them, what these values take; `ljjax.batch` tells how
to compile so that it holds."""


class How(NamedTuple):
    """How to run a step: Newton iterations a stage (two simulate well, derivatives want three or more), and whether
    iterations and stages are loops, and sums taken term by term, which compiles several times faster and runs as fast
    where the batch is wide."""

    iterations: int = 3
    loops: bool = False


def _piece(how: How, x: Any) -> Any:
    """What several results need, in loops a piece of its own: the same for all joints, it is compiled once."""
    return apart(x) if how.loops else x


def _running(x: Sequence[Array]) -> list[Array]:
    out = list(x)
    for i in range(1, len(out)):
        out[i] = apart(out[i] + out[i - 1])
    return out


def directions(q: Sequence[Array]) -> tuple[Vector, Vector]:
    """Sine and cosine of the links' directions ψᵢ = q₁ + … + qᵢ."""
    psi = _running(q)
    sin, cos = apart(([jnp.sin(x) for x in psi], [jnp.cos(x) for x in psi]))
    return tuple(sin), tuple(cos)


def inertia_and_coriolis(
    how: How, c: Constants, sin: Vector, cos: Vector, v: Sequence[Array]
) -> tuple[tuple[Vector, ...], Vector]:
    """M(q), its lower rows, and C(q, v)v, from `directions(q)`: sums of A_ab cos(ψ_a − ψ_b) from the end on."""
    n = len(v)
    m: list[list[Any]] = [[None] * n for _ in range(n)]
    for i in range(n - 1, -1, -1):
        for k in range(i, -1, -1):
            x = c.own[i] if i == k else apart(c.off[i] * _piece(how, cos[i] * cos[k] + sin[i] * sin[k]))
            if i + 1 < n:
                x = x + m[i + 1][k] - m[i + 1][k + 1] + (m[i][k + 1] if k < i else m[i + 1][i])
            elif k < i:
                x = x + m[i][k + 1]
            m[i][k] = apart(x)
    square = [_piece(how, w * w) for w in _running(v)]
    along, across = (
        _weighted(how, c.off, [_piece(how, x * w) for x, w in zip(part, square, strict=True)]) for part in (cos, sin)
    )
    force = [apart(sin[i] * along[i] - cos[i] * across[i]) for i in range(n)]
    return tuple(tuple(row[: i + 1]) for i, row in enumerate(m)), tuple(_running(force[::-1])[::-1])


def _weighted(how: How, off: Vector, x: Sequence[Array]) -> list[Array]:
    """Σ_k A_ik x_k over k ≠ i."""
    before = _running(x[:-1])
    after = _running([_piece(how, w * y) for w, y in zip(off[:0:-1], x[:0:-1], strict=True)])[::-1]
    inside = [apart(off[i] * before[i - 1] + after[i]) for i in range(1, len(x) - 1)]
    return [*after[:1], *inside, _piece(how, off[-1] * before[-1])] if before else [jnp.zeros_like(y) for y in x]


def _less(how: How, x: Array, terms: Iterable[tuple[Array, Array]]) -> Array:
    """x − Σ ab. In loops term by term, the same piece over and over, which is compiled once."""
    for a, b in terms:
        x = apart(x - a * b) if how.loops else x - a * b
    return x


def _factor(how: How, matrix: Sequence[Sequence[Array]]) -> tuple[list[list[Any]], list[Any]]:
    """LDLᵀ of a symmetric matrix given by its lower rows: L and 1/D."""
    n = len(matrix)
    low: list[list[Any]] = [[None] * n for _ in range(n)]
    d: list[Any] = [None] * n
    inverse: list[Any] = [None] * n
    for j in range(n):
        scaled = apart([low[j][s] * d[s] for s in range(j)])
        d[j] = apart(_less(how, matrix[j][j], zip(low[j][:j], scaled, strict=True)))
        inverse[j] = apart(1 / d[j])
        for i in range(j + 1, n):
            low[i][j] = apart(_less(how, matrix[i][j], zip(low[i][:j], scaled, strict=True)) * inverse[j])
    return low, inverse


def _substitute(how: How, factors: tuple[list[list[Any]], list[Any]], right: Sequence[Array]) -> Vector:
    low, inverse = factors
    y = list(right)
    n = len(y)
    for i in range(n):
        y[i] = apart(_less(how, y[i], [(low[i][s], y[s]) for s in range(i)]))
    y = apart([y[i] * inverse[i] for i in range(n)])
    for i in range(n - 1, -1, -1):
        y[i] = apart(_less(how, y[i], [(low[s][i], y[s]) for s in range(i + 1, n)]))
    return tuple(y)


class _Stage(NamedTuple):
    """One stage's equation F(v) = 0: its base, what is frozen, the parameters, s = γh, and the time since the step's
    start [s]."""

    q: Vector
    v: Vector
    z: Vector
    m: tuple[Vector, ...]
    load: Vector
    s: Array
    time: Array
    alpha1: Array
    alpha2: Vector
    bare: Array
    phi: Vector
    friction: Friction
    effects: tuple[Effect, ...]
    memory: tuple[Memory, ...]
    slip: Vector | None


def _joint(how: How, stage: _Stage, i: int, v: Array, side: Array) -> tuple[Array, Array]:
    """Torque that depends on joint i alone (friction, elasticity, effects) [N·m], and z [rad], at the rate v; `side`
    is the sign of v, or at 0 the side whose slope to take."""
    f = stage.friction
    start = stage.z[i]
    q = stage.q[i] + stage.s * v
    bend = _piece(how, stribeck(f, v) if stage.slip is None else stage.slip[i] * stribeck(f, v))
    z = _piece(how, (start + stage.s * v) / (1 + stage.s * f.sigma0 * (side * v) / bend))
    torque = stage.phi[i] * (f.sigma0 * z + f.sigma1 * (z - start) / stage.s + f.sigma2 * v) + stage.alpha2[i] * q
    for k, resist in acting(stage.effects, "torque"):
        more = resist(stage.memory[k], i, q, v, stage)
        torque = torque if more is None else torque + more
    return torque, z


def _own(how: How, stage: _Stage, v: Sequence[Array], side: Sequence[Array]) -> tuple[list[Array], list[Array]]:
    """`_joint` of all joints: torques and deflections."""
    pairs = [_joint(how, stage, i, v[i], side[i]) for i in range(len(v))]
    return [torque for torque, _ in pairs], [z for _, z in pairs]


def _felt(how: How, stage: _Stage, v: Sequence[Array], side: Sequence[Array]) -> Any:
    """`_own`, and its slopes over each joint's own rate."""
    v, side = _piece(how, (list(v), list(side)))
    return apart(jax.jvp(lambda x: _own(how, stage, x, side), (v,), ([jnp.ones_like(x) for x in v],)))


def _residual(how: How, stage: _Stage, v: Sequence[Array], torque: Sequence[Array]) -> list[Array]:
    """F(v), from the joints' own torques."""
    n = len(v)
    change = apart([stage.v[i] - v[i] for i in range(n)])
    gravity = apart(stage.alpha1 * jnp.sin(sum(stage.q) + stage.s * sum(v)))
    out = []
    for i in range(n):
        force = stage.s * (gravity + torque[i] - stage.load[i])
        row = [stage.m[i][k] if k <= i else stage.m[k][i] for k in range(n)]
        out.append(_less(how, force, zip(row, change, strict=True)))
    return out


def _matrix(stage: _Stage, v: Sequence[Array], slope: Sequence[Array]) -> list[list[Array]]:
    """∂F/∂v, its lower rows, from the slopes of the joints' own torques."""
    common = apart(stage.s * stage.s * stage.alpha1 * jnp.cos(sum(stage.q) + stage.s * sum(v)))
    rows = []
    for i in range(len(v)):
        row = [stage.m[i][k] + common for k in range(i + 1)]
        row[i] = row[i] + stage.s * slope[i]
        rows.append(row)
    return rows


def _newton(how: How, start: Vector, stage: _Stage) -> tuple[Vector, Vector]:
    def iterate(carry: tuple[Vector, Vector]) -> tuple[Vector, Vector]:
        v, side = carry
        (torque, _), (slope, _) = _felt(how, stage, v, side)
        right, matrix = apart(([-r for r in _residual(how, stage, v, torque)], _matrix(stage, v, slope)))
        step = _substitute(how, _factor(how, matrix), right)
        new = [x + dx for x, dx in zip(v, step, strict=True)]
        crossed = [a * x < 0 for a, x in zip(side, new, strict=True)]
        turned = [
            jnp.where(c, -a, jnp.where(a == 0, jnp.sign(dx), a)) for c, a, dx in zip(crossed, side, step, strict=True)
        ]
        return apart(
            (tuple(jnp.where(c, jnp.zeros_like(x), x) for c, x in zip(crossed, new, strict=True)), tuple(turned))
        )

    carry = start, tuple(jnp.sign(x) for x in start)
    if how.loops:
        return jax.lax.fori_loop(0, how.iterations, lambda _, c: iterate(c), carry)
    for _ in range(how.iterations):
        carry = iterate(carry)
    return carry


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _solve(how: How, start: Vector, stage: _Stage) -> tuple[Vector, Vector]:
    """The rates that solve a stage, and the deflections there."""
    v, side = _newton(how, start, stage)
    return v, tuple(_own(how, stage, v, side)[1])


@_solve.defjvp
def _solve_jvp(how, primals, tangents):
    (start, stage), (_, moved) = primals, tangents
    v, side = _newton(how, start, stage)
    side = tuple(jnp.where(x == 0, s, jnp.sign(x)) for x, s in zip(v, side, strict=True))
    (torque, z), (slope, stretch) = _felt(how, stage, v, side)
    more, bent = apart(jax.jvp(lambda given: _own(how, given, v, side), (stage,), (moved,))[1])
    change = jax.jvp(lambda given: _residual(how, given, v, torque), (stage,), (moved,))[1]
    right = apart([-(x + stage.s * y) for x, y in zip(change, more, strict=True)])
    dv = _substitute(how, _factor(how, _matrix(stage, v, slope)), right)
    dz = tuple(x + jnp.where(w == 0, stage.s, a) * y for x, a, y, w in zip(bent, stretch, dv, v, strict=True))
    return (v, tuple(z)), (dv, dz)


def at_rest(model: Model, q: Vector, drive: Drive) -> Unrolled:
    """Rest at the shape q under a drive: z balances the forces, within |zᵢ| ≤ μ_S/σ₀."""
    return in_balance(model, q, tuple(jnp.zeros_like(x) for x in q), drive)


def in_balance(model: Model, q: Vector, v: Vector, drive: Drive) -> Unrolled:
    """The shape q moving steadily at v under a drive: z balances the forces, within |zᵢ| ≤ μ_S/σ₀."""
    n = len(q)
    now = _now(model, Unrolled(q, v, v), drive, jnp.full_like(drive.left, MOMENT_S))
    now, memory, alpha2, phi = _inputs(model, now)
    load = _load(model, now._replace(alpha2=alpha2, phi=phi), memory, drive)
    gravity = model.gravity.alpha1 * jnp.sin(sum(q))
    f = model.friction
    free = [((load[i] - gravity - alpha2[i] * q[i]) / phi[i] - f.sigma2 * v[i]) / f.sigma0 for i in range(n)]
    limit = f.mu_s / f.sigma0
    return begin(model, q, v, tuple(jnp.clip(z, -limit, limit) for z in free), drive, memory)


def unsensed(model: Model, q: Vector, v: Vector, drive: Drive) -> Vector:
    """The joint angles that are [rad], from those that are logged (q, at the rate v): effects of sensing undone."""
    now = _now(model, Unrolled(q, v, v), drive, jnp.full_like(drive.left, MOMENT_S))
    for _, unsense in reversed(acting(model.effects, "unsense")):
        q = unsense(q, now)
    return q


def begin(
    model: Model, q: Vector, v: Vector, z: Vector, drive: Drive, memory: tuple[Memory, ...] | None = None
) -> Unrolled:
    """A state from which to start, with what the effects remember, at rest unless it is told."""
    now = _now(model, Unrolled(q, v, z), drive, jnp.full_like(drive.left, MOMENT_S))
    if memory is None:
        memory = _inputs(model, now)[1]
    sensed, memory = _sense(model, q, now, memory, starts=True)
    return Unrolled(q, v, z, memory, sensed)


def _now(model: Model, state: Unrolled, drive: Drive, h: Array) -> Now:
    zero = jnp.zeros_like(drive.left)
    middle = tuple(q + 0.5 * h * v for q, v in zip(state.q, state.v, strict=True))
    u = drive.left, drive.right
    if drive.late is not None:
        for _, delay_s in acting(model.effects, "delay_s"):  # to first order, whose value the inputs hold already
            delay = delay_s()
            more = delay - jax.lax.stop_gradient(delay)
            u = u[0] + more * drive.late[0], u[1] + more * drive.late[1]
    warm = drive.warm
    if warm is None:
        warm = zero if drive.t is None else -SELF_HEATING_K * jnp.expm1(-drive.t / SELF_HEATING_S)
    return Now(
        model,
        zero if drive.t is None else drive.t,
        h,
        state.q,
        state.v,
        state.z,
        middle,
        u,
        drive.vacuum,
        warm,
        zero if drive.worn is None else drive.worn,
        *directions(middle),
    )


def _inputs(
    model: Model, now: Now, memory: tuple[Memory, ...] | None = None
) -> tuple[Now, tuple[Memory, ...], Vector, Vector]:
    """Tensions and vacuum as they reach the body, α₂ [N·m/rad] and φ [N·m] of each joint; without a memory as effects
    start, each with what reaches it."""
    n = len(now.q)
    kept = list(memory) if memory is not None else [()] * len(model.effects)
    start, actuate, evacuate = (dict(acting(model.effects, hook)) for hook in ("start", "actuate", "evacuate"))
    for k in range(len(kept)):
        if memory is None and k in start:
            kept[k] = start[k](now)
        if k in actuate:
            u, kept[k] = actuate[k](kept[k], now.u, now)
            now = now._replace(u=u)
        if k in evacuate:
            vacuum, kept[k] = evacuate[k](kept[k], now.vacuum, now)
            now = now._replace(vacuum=vacuum)
    alpha2, phi = (energy.alpha2(model, now.vacuum),) * n, (energy.phi(model, now.vacuum),) * n
    for k, change in acting(model.effects, "alpha2"):
        alpha2 = change(kept[k], alpha2, now)
    for k, change in acting(model.effects, "phi"):
        phi = change(kept[k], phi, now)
    return now, tuple(kept), alpha2, phi


def _possible(model: Model, vacuum: Array, alpha2: Vector, phi: Vector) -> tuple[Vector, Vector]:
    """α₂ and φ as far as effects leave a spring and a friction: `LEAST` of them."""
    if acting(model.effects, "alpha2"):
        alpha2 = tuple(jnp.maximum(x, LEAST * energy.alpha2(model, vacuum)) for x in alpha2)
    if acting(model.effects, "phi"):
        phi = tuple(jnp.maximum(x, LEAST * energy.phi(model, vacuum)) for x in phi)
    return alpha2, phi


def settled(model: Model, q: Vector, drive: Drive, after_s: float) -> tuple[Vector, Vector]:
    """α₂ [N·m/rad] and φ [N·m] of each joint, at rest at the shape q, once a drive has been held for so long."""
    still = tuple(jnp.zeros_like(x) for x in q)
    now = _now(model, Unrolled(q, still, still), drive, jnp.full_like(drive.left, after_s))
    return _inputs(model, now)[2:]


def _load(model: Model, now: Now, memory: tuple[Memory, ...], drive: Drive) -> Vector:
    """What pushes the joints and is frozen over the step [N·m]: tendons, external torques, effects."""
    n = len(now.q)
    arm = model.chain.lever_arm_m if model.lever is None else model.lever(jnp.stack(now.middle))
    load = (arm * (now.u[0] - now.u[1]),) * n
    if drive.torque is not None:
        load = tuple(load[i] + drive.torque[i] for i in range(n))
    for k, push in acting(model.effects, "load"):
        load = push(memory[k], load, now)
    return load


def _sense(
    model: Model, q: Vector, now: Now, memory: tuple[Memory, ...], starts: bool = False
) -> tuple[Vector | None, tuple[Memory, ...]]:
    sensors, start = acting(model.effects, "sense"), dict(acting(model.effects, "start"))
    if not sensors:
        return None, memory
    kept = list(memory)
    for k, sense in sensors:
        if starts and k in start:  # what it has seen so far is what those before it show
            kept[k] = start[k](now._replace(q=q))
        q, kept[k] = sense(kept[k], q, now)
    return q, tuple(kept)


def advance(model: Model, c: Constants, state: Unrolled, drive: Drive, h: Any, how: How) -> Unrolled:
    """The state a step h [s] later, from `constants(model)` and the mean inputs over the step."""
    n = len(state.q)
    h = h * jnp.ones_like(drive.left)
    s = GAMMA * h
    now, memory, alpha2, phi = _inputs(model, _now(model, state, drive, h), state.memory)
    alpha2, phi = _possible(model, now.vacuum, alpha2, phi)
    now = now._replace(alpha2=alpha2, phi=phi)
    still = tuple(jnp.zeros_like(x) for x in state.q), tuple(jnp.ones_like(x) for x in state.q)
    m, coriolis = inertia_and_coriolis(how, c, *(still if model.constant_mass else (now.sin, now.cos)), state.v)
    for k, load in acting(model.effects, "inertia"):
        m = load(memory[k], m, now)
    slip = None
    if sheets := acting(model.effects, "slip"):
        slip = (jnp.ones_like(alpha2[0]),) * n
        for k, change in sheets:
            slip = change(memory[k], slip, now)
    load = _load(model, now, memory, drive)
    if not model.constant_mass:
        load = tuple(load[i] - coriolis[i] for i in range(n))

    def solve(base: tuple[Vector, Vector, Vector], start: Vector, time: Array) -> tuple[Vector, Vector, Vector]:
        q, v, z = base
        stage = _Stage(
            *(q, v, z, m, load, s, time, model.gravity.alpha1, alpha2, model.elastic.c3, phi, model.friction),
            *(model.effects, memory, slip),
        )
        new, deflected = _solve(how, start, stage)
        return apart((tuple(q[i] + s * new[i] for i in range(n)), new, deflected))

    begun = (state.q, state.v, state.z)

    def onward(first: tuple[Vector, Vector, Vector]) -> tuple[tuple[Vector, Vector, Vector], Vector]:
        """Base and first guess of the second stage."""
        more = (1 - GAMMA) / GAMMA
        q, v, z = (
            tuple(a + more * (b - a) for a, b in zip(x, y, strict=True)) for x, y in zip(begun, first, strict=True)
        )
        guess = tuple(a + (b - a) / GAMMA for a, b in zip(state.v, first[1], strict=True))
        return apart(((q, v, z), tuple(jnp.where(g * b < 0, b, g) for g, b in zip(guess, first[1], strict=True))))

    if how.loops:

        def stage(carry, time):
            base, start, _ = carry
            found = solve(base, start, time)
            return (*onward(found), found), None

        (_, _, (q, v, z)), _ = jax.lax.scan(stage, (begun, state.v, begun), jnp.stack([s, h]))
    else:
        q, v, z = solve(*onward(solve(begun, state.v, s)), h)
    after = Unrolled(q, v, z)
    kept = list(memory)
    for k, remember in acting(model.effects, "remember"):
        kept[k] = remember(kept[k], now, after)
    sensed, memory = _sense(model, q, now, tuple(kept))
    return Unrolled(q, v, z, memory, sensed)
