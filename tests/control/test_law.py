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
MIDDLE = 6000.0
"""A stiffness in reach of the laws of two segments [N/m]."""


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
    _, output = settle(given, Measured(q_sum, u_p), Command(theta, MIDDLE))
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
        state, output = law.tick(given, state, Measured(q_sum, 0.0), Command(0.0, MIDDLE))
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
    for k, now in ((1, left), (-1, right)):
        before = ticks[:, 5] + 0.5 * k * ticks[:, 4]
        assert np.abs(now - before).max() <= limits.tension_slew_n_s * t + 1e-5


def wild(rng: np.random.Generator, size: float) -> float:
    """Any finite number: about as large as is usual, 0, or of any exponent."""
    return float(rng.choice([rng.normal() * size, 0.0, rng.normal() * 10.0 ** rng.uniform(-300, 300)]))


@pytest.mark.parametrize("kind", LAWS)
def test_whatever_it_starts_from_and_is_told_tensions_and_vacuum_keep_their_slew(designs, kind):
    """From slack tendons, or tensions and a vacuum above their limits, which it leaves at the slew and for good."""
    made: Law = designs[kind].law
    given = dataclasses.replace(made, limits=made.limits._replace(tension_slew_n_s=50.0))
    limits, t, rng = given.limits, given.period_s, np.random.default_rng(3)
    most = limits.tension_max_n, limits.tension_max_n, limits.vacuum_max_kpa
    least = limits.tension_min_n, limits.tension_min_n, 0.0
    slew = limits.tension_slew_n_s * t, limits.tension_slew_n_s * t, limits.vacuum_slew_kpa_s * t
    for k in range(150):
        last = [0.0 if rng.random() < 0.3 else float(rng.uniform(0, 1.4 * x)) for x in most]
        state = law.start(given, wild(rng, 0.3), last[2], *last[:2])
        assert isinstance(state, State)
        inputs = [
            (Measured(wild(rng, 0.3), wild(rng, 30.0)), Command(wild(rng, 0.2), wild(rng, 5e3)))
            if k % 2
            else (Measured(0.3 * rng.normal(), 10.0), Command(0.2, 5e3))
            for _ in range(40)
        ]
        for measured, command in inputs:
            state, output = law.tick(given, state, measured, command)
            for now, before, low, high, step in zip(output, last, least, most, slew, strict=True):
                assert now >= min(low, before + step) - 1e-12 and now >= 0
                assert now <= max(high, before - step) + 1e-12
                assert abs(now - before) <= step + 1e-9
            last = list(output)


def test_a_tendon_that_was_slack_is_drawn_in_at_the_slew(designs):
    made: Law = designs["integral"].law
    given = dataclasses.replace(made, limits=made.limits._replace(tension_slew_n_s=50.0))
    drawn = [(0.0, 0.0, 0.25, 0.25), (80.0, 10.0, 79.75, 10.25), (-0.3, 0.0, 0.25, 0.25)]
    for left, right, then_left, then_right in drawn:
        _, output = law.tick(given, law.start(given, 0.0, 0.0, left, right), Measured(0.0, 0.0), Command(0.0, MIDDLE))
        assert output[:2] == pytest.approx((then_left, then_right), abs=1e-12)
    for vacuum, then in ((-0.3, 0.0), (50.0, 49.75)):
        state = law.start(given, 0.0, vacuum, 1.0, 1.0)
        _, output = law.tick(given, state, Measured(0.0, 0.0), Command(0.0, given.limits.stiffness_min_n_m))
        assert output.vacuum == pytest.approx(then, abs=1e-12)


@pytest.mark.parametrize("kind", LAWS)
def test_a_tick_of_nonsense_is_forgotten(designs, kind):
    """A bend of 10³⁰⁷ rad counts as that of joints bent to π, and a second later the law is where it was."""
    given: Law = designs[kind].law
    at = Measured(0.2, 5.0), Command(0.1, MIDDLE)
    calm, before = settle(given, *at)
    for nonsense in (1e307, -1e250, 1e36):
        state, output = law.tick(given, calm, Measured(nonsense, 5.0), at[1])
        assert all(map(math.isfinite, (*state, *output)))
        assert abs(state.q_sum) == given.robot.segments * math.pi
        for _ in range(200):
            state, output = law.tick(given, state, *at)
        assert state.rate == pytest.approx(0.0, abs=1e-6)
        if kind == "passivity":
            assert output == pytest.approx(before, abs=1e-6)


@pytest.mark.parametrize("kind", LAWS)
def test_tensions_never_move_faster_than_they_may(designs, kind):
    given: Law = designs[kind].law
    rng = np.random.default_rng(0)
    state = law.start(given, 0.0, 0.0, given.limits.tension_min_n, given.limits.tension_min_n)
    last = given.limits.tension_min_n, given.limits.tension_min_n
    for k in range(400):
        theta = 0.3 * (-1) ** (k // 40) if k < 200 else 0.02 * rng.normal()
        state, output = law.tick(given, state, Measured(0.5 * rng.normal(), 10.0), Command(theta, MIDDLE))
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
        held = settle(given, Measured(q_sum, 0.0), Command(theta, MIDDLE), 1)[0]
        calm = (0.0205 * math.sin(q_sum) - gains.gamma * math.sin(error) + 1.861 * theta) / 0.02
        now = calm if net is None else net
        level = given.limits.tension_min_n + 0.5 * abs(now)
        state = held._replace(q_sum=state.q_sum, rate=rate, integral=0.0, net=now, level=level)
        return law.tick(given, state, Measured(q_sum, 0.0), Command(theta, MIDDLE))[0].integral

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
        state, _ = law.tick(given, state, Measured(q_sum, 0.0), Command(0.1, MIDDLE))
    beyond = v - given.gains.still_rad_s
    rho = robot.mu_c + (robot.mu_s - robot.mu_c) * math.exp(-((beyond / robot.v_s) ** robot.sigma3))
    assert state.bristle == pytest.approx(rho / robot.sigma0, rel=1e-3)


def test_a_measurement_that_is_no_number_is_refused(designs):
    given: Law = designs["integral"].law
    state = law.start(given, 0.0, 0.0, 1.0, 1.0)
    with pytest.raises(InputError, match="measured.q_sum is nan"):
        law.tick(given, state, Measured(math.nan, 0.0), Command(0.1, MIDDLE))


def test_a_state_that_is_no_number_neither_begins_nor_goes_on(designs):
    given: Law = designs["integral"].law
    for i, name in enumerate(("q_sum", "vacuum", "left", "right")):
        numbers = [0.0, 0.0, 1.0, 1.0]
        for numbers[i] in (math.nan, math.inf):
            with pytest.raises(InputError, match=f"start: {name} is"):
                law.start(given, *numbers)
    with pytest.raises(InputError, match=r"state\.level is inf"):
        law.start(given, 0.0, 0.0, 1.7e308, 1.7e308)
    state = law.start(given, 0.0, 0.0, 1.0, 1.0)
    for name in State._fields:
        with pytest.raises(InputError, match=rf"state\.{name} is nan: hold the last output, and start the law again"):
            law.tick(given, state._replace(**{name: math.nan}), Measured(0.0, 0.0), Command(0.1, MIDDLE))
    broken = dataclasses.replace(given, gains=given.gains._replace(damping=math.nan))
    with pytest.raises(InputError, match="state.net is nan"):
        law.tick(broken, state, Measured(0.0, 0.0), Command(0.1, MIDDLE))


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
