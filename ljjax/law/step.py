"""One tick of the control law, as plain scalar arithmetic: on a rig, under JAX, and as the source of the C header.

The energy-shaping law with g the lever arm (model section 7),

    g τ_es = α₁ sin q_Σ − γ sin(q_Σ − nθ*) + α₂(u_P)θ*,    τ_da = −K_D g q̇_Σ,

is the net tension u₁ − u₂; the rate comes from a difference through a first-order filter. `integral` adds the torque I,

    İ = −k_I dead(sin(q_Σ − nθ*))/(1 + (v/v₀)²) − leak·I,    v = q̇_Σ/n,

which waits while the body moves, and is held where the tension cannot follow (slew, saturation); `observer` adds κφσ₀ẑ
beside it, from LuGre's own equation with the rate of the mean joint beyond a dead zone of v₀,

    ẑ˙ = v − σ₀|v|/ρ(v) ẑ,    |ẑ| ≤ μ_S/σ₀.

What is proven: without friction but viscous, without sampling and limits, `passivity` has q = θ*·1 as its equilibrium,
stable for γ > 0, K_D > 0, and the only one where nγ/α₂ < 4.603. With LuGre friction it stalls: every shape with |∂ᵢU_d|
≤ φμ_S is an equilibrium. Under `integral` any rest lies within the dead zone, at a limit, or (with a leak) where the
leak balances it; the bend with equal joints is stable for small steps while friction is viscous only if Routh's
condition holds (`ljjax.control.design` checks it). The observer's error ẑ − z shrinks as exp(−σ₀∫|v|/ρ dt) where the
rate is known, v₀ = 0 and friction is LuGre's. Not proven: that the loop with stiction, sampling and limits comes to
rest at all (with μ_S > μ_C and integral action it may hunt); this is what the simulated loop is for.
"""

from __future__ import annotations

from typing import Any

from ljjax.law.parts import Command, Law, Measured, Output, State

EPSILON_KPA = 1e-4
"""Width of the model's smoothing of √u_P at 0."""
LEAST_RATIO, MOST_RATIO = 1e-12, 1e3
"""Of |v|/v_s: added, so that its power has derivatives at rest; and where exp(−(|v|/v_s)^σ₃) is 0 long since."""
FARTHEST_RAD = 3.141592653589793
"""The largest segment angle that is taken for a measurement; a sensor that says more is cut to it."""


def root_of(ops: Any, vacuum: Any) -> Any:
    """w(u_P) = u_P/√(u_P + ε), 0 below 0."""
    u = ops.larger(vacuum, 0.0)
    return u / ops.sqrt(u + EPSILON_KPA)


def vacuum_of(ops: Any, root: Any) -> Any:
    """The vacuum with w(u_P) = `root`."""
    return 0.5 * root * (root + ops.sqrt(root * root + 4.0 * EPSILON_KPA))


def _between(ops: Any, x: Any, low: Any, high: Any) -> Any:
    return ops.larger(ops.smaller(x, high), low)


def _next(ops: Any, before: Any, change: Any, low: Any, high: Any) -> tuple[Any, Any]:
    """Between which values a number may be a tick later: low and high, or as far on the way there as it may change."""
    least, most = before - change, before + change
    return _between(ops, low, least, most), _between(ops, high, least, most)


def _dead(ops: Any, x: Any, zone: Any) -> Any:
    """x beyond ±zone, 0 within."""
    return x - _between(ops, x, -zone, zone)


def _place(ops: Any, share: Any, size: int) -> tuple[Any, Any]:
    """Where a share in [0, 1] of a table's width lies: the entry before it, and the way to the next."""
    place = _between(ops, share, 0.0, 1.0) * (size - 1.0)
    index = ops.smaller(ops.floor(place), size - 2.0)
    return index, place - index


def _look_up(ops: Any, table: Any, at: tuple[Any, Any]) -> Any:
    index, way = at
    before = ops.take(table, index)
    return before + way * (ops.take(table, index + 1.0) - before)


def start(law: Law, q_sum: Any, vacuum: Any, left: Any, right: Any) -> State:
    """The state in which a law takes over without a bump: the bend [rad] and vacuum [kPa] measured, and the tensions
    [N] that are applied."""
    zero = 0.0 * q_sum
    return State(q_sum, zero, zero, zero, left - right, 0.5 * (left + right), vacuum)


