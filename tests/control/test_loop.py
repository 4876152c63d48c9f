"""The simulated closed loop: the robot's own motion under what the law commands; the better laws are better."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import ljjax
from ljjax import batch, law
from ljjax.chain import lateral_jacobian
from ljjax.control import design, scenario, simulate
from ljjax.control.loop import HOW, depth, run, substeps_of, to_jax
from ljjax.control.statics import Hardware
from ljjax.control.synthesis import build
from ljjax.errors import InputError
from ljjax.inputs import Inputs
from ljjax.model import get, replace
from ljjax.stiffness import closed_loop_stiffness, transverse_stiffness

THETA = 0.12
FAST = HOW._replace(loops=True)


@pytest.fixture(scope="module")
def loops(designs, robot):
    """Each law's loop on the robot it was designed for, 2.5 s."""
    out = {}
    for kind, made in designs.items():
        out[kind] = simulate(made.law, robot(), scenario(made.law, THETA, _middle(made), 2.5))
    return out


def _middle(made) -> float:
    """A stiffness about the middle of those in reach, between two entries of the table."""
    low, high = made.reach["stiffness_n_m"]
    return low + 0.43 * (high - low)


def test_the_published_law_stalls_within_the_stiction_set(designs, robot, loops):
    made, loop = designs["passivity"], loops["passivity"]
    assert bool(loop.ok)
    error = np.asarray(loop.theta) - THETA
    assert abs(error[-1]) > 1e-3  # 0.06°, and it is at rest:
    assert np.ptp(np.asarray(loop.theta)[-40:]) < 1e-6
    u = float(loop.vacuum[-1])
    gains = made.law.gains
    alpha2, phi = -0.0017 * u**2 + 0.102 * u + 1.861, 12.0 + 3.416 * np.sqrt(u)
    slope = gains.gamma * np.sin(2 * error[-1]) + alpha2 * error[-1]  # ∂ᵢU_d
    assert abs(slope) <= phi * 0.003
    assert slope == pytest.approx(-phi * float(jnp.mean(loop.z[-1])), rel=1e-3)


@pytest.mark.parametrize("kind", ["integral", "observer"])
def test_the_better_laws_cut_the_steady_error_to_a_fifth(loops, kind):
    left = abs(float(loops["passivity"].theta[-1]) - THETA)
    assert abs(float(loops[kind].theta[-1]) - THETA) <= left / 5


def test_the_observer_gets_there_sooner_and_neither_overshoots(loops):
    late = {k: np.argmax(np.abs(np.asarray(x.theta) - THETA) < 0.02 * THETA) for k, x in loops.items()}
    assert late["observer"] < late["integral"]
    for kind in ("integral", "observer"):
        assert float(jnp.max(loops[kind].theta)) < 1.02 * THETA


def test_the_stiffness_commanded_is_held(designs, robot, loops):
    made = designs["integral"]
    k = closed_loop_stiffness(robot(), loops["integral"].vacuum[-1], jnp.asarray(made.law.gains.gamma))
    assert float(transverse_stiffness(robot(), k)) == pytest.approx(_middle(made), rel=1e-4)


@pytest.mark.parametrize("kind", list(law.KINDS))
def test_a_small_push_on_the_unbent_robot_feels_the_stiffness_commanded(designs, robot, kind):
    """While the bristles are straight and hardly bend: less than a twentieth of what they break away at."""
    made, model = designs[kind], robot()
    lateral = np.asarray(lateral_jacobian(model.chain, jnp.zeros(2)))
    force = 0.05 * 0.003 * _middle(made) * lateral[0] / 2
    base = scenario(made.law, 0.0, _middle(made), 1.6)
    push = force * np.clip((np.arange(len(base.theta)) * made.law.period_s - 0.8) / 0.4, 0.0, 1.0)
    loop = simulate(made.law, model, base._replace(torque=jnp.asarray(push[:, None] * lateral)))
    assert force / float(lateral @ loop.q[-1]) == pytest.approx(_middle(made), rel=0.03)


