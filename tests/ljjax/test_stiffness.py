"""Statics: stiffness matrices, tip stiffness, shape locking, tension at rest (model sections 2, 6 and 7)."""

from __future__ import annotations

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ljjax import energy
from ljjax.chain import constant_curvature, tip_pose
from ljjax.dynamics import State, rhs, tendon_torque
from ljjax.friction import breakaway
from ljjax.inputs import Inputs
from ljjax.simulation import simulate
from ljjax.stiffness import (
    closed_loop_stiffness,
    lock,
    open_loop_stiffness,
    probe_stiffness,
    steady_tension,
    transverse_stiffness,
)

U_P = jnp.asarray(25.0)
NONE = jnp.zeros(2)


def force(model, q, z, u, u_p):
    """What accelerates the joints at rest, M v̇ [N·m]."""
    state = State(q, jnp.zeros_like(q), z)
    return energy.inertia(model, q) @ rhs(model, state, u, u_p).v


@eqx.filter_jit
def stiffness_by_differentiation(model, at, law):
    """−d/dq of the torque for a displacement from rest, over which the bristles move along: dz = dq from z = 0."""
    return -jax.jacfwd(lambda d: force(model, at + d, d, law(at + d), U_P))(jnp.zeros_like(at))


@pytest.mark.parametrize("n", [1, 3])
@pytest.mark.parametrize("sigma0", [1.0, 2.5])
def test_open_loop_stiffness(robot, n, sigma0):
    model = robot(n, {"friction.sigma0": sigma0})
    expected = stiffness_by_differentiation(model, jnp.zeros(n), lambda q: NONE)
    np.testing.assert_allclose(open_loop_stiffness(model, U_P), expected, rtol=1e-9)


@pytest.mark.parametrize("theta", [0.0, 0.3])
@pytest.mark.parametrize("gamma", [0.1, 2.0])
def test_closed_loop_stiffness(robot, gamma, theta):
    """τ_es of model section 7, at its goal q* = θ*: K ends with γ, not with α₁."""
    model, n = robot(), 3
    alpha1, alpha2 = model.gravity.alpha1, energy.alpha2(model, U_P)

    def law(q):
        torque = alpha1 * jnp.sin(jnp.sum(q)) - gamma * jnp.sin(jnp.sum(q) - n * theta) + alpha2 * theta
        return jnp.stack([torque / model.chain.lever_arm_m, jnp.zeros(())])

    goal = jnp.full(n, theta)
    np.testing.assert_allclose(force(model, goal, jnp.zeros(n), law(goal), U_P), 0, atol=1e-12)
    expected = stiffness_by_differentiation(model, goal, law)
    np.testing.assert_allclose(closed_loop_stiffness(model, U_P, jnp.asarray(gamma)), expected, rtol=1e-9)


def test_tip_stiffness_of_six_equal_joints(robot):
    """K_T = 7.9286 k for K = kI, n = 6, l = 21 mm (model section 2)."""
    model = robot(6)
    for k in (1.0, 14.0):
        assert float(transverse_stiffness(model, k * jnp.eye(6))) == pytest.approx(7.9286 * k, rel=1e-5)


@pytest.mark.parametrize("q", [np.zeros(3), np.array([0.2, -0.5, 0.8])])
def test_tip_stiffness_is_force_over_deflection(robot, q):
    """A small lateral force f at the tip: joints turn by K⁻¹Jᵀf, and the tip goes x = f/K_T aside."""
    model, q = robot(), jnp.asarray(q)
    k = open_loop_stiffness(model, U_P)
    pose = partial(tip_pose, model.chain)
    small = 1e-4
    turn = jnp.linalg.solve(k, small * jax.grad(lambda q: pose(q)[0])(q))
    aside = (pose(q + turn)[0] - pose(q - turn)[0]) / 2
    np.testing.assert_allclose(transverse_stiffness(model, k, q), small / aside, rtol=1e-6)


def test_probe_stiffness_grows_with_the_vacuum(robot):
    model = robot(6)
    values = [float(probe_stiffness(model, jnp.asarray(u_p))) for u_p in (0.0, 10.0, 20.0, 30.0)]
    assert np.all(np.diff(values) > 0)
    assert values[0] == float(transverse_stiffness(model, open_loop_stiffness(model, jnp.asarray(0.0))))


@pytest.mark.parametrize("seed", range(4))
def test_a_locked_shape_is_an_equilibrium(random_robot, seed):
    model = random_robot(seed)
    q = jnp.asarray(np.random.default_rng(seed).uniform(-0.5, 0.5, 3))
    state, holds = lock(model, q, U_P)
    rate = rhs(model, state, NONE, U_P)
    scale = float(jnp.abs(force(model, q, jnp.zeros(3), NONE, U_P)).max())
    np.testing.assert_allclose(energy.inertia(model, q) @ rate.v, 0, atol=1e-13 * scale)
    assert not np.any(rate.q)
    assert not np.any(rate.z)
    assert bool(holds) == bool(jnp.all(jnp.abs(state.z) <= breakaway(model)))


