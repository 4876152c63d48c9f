"""The overall system: two forms of one right-hand side, dtypes, transformations, derivatives (model section 5)."""

from __future__ import annotations

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ljjax import energy
from ljjax.dynamics import State, momentum, port_hamiltonian, pressure_power, rhs, tendon_torque
from ljjax.friction import stribeck
from ljjax.model import astype

U, U_P = jnp.array([12.0, 3.0]), jnp.asarray(17.0)


def curved_lever(q):
    """A lever arm that shrinks where the body bends."""
    return 0.02 * jnp.cos(jnp.sum(q) / 10)


ROBOTS = {
    "six segments": (6, {}),
    "one segment": (1, {}),
    "nine segments": (9, {}),
    "constant mass": (3, {"constant_mass": True}),
    "lever g(q)": (3, {"lever": curved_lever}),
}


def random_state(seed: int, n: int, rate: float = 1.0) -> State:
    rng = np.random.default_rng(seed)
    q, v, z = rng.uniform(-0.5, 0.5, n), rng.normal(scale=rate, size=n), rng.uniform(-0.03, 0.03, n)
    return State(jnp.asarray(q), jnp.asarray(v), jnp.asarray(z))


@pytest.mark.parametrize(("n", "options"), ROBOTS.values(), ids=ROBOTS.keys())
def test_two_forms_of_one_right_hand_side(random_robot, n, options):
    """(𝒥 − 𝓡)∇𝓗 + 𝓖u + τ_ext is d(q, p, z)/dt of `rhs`; 𝒥 is skew, 𝓡 symmetric, ∇𝓗 the gradient of the energy."""
    torque = jnp.linspace(-0.2, 0.3, n)

    @eqx.filter_jit
    def both(model, state):
        rate = rhs(model, state, U, U_P, torque)
        p, p_rate = jax.jvp(partial(momentum, model), (state,), (rate,))
        fast = jnp.concatenate([rate.q, p_rate, rate.z])
        form = port_hamiltonian(model, state, U_P)
        outside = jnp.concatenate([jnp.zeros(n), torque, jnp.zeros(n)])
        explicit = (form.j - form.r) @ form.gradient + form.g @ U + outside

        def hamiltonian(q, p, z):
            v = jnp.linalg.solve(energy.inertia(model, q), p)
            return 0.5 * p @ v + energy.potential(model, q, U_P) + energy.bristle(model, z, U_P)

        gradient = jnp.concatenate(jax.grad(hamiltonian, argnums=(0, 1, 2))(state.q, p, state.z))
        h = hamiltonian(state.q, p, state.z)
        total = energy.total(model, state.q, state.v, state.z, U_P)
        return fast, explicit, form, gradient, (h, total), tendon_torque(model, state.q, U)

    for seed in range(5):
        model, state = random_robot(seed, n=n, **options), random_state(seed, n)
        fast, explicit, form, gradient, (h, total), tendons = both(model, state)
        np.testing.assert_allclose(fast, explicit, rtol=1e-10, atol=1e-11 * float(jnp.abs(explicit).max()))
        np.testing.assert_allclose(form.gradient, gradient, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(form.g @ U, np.r_[np.zeros(n), tendons, np.zeros(n)], rtol=1e-14)
        np.testing.assert_allclose(h, total, rtol=1e-12)
        np.testing.assert_array_equal(form.j, -form.j.T)
        np.testing.assert_array_equal(form.r, form.r.T)


def test_lever_arm_is_used(robot):
    state = random_state(0, 3)
    expected = float(curved_lever(state.q)) * float(U[0] - U[1])
    np.testing.assert_allclose(tendon_torque(robot(lever=curved_lever), state.q, U), expected, rtol=1e-14)
    np.testing.assert_allclose(tendon_torque(robot(), state.q, U), 0.02 * 9.0, rtol=1e-14)


@pytest.mark.parametrize("side", ["within", "beyond"])
def test_when_r_is_positive(robot, side):
    """𝓡 ⪰ 0 exactly where |v|/ρ ≤ 4(σ₁ + σ₂)/σ₁² at every joint (model section 8)."""
    model = robot(parameters={"friction.sigma1": 0.4})
    f = model.friction
    bound = float(4 * (f.sigma1 + f.sigma2) / f.sigma1**2)
    rng = np.random.default_rng(0)
    form = eqx.filter_jit(port_hamiltonian)
    for _ in range(20):
        share = rng.uniform(0.01, 0.999, 3)
        if side == "beyond":
            share[rng.integers(3)] = rng.uniform(1.001, 20)
        v = jnp.full(3, 1.0)
        for _ in range(200):  # |v| = share·bound·ρ(v)
            v = jnp.asarray(share) * bound * stribeck(f, v)
        v = v * jnp.asarray(rng.choice([-1.0, 1.0], 3))
        r = np.asarray(form(model, State(jnp.zeros(3), v, jnp.zeros(3)), U_P).r)[3:, 3:]
        scale = 1 / np.sqrt(np.diag(r))
        assert (np.linalg.eigvalsh(scale * r * scale[:, None]).min() >= 0) == (side == "within")


def test_at_rest_r_is_positive_semidefinite(robot):
    r = port_hamiltonian(robot(), State(*(jnp.zeros(3),) * 3), U_P).r
    assert np.linalg.eigvalsh(np.asarray(r)).min() == 0


@pytest.mark.parametrize("constant_mass", [False, True])
def test_float32_stays_float32_and_close(random_robot, constant_mass):
    run = eqx.filter_jit(lambda model, state, u, u_p, tau: rhs(model, state, u, u_p, tau))
    for seed in range(5):
        model, state = random_robot(seed, n=6, constant_mass=constant_mass), random_state(seed, 6)
        values = (state, U, U_P, jnp.linspace(-0.1, 0.1, 6))
        double = run(model, *values)
        single = run(astype(model, jnp.float32), *jax.tree.map(lambda x: x.astype(jnp.float32), values))
        for a, b in zip(single, double, strict=True):
            assert (a.dtype, b.dtype) == (jnp.float32, jnp.float64)
            np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-4 * float(jnp.abs(b).max()))


