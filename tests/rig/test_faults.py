"""The fault table: what is detected, in how long, what the robot is told. On the mock, in a time of its own."""

from __future__ import annotations

import math

import pytest

from ljjax.errors import InputError
from ljjax.rig.config import Config
from ljjax.rig.gate import Sent
from ljjax.rig.loop import RAMP_IN, RAMP_OUT, RUN, SAFE, Outcome, Tick, run
from ljjax.rig.mock import MockRobot
from ljjax.rig.robot import Reading
from ljjax.rig.safety import Seen

from .conftest import FakeClock, configured, mock_robot

BEGIN_S, TICK_S = 2.0, 0.005

FAULTS = {
    "camera_frozen": ("camera_stale", 0.1),
    "camera_stuck": ("camera_stuck", 2.0),
    "tag_lost": ("tag_lost", 0.1),
    "tag_jump": ("tag_jump", 0.1),
    "gauge_frozen": ("gauge_stale", 0.5),
    "gauge_stuck": ("gauge_stuck", 2.0),
    "gauge_nan": ("gauge_nan", 0.5),
    "leak": ("vacuum_leak", 2.3),
    "servo_error": ("hardware", 0.0),
    "unplugged": ("hardware", 0.0),
    "tendon_cut": ("tension_off", 0.9),
    "hot": ("temperature_limit", 0.0),
    "overcurrent": ("current_limit", 0.0),
}
"""What happens to the mock: the fault's name, and the longest time until it latches [s]."""


class Wiggle:
    """Tensions and a vacuum that never rest."""

    name, period_s, seconds = "wiggle", TICK_S, 6.0

    def tick(self, t: float, seen: Seen, sent: Sent) -> tuple[float, float, float]:
        return 13 + 8 * math.sin(3 * t), 13 - 8 * math.sin(3 * t), 22 + 8 * math.sin(2 * t)


class Kept:
    """A log in memory."""

    def __init__(self):
        self.ticks: list[Tick] = []
        self.names: list[list[str]] = []
        self.wrong = ""

    def tick(self, tick: Tick) -> None:
        self.ticks.append(tick)
        self.names.append(list(tick.faults))

    def trouble(self) -> str:
        return self.wrong


def calm(about: Config, log: Kept, outcome: Outcome, robot: MockRobot) -> None:
    """Once it is in the safe state, a robot's tensions only fall, at the rate of release at most, down to zero."""
    safe = [tick.sent for tick in log.ticks if tick.state == SAFE]
    most = about.safety.release_n_s * TICK_S + 1e-9
    for before, after in zip(safe, safe[1:], strict=False):
        for a, b in zip(before[:2], after[:2], strict=True):
            assert 0 <= a - b <= most
    assert outcome.fault is not None and safe[-1][:2] == (0.0, 0.0)
    assert not robot.connected and robot.wanted[:2] == (0.0, 0.0)
    assert log.names[-1][0] == outcome.fault.name


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_latches_is_named_and_lets_go(fault: str, clock: FakeClock):
    about = configured("tension_off_n = 8.0", f"fault = '{fault}'\nfault_s = {BEGIN_S}")
    robot, log = mock_robot(about, clock), Kept()
    about = _with_current(about)
    begun = clock.t
    outcome = run(Wiggle(), robot, about, log, clock=clock)
    name, within = FAULTS[fault]
    assert outcome.fault is not None and outcome.fault.name == name
    assert 0 <= outcome.fault.t - begun - BEGIN_S <= within + 4 * TICK_S
    assert outcome.end_reason == f"fault: {outcome.fault}" and outcome.fault.detail
    calm(about, log, outcome, robot)


def _with_current(about: Config) -> Config:
    import dataclasses

    return dataclasses.replace(about, limits=dataclasses.replace(about.limits, current_max_ma=2000.0))


def test_without_a_fault_it_completes_and_vents(clock: FakeClock):
    about, log = configured(), Kept()
    robot = mock_robot(about, clock)
    outcome = run(Wiggle(), robot, about, log, clock=clock)
    assert (outcome.end_reason, outcome.missed, outcome.faults) == ("completed", 0, {})
    assert list(dict.fromkeys(tick.state for tick in log.ticks)) == [RAMP_IN, RUN, RAMP_OUT]
    assert log.ticks[-1].sent == (0.0, 0.0, 0.0) and not robot.connected


