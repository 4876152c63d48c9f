"""Whatever a law or a plan says, no tension is above its limit, and none moves faster than its slew."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ljjax.rig.gate import Gate, Sent
from ljjax.rig.loop import run
from ljjax.rig.mock import MockRobot
from ljjax.rig.safety import Seen

from .conftest import FakeClock, configured
from .test_faults import Kept

ANY = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True), st.sampled_from([0.0, 30.0, 31.0, -1.0, 1e300, math.inf, math.nan])
)


class Nasty:
    """Asks for whatever it was given."""

    name, period_s, seconds = "nasty", 0.005, 1.0

    def __init__(self, asked: list[tuple[float, float, float]]):
        self._asked, self._k = asked, 0

    def tick(self, t: float, seen: Seen, sent: Sent) -> tuple[float, float, float]:
        self._k += 1
        return self._asked[self._k // 20 % len(self._asked)]


@settings(max_examples=15, deadline=None)
@given(asked=st.lists(st.tuples(ANY, ANY, ANY), min_size=1, max_size=12), late=st.floats(0, 0.02), stop=st.floats(0, 3))
def test_no_tension_above_its_limit_ever(asked: list[tuple[float, float, float]], late: float, stop: float):
    clock = FakeClock(lambda t: late if int(t * 20) % 3 == 0 else 0.0)
    about = configured("missed_share = 1.0")
    told: list[tuple[float, float, float, float]] = []

    class Spied(MockRobot):
        def command(self, left_n: float, right_n: float, vacuum_kpa: float) -> None:
            told.append((clock.t, left_n, right_n, vacuum_kpa))
            super().command(left_n, right_n, vacuum_kpa)

    robot = Spied(about.mock, clock.now)
    run(Nasty(asked), robot, about, Kept(), clock=clock, stopped=lambda: "me" if clock.t > 1000 + stop else "")
    limits = about.limits
    before = (told[0][0] - 1.0, 0.0, 0.0, told[0][3]) if told else (0.0, 0.0, 0.0, 0.0)
    for now in told:
        dt = now[0] - before[0]
        for k, (most, slew) in {
            1: (limits.tension_max_n, limits.tension_slew_n_s),
            2: (limits.tension_max_n, limits.tension_slew_n_s),
            3: (limits.vacuum_max_kpa, limits.vacuum_slew_kpa_s),
        }.items():
            assert 0 <= now[k] <= most
            assert abs(now[k] - before[k]) <= slew * min(dt, 0.005) + 1e-9
        before = now
    assert robot.wanted[:2] == (0.0, 0.0)


def test_what_is_no_number_changes_nothing():
    gate = Gate(configured().limits, 0.005, 40.0)
    gate.start(12.0)
    assert gate.let(0.0, 0.5, 0.5, 12.1) == (0.5, 0.5, pytest.approx(12.1))
    assert gate.let(0.005, math.nan, math.inf, -math.inf) == (0.5, 0.5, pytest.approx(12.1))


def test_a_late_loop_does_not_catch_up_in_one_jump():
    gate = Gate(configured().limits, 0.005, 40.0)
    assert gate.let(0.0, 30.0, 0.0, 0.0).left == 1.0
    assert gate.let(5.0, 30.0, 0.0, 0.0).left == 2.0
    assert gate.let(5.001, 30.0, 0.0, 0.0).left == pytest.approx(2.2)
    assert gate.let(4.0, 30.0, 0.0, 0.0).left == pytest.approx(2.2)  # time that went back moves nothing
    assert gate.let(4.005, 0.0, 0.0, 0.0, releasing=True).left == pytest.approx(2.0)
