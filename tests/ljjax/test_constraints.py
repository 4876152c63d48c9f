"""Admissible parameters by construction: whatever the free numbers, the robot is possible."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ljjax import energy
from ljjax.constraints import FREE, constrain, unconstrain
from ljjax.model import UNITS, check, get, passivity_margin

examples = settings(deadline=None, max_examples=200, derandomize=True)
free_numbers = st.lists(st.floats(-6.0, 6.0), min_size=len(FREE), max_size=len(FREE))
PRESSURES = [1.0, 40.0, 90.0]

constrain_jit = eqx.filter_jit(constrain)
unconstrain_jit = eqx.filter_jit(unconstrain)


@eqx.filter_jit
def alpha2_and_phi(model, u_p):
    return jax.vmap(lambda u: energy.alpha2(model, u))(u_p), jax.vmap(lambda u: energy.phi(model, u))(u_p)


@pytest.mark.parametrize("p", PRESSURES)
@examples
@given(numbers=free_numbers)
def test_any_numbers_make_an_admissible_robot(robot, p, numbers):
    free = {path: jnp.asarray(x) for path, x in zip(FREE, numbers, strict=True)}
    model = constrain_jit(free, robot(), p)
    check(model, [0.0, p])
    assert float(passivity_margin(model)) > 0
    alpha2, phi = alpha2_and_phi(model, jnp.linspace(0, p, 501))
    assert float(alpha2.min()) > 0
    assert float(phi.min()) > 0
    assert float(model.friction.mu_s) >= float(model.friction.mu_c) > 0


@pytest.mark.parametrize("p", PRESSURES)
@examples
@given(numbers=st.lists(st.floats(-3.0, 3.0), min_size=len(FREE), max_size=len(FREE)))
def test_free_numbers_come_back(robot, p, numbers):
    free = {path: jnp.asarray(x) for path, x in zip(FREE, numbers, strict=True)}
    back = unconstrain_jit(constrain_jit(free, robot(), p), p)
    assert set(back) == set(FREE)
    np.testing.assert_allclose([back[path] for path in FREE], numbers, rtol=1e-7, atol=1e-7)


def test_robots_come_back(robot, random_robot):
    for model in (robot(), random_robot(0), random_robot(1)):
        again = constrain(unconstrain(model, 40.0), model, 40.0)
        for path in UNITS:
            np.testing.assert_allclose(get(again, path), get(model, path), rtol=1e-9, atol=1e-15, err_msg=path)


def test_a_single_number_moves_its_own_table_only(robot):
    """What is not given comes from `like`, options and segments too."""
    like = robot(5, constant_mass=True)
    model = constrain({"gravity.alpha1": jnp.asarray(0.9)}, like, 40.0)
    assert (model.n, model.constant_mass) == (5, True)
    for path in UNITS:
        expected = 0.9 if path == "gravity.alpha1" else float(get(like, path))
        np.testing.assert_allclose(get(model, path), expected, rtol=1e-9, atol=1e-15, err_msg=path)


@pytest.mark.parametrize("scale", [0.0, 1.0, 3.0])
def test_derivatives_against_differences(robot, scale):
    rng = np.random.default_rng(1)
    like = robot()
    start = jnp.asarray([float(x) for x in unconstrain(like, 40.0).values()])
    x = start + jnp.asarray(scale * rng.normal(size=len(FREE)))

    @jax.jit
    def numbers(x):
        model = constrain({path: x[i] for i, path in enumerate(FREE)}, like, 40.0)
        return jnp.stack([get(model, path) for path in FREE])

    forward, reverse = jax.jacfwd(numbers)(x), jax.jacrev(numbers)(x)
    h = 1e-5
    differences = [(numbers(x + h * e) - numbers(x - h * e)) / (2 * h) for e in jnp.eye(len(FREE))]
    size = np.abs(numbers(x))[:, None] + 1e-9
    np.testing.assert_allclose(forward, reverse, rtol=1e-12)
    np.testing.assert_allclose(forward / size, np.stack(differences, axis=1) / size, atol=1e-7, rtol=1e-6)
    assert np.linalg.matrix_rank(np.asarray(forward / size)) == len(FREE)  # one-to-one, locally


@pytest.mark.parametrize(
    "start",
    [{"friction.sigma1": 0.0}, {"friction.mu_s": 0.025}, {"friction.sigma3": 1.0}],
    ids=["σ₁ = 0", "μ_S = μ_C", "σ₃ = 1"],
)
def test_a_start_on_a_bound_stays_there(robot, start):
    like = robot(parameters=start)
    model = constrain({"gravity.alpha1": jnp.asarray(0.5)}, like, 40.0)
    for path in start:
        np.testing.assert_allclose(get(model, path), start[path], atol=1e-15)
    check(model, [0.0, 40.0])
