"""The reference simulation: against another solver and another program of the equations, and its edges."""

from __future__ import annotations

from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ljjax import simulation
from ljjax.dynamics import State, rhs
from ljjax.errors import InputError, SolverError
from ljjax.friction import breakaway
from ljjax.inputs import Inputs, from_run
from ljjax.logs.run import Run, Signal
from ljjax.model import Model, astype, get, replace
from ljjax.simulation import initial_shape, rest

simulate = partial(simulation.simulate, method="reference")
AT = np.linspace(0.0, 1.0, 21)
START = State(jnp.array([0.2, -0.1, 0.3]), jnp.array([1.0, -2.0, 0.5]), jnp.array([0.01, 0.0, -0.02]))


def straight(n: int = 3) -> State:
    return State(jnp.zeros(n), jnp.zeros(n), jnp.zeros(n))


def stack(items: list[Any]) -> Any:
    return jax.tree.map(lambda *x: jnp.stack(x), *items)


# The equations once more, in NumPy, from the definition: points on links, Newton's law along every joint.


def numpy_rhs(model: Model, y: np.ndarray, u: np.ndarray, u_p: float, tau: np.ndarray) -> np.ndarray:
    n = model.n
    c, e, j, f = ({k: float(x) for k, x in vars(part).items()} for part in
                  (model.chain, model.elastic, model.jamming, model.friction))  # fmt: skip
    q, v, z = y.reshape(3, n)
    psi, omega = np.cumsum(q), np.cumsum(v)
    mass_matrix, bias = np.zeros((n, n)), np.zeros(n)
    for k in range(n):
        part = 0.5 if k == n - 1 else 1.0
        length, mass = part * 2 * c["half_length_m"], part * c["segment_mass_kg"]
        jacobian, drift = np.zeros((2, n)), np.zeros(2)
        for a in range(k + 1):
            arm = length / 2 if a == k else 2 * c["half_length_m"]
            turn = np.array([np.cos(psi[a]), -np.sin(psi[a])]) * arm
            jacobian[:, : a + 1] += turn[:, None]
            drift -= arm * np.array([np.sin(psi[a]), np.cos(psi[a])]) * omega[a] ** 2
        ones = (np.arange(n) <= k).astype(float)
        mass_matrix += mass * jacobian.T @ jacobian
        mass_matrix += mass * (c["radius_m"] ** 2 / 4 + length**2 / 12) * np.outer(ones, ones)
        bias += mass * jacobian.T @ drift
    alpha2 = e["c1"] * u_p**2 + e["c2"] * u_p + e["c3"]
    phi = j["c4"] + j["c5"] * u_p / np.sqrt(u_p + 1e-4)  # √u_P, smoothed as the program says
    rho = f["mu_c"] + (f["mu_s"] - f["mu_c"]) * np.exp(-(np.abs(v / f["v_s"]) ** f["sigma3"]))
    z_rate = v - f["sigma0"] * np.abs(v) / rho * z
    friction = phi * (f["sigma0"] * z + f["sigma1"] * z_rate + f["sigma2"] * v)
    force = c["lever_arm_m"] * (u[0] - u[1]) - friction - alpha2 * q + tau
    force -= float(model.gravity.alpha1) * np.sin(q.sum())
    return np.concatenate([v, np.linalg.solve(mass_matrix, force - bias), z_rate])


def by_scipy(model: Model, inputs: Inputs, start: State) -> State:
    """Radau from stamp to stamp, at AT."""
    t, tau = np.asarray(inputs.t), np.asarray(inputs.torque)
    columns = np.column_stack([inputs.tendons, inputs.pressure_kpa, tau])
    y, out = np.concatenate([np.asarray(x) for x in start]), []
    for k in range(len(t) - 1):

        def field(now, y, k=k):
            w = 0.0 if inputs.hold else (now - t[k]) / (t[k + 1] - t[k])
            x = (1 - w) * columns[k] + w * columns[k + 1]
            return numpy_rhs(model, y, x[:2], x[2], x[3:])

        asked = AT[(AT >= t[k]) & (AT < t[k + 1])]
        piece = solve_ivp(field, (t[k], t[k + 1]), y, "Radau", np.r_[asked, t[k + 1]], rtol=1e-7, atol=1e-9)
        assert piece.success
        y = piece.y[:, -1]
        out.append(piece.y[:, :-1])
    out.append(y[:, None])
    q, v, z = np.concatenate(out, axis=1).T.reshape(len(AT), 3, -1).transpose(1, 0, 2)
    return State(jnp.asarray(q), jnp.asarray(v), jnp.asarray(z))