@pytest.mark.parametrize("ticks", [0, 1, 2])
def test_the_motion_is_that_of_the_commands_replayed_with_the_loops_delay(designs, robot, ticks):
    made = designs["observer"]
    given = scenario(made.law, THETA, _middle(made), 0.6, compute_ticks=ticks)
    loop = simulate(made.law, robot(), given)
    t = loop.t

    def late(x):
        return jnp.concatenate([jnp.zeros(ticks), x])[: len(t)]

    commands = Inputs(t, jnp.stack([late(loop.left), late(loop.right)], axis=1), late(loop.vacuum), hold=True)
    initial = ljjax.State(loop.q[0], loop.v[0], loop.z[0])
    motion = ljjax.simulate(robot(), commands, at=t, initial=initial, step_s=0.0025)
    np.testing.assert_allclose(motion.state.q, loop.q, atol=1e-10)


def test_the_law_in_the_loop_is_the_law_on_the_rig(designs, loops):
    for kind, loop in loops.items():
        given = designs[kind].law
        state, vacuum = law.start(given, float(loop.seen[0]), 0.0, 0.0, 0.0), 0.0
        for k in range(len(loop.t)):
            measured = law.Measured(float(loop.seen[k]), vacuum)
            state, output = law.tick(given, state, measured, law.Command(THETA, _middle(designs[kind])))
            vacuum = output.vacuum
            expected = [float(x[k]) for x in (loop.left, loop.right, loop.vacuum)]
            assert output == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_delays_of_effects_add_to_the_loops_own(designs, robot):
    made = designs["integral"]
    low = made.reach["stiffness_n_m"][0]  # without vacuum, whose command an actuator's delay does not touch
    period = made.law.period_s
    for effect, ticks, sensor in (("actuator_delay", 2.5, 0.0), ("sensor_delay", 1.0, 1.5)):
        plain = scenario(made.law, THETA, low, 0.4, compute_ticks=ticks, sensor_s=sensor * period)
        own = simulate(
            made.law, robot(effects={effect: {"delay_seconds": 1.5 * period}}), scenario(made.law, THETA, low, 0.4)
        )
        np.testing.assert_allclose(own.q, simulate(made.law, robot(), plain).q, atol=1e-12)
        prompt = simulate(made.law, robot(), scenario(made.law, THETA, low, 0.4))
        assert float(jnp.max(jnp.abs(prompt.q - own.q))) > 1e-4


def test_a_sensors_bias_moves_the_rest_by_as_much(designs, robot):
    made = designs["integral"]
    biased = simulate(
        made.law, robot(effects={"sensor_bias": {"offset_rad": 0.01}}), scenario(made.law, THETA, _middle(made), 2.0)
    )
    assert float(biased.theta[-1]) == pytest.approx(THETA - 0.01, abs=0.001)


def test_the_loop_in_float32_is_that_in_float64(designs, robot, loops):
    made = designs["integral"]
    given = scenario(made.law, THETA, _middle(made), 2.5, dtype=jnp.float32)
    loop = simulate(made.law, robot(), given)
    assert {x.dtype for x in loop[:-1]} == {jnp.dtype("float32")}
    np.testing.assert_allclose(loop.theta, loops["integral"].theta, atol=2e-4)


def test_many_at_once_are_each_alone(designs, robot):
    made = designs["observer"]
    model, given = robot(), to_jax(made.law)
    scenarios = [
        scenario(made.law, th, _middle(made), 0.2, noise_rad=1e-4, seed=i, compute_ticks=0.5 * i, sensor_s=0.001 * i)
        for i, th in enumerate((0.05, -0.1, 0.2))
    ]
    kept = max(depth(made.law, s, model) for s in scenarios)

    def one(c4, s):
        return run(given, replace(model, {"jamming.c4": c4}), s, kept=kept, substeps=2, how=FAST)

    c4 = jnp.array([11.0, 12.0, 14.0])
    many = batch.over(one, threads=1)(c4, jax.tree.map(lambda *x: jnp.stack(x), *scenarios))
    for i, s in enumerate(scenarios):
        alone = simulate(made.law, replace(model, {"jamming.c4": c4[i]}), s)
        np.testing.assert_allclose(many.q[i], alone.q, atol=1e-9)


GAINS = ("gamma", "damping", "integral", "compensation", "filter_s", "still_rad_s")
PATHS = (
    "jamming.c4",
    "elastic.c3",
    "friction.mu_s",
    "friction.mu_c",
    "chain.segment_mass_kg",
    "effects.friction_saturation.rise",
)


