"""LuGre friction: limits, invariance, dissipation, the scale that cannot be seen (model section 4)."""

from __future__ import annotations

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ljjax import friction as lugre
from ljjax.model import Friction, passivity_margin

RATES = np.concatenate([[0.0], np.geomspace(1e-9, 1e3, 25), -np.geomspace(1e-9, 1e3, 25)])
PHI = 4.0

seeds = st.integers(0, 2**32 - 1)
reals = st.floats(-1.0, 1.0)
rates = st.builds(lambda sign, power: sign * 10.0**power, st.sampled_from([-1.0, 0.0, 1.0]), st.floats(-8, 3))
examples = settings(deadline=None, max_examples=200, derandomize=True)


@eqx.filter_jit
def evaluate(friction: Friction, v, z, phi):
    """ρ, ż, τ_f and the dissipation of each joint."""
    one = jax.vmap(lambda v, z: lugre.dissipation(friction, v[None], z[None], phi))
    return (
        lugre.stribeck(friction, v),
        lugre.bristle_rate(friction, v, z),
        lugre.friction_torque(friction, v, z, phi),
        one(v, z),
    )


def numpy_rho(f: Friction, v: np.ndarray) -> np.ndarray:
    return float(f.mu_c) + (float(f.mu_s) - float(f.mu_c)) * np.exp(-(np.abs(v / float(f.v_s)) ** float(f.sigma3)))


@pytest.mark.parametrize("sigma3", [1.0, 1.6, 2.0, 5.0])
def test_stribeck_curve(robot, sigma3):
    f = robot(parameters={"friction.sigma3": sigma3}).friction
    rho = lugre.stribeck(f, jnp.asarray(RATES))
    np.testing.assert_allclose(rho, numpy_rho(f, RATES), rtol=1e-13)
    assert float(lugre.stribeck(f, jnp.zeros(1))[0]) == float(f.mu_s)
    assert float(lugre.stribeck(f, jnp.full(1, 1e6))[0]) == float(f.mu_c)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("sigma3", [1.0, 1.6, 3.0, 20.0])
def test_stribeck_slopes_are_finite_everywhere(robot, sigma3, dtype):
    f = jax.tree.map(lambda x: x.astype(dtype), robot(parameters={"friction.sigma3": sigma3}).friction)
    v = jnp.asarray(RATES, dtype)
    for mode in (jax.jacfwd, jax.jacrev):
        by_parameter, by_rate = jax.jit(mode(lugre.stribeck, argnums=(0, 1)))(f, v)
        for leaf in jax.tree.leaves((by_parameter, by_rate)):
            assert leaf.dtype == dtype
            assert np.isfinite(leaf).all()


def test_steady_sliding(robot):
    """Where ż = 0, τ_f = φ[ρ(v) sign v + σ₂v]."""
    f, v = robot().friction, jnp.asarray(RATES[1:])
    z = lugre.stribeck(f, v) * jnp.sign(v) / f.sigma0
    _, rate, torque, _ = evaluate(f, v, z, jnp.asarray(PHI))
    np.testing.assert_allclose(np.asarray(rate) / np.asarray(v), 0, atol=1e-14)
    expected = PHI * (numpy_rho(f, RATES[1:]) * np.sign(v) + float(f.sigma2) * np.asarray(v))
    np.testing.assert_allclose(torque, expected, rtol=1e-12)
    np.testing.assert_allclose(lugre.sliding_torque(f, v, jnp.asarray(PHI)), expected, rtol=1e-12)


@examples
@given(seed=seeds, v=rates, share=reals)
def test_bristles_stay_bounded_and_dissipate(random_robot, seed, v, share):
    """On |z| = μ_S/σ₀ the rate ż points inwards; inside, friction never feeds energy in."""
    model = random_robot(seed)
    f = model.friction
    limit = float(lugre.breakaway(model))
    z = np.array([limit, -limit, share * limit])
    rho, rate, _, loss = (np.asarray(x) for x in evaluate(f, jnp.full(3, v), jnp.asarray(z), jnp.asarray(PHI)))
    slip = float(f.sigma0) * abs(v) / rho * np.abs(z)
    assert np.all((z * rate)[:2] <= 1e-14 * limit * slip[:2])
    size = PHI * (float(f.sigma0) * slip * np.abs(z) + float(f.sigma1 + f.sigma2) * v**2)
    assert np.all(loss >= -1e-13 * size)
    assert float(passivity_margin(model)) > 0