@pytest.mark.parametrize("hold", [True, False], ids=["held", "linear"])
def test_scipy_integrates_the_same_motion(random_robot, random_inputs, hold):
    model, inputs = random_robot(1), random_inputs(1, hold=hold, torque=True)
    expected = by_scipy(model, inputs, START)
    got = simulate(model, inputs, at=AT, initial=START)
    assert bool(got.ok)
    for name, tolerance in (("q", 1e-5), ("v", 5e-4), ("z", 1e-6)):
        a, b = getattr(got.state, name), getattr(expected, name)
        np.testing.assert_allclose(a, b, atol=tolerance, err_msg=name)
        assert float(jnp.abs(b).max()) > 1e3 * tolerance  # there is something to compare
    assert float(jnp.abs(got.state.z).max()) <= float(breakaway(model)) * (1 + 1e-4)  # the invariant set


def test_equations_agree_pointwise(random_robot):
    for seed in range(3):
        model, rng = random_robot(seed, n=4), np.random.default_rng(seed)
        state = State(*(jnp.asarray(s * rng.normal(size=4)) for s in (0.5, 3.0, 0.02)))
        u, u_p, tau = rng.uniform(0, 30, 2), 17.0, rng.normal(size=4)
        got = rhs(model, state, jnp.asarray(u), jnp.asarray(u_p), jnp.asarray(tau))
        expected = numpy_rhs(model, np.concatenate([np.asarray(x) for x in state]), u, u_p, tau)
        np.testing.assert_allclose(np.concatenate(got), expected, rtol=1e-9)


def test_stamps_asked_for_do_not_change_the_motion(random_robot, random_inputs):
    model, inputs = random_robot(2), random_inputs(2, torque=True)
    many = simulate(model, inputs, at=AT, initial=START)
    other = np.sort(np.r_[AT[::2], AT[:10] + 0.0123])
    few = simulate(model, inputs, at=other, initial=START)
    here, there = np.isin(AT, other), np.isin(other, AT)
    for a, b in zip(many.state, few.state, strict=True):
        np.testing.assert_allclose(a[here], b[there], rtol=1e-9, atol=1e-10)
    # a stamp may stand twice, as in a log of two messages at once
    twice = simulate(model, inputs, at=np.r_[AT[:10], AT[9], AT[11:]], initial=START)
    np.testing.assert_allclose(twice.state.q[10], twice.state.q[9], rtol=1e-12)


def test_tighter_tolerances_converge(random_robot, random_inputs):
    """From 1e-6 to 1e-10 the solution moves by no more than the looser tolerance says, and the solver arrives."""
    model, inputs = random_robot(2), random_inputs(2, torque=True)
    coarse = simulate(model, inputs, at=AT, initial=START)
    fine = simulate(model, inputs, at=AT, initial=START, rtol=1e-10, atol=1e-12, max_steps=50_000)
    assert bool(fine.ok)
    np.testing.assert_allclose(coarse.state.q, fine.state.q, atol=1e-5)


@pytest.mark.parametrize("q", [0.0, 0.02], ids=["straight", "bent"])
def test_rest_is_rest_for_long_and_then_moves(robot, q):
    """Once the step shrank to nothing at rest: 5 s of standing still, then a tension step, in few steps."""
    model = robot()
    tendons = jnp.zeros((6, 2)).at[3:, 0].set(30.0)
    inputs = Inputs(jnp.array([0.0, 1.0, 3.0, 5.0, 5.5, 6.0]), tendons, jnp.zeros(6))
    start = rest(model, inputs, q)
    run = simulate(model, inputs, initial=start)
    still = run.state.q[:4] - q
    assert float(jnp.abs(still).max()) < (1e-20 if q == 0 else 1e-9)  # the last of these is at the step itself
    if q == 0:
        assert all(not np.any(x[:3]) for x in run.state)
    assert int(run.steps) < 1000
    assert float(run.theta[-1]) > 0.05


@pytest.mark.parametrize("seed", range(3))
def test_jumps_cost_few_steps(random_robot, random_inputs, seed):
    """The solver does not creep up to the stamps at which held inputs jump: Kvaerno5 has a stage beyond its step's
    end, which must not see the next value. (It did, and took twice as many steps, of 1e-12 s before every stamp.)"""
    run = simulate(random_robot(seed + 1), random_inputs(seed + 1, torque=True), at=AT, initial=START)
    assert int(run.steps) < 900