def test_derivatives_by_gains_robot_and_delay_are_those_of_differences(robot):
    """Of the law designed from the gains, and of the robot apart from its design, through sampling and limits."""
    model = robot(effects={"friction_saturation": {"rise": 3.0}})
    made = design(model, "observer", gains={"damping": 5.0}, hardware=Hardware(theta_max_rad=0.25))
    hardware = Hardware(*(jnp.asarray(x) for x in Hardware(theta_max_rad=0.25)))
    plan = scenario(made.law, THETA, _middle(made), 0.35, compute_ticks=1.3)
    base = made.law.gains._replace(**{name: jnp.asarray(x) for name, x in made.law.gains._asdict().items()})
    weights = jnp.linspace(0.5, 1.5, len(plan.theta))

    def loss(x):
        gains = base._replace(**{name: x[f"gains.{name}"] for name in GAINS})
        driven = replace(model, {path: x[path] for path in PATHS})
        late = plan._replace(compute_s=x["delay"])
        loop = run(build(model, "observer", gains, hardware), driven, late, kept=4, substeps=2, how=FAST)
        return 100 * jnp.mean(weights * (loop.theta - THETA) ** 2) + 1e-3 * jnp.mean(loop.left)

    x = {f"gains.{name}": jnp.asarray(getattr(made.law.gains, name)) for name in GAINS}
    x |= {path: get(model, path) for path in PATHS} | {"delay": plan.compute_s}
    value = jax.jit(loss)
    slope = jax.jit(jax.grad(loss))(x)
    for name in x:
        h = 1e-5 * x[name]
        difference = (value({**x, name: x[name] + h}) - value({**x, name: x[name] - h})) / (2 * h)
        assert float(slope[name]) == pytest.approx(float(difference), rel=1e-5, abs=1e-9), name


def test_commands_out_of_reach_and_laws_of_other_robots_are_refused(designs, robot):
    made = designs["integral"]
    with pytest.raises(InputError, match="scenario: theta = 0.5 rad"):
        scenario(made.law, [0.1, 0.5], _middle(made), 0.01)
    with pytest.raises(InputError, match="the law is for 2 segments, the model has 3"):
        simulate(made.law, robot(3), scenario(made.law, 0.1, _middle(made), 0.1))


NOTHING = {
    "a duration below a tick": ({"duration_s": 0.001}, "scenario: duration_s = 0.001: expected a period of the law"),
    "no duration": ({"duration_s": float("nan")}, "scenario: duration_s = nan: expected a number from 0 on"),
    "no end": ({"duration_s": float("inf")}, "scenario: duration_s = inf: expected a number from 0 on"),
    "a command before its measurement": ({"compute_ticks": -1.0}, "scenario: compute_ticks = -1.0: expected a number"),
    "a sensor that sees ahead": ({"sensor_s": -0.01}, "scenario: sensor_s = -0.01: expected a number from 0 on"),
    "noise that is none": ({"noise_rad": float("nan")}, "scenario: noise_rad = nan: expected a number from 0 on"),
    "angles for other ticks": (
        {"theta": [0.1, 0.1, 0.1]},
        "scenario: theta has the shape (3,); expected a number or 4",
    ),
    "one stiffness a row": (
        {"stiffness": [[1e4]] * 4},
        "scenario: stiffness has the shape (4, 1); expected a number or",
    ),
    "angles of other joints": (
        {"shape": [0.1]},
        "scenario: shape has the shape (1,); expected a number or 2, one a jo",
    ),
    "an angle that is none": ({"theta": [0.1, float("nan"), 0.1, 0.1]}, "scenario: theta holds a number that is not"),
    "a shape without end": ({"shape": float("inf")}, "scenario: shape holds a number that is not finite"),
}


@pytest.mark.parametrize("case", NOTHING)
def test_a_scenario_that_is_none_is_refused_in_a_line(designs, case):
    made = designs["integral"]
    more, said = NOTHING[case]
    given: Any = {"theta": 0.1, "stiffness": _middle(made), "duration_s": 0.02} | more
    with pytest.raises(InputError) as error:
        scenario(made.law, **given)
    assert str(error.value).startswith(said) and "\n" not in str(error.value)


def test_a_slow_law_gets_more_solver_steps(designs):
    given = designs["integral"].law
    assert [substeps_of(dataclasses.replace(given, period_s=t)) for t in (0.001, 0.0025, 0.005, 0.02)] == [1, 1, 2, 8]