@pytest.mark.parametrize("vent", [True, False])
def test_the_vacuum_is_vented_or_held(vent: bool, clock: FakeClock):
    about, log = configured("", "fault = 'hot'\nfault_s = 2.0"), Kept()
    robot = mock_robot(about, clock)
    run(Wiggle(), robot, about, log, clock=clock, vent=vent)
    safe = [tick.sent.vacuum for tick in log.ticks if tick.state == SAFE]
    assert safe[-1] == 0 if vent else len(set(safe)) == 1 and safe[0] > 5
    assert robot.wanted[2] == safe[-1]


def test_one_picture_without_the_tag_or_with_a_jump_is_not_believed_and_no_fault(clock: FakeClock):
    about, log = configured(), Kept()

    class Blinks(MockRobot):
        def read(self) -> Reading:
            r = super().read()
            k = round(r.t_shape / 0.015)
            return r._replace(theta=math.nan if k % 40 == 1 else r.theta + 0.5 if k % 40 == 21 else r.theta)

    believed: list[float] = []

    class Look(Wiggle):
        def tick(self, t: float, seen: Seen, sent: Sent) -> tuple[float, float, float]:
            believed.append(seen.theta)
            return super().tick(t, seen, sent)

    outcome = run(Look(), Blinks(about.mock, clock.now), about, log, clock=clock)
    assert outcome.fault is None and log.ticks[-1].rejected > 5
    assert all(abs(theta) < 0.2 for theta in believed)


def test_a_late_tick_and_missed_deadlines(clock: FakeClock):
    about, log = configured(), Kept()
    for late, name in ((lambda t: 0.3 if 2.0 < t < 2.1 else 0.0, "late_loop"), (lambda t: 0.013, "deadlines_missed")):
        slow = FakeClock(late)
        robot = mock_robot(about, slow)
        outcome = run(Wiggle(), robot, about, log, clock=slow)
        assert outcome.fault is not None and outcome.fault.name == name and outcome.missed >= 1
        calm(about, log, outcome, robot)
        log = Kept()


def test_an_operator_a_task_and_a_log_stop_it(clock: FakeClock):
    about = configured()

    class Raises(Wiggle):
        def tick(self, t: float, seen: Seen, sent: Sent) -> tuple[float, float, float]:
            if t > 1:
                raise InputError("output.left is nan: hold the last output")
            return super().tick(t, seen, sent)

    for case in ("operator", "task", "log"):
        log, robot = Kept(), mock_robot(about, clock)
        begun = clock.t

        def stopped(case: str = case, log: Kept = log, begun: float = begun) -> str:
            log.wrong = "disk full" if case == "log" and clock.t > begun + 2 else ""
            return "Ctrl-C" if case == "operator" and clock.t > begun + 2 else ""

        task = Raises() if case == "task" else Wiggle()
        outcome = run(task, robot, about, log, clock=clock, stopped=stopped)
        assert outcome.fault is not None and outcome.fault.name == case
        calm(about, log, outcome, robot)


def test_a_sensor_that_never_speaks_stops_it_before_anything_moves(clock: FakeClock):
    about, log = configured("", "fault = 'tag_lost'\nfault_s = 0.0"), Kept()
    commands: list[tuple[float, float, float]] = []

    class Spied(MockRobot):
        def command(self, left_n: float, right_n: float, vacuum_kpa: float) -> None:
            commands.append((left_n, right_n, vacuum_kpa))

    outcome = run(Wiggle(), Spied(about.mock, clock.now), about, log, clock=clock)
    assert outcome.fault is not None and outcome.fault.name == "no_reading" and "the angle" in outcome.fault.detail
    assert commands == []


def test_what_breaks_the_loop_still_stops_the_robot(clock: FakeClock):
    about = configured()
    robot = mock_robot(about, clock)

    class Broken(Wiggle):
        def tick(self, t: float, seen: Seen, sent: Sent) -> tuple[float, float, float]:
            raise RuntimeError("ours")

    with pytest.raises(RuntimeError, match="ours"):
        run(Broken(), robot, about, Kept(), clock=clock)
    assert not robot.connected and robot.wanted[:2] == (0.0, 0.0)


def test_a_first_fault_stays_the_first(clock: FakeClock):
    about, log = configured("", "fault = 'hot'\nfault_s = 2.0"), Kept()

    class Worse(MockRobot):
        def read(self) -> Reading:
            r = super().read()
            return r._replace(faults=("overload",)) if r.temperature_c > 90 and clock.t > 1002.1 else r

    outcome = run(Wiggle(), Worse(about.mock, clock.now), about, log, clock=clock)
    assert list(outcome.faults) == ["temperature_limit", "hardware"]
    assert outcome.end_reason.startswith("fault: temperature_limit: 95")
