"""What a run does from tick to tick: a control law that follows a schedule."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

from ljjax import law
from ljjax.errors import InputError, read_file
from ljjax.law import Command, Law, Measured
from ljjax.rig.gate import Sent
from ljjax.rig.safety import Seen

SCHEMA = "ljjax.schedule/1"


class Task(Protocol):
    """What the loop asks for tensions and vacuum, `period_s` apart, for `seconds`.

    `tick` gets the time since the run began [s], negative while it is ramped in (from −`ramp_s` on), what can be
    believed of the robot, and what it was last told. It may raise InputError, which is a fault.
    """

    name: str
    period_s: float
    seconds: float

    def tick(self, t: float, seen: Seen, sent: Sent) -> tuple[float, float, float]: ...


class Point(NamedTuple):
    """From this time on [s]: a mean segment angle [rad] and a transverse tip stiffness [N/m]."""

    t: float
    command: Command


class Follow:
    """A law that follows a schedule.

    Before the first tick the law takes over from what the robot was told last; while the run is ramped in, its command
    goes from where the robot is to the schedule's first.
    """

    def __init__(self, given: Law, points: Sequence[Point], seconds: float, ramp_s: float, name: str = "law"):
        self.law, self.period_s, self.seconds, self.name = given, float(given.period_s), seconds, name
        self._points, self._ramp_s, self._n = tuple(points), ramp_s, float(given.robot.segments)
        self._next, self._now, self._first = 1, points[0].command, points[0].command
        self._state: law.State | None = None

    def tick(self, t: float, seen: Seen, sent: Sent) -> tuple[float, float, float]:
        """One tick of the law, told what the gate let through at the last one."""
        vacuum = sent.vacuum if seen.vacuum != seen.vacuum else seen.vacuum  # no gauge: what was commanded
        q_sum = self._n * seen.theta
        if self._state is None:
            self._state = law.start(self.law, q_sum, vacuum, sent.left, sent.right)
            low, high = -self.law.limits.theta_max_rad, self.law.limits.theta_max_rad
            self._first = Command(min(max(seen.theta, low), high), self.law.limits.stiffness_min_n_m)
        state = self._state._replace(net=sent.left - sent.right, level=0.5 * (sent.left + sent.right))
        self._state, out = law.tick(self.law, state, Measured(q_sum, vacuum), self._command(t))
        return out.left, out.right, out.vacuum

    def _command(self, t: float) -> Command:
        while self._next < len(self._points) and self._points[self._next].t <= t:
            self._now = self._points[self._next].command
            self._next += 1
        if t >= 0 or self._ramp_s <= 0:
            return self._now
        a, b, way = self._first, self._now, 1 + max(t / self._ramp_s, -1.0)
        return Command(a.theta + way * (b.theta - a.theta), a.stiffness + way * (b.stiffness - a.stiffness))


def follow(
    given: Law, points: Sequence[Point], seconds: float, ramp_s: float, where: str = "command", name: str = "law"
) -> Follow:
    """A task of a law, refused before anything moves where a command is beyond its reach.

    Raises:
        InputError: a command out of reach, no time to run, points that are not in order.
    """
    if not 0 < seconds < float("inf"):
        raise InputError(f"{where}: seconds = {seconds:g}; expected how long to run, > 0")
    for k, (before, after) in enumerate(zip(points, points[1:], strict=False), 1):
        if after.t <= before.t:
            raise InputError(f"{where}: points[{k}].t_s = {after.t:g} is not after {before.t:g}; put them in order")
    for k, point in enumerate(points):
        law.refuse_beyond(given, point.command, f"{where}: points[{k}]" if len(points) > 1 else where)
    return Follow(given, points, seconds, ramp_s, name)


def load_schedule(path: str | os.PathLike[str]) -> tuple[list[Point], float]:
    """The points of a schedule file (TOML, schema ljjax.schedule/1), and its seconds.

    Raises:
        InputError: no such file, not TOML, a key or number that is missing or unknown.
    """
    import math

    where = os.fspath(path)
    _, data = read_file(path, tomllib.loads, "TOML", "give a schedule, as docs/rig.md shows one")
    if data.get("schema") != SCHEMA:
        raise InputError(f"{where}: schema is {data.get('schema')!r}; expected {SCHEMA!r}")
    if set(data) != {"schema", "seconds", "points"} or not isinstance(data["points"], list) or not data["points"]:
        raise InputError(f"{where}: expected schema, seconds, and one [[points]] or more")
    points = []
    for k, row in enumerate(data["points"]):
        if not isinstance(row, dict) or set(row) != {"t_s", "theta_deg", "stiffness_n_m"}:
            raise InputError(f"{where}: points[{k}]: expected t_s, theta_deg and stiffness_n_m")
        t, theta, stiffness = (_number(f"{where}: points[{k}].{key}", row[key]) for key in sorted(row, key=_ORDER))
        points.append(Point(t, Command(math.radians(theta), stiffness)))
    return points, _number(f"{where}: seconds", data["seconds"])


_ORDER = ("t_s", "theta_deg", "stiffness_n_m").index


def _number(where: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{where} is {value!r}; expected a number")
    return float(value)