def test_a_batch_survives_bad_elements(random_robot, random_inputs):
    """vmap over robots and starts, two of which hold no numbers: they say so, and the others are unharmed."""
    models, inputs = [random_robot(i) for i in range(4)], random_inputs(3, torque=True)
    nan = float("nan")
    models[1] = replace(models[1], {"gravity.alpha1": nan})
    starts = [START, START, START, State(START.q + nan, START.v, START.z)]

    def one(model, start):
        return simulate(model, inputs, at=AT, initial=start, throw=False, max_steps=3000)

    batch = eqx.filter_jit(eqx.filter_vmap(one))(stack(models), stack(starts))
    assert batch.ok.tolist() == [True, False, True, False]
    for i in range(4):
        if not batch.ok[i]:
            assert not np.isfinite(batch.state.q[i, -1]).any()
            continue
        alone = simulate(models[i], inputs, at=AT, initial=START)
        for a, b in zip(batch.state, alone.state, strict=True):  # to the solver's tolerance: rounding moves its steps
            np.testing.assert_allclose(a[i], b, rtol=1e-4, atol=1e-4)


def test_float32_runs(random_robot, random_inputs):
    model, inputs = random_robot(1), random_inputs(1, torque=True)
    double = simulate(model, inputs, at=AT, initial=START)
    model, inputs, start = jax.tree.map(lambda x: x.astype(jnp.float32), (model, inputs, START))
    single = simulate(model, inputs, at=AT, initial=start, rtol=3e-5, atol=3e-7, max_steps=20000)
    assert {x.dtype for x in (*single.state, single.t, single.theta)} == {jnp.dtype("float32")}
    np.testing.assert_allclose(single.state.q, double.state.q, atol=1e-4)
    np.testing.assert_allclose(single.state.z, double.state.z, atol=1e-3 * float(jnp.abs(double.state.z).max()) + 1e-5)
    assert astype(model, jnp.float64).chain.radius_m.dtype == jnp.float64


PATHS = ["gravity.alpha1", "elastic.c2", "jamming.c4", "friction.sigma2", "friction.mu_c", "chain.lever_arm_m"]


def final_theta(model, x, mode):
    inputs = Inputs(jnp.array([0.0, 0.1]), jnp.array([[0.0, 0.0], [40.0, 5.0]]), jnp.array([5.0, 10.0]), hold=False)
    changed = replace(model, dict(zip(PATHS, x, strict=True)))
    tight: dict[str, Any] = {"rtol": 1e-9, "atol": 1e-11, "max_steps": 5000, "derivatives": mode}
    return simulate(changed, inputs, at=np.array([0.0, 0.1]), initial=straight(2), **tight).theta[-1]


@pytest.fixture(scope="module")
def differences(robot) -> np.ndarray:
    """d(final θ)/d(parameter), of tight runs."""
    final = jax.jit(lambda x: final_theta(robot(2), x, "reverse"))
    centre = np.array([float(get(robot(2), path)) for path in PATHS])
    steps = 1e-4 * np.diag(centre)
    return np.array([(final(jnp.asarray(centre + d)) - final(jnp.asarray(centre - d))) / (2 * d.sum()) for d in steps])


@pytest.mark.parametrize("mode", ["reverse", "forward"])
def test_gradients_against_differences(robot, differences, mode):
    model = robot(2)
    x = jnp.asarray([float(get(model, path)) for path in PATHS])
    transform = jax.jacrev if mode == "reverse" else jax.jacfwd
    gradient = np.asarray(jax.jit(transform(lambda x: final_theta(model, x, mode)))(x))
    assert np.all(np.isfinite(gradient))
    effect = np.abs(gradient * np.asarray(x))
    assert np.all(effect > 1e-6)  # every parameter matters
    np.testing.assert_allclose(gradient * x, differences * x, rtol=1e-3, atol=1e-3 * effect.max())


TIMES = jnp.array([-1.0, 0.0, 0.4, 0.999, 1.0, 2.5, 3.0, 9.0])
READ = [
    ("held", True, [10, 10, 10, 10, 20, 20, 50, 50]),
    ("linear", False, [10, 10, 14, 19.99, 20, 42.5, 50, 50]),
]