def test_locks_hold_up_to_breakaway(robot):
    """The largest equal angle that holds has |∇U| = φμ_S at a joint, whatever σ₀."""
    for sigma0 in (1.0, 2.0):
        model = robot(parameters={"friction.sigma0": sigma0, "gravity.alpha1": 0.0})
        limit = energy.phi(model, U_P) * model.friction.mu_s / energy.alpha2(model, U_P)
        for share, expected in ((0.99, True), (1.01, False), (-0.99, True), (-1.01, False)):
            assert bool(lock(model, constant_curvature(share * limit, 3), U_P).holds) == expected


LOCKING = {
    "gravity.alpha1": 0.1,
    "jamming.c4": 5.0,
    "jamming.c5": 3.0,
}
STAMPS = jnp.array([0.0, 0.5, 1.0, 1.2, 1.5, 3.0])


def bend_evacuate_release(model, u_p) -> State:
    """The states bent, locked, and 1.8 s after the tendons are let go."""
    tendons = jnp.zeros((6, 2)).at[:3, 0].set(20.0)
    pressure = jnp.array([0.0, u_p, u_p, u_p, u_p, u_p])
    return simulate(model, Inputs(STAMPS, tendons, pressure), initial=State(*(jnp.zeros(3),) * 3)).state


def test_vacuum_locks_the_shape(robot):
    """Bend, apply vacuum, release: the shape holds, and the displacement shrinks with the vacuum (model section 6)."""
    model = robot(parameters=LOCKING)
    displacements = []
    for u_p in (10.0, 20.0, 40.0):
        q, v, z = bend_evacuate_release(model, u_p)
        assert float(q[2].mean()) > 0.15  # bent, when the tendons are let go
        displacements.append(float((q[2] - q[-1]).mean()))
        locked = lock(model, q[-1], jnp.asarray(u_p))
        assert bool(locked.holds)
        np.testing.assert_allclose(z[-1], locked.state.z, rtol=1e-2)
        np.testing.assert_allclose(v[-1], 0, atol=1e-3)
    assert all(0 < d < 0.15 * 0.3 for d in displacements)
    assert displacements[0] > 1.2 * displacements[1] > 1.2**2 * displacements[2]


def test_too_little_stiction_slips(robot):
    model = robot(parameters={**LOCKING, "friction.mu_c": 0.002, "friction.mu_s": 0.003})
    q, _, _ = bend_evacuate_release(model, 40.0)
    assert float(jnp.abs(q[-1]).max()) < 0.3 * float(jnp.abs(q[2]).max())


@pytest.mark.parametrize("theta", [0.15, -0.1])
def test_tension_at_rest_is_in_the_middle_of_the_friction_band(robot, theta):
    """The steady tension is reached within ±φμ_S/g, whether the tension grew or fell; the two ends differ."""
    model, u_p = robot(parameters=LOCKING), jnp.asarray(5.0)
    tension = float(steady_tension(model, jnp.asarray(theta), u_p))
    band = float(energy.phi(model, u_p) * model.friction.mu_s / model.chain.lever_arm_m)
    ends = []
    for first in (0.0, 2.5):  # from below, and from above
        pull = np.maximum(0.0, np.outer([first, first, 1.0, 1.0, 1.0, 1.0], [tension, -tension]))
        inputs = Inputs(STAMPS, jnp.asarray(pull), jnp.full(6, u_p))
        run = simulate(model, inputs, initial=State(*(jnp.zeros(3),) * 3))
        np.testing.assert_allclose(run.state.v[-1], 0, atol=2e-3)
        ends.append(float(run.theta[-1]))
        needed = float(steady_tension(model, run.theta[-1], u_p))
        assert abs(needed - tension) <= 1.02 * band
    assert abs(ends[1]) > 1.2 * abs(ends[0])


def test_steady_tension_balances(robot):
    model = robot(6, lever=lambda q: 0.02 * jnp.cos(q[0]))
    q = constant_curvature(jnp.asarray(0.3), 6)
    u = jnp.stack([steady_tension(model, jnp.asarray(0.3), U_P), jnp.zeros(())])
    np.testing.assert_allclose(tendon_torque(model, q, u), energy.potential_gradient(model, q, U_P), rtol=1e-13)


def test_statics_batch_and_differentiate(robot):
    """vmap over vacuum and angle; d(probe stiffness)/dc₄ against a difference."""
    model = robot(6)
    batch = jax.vmap(partial(steady_tension, model), in_axes=(0, None))(jnp.linspace(-0.3, 0.3, 5), U_P)
    np.testing.assert_allclose(batch, -batch[::-1], rtol=1e-12, atol=1e-12)

    def by_c4(c4):
        return probe_stiffness(eqx.tree_at(lambda m: m.jamming.c4, model, c4), U_P)

    slope = jax.grad(by_c4)(model.jamming.c4)
    difference = (by_c4(model.jamming.c4 + 1e-4) - by_c4(model.jamming.c4 - 1e-4)) / 2e-4
    np.testing.assert_allclose(slope, difference, rtol=1e-7)