def test_float32_everywhere(robot):
    """The explicit form, energies and derivatives keep float32 too."""
    model = astype(robot(), jnp.float32)
    state = State(*(jnp.full(3, 0.01, jnp.float32),) * 3)
    u_p = jnp.float32(3.0)

    @eqx.filter_jit
    def everything(model, state, u_p):
        field = jax.jacrev(lambda s: rhs(model, s, jnp.ones(2, jnp.float32), u_p))
        power = pressure_power(model, state, u_p, u_p)
        return (
            port_hamiltonian(model, state, u_p),
            energy.total(model, state.q, state.v, state.z, u_p),
            power,
            field(state),
        )

    out = everything(model, state, jnp.asarray(u_p))
    assert {leaf.dtype for leaf in jax.tree.leaves(out)} == {jnp.dtype("float32")}


def test_vmap_over_models_and_states_is_a_loop(random_robot):
    models, states = [random_robot(i) for i in range(4)], [random_state(i, 3) for i in range(4)]

    def stack(items):
        return jax.tree.map(lambda *x: jnp.stack(x), *items)

    together = jax.jit(jax.vmap(lambda m, s: rhs(m, s, U, U_P)))(stack(models), stack(states))
    one = eqx.filter_jit(lambda m, s: rhs(m, s, U, U_P))
    for batched, single in zip(together, stack([one(m, s) for m, s in zip(models, states, strict=True)]), strict=True):
        np.testing.assert_allclose(batched, single, rtol=1e-11)