@pytest.mark.parametrize(("name", "hold", "expected"), READ, ids=[r[0] for r in READ])
def test_inputs_between_and_beyond_stamps(name, hold, expected):
    x = jnp.array([10.0, 20.0, 50.0])
    inputs = Inputs(
        jnp.array([0.0, 1.0, 3.0]), jnp.stack([x, 2 * x], 1), 3 * x, jnp.stack([4 * x, 5 * x], 1), hold=hold
    )
    u, u_p, tau = jax.vmap(inputs.at)(TIMES)
    assert tau is not None
    for column, factor in ((u[:, 0], 1), (u[:, 1], 2), (u_p, 3), (tau[:, 0], 4), (tau[:, 1], 5)):
        np.testing.assert_allclose(column, factor * np.array(expected), rtol=1e-14)
    rate = jax.vmap(inputs.pressure_rate)(TIMES)
    np.testing.assert_allclose(rate, 0 * TIMES if hold else [0, 30, 30, 30, 45, 45, 0, 0], rtol=1e-14)


def test_inputs_continued_from_within_an_interval():
    """What a stage beyond the end of its step sees: its own interval, continued."""
    x = jnp.array([10.0, 20.0, 50.0])
    for hold, expected in ((True, [10, 10, 20, 50, 10]), (False, [22, 10, 57.5, 50, 10])):
        inputs = Inputs(jnp.array([0.0, 1.0, 3.0]), jnp.stack([x, x], 1), x, hold=hold)
        now, within = jnp.array([1.2, 0.0, 3.5, 3.5, 0.1]), jnp.array([0.9, 0.0, 2.9, 3.0, -0.1])
        np.testing.assert_allclose(jax.vmap(inputs.at)(now, within)[1], expected, rtol=1e-14)


@pytest.mark.parametrize("hold", [True, False])
def test_one_stamp_holds_for_ever(hold):
    inputs = Inputs(jnp.zeros(1), jnp.array([[3.0, 1.0]]), jnp.array([7.0]), hold=hold)
    u, u_p, tau = jax.vmap(inputs.at)(jnp.array([-1.0, 0.0, 5.0]))
    assert (u[:, 0].tolist(), u_p.tolist(), tau) == ([3.0] * 3, [7.0] * 3, None)
    assert float(inputs.pressure_rate(jnp.asarray(0.0))) == 0


def log(**signals: tuple[list, list, str]) -> Run:
    """A run from `name=(stamps, values, unit)`."""
    made = {}
    for name, (t, value, unit) in signals.items():
        table = np.array(value, float).reshape(len(t), -1)
        columns = tuple(f"c{i}" for i in range(table.shape[1]))
        made[name] = Signal(np.array(t), table, columns, unit, f"/real/{name}")
    return Run("run.mcap", "0" * 64, 0, made, {"p_atm_pa": "100000"})


COMMANDS: dict[str, Any] = {
    "cmd_tendons": ([0.0, 0.5, 1.0], [[0, 0], [0, 0], [20, 5]], "N"),
    "cmd_pressure": ([0.0, 0.7, 1.0], [1e5, 9e4, 9e4], "Pa"),
}
MEASURED: dict[str, Any] = {
    "tendons": ([0.0, 1.0], [[0, 0], [20, 5]], "N"),
    "pressure": ([0.5, 1.5], [1e5, 9e4], "Pa"),
}
SHAPE: dict[str, Any] = {"shape": ([0.0, 0.5, 0.9, 1.5], [0.010, 0.014, 0.5, 0.6], "rad")}


def test_commands_of_a_log_hold():
    inputs = from_run(log(**COMMANDS, **SHAPE))
    assert inputs.hold
    np.testing.assert_array_equal(inputs.t, [0.0, 0.7, 1.0])  # nothing changes at 0.5
    np.testing.assert_array_equal(inputs.tendons, [[0, 0], [0, 0], [20, 5]])
    np.testing.assert_allclose(inputs.pressure_kpa, [0, 10, 10])


def test_measurements_of_a_log_are_linear():
    inputs = from_run(log(**MEASURED), "measured")
    assert not inputs.hold
    np.testing.assert_array_equal(inputs.t, [0.0, 0.5, 1.0, 1.5])
    np.testing.assert_allclose(inputs.tendons[:, 0], [0, 10, 20, 20])
    np.testing.assert_allclose(inputs.pressure_kpa, [0, 0, 5, 10])


@pytest.mark.parametrize("n", [1, 3])
def test_a_run_starts_from_the_shape_before_its_commands_move(n):
    np.testing.assert_allclose(initial_shape(log(**COMMANDS, **SHAPE), n), np.full(n, 0.012), rtol=1e-12)


