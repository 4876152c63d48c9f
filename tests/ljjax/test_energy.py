"""Energies: the smooth root, gradients, and a balance that closes with the pressure port (model sections 3 and 5)."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ljjax import energy
from ljjax.dynamics import State, pressure_power
from ljjax.inputs import Inputs
from ljjax.simulation import energy_balance

Q = jnp.array([0.3, -0.2, 0.5])


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("u_p", [-5.0, -1e-6, 0.0, 1e-12, 1e-4, 0.1, 1.0, 90.0])
def test_root_is_smooth(u_p, dtype):
    """√u_P where vacuum is vacuum, 0 below, and a finite slope everywhere in both modes."""
    x = jnp.asarray(u_p, dtype)
    value, slope = jax.value_and_grad(energy.root)(x)
    assert value.dtype == slope.dtype == dtype
    assert np.isfinite(slope) and slope >= 0
    forward = jax.jvp(energy.root, (x,), (jnp.ones_like(x),))[1]
    np.testing.assert_allclose(forward, slope, rtol=1e-6)
    if u_p <= 0:
        assert value == 0
    if u_p >= 0.1:
        np.testing.assert_allclose(value, np.sqrt(u_p), rtol=1e-3)
        np.testing.assert_allclose(slope, 0.5 / np.sqrt(u_p), rtol=1e-3)
    if u_p >= 1:
        np.testing.assert_allclose(value, np.sqrt(u_p), rtol=6e-5)


def test_root_is_monotone():
    x = jnp.concatenate([jnp.linspace(-1, 0, 5), jnp.geomspace(1e-9, 100, 400)])
    assert np.all(np.diff(energy.root(x)) >= 0)


def test_coefficients(robot):
    model = robot()
    for u_p in (0.0, 3.0, 29.7, 40.0):
        expected = -6e-4 * u_p**2 + 0.04 * u_p + 0.8
        np.testing.assert_allclose(energy.alpha2(model, jnp.asarray(u_p)), expected, rtol=1e-13)
        np.testing.assert_allclose(energy.phi(model, jnp.asarray(u_p)), 3 + 0.7 * np.sqrt(u_p), rtol=1e-4)


@pytest.mark.parametrize("u_p", [0.0, 25.0])
def test_potential_gradient(robot, u_p):
    gradient = jax.grad(partial(energy.potential, robot()))(Q, jnp.asarray(u_p))
    np.testing.assert_allclose(energy.potential_gradient(robot(), Q, jnp.asarray(u_p)), gradient, rtol=1e-13)


def test_pressure_power_is_the_energy_rate_of_the_vacuum(robot):
    """∂𝓗/∂u_P · u̇_P, by autodiff and by differences; α₂ and φ both have their part."""
    model, state = robot(), State(Q, 2 * Q, 0.02 * Q)
    u_p, rate, h = jnp.asarray(12.0), jnp.asarray(-30.0), 1e-3
    total = partial(energy.total, model, *state)
    expected = float(pressure_power(model, state, u_p, rate))
    np.testing.assert_allclose(expected, jax.grad(total)(u_p) * rate, rtol=1e-12)
    np.testing.assert_allclose(expected, (total(u_p + h) - total(u_p - h)) / (2 * h) * rate, rtol=1e-8)
    for change in ({"elastic.c1": 0.0, "elastic.c2": 0.0}, {"jamming.c5": 0.0}):
        part = float(pressure_power(robot(parameters=change), state, u_p, rate))
        assert abs(part) < 0.999 * abs(expected)


@pytest.mark.parametrize("hold", [True, False], ids=["held", "linear"])
@pytest.mark.parametrize("seed", [0, 1])
def test_the_balance_closes_only_with_the_pressure_port(random_robot, random_inputs, hold, seed):
    """Random tensions, vacuum and external torques: nothing is gained or lost unexplained, at any stamp."""
    inputs = random_inputs(seed, hold=hold, torque=True)
    start = State(Q, jnp.array([1.0, -2.0, 0.5]), jnp.zeros(3))
    balance = energy_balance(random_robot(seed), inputs, initial=start, at=np.linspace(0, 1, 21))
    size = float(jnp.abs(balance.stored).max())
    assert float(jnp.abs(balance.residual).max()) < 1e-6 * size
    for port in ("tendons", "pressure", "external", "lost"):  # each is needed, by far
        without = balance._replace(**{port: jnp.zeros_like(balance.t)})
        assert float(jnp.abs(without.residual).max()) > 1e-3 * size, port
    assert np.all(np.diff(balance.lost) >= -1e-9 * size)


def test_the_balance_closes_from_a_later_stamp(random_robot, random_inputs):
    """What came in before the first stamp asked for is not counted."""
    start = State(Q, jnp.array([1.0, -2.0, 0.5]), jnp.zeros(3))
    inputs = random_inputs(0, hold=False, torque=True)
    late = energy_balance(random_robot(0), inputs, initial=start, at=np.linspace(0.2, 1, 21))
    assert float(jnp.abs(late.residual).max()) < 1e-6 * float(jnp.abs(late.stored).max())
    assert all(float(x[0]) == 0 for x in late[1:])


def test_a_vacuum_step_does_its_work_at_once(robot):
    """A held robot: when the vacuum jumps, ½Δα₂|q|² + ½σ₀Δφ|z|² comes in, and nothing else."""
    model = robot()
    t = jnp.array([0.0, 0.13, 0.35, 0.6, 0.8, 1.0])  # as many stamps as above: compiled once
    inputs = Inputs(t, jnp.zeros((6, 2)), jnp.array([0.0, 0, 30, 30, 30, 30]), jnp.zeros((6, 3)))
    z = -energy.potential_gradient(model, Q / 10, jnp.asarray(0.0)) / energy.phi(model, jnp.asarray(0.0))
    start = State(Q / 10, jnp.zeros(3), z)
    balance = energy_balance(model, inputs, initial=start, at=np.linspace(0, 1, 21))
    jump = [float(energy.total(model, *start, jnp.asarray(u_p))) for u_p in (0.0, 30.0)]
    expected = np.where(np.asarray(balance.t) < 0.35, 0.0, jump[1] - jump[0])
    np.testing.assert_allclose(balance.pressure, expected, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(balance.residual, 0, atol=1e-10)
