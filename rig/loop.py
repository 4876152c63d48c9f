"""The loop: read, watch, ask the task, pass the gate, command, log. A person should read this before trusting it.

    wait      until every sensor has said something good; nothing is commanded
    ramp_in   the task's first command is approached
    run       the task
    ramp_out  tensions fall to zero at the rate of release, the vacuum is vented or held
    safe      the same after a fault, which latches

Every tick has a deadline on the monotonic clock. A tick that comes late is counted, and the ticks it has missed are
left out, not made up for. What leaves for the robot has passed the gate, in every state.
"""

from __future__ import annotations

import gc
from collections.abc import Callable
from typing import NamedTuple, Protocol

from ljjax.errors import InputError
from ljjax.rig.clock import Clock
from ljjax.rig.config import Config
from ljjax.rig.gate import Gate, Sent
from ljjax.rig.robot import Reading, Robot
from ljjax.rig.safety import Fault, Watch
from ljjax.rig.task import Task

STATES = ("wait", "ramp_in", "run", "ramp_out", "safe")
WAIT, RAMP_IN, RUN, RAMP_OUT, SAFE = range(5)


class Tick(NamedTuple):
    """What a tick was: its time [s, monotonic], state, how late it came, how long the last one took [s], deadlines
    missed and angles rejected so far, what was sent, what was read, and the faults so far."""

    t: float
    state: int
    late_s: float
    busy_s: float
    missed: int
    rejected: int
    sent: Sent
    reading: Reading
    faults: dict[str, Fault]


class Log(Protocol):
    """Where ticks go, without waiting; `trouble` says what is wrong with it, or nothing."""

    def tick(self, tick: Tick) -> None: ...

    def trouble(self) -> str: ...


class Outcome(NamedTuple):
    """How a run ended: its faults by name, ticks, deadlines missed, the worst lateness and the longest tick [s]."""

    faults: dict[str, Fault]
    ticks: int
    missed: int
    worst_late_s: float
    worst_busy_s: float

    @property
    def fault(self) -> Fault | None:
        """The first fault, which stopped the run, or None."""
        return next(iter(self.faults.values()), None)

    @property
    def end_reason(self) -> str:
        """As the log's metadata says it."""
        return "completed" if self.fault is None else f"fault: {self.fault}"


def run(task: Task, robot: Robot, config: Config, log: Log, *, clock: Clock | None = None, vent: bool | None = None,
        stopped: Callable[[], str] = str) -> Outcome:  # fmt: skip
    """Connect, run a task once, leave the robot without tension and stopped, whatever happens.

    Args:
        task: what to do, as from `ljjax.rig.task.follow` or `ljjax.rig.experiments`.
        robot, config: the robot, not connected yet, and its rig.toml.
        log: takes every tick, such as a `ljjax.rig.recorder.Recorder`.
        clock: another clock than the monotonic one, for tests.
        vent: whether the vacuum is vented at the end and after a fault; by default as rig.toml says.
        stopped: asked every tick; says who stopped the run, or nothing.

    Raises:
        RigError: the hardware cannot be opened. Whatever goes wrong later is a fault, and in the outcome.
    """
    vent = config.safety.vacuum == "vent" if vent is None else vent
    gc.collect()
    collecting = gc.isenabled()
    gc.disable()
    try:
        robot.connect()
        return _loop(task, robot, config, log, clock or Clock(), vent, stopped)
    finally:
        robot.stop(vent)
        if collecting:
            gc.enable()


def _loop(task: Task, robot: Robot, config: Config, log: Log, clock: Clock, vent: bool,
          stopped: Callable[[], str]) -> Outcome:  # fmt: skip
    safety, period = config.safety, task.period_s
    gate, watch = Gate(config.limits, period, safety.release_n_s), Watch(config.limits, safety, period)
    state, reading, sent = WAIT, Reading(), gate.sent
    ticks, missed, busy, worst_late, worst_busy = 0, 0, 0.0, 0.0, 0.0
    deadline = start = clock.now()
    while True:
        clock.wait(deadline)
        now = clock.now()
        late = now - deadline
        skipped = max(0, int(late / period))
        deadline += period * (1 + skipped)
        if state != WAIT:
            missed, worst_late = missed + skipped, max(worst_late, late)
            watch.late(now, late, skipped)

        try:
            reading = robot.read()
        except (InputError, OSError) as error:
            watch.latch("hardware", f"cannot be read: {error}", now)
        seen = watch.look(now, reading)
        if state != WAIT:
            watch.judge(now, reading, sent)
        if who := stopped():
            watch.latch("operator", who, now)
        if trouble := log.trouble():
            watch.latch("log", trouble, now)

        lacking = watch.lacking()
        if state == WAIT and not lacking:
            gate.start(seen.vacuum)
            state, sent, start = RAMP_IN, gate.sent, now + safety.ramp_s
        elif state == WAIT and now - start > safety.first_s:
            watch.latch("no_reading", f"{lacking}: nothing good in {safety.first_s:g} s", now)
        if state == RAMP_IN and now >= start:
            state = RUN
        if state == RUN and now - start >= task.seconds:
            state = RAMP_OUT
        if watch.fault is not None:
            if state == WAIT:  # nothing has been commanded, and nothing is
                log.tick(Tick(now, SAFE, late, busy, missed, watch.rejected, sent, reading, watch.faults))
                return Outcome(watch.faults, ticks, missed, worst_late, worst_busy)
            state = SAFE

        wanted = Sent(0.0, 0.0, 0.0 if vent else sent.vacuum)
        if state in (RAMP_IN, RUN):
            try:
                wanted = task.tick(now - start, seen, sent)
            except (InputError, ArithmeticError) as error:
                watch.latch("task", str(error), now)
                state = SAFE
        taken = None
        if state != WAIT:
            sent = gate.let(now, *wanted, releasing=state >= RAMP_OUT)
            try:
                taken = robot.command(*sent)
            except (InputError, OSError) as error:
                watch.latch("hardware", f"takes no command: {error}", now)
        told = Sent(*(taken or sent[:2]), sent.vacuum)
        log.tick(Tick(now, state, late, busy, missed, watch.rejected, told, reading, watch.faults))

        ticks += 1
        busy = clock.now() - now
        worst_busy = max(worst_busy, busy)
        if state >= RAMP_OUT and sent.left == sent.right == 0.0 and (sent.vacuum == 0.0 or not vent):
            return Outcome(watch.faults, ticks, missed, worst_late, worst_busy)