def test_joint_angles_of_a_log_are_taken_one_by_one():
    shape = ([0.0, 0.5, 1.5], [[0.1, 0.2, 0.3], [0.1, 0.2, 0.3], [9, 9, 9]], "rad")
    np.testing.assert_allclose(initial_shape(log(**COMMANDS, shape=shape), 3), [0.1, 0.2, 0.3], rtol=1e-12)


def test_a_log_is_replayed_at_its_own_stamps(robot):
    """Rest at the measured first shape; the commands act at their stamps; θ is reported at the shape's stamps."""
    run = log(**COMMANDS, **SHAPE)
    model = robot(parameters={"gravity.alpha1": 0.0})
    got = simulate(model, run)
    np.testing.assert_array_equal(got.t, [0.0, 0.5, 0.9, 1.5])
    np.testing.assert_allclose(got.theta[:2], 0.012, rtol=1e-6)  # held by the bristles until the tendons pull
    assert float(got.theta[-1]) > 0.05
    expected = simulate(model, from_run(run), at=run.signals["shape"].t, initial=rest(model, from_run(run), 0.012))
    np.testing.assert_allclose(got.state.q, expected.state.q, rtol=1e-12)
    tip = got.tip(model)
    np.testing.assert_allclose(tip[:, 2], 3 * got.theta, rtol=1e-12)


def test_rest_balances_within_the_bristles(robot):
    model = robot()
    inputs = Inputs(jnp.zeros(1), jnp.array([[4.0, 1.0]]), jnp.array([9.0]), jnp.array([[0.01, -0.02, 0.0]]))
    balanced, loaded = rest(model, inputs, 0.02), rest(model, inputs, 0.5)
    u, u_p, tau = inputs.at(jnp.zeros(()))
    np.testing.assert_allclose(rhs(model, balanced, u, u_p, tau).v, 0, atol=1e-8)
    np.testing.assert_allclose(jnp.abs(loaded.z), breakaway(model), rtol=1e-14)


TENDONS, PRESSURE = ({name: COMMANDS[name]} for name in COMMANDS)
DEEP: dict[str, Any] = {"cmd_pressure": ([0.0, 1.0], [1e5, 1e4], "Pa")}
TWO_JOINTS: dict[str, Any] = {"shape": ([0.0, 1.0], [[0, 0], [0, 0]], "rad")}


def held(tension: float = 0.0, u_p: float = 0.0) -> Inputs:
    return Inputs(jnp.zeros(1), jnp.full((1, 2), tension), jnp.full(1, u_p))


REFUSED: dict[str, tuple[Any, dict[str, Any], dict[str, float], str]] = {  # run, options, parameters, message
    "α₂ ≤ 0 within the run's vacuum": (log(**TENDONS, **DEEP, **SHAPE), {}, {}, "run.mcap.*elastic"),
    "joints of another robot": (log(**COMMANDS, **TWO_JOINTS), {}, {}, "run.mcap.*2 joint angles.*3 segments"),
    "no shape": (log(**COMMANDS), {}, {}, "run.mcap.*shape"),
    "no tendon commands": (log(**PRESSURE, **SHAPE), {}, {}, "run.mcap.*cmd_tendons"),
    "no pressure commands": (log(**TENDONS, **SHAPE), {}, {}, "run.mcap.*cmd_pressure"),
    "no measured tension": (log(**COMMANDS, **SHAPE), {"inputs": "measured"}, {}, "run.mcap.*tendons"),
    "tension that is no number": (held(np.nan), {}, {}, "tendons.*finite"),
    "vacuum without end": (held(0.0, np.inf), {}, {}, "pressure_kpa.*finite"),
    "an impossible parameter": (held(), {}, {"friction.mu_s": 0.001}, "friction.mu_s"),
}


@pytest.mark.parametrize(("run", "options", "parameters", "message"), REFUSED.values(), ids=REFUSED.keys())
def test_refusals_name_the_run_and_what_is_wrong(robot, run, options, parameters, message):
    with pytest.raises(InputError, match=message):
        simulate(robot(parameters=parameters), run, **options)


def test_failure_says_where_and_what_to_try(random_robot, random_inputs):
    arguments: dict[str, Any] = {"at": AT, "initial": START, "max_steps": 300}
    with pytest.raises(SolverError, match=r"stopped after t = 0\.\d+ s and 300 steps.*max_steps"):
        simulate(random_robot(1), random_inputs(1, torque=True), **arguments)
    run = simulate(random_robot(1), random_inputs(1, torque=True), **arguments, throw=False)
    assert not bool(run.ok)
    assert np.isfinite(run.state.q[0]).all()
    assert not np.isfinite(run.state.q[-1]).any()