def test_bristles_stay_bounded_in_time(random_robot):
    """A bristle dragged through random rates for 2 s nears ±μ_S/σ₀ and never passes it (RK4, 0.1 ms)."""
    rng = np.random.default_rng(3)
    model = random_robot(5, n=6)
    amplitude, frequency, lag = (jnp.asarray(rng.uniform(0.01, top, (6, 4))) for top in (0.3, 20, 6))
    h = 1e-4

    def drag(t):
        return jnp.sum(amplitude * jnp.sin(frequency * t + lag), axis=1)

    def step(z, t):
        rate = partial(lugre.bristle_rate, model.friction)
        k1 = rate(drag(t), z)
        k2 = rate(drag(t + h / 2), z + h / 2 * k1)
        k3 = rate(drag(t + h / 2), z + h / 2 * k2)
        k4 = rate(drag(t + h), z + h * k3)
        z = z + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return z, z

    _, z = jax.jit(lambda z: jax.lax.scan(step, z, h * jnp.arange(20_000, dtype=float)))(jnp.zeros(6))
    share = np.abs(z) / float(lugre.breakaway(model))
    assert share.max() <= 1 + 1e-9
    assert share.max() > 0.8


@pytest.mark.parametrize(
    ("change", "passive"),
    [({}, True), ({"friction.sigma1": 2.0, "friction.sigma2": 0.0, "friction.mu_s": 0.05}, False)],
)
def test_dissipation_tells_passive_from_active(robot, change, passive):
    """The same grid of states shows friction feeding energy in where σ₂ < σ₁(μ_S − μ_C)/μ_C by far."""
    model = robot(parameters=change)
    v, share = np.meshgrid(RATES, np.linspace(-1, 1, 21))
    z = share * float(lugre.breakaway(model))
    *_, loss = evaluate(model.friction, jnp.asarray(v.ravel()), jnp.asarray(z.ravel()), jnp.asarray(PHI))
    assert (float(passivity_margin(model)) > 0) == passive
    assert (np.asarray(loss).min() >= 0) == passive


@pytest.mark.parametrize("order", ["rates", "random"])
def test_dissipation_is_what_friction_takes_and_does_not_store(robot, order):
    """v·τ_f − dH_z/dt, from the torque and the bristle energy's own derivative."""
    f = robot(parameters={"friction.sigma0": 1.7}).friction
    rng = np.random.default_rng(0)
    v = jnp.asarray(RATES[::8] if order == "rates" else rng.normal(size=7))
    z = jnp.asarray(rng.uniform(-0.03, 0.03, v.shape))
    phi = jnp.asarray(PHI)
    _, rate, torque, _ = evaluate(f, v, z, phi)
    _, stored = jax.jvp(lambda z: 0.5 * f.sigma0 * phi * jnp.sum(z**2), (z,), (rate,))
    np.testing.assert_allclose(lugre.dissipation(f, v, z, phi), v @ torque - stored, rtol=1e-10)


@examples
@given(k=st.floats(1e-3, 1e3), seed=seeds, v=rates, share=reals)
def test_one_scale_cannot_be_seen(random_robot, k, seed, v, share):
    """τ_f and ż are unchanged by φ → kφ, (σ₀, σ₁, σ₂, μ_C, μ_S) → (·)/k."""
    model = random_robot(seed)
    f = model.friction
    scaled = eqx.tree_at(lambda f: (f.sigma0, f.sigma1, f.sigma2, f.mu_c, f.mu_s), f, replace_fn=lambda x: x / k)
    v3, z3 = jnp.full(3, v), jnp.full(3, share) * lugre.breakaway(model)
    _, rate, torque, loss = evaluate(f, v3, z3, jnp.asarray(PHI))
    _, rate_k, torque_k, loss_k = evaluate(scaled, v3, z3, jnp.asarray(k * PHI))
    size = abs(v) * (1 + float(f.mu_s / f.mu_c))
    np.testing.assert_allclose(rate_k, rate, rtol=1e-10, atol=1e-13 * size)
    top = PHI * (float(f.sigma0) * np.abs(z3[0]) + float(f.sigma1) * size + float(f.sigma2) * abs(v))
    np.testing.assert_allclose(torque_k, torque, rtol=1e-10, atol=1e-13 * top)
    np.testing.assert_allclose(loss_k, loss, rtol=1e-10, atol=1e-13 * top * abs(v))
