"""The fast solver: the same motion as the reference, converging at its order, with right derivatives."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ljjax import energy, fast, step
from ljjax.chain import coriolis_forces, mass_matrix
from ljjax.dynamics import State, lever_arm, rhs
from ljjax.errors import InputError, SolverError
from ljjax.inputs import Inputs
from ljjax.model import astype, get, replace
from ljjax.simulation import ITERATIONS, rest, simulate

AT = np.linspace(0.0, 1.0, 21)
LEARNED = (
    *("chain.segment_mass_kg", "gravity.alpha1", "elastic.c1", "elastic.c3", "jamming.c4", "jamming.c5"),
    *("friction.sigma1", "friction.sigma2", "friction.sigma3", "friction.mu_c", "friction.mu_s", "friction.v_s"),
)


@eqx.filter_jit
def run(model, inputs, initial, at, steps: int):
    h = (at[-1] - at[0]) / steps
    return fast.run(model, inputs, initial, at, at[0], h, steps, ITERATIONS)


def smooth_inputs(end: float = 1.0, n: int = 61, tension: float = 12.0, vacuum: float = 20.0) -> Inputs:
    """Pull, ease off and pull back (every joint turns round), under a moving vacuum that starts from none."""
    t = jnp.linspace(0.0, end, n)
    wave = tension * jnp.sin(2 * jnp.pi * t / end)
    tendons = jnp.stack([jnp.maximum(wave, 0.0), jnp.maximum(-wave, 0.0)], axis=1)
    return Inputs(t, tendons, vacuum * jnp.sin(jnp.pi * t / end) ** 2, hold=False)


def lock_inputs() -> Inputs:
    """Bend, draw the vacuum, let go: the end is locked."""
    t, at = jnp.linspace(0.0, 1.0, 61), jnp.array([0.0, 0.3, 0.5, 0.6, 0.8, 1.0])
    pull = jnp.interp(t, at, jnp.array([0.0, 20.0, 20.0, 20.0, 0.0, 0.0]))
    return Inputs(
        t, jnp.stack([pull, 0 * pull], axis=1), jnp.interp(t, at, jnp.array([0.0, 0, 0, 30, 30, 30])), hold=False
    )


CASES = {"turning round": smooth_inputs, "no vacuum": lambda: smooth_inputs(vacuum=0.0), "locking": lock_inputs}


@pytest.mark.parametrize("n", [1, 2, 6])
def test_inertia_and_coriolis_are_the_chains(robot, n):
    model = robot(n)
    for seed in range(5):
        q, v = np.random.default_rng(seed).normal(size=(2, n))
        m, force = step.inertia_and_coriolis(
            step.How(),
            step.constants(model),
            *step.directions(step.unroll(jnp.asarray(q))),
            step.unroll(jnp.asarray(v)),
        )
        full = np.array([[m[max(i, k)][min(i, k)] for k in range(n)] for i in range(n)])
        np.testing.assert_allclose(full, mass_matrix(model.chain, jnp.asarray(q)), rtol=1e-11, atol=1e-18)
        np.testing.assert_allclose(
            np.array(force), coriolis_forces(model.chain, jnp.asarray(q), jnp.asarray(v)), rtol=1e-9, atol=1e-16
        )


def test_a_short_step_follows_the_right_hand_side(random_robot):
    model = random_robot(3)
    state = State(jnp.array([0.2, -0.1, 0.3]), jnp.array([0.6, -0.9, 0.5]), jnp.array([0.01, 0.0, -0.02]))
    u, u_p, tau, h = jnp.array([20.0, 5.0]), jnp.asarray(12.0), jnp.array([0.02, -0.05, 0.03]), 1e-7
    drive = step.Drive(u[0], u[1], u_p, step.unroll(tau))
    first = step.Unrolled(step.unroll(state.q), step.unroll(state.v), step.unroll(state.z))
    after = step.advance(model, step.constants(model), first, drive, h, step.How())
    slope = [(jnp.stack(b) - a) / h for a, b in zip(state, after[:3], strict=True)]
    for got, expected in zip(slope, rhs(model, state, u, u_p, tau), strict=True):
        np.testing.assert_allclose(got, expected, rtol=2e-2, atol=1e-6 * float(jnp.abs(expected).max()))


@pytest.mark.parametrize("hold", [True, False], ids=["held", "linear"])
def test_the_reference_makes_the_same_motion(random_robot, random_inputs, hold):
    """Random robots, jumping tensions and vacuum, outside torques; steps of 1 ms."""
    for seed in range(2):
        model, inputs = random_robot(seed), random_inputs(seed, hold=hold, torque=True)
        initial = rest(model, inputs)
        reference = simulate(model, inputs, at=AT, initial=initial, method="reference")
        ours = simulate(model, inputs, at=AT, initial=initial, step_s=1e-3)
        assert float(jnp.abs(reference.state.q).max()) > 0.1
        np.testing.assert_allclose(ours.state.q, reference.state.q, atol=4e-4)


def test_it_converges_at_second_order_where_the_motion_is_smooth(robot):
    """One-way motion has no kink: halving the step quarters the error. With kinks it still converges."""
    t = jnp.linspace(0.0, 1.0, 61)  # as many as of the other: compiled once
    push = Inputs(t, jnp.stack([10 + 15 * t, 0 * t], axis=1), 5 + 5 * t, hold=False)
    for inputs, rate, initial in (
        (push, 3.5, State(jnp.zeros(2), jnp.full(2, 0.3), jnp.full(2, 0.02))),
        (smooth_inputs(), 1.6, None),
    ):
        model = robot(2)
        initial = rest(model, inputs) if initial is None else initial
        at = jnp.linspace(0.0, 1.0, 6)
        fine = run(model, inputs, initial, at, 12800)
        errors = [float(jnp.abs(run(model, inputs, initial, at, k).q - fine.q).max()) for k in (200, 1600)]
        mean_rate = (errors[0] / errors[1]) ** (1 / 3)  # of three halvings; each number of steps compiles anew
        assert mean_rate > rate, (errors, mean_rate)


@eqx.filter_jit
def theta(x, model, inputs):
    changed = replace(model, dict(zip(LEARNED, x, strict=True)))
    initial, at = State(*(jnp.zeros(3),) * 3), jnp.linspace(0.0, 1.0, 9)
    return fast.run(changed, inputs, initial, at, jnp.asarray(0.0), jnp.asarray(0.005), 200, ITERATIONS).q.mean(axis=1)


slopes = eqx.filter_jit(lambda x, model, inputs: jax.jacfwd(theta)(x, model, inputs))


@pytest.mark.parametrize("case", CASES)
def test_derivatives_against_differences(robot, case):
    """Forward mode against central differences, through turning joints, no vacuum, and locking."""
    inputs, model = CASES[case](), robot()
    x0 = jnp.stack([get(model, name) for name in LEARNED])
    jacobian = np.asarray(slopes(x0, model, inputs))
    for i, name in enumerate(LEARNED):
        e = 1e-6 * jnp.zeros_like(x0).at[i].set(jnp.abs(x0[i]))
        difference = np.asarray(theta(x0 + e, model, inputs) - theta(x0 - e, model, inputs)) / float(2 * e[i])
        scale = np.abs(jacobian[:, i]).max()
        np.testing.assert_allclose(jacobian[:, i], difference, atol=2e-5 * scale + 1e-9, err_msg=name)


def test_reverse_and_forward_agree(robot):
    inputs, model = smooth_inputs(), robot(2)
    initial, at = State(*(jnp.zeros(2),) * 3), jnp.linspace(0.0, 1.0, 5)

    def last(x):
        changed = replace(model, {"elastic.c3": x[0], "friction.mu_s": x[1], "jamming.c5": x[2]})
        return fast.run(changed, inputs, initial, at, jnp.asarray(0.0), jnp.asarray(0.01), 100, 3).q[-1].sum()

    x = jnp.stack([model.elastic.c3, model.friction.mu_s, model.jamming.c5])
    np.testing.assert_allclose(jax.jit(jax.grad(last))(x), jax.jit(jax.jacfwd(last))(x), rtol=1e-9)


def test_float32_is_as_good_as_its_digits(robot):
    model, inputs = robot(), smooth_inputs()
    initial, at = rest(model, inputs), jnp.asarray(AT)
    double = run(model, inputs, initial, at, 200)
    model32, inputs32, initial32, at32 = jax.tree.map(lambda x: x.astype(jnp.float32), (model, inputs, initial, at))
    single = run(model32, inputs32, initial32, at32, 200)
    assert single.q.dtype == jnp.float32
    np.testing.assert_allclose(single.q, double.q, atol=2e-4)
    assert astype(model, jnp.float32).friction.mu_s.dtype == jnp.float32


def test_energy_is_never_created_beyond_the_schemes_order(robot):
    """Let go from a bent shape: the energy falls, but for what a second-order scheme may add."""
    model = robot()
    t = jnp.array([0.0, 1.0])
    inputs = Inputs(t, jnp.zeros((2, 2)), jnp.full(2, 5.0))
    start = State(jnp.array([0.5, 0.3, -0.2]), jnp.zeros(3), jnp.zeros(3))
    for steps in (200, 800):
        at = jnp.linspace(0.0, 1.0, steps + 1)
        path = run(model, inputs, start, at, steps)
        total = jax.vmap(lambda q, v, z: energy.total(model, q, v, z, jnp.asarray(5.0)))(*path[:3])
        gained = np.maximum(np.diff(total), 0).max()
        assert float(total[-1]) < 0.7 * float(total[0])
        assert gained < 1e-3 * float(total[0]) * (200 / steps) ** 2


def test_a_batch_is_its_elements(random_robot):
    inputs, initial = smooth_inputs(), State(*(jnp.zeros(3),) * 3)
    models = [random_robot(seed) for seed in range(4)]
    at = jnp.asarray(AT)
    batch = eqx.filter_jit(
        eqx.filter_vmap(lambda m: fast.run(m, inputs, initial, at, at[0], jnp.asarray(0.005), 200, 3).q)
    )(jax.tree.map(lambda *x: jnp.stack(x), *models))
    for model, q in zip(models, batch, strict=True):
        np.testing.assert_allclose(q, run(model, inputs, initial, at, 200).q, atol=1e-9)


@pytest.mark.parametrize("hold", [True, False], ids=["held", "linear"])
def test_means_are_exact(random_inputs, hold):
    inputs = random_inputs(1, hold=hold)
    edges = jnp.linspace(-0.1, 1.2, 14)
    tendons, pressure, _ = fast.means(inputs, edges)
    for k in range(13):
        t = jnp.linspace(edges[k], edges[k + 1], 4001)
        middle = 0.5 * (t[1:] + t[:-1])
        u, p, _ = jax.vmap(inputs.at)(middle)
        np.testing.assert_allclose(tendons[k], u.mean(axis=0), rtol=1e-3, atol=1e-3)
        np.testing.assert_allclose(pressure[k], p.mean(), rtol=1e-3, atol=1e-3)


def test_options_of_the_model_hold_here_too(robot, random_inputs):
    """A constant inertia and a lever arm that changes with the shape, against the reference."""
    model = robot(constant_mass=True, lever=lambda q: 0.02 - 0.01 * jnp.mean(q) ** 2)
    inputs = random_inputs(2, hold=False)
    assert float(lever_arm(model, jnp.ones(3))) == pytest.approx(0.01)
    reference = simulate(model, inputs, at=AT, method="reference")
    np.testing.assert_allclose(simulate(model, inputs, at=AT, step_s=1e-3).state.q, reference.state.q, atol=4e-4)


def test_what_cannot_be_done_is_said(robot, random_inputs):
    model, inputs = robot(), random_inputs(0, torque=True)
    with pytest.raises(InputError, match="step_s is 0"):
        simulate(model, inputs, step_s=0.0)
    with pytest.raises(InputError, match="stamps must be known"):
        jax.jit(lambda at: simulate(model, inputs, at=at).theta)(jnp.asarray(AT))
    wild: dict = {"initial": State(jnp.full(3, 1e200), jnp.full(3, 1e200), jnp.zeros(3)), "at": AT, "step_s": 1e-3}
    with pytest.raises(SolverError, match="fast solver stopped"):
        simulate(model, inputs, **wild)
    assert not bool(simulate(model, inputs, **wild, throw=False).ok)
