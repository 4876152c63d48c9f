"""One tick of the law on Python floats: the equations, and limits that hold whatever it is told."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from ljjax import law
from ljjax.control.runtimes import by_python, random_ticks
from ljjax.errors import InputError
from ljjax.law import Command, Law, Measured, State
from ljjax.law.step import root_of, vacuum_of

LAWS = tuple(law.KINDS)
LEFT, RIGHT = 7, 8


def settle(given: Law, measured: Measured, command: Command, ticks: int = 400):
    state = law.start(given, measured.q_sum, measured.vacuum, 1.0, 1.0)
    output = None
    for _ in range(ticks):
        state, output = law.tick(given, state, measured, command)
    assert output is not None
    return state, output


def test_at_rest_the_published_law_is_its_equation(designs):
    given: Law = designs["passivity"].law
    theta, q_sum, u_p = 0.12, 0.2, 10.0
    _, output = settle(given, Measured(q_sum, u_p), Command(theta, 60.0))
    alpha2 = -0.0017 * u_p**2 + 0.102 * u_p + 1.861
    wanted = 0.0205 * math.sin(q_sum) - given.gains.gamma * math.sin(q_sum - 2 * theta) + alpha2 * theta
    assert output.left - output.right == pytest.approx(
        wanted / 0.02, rel=1e-4
    )  # tables: straight lines between entries


def test_damping_resists_the_filtered_rate(designs):
    given: Law = designs["passivity"].law
    state = law.start(given, 0.0, 0.0, 1.0, 1.0)
    rate, q_sum, nets = 0.4, 0.0, []
    for _ in range(60):
        q_sum += rate * given.period_s
        state, output = law.tick(given, state, Measured(q_sum, 0.0), Command(0.0, 60.0))
        nets.append(output.left - output.right)
    assert state.rate == pytest.approx(rate, rel=1e-6)
    static = 0.0205 * math.sin(q_sum) - given.gains.gamma * math.sin(q_sum)
    assert nets[-1] == pytest.approx(static / 0.02 - given.gains.damping * 0.02 * rate, rel=1e-6)


@pytest.mark.parametrize("kind", LAWS)
def test_whatever_it_is_told_it_keeps_its_limits(designs, kind):
    given: Law = designs[kind].law
    limits, t = given.limits, given.period_s
    ticks = random_ticks(given, 3000, seed=1)
    out = by_python(given, ticks)
    left, right, vacuum = out[:, LEFT], out[:, RIGHT], out[:, 9]
    least, most = limits.tension_min_n - 1e-5, limits.tension_max_n + 1e-5  # the states before are rounded to float32
    assert (left >= least).all() and (right >= least).all() and (left <= most).all() and (right <= most).all()
    assert (vacuum >= 0).all() and (vacuum <= limits.vacuum_max_kpa).all()
    assert np.abs(vacuum - ticks[:, 6]).max() <= limits.vacuum_slew_kpa_s * t + 1e-9
    bend = given.robot.mu_s / given.robot.sigma0
    assert np.abs(out[:, 3]).max() <= bend
    for k, now in ((1, left), (-1, right)):  # from tick to tick, in a run with commands that jump
        before = ticks[:, 5] + 0.5 * k * ticks[:, 4]
        running = ticks[:, 5] <= np.maximum(limits.co_contraction_n, limits.tension_min_n + 0.5 * np.abs(ticks[:, 4]))
        assert np.abs(now - before)[running].max(initial=0.0) <= limits.tension_slew_n_s * t + 1e-5


@pytest.mark.parametrize("kind", LAWS)
def test_tensions_never_move_faster_than_they_may(designs, kind):
    given: Law = designs[kind].law
    rng = np.random.default_rng(0)
    state = law.start(given, 0.0, 0.0, given.limits.tension_min_n, given.limits.tension_min_n)
    last = given.limits.tension_min_n, given.limits.tension_min_n
    for k in range(400):
        theta = 0.3 * (-1) ** (k // 40) if k < 200 else 0.02 * rng.normal()
        state, output = law.tick(given, state, Measured(0.5 * rng.normal(), 10.0), Command(theta, 60.0))
        for now, before in zip(output[:2], last, strict=True):
            assert abs(now - before) <= given.limits.tension_slew_n_s * given.period_s + 1e-9
        last = output[:2]
    assert sum(last) >= 2 * given.limits.co_contraction_n - 1e-9


def test_a_vacuum_and_its_root_are_each_others_inverse():
    for u in (0.0, 1e-6, 1e-3, 0.5, 40.0):
        assert vacuum_of(law.ops, root_of(law.ops, u)) == pytest.approx(u, rel=1e-12, abs=1e-15)


def test_integral_action_waits_in_the_dead_zone_while_moving_and_against_a_limit(designs):
    given: Law = designs["integral"].law
    gains, n = given.gains, given.robot.segments
    theta = 0.1

    def change(error: float, rate: float = 0.0, net: float | None = None) -> float:
        q_sum = n * theta + error
        state = law.start(given, q_sum - rate * given.period_s, 0.0, 1.0, 1.0)
        held = settle(given, Measured(q_sum, 0.0), Command(theta, 60.0), 1)[0]
        calm = (0.0205 * math.sin(q_sum) - gains.gamma * math.sin(error) + 1.861 * theta) / 0.02
        state = held._replace(q_sum=state.q_sum, rate=rate, integral=0.0, net=calm if net is None else net)
        return law.tick(given, state, Measured(q_sum, 0.0), Command(theta, 60.0))[0].integral

    zone = n * gains.dead_zone_rad
    assert change(0.9 * zone) == 0.0
    assert change(-0.02) == pytest.approx(gains.integral * given.period_s * (math.sin(0.02) - zone), rel=1e-9)
    assert change(0.02) == pytest.approx(-change(-0.02), rel=1e-9)
    assert 0 < change(-0.02, rate=10 * n * gains.still_rad_s) < 0.02 * change(-0.02)
    assert change(-0.02, net=-30.0) == 0.0  # the tension is still on its way up
    assert change(-0.02, net=40.0) == pytest.approx(change(-0.02), rel=1e-9)  # and here on its way down


def test_the_observer_finds_the_friction_of_a_body_that_slides(designs):
    given: Law = designs["observer"].law
    robot, v = given.robot, 0.3
    state, q_sum = law.start(given, 0.0, 0.0, 1.0, 1.0), 0.0
    for _ in range(200):
        q_sum += robot.segments * v * given.period_s
        state, _ = law.tick(given, state, Measured(q_sum, 0.0), Command(0.1, 60.0))
    beyond = v - given.gains.still_rad_s
    rho = robot.mu_c + (robot.mu_s - robot.mu_c) * math.exp(-((beyond / robot.v_s) ** robot.sigma3))
    assert state.bristle == pytest.approx(rho / robot.sigma0, rel=1e-3)


def test_a_measurement_that_is_no_number_is_refused(designs):
    given: Law = designs["integral"].law
    state = law.start(given, 0.0, 0.0, 1.0, 1.0)
    with pytest.raises(InputError, match="measured.q_sum is nan"):
        law.tick(given, state, Measured(math.nan, 0.0), Command(0.1, 60.0))


def test_taking_over_a_body_at_rest_where_it_is_wanted_makes_no_bump(designs):
    given: Law = designs["observer"].law
    theta, n = 0.1, given.robot.segments
    hold = (0.0205 * math.sin(n * theta) + 1.861 * theta) / 0.02
    level = given.limits.tension_min_n + 0.5 * hold
    state = law.start(given, n * theta, 0.0, level + 0.5 * hold, level - 0.5 * hold)
    assert isinstance(state, State)
    _, output = law.tick(given, state, Measured(n * theta, 0.0), Command(theta, given.limits.stiffness_min_n_m))
    assert output == pytest.approx((level + 0.5 * hold, level - 0.5 * hold, 0.0), abs=1e-6)


def test_a_law_of_another_kind_with_the_same_numbers_differs_in_action_only(designs):
    given: Law = designs["integral"].law
    ticks = random_ticks(given, 200)
    plain = by_python(dataclasses.replace(given, kind="passivity"), ticks)
    with_i = by_python(given, ticks)
    np.testing.assert_array_equal(plain[:, [0, 1, 6]], with_i[:, [0, 1, 6]])
    assert np.abs(plain[:, 4] - with_i[:, 4]).max() > 0