BENT = jnp.array([0.3, -0.2, 0.5])
POINTS = {  # state, u_P, and whether the right-hand side is smooth there
    "straight, at rest, no vacuum": (State(jnp.zeros(3), jnp.zeros(3), jnp.zeros(3)), 0.0, False),
    "bent, at rest, no vacuum": (State(BENT, jnp.zeros(3), 0.01 * BENT), 0.0, False),
    "bent, at rest, vacuum": (State(BENT, jnp.zeros(3), 0.01 * BENT), 20.0, False),
    "bent, moving, no vacuum": (State(BENT, 2 * BENT, 0.01 * BENT), 0.0, False),
    "straight, moving": (State(jnp.zeros(3), jnp.array([0.1, -0.3, 0.02]), jnp.zeros(3)), 20.0, True),
    "bent, moving": (State(BENT, jnp.array([0.1, -0.3, 0.02]), 0.02 * BENT), 20.0, True),
    "bent, fast": (State(BENT, 30 * BENT, 0.02 * BENT), 35.0, True),
}


@eqx.filter_jit
def derivatives(model, state, u, u_p):
    def field(x):
        return jnp.concatenate(rhs(*x))

    x = (model, state, u, u_p)
    return field(x), jax.jacfwd(field)(x), jax.jacrev(field)(x), jax.grad(lambda x: jnp.sum(field(x) ** 2))(x)


@eqx.filter_jit
def push(model, state, u, u_p, direction, h):
    """Central difference of rhs along a direction, Richardson's."""

    def at(s):
        return jnp.concatenate(rhs(*jax.tree.map(lambda x, d: x + s * d, (model, state, u, u_p), direction)))

    return (8 * (at(h) - at(-h)) - (at(2 * h) - at(-2 * h))) / (12 * h)


@pytest.mark.parametrize(("state", "u_p", "smooth"), POINTS.values(), ids=POINTS.keys())
def test_derivatives_are_finite_and_right(robot, state, u_p, smooth):
    """jacfwd, jacrev and grad with respect to everything: the model, the state, the tensions, the vacuum."""
    x = (robot(), state, U, jnp.asarray(u_p))
    _, forward, reverse, gradient = derivatives(*x)
    for a, b in zip(jax.tree.leaves(forward), jax.tree.leaves(reverse), strict=True):
        assert np.isfinite(a).all()
        np.testing.assert_allclose(a, b, rtol=1e-8, atol=1e-8 * (1 + float(jnp.abs(a).max())))
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradient))
    if not smooth:
        return
    leaves, tree = jax.tree.flatten(x)
    slopes = [np.asarray(leaf).reshape(9, -1) for leaf in jax.tree.leaves(forward)]
    for i, leaf in enumerate(leaves):
        size = np.asarray(np.maximum(np.abs(leaf), 1e-2))
        for j in range(leaf.size):
            unit = [np.zeros(np.shape(x)) for x in leaves]
            unit[i].reshape(-1)[j] = size.reshape(-1)[j]
            direction = jax.tree.unflatten(tree, [jnp.asarray(d) for d in unit])
            change = np.asarray(push(*x, direction, jnp.asarray(1e-3)))
            expected = slopes[i][:, j] * size.reshape(-1)[j]
            np.testing.assert_allclose(expected, change, rtol=1e-5, atol=1e-6 * (1 + np.abs(change).max()))


def test_constant_mass_leaves_out_only_the_shape(robot):
    """At rest and straight both options agree; bent and moving they differ."""
    full, constant = robot(), robot(constant_mass=True)
    straight = State(jnp.zeros(3), jnp.zeros(3), jnp.zeros(3))
    np.testing.assert_array_equal(rhs(full, straight, U, U_P).v, rhs(constant, straight, U, U_P).v)
    state = random_state(1, 3, rate=10)
    a, b = rhs(full, state, U, U_P).v, rhs(constant, state, U, U_P).v
    assert float(jnp.abs(a - b).max()) > 1e-3 * float(jnp.abs(a).max())


def test_external_torque_acts_on_the_momentum(robot):
    model, state, torque = robot(), random_state(2, 3), jnp.array([0.1, -0.2, 0.3])
    change = jax.tree.map(jnp.subtract, rhs(model, state, U, U_P, torque), rhs(model, state, U, U_P))
    np.testing.assert_allclose(energy.inertia(model, state.q) @ change.v, torque, rtol=1e-9)
    assert not np.any(change.q)
    assert not np.any(change.z)