def step(ops: Any, law: Law, state: State, measured: Measured, command: Command) -> tuple[State, Output]:
    """The state and the output of the tick that begins with a measurement.

    Args:
        ops: the arithmetic: `ljjax.law.ops` for Python floats, `ljjax.control.jax_ops` for JAX.
        law, state: as from `ljjax.law.load` and `start`.
        measured, command: all numbers finite; commands beyond the limits are cut to them.

    Tensions and vacuum leave the state's, those applied last, no faster than their slew, wherever these are: what lies
    outside its limits comes in at the slew. A tension or a vacuum below 0 counts as 0.
    """
    gains, robot, limits, tables, t = law.gains, law.robot, law.limits, law.tables, law.period_s
    n, g = robot.segments, robot.lever_arm_m

    low, high = limits.stiffness_min_n_m, limits.stiffness_max_n_m
    wanted = _look_up(ops, tables.root, _place(ops, (command.stiffness - low) / (high - low), len(tables.root)))
    before = ops.larger(state.vacuum, 0.0)
    vacuum = _between(
        ops, vacuum_of(ops, wanted), *_next(ops, before, limits.vacuum_slew_kpa_s * t, 0.0, limits.vacuum_max_kpa)
    )

    share = root_of(ops, measured.vacuum) / root_of(ops, limits.vacuum_max_kpa)
    at = _place(ops, share, len(tables.alpha2))
    alpha2 = _look_up(ops, tables.alpha2, at)

    farthest = n * FARTHEST_RAD
    q_sum = _between(ops, measured.q_sum, -farthest, farthest)
    way = q_sum - _between(ops, state.q_sum, -farthest, farthest)
    rate = state.rate + t / (t + gains.filter_s) * (way / t - state.rate)
    theta = _between(ops, command.theta, -limits.theta_max_rad, limits.theta_max_rad)
    error = ops.sin(q_sum - n * theta)
    torque = robot.alpha1 * ops.sin(q_sum) - gains.gamma * error + alpha2 * theta - gains.damping * g * g * rate

    mean_rate = rate / n
    bristle = state.bristle
    if law.kind == "observer":
        v = _dead(ops, mean_rate, gains.still_rad_s)
        ratio = ops.smaller(ops.absolute(v) / robot.v_s, MOST_RATIO) + LEAST_RATIO
        rho = robot.mu_c + (robot.mu_s - robot.mu_c) * ops.exp(-ops.power(ratio, robot.sigma3))
        slip = t * robot.sigma0 * ops.absolute(v) / rho
        bend = robot.mu_s / robot.sigma0
        bristle = _between(ops, (bristle + t * v) / (1.0 + slip), -bend, bend)
        torque = torque + gains.compensation * robot.sigma0 * _look_up(ops, tables.phi, at) * bristle

    integral = state.integral
    if law.kind != "passivity":
        torque = torque + integral

    net_wanted = torque / g
    slew = limits.tension_slew_n_s * t
    reach = slew, limits.tension_min_n, limits.tension_max_n
    left_low, left_high = _next(ops, ops.larger(state.level + 0.5 * state.net, 0.0), *reach)
    right_low, right_high = _next(ops, ops.larger(state.level - 0.5 * state.net, 0.0), *reach)
    net = _between(ops, net_wanted, left_low - right_high, left_high - right_low)

    if law.kind != "passivity":
        # Anti-windup: growth that asks for more of what the tension cannot follow fades over one tick's slew.
        lacking = net_wanted - net
        moving = mean_rate / gains.still_rad_s
        growth = -gains.integral * t * _dead(ops, error, n * gains.dead_zone_rad) / (1.0 + moving * moving)
        free = ops.larger(1.0 - ops.absolute(lacking) / slew, 0.0)
        growth = ops.where(lacking * growth > 0.0, free * growth, growth)
        strongest = limits.tension_max_n - limits.tension_min_n
        integral = _between(ops, integral + growth - t * gains.leak_per_s * integral, -g * strongest, g * strongest)

    half = 0.5 * net
    least, most = ops.larger(left_low - half, right_low + half), ops.smaller(left_high - half, right_high + half)
    level = _between(ops, limits.co_contraction_n, least, most)
    return (
        State(q_sum, rate, integral, bristle, net, level, vacuum),
        Output(level + half, level - half, vacuum),
    )
