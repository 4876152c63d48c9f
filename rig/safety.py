"""What is wrong with a robot, tick by tick: faults by name, the first of which latches."""

from __future__ import annotations

import math
from typing import NamedTuple

from ljjax.rig.config import Limits, Safety
from ljjax.rig.gate import Sent
from ljjax.rig.robot import NAN, Reading


class Fault(NamedTuple):
    """What went wrong: its name, what was found in a few words, and when [s, monotonic]."""

    name: str
    detail: str
    t: float

    def __str__(self) -> str:
        return f"{self.name}: {self.detail}"


class Seen(NamedTuple):
    """What can be believed of the robot: the mean segment angle [rad] and the vacuum [kPa], each the last good one."""

    theta: float = NAN
    vacuum: float = NAN


class Watch:
    """Looks at every reading before the law does. A fault stays until the run is over.

    A reading that cannot be believed (no number, a jump) is not handed on: the last good one is, until it is too old.

    Attributes:
        fault: the first fault, or None; `faults`: all by name, in the order in which they came.
        seen: what can be believed.
        rejected: readings of the angle that were not.
    """

    def __init__(self, limits: Limits, safety: Safety, period_s: float):
        self._limits, self._safety, self._period = limits, safety, period_s
        self.faults: dict[str, Fault] = {}
        self.fault: Fault | None = None
        self.seen = Seen()
        self.rejected = 0
        self._shape = _Sensor("camera_stale", "tag_lost", safety.shape_s, "the angle")
        self._gauge = _Sensor("gauge_stale", "gauge_nan", safety.pressure_s, "the vacuum")
        self._tendons = _Sensor("tendons_stale", "tendons_nan", safety.tendons_s, "the tensions")
        self._still_angle = _Stuck(safety.stuck_n, safety.stuck_s)
        self._still_gauge = _Stuck(safety.stuck_kpa, safety.stuck_s)
        self._leak, self._off = _Since(safety.leak_s), _Since(safety.tension_off_s)
        self._second, self._missed = -math.inf, 0

    def latch(self, name: str, detail: str, now: float) -> None:
        """Note a fault; the first one counts, and each name once."""
        if name not in self.faults:
            self.faults[name] = Fault(name, detail, now)
            self.fault = self.fault or self.faults[name]

    def lacking(self) -> str:
        """The sensors that have not said anything good yet, in words."""
        return " and ".join(s.what for s in (self._shape, self._gauge, self._tendons) if s.limit_s and s.t == -math.inf)

    def look(self, now: float, r: Reading) -> Seen:
        """Take a reading in and judge what is wrong whether or not a run has begun."""
        self._angle(now, r)
        if self._gauge.new(now, r.t_pressure) and self._gauge.good(r.vacuum_kpa):
            self._gauge.t, self.seen = min(now, r.t_pressure), Seen(self.seen.theta, r.vacuum_kpa)
        if self._tendons.new(now, r.t_tendons) and self._tendons.good(r.left_n + r.right_n):
            self._tendons.t = min(now, r.t_tendons)
        if r.faults:
            self.latch("hardware", "; ".join(r.faults), now)
        limits = self._limits
        self._limit("angle_limit", abs(self.seen.theta), limits.theta_max_rad, "rad", now)
        self._limit("tension_limit", r.left_n, limits.tension_trip_n, "N left", now)
        self._limit("tension_limit", r.right_n, limits.tension_trip_n, "N right", now)
        self._limit("vacuum_limit", r.vacuum_kpa, limits.vacuum_trip_kpa, "kPa", now)
        self._limit("current_limit", abs(r.left_ma), limits.current_max_ma, "mA left", now)
        self._limit("current_limit", abs(r.right_ma), limits.current_max_ma, "mA right", now)
        self._limit("temperature_limit", r.temperature_c, limits.temperature_max_c, "°C", now)
        return self.seen

    def _angle(self, now: float, r: Reading) -> None:
        if not self._shape.new(now, r.t_shape):
            return
        if not self._shape.good(r.theta):
            self.rejected += 1
        elif abs(r.theta - self.seen.theta) > self._safety.jump_rad:  # false for the first, from NaN
            self._shape.bad("tag_jump", f"{self.seen.theta:.3f} to {r.theta:.3f} rad at once")
            self.rejected += 1
        else:
            self._shape.t, self.seen = min(now, r.t_shape), Seen(r.theta, self.seen.vacuum)

    def judge(self, now: float, r: Reading, sent: Sent) -> None:
        """What is wrong once a run has begun: old readings, stuck ones, and what does not follow its command."""
        for sensor in (self._shape, self._gauge, self._tendons):
            if sensor.limit_s and now - sensor.t > sensor.limit_s:
                self.latch(sensor.why, f"{sensor.what}: {sensor.detail} for {now - sensor.t:.3g} s", now)
        safety = self._safety
        if safety.shape_s and self._still_angle.too_long(now, r.theta, sent.left - sent.right):
            self.latch("camera_stuck", f"the angle stays {r.theta:.6g} rad while the tension changes", now)
        if safety.pressure_s:
            if self._still_gauge.too_long(now, r.vacuum_kpa, sent.vacuum):
                self.latch("gauge_stuck", f"stays {r.vacuum_kpa:.6g} kPa while the command changes", now)
            lacking = sent.vacuum - self.seen.vacuum
            if self._leak.too_long(now, abs(lacking) > safety.leak_kpa > 0):
                name = "vacuum_leak" if lacking > 0 else "vacuum_excess"
                self.latch(name, f"{self.seen.vacuum:.3g} kPa where {sent.vacuum:.3g} is commanded", now)
        if safety.tendons_s:
            left, right = r.left_n - sent.left, r.right_n - sent.right
            if self._off.too_long(now, max(abs(left), abs(right)) > safety.tension_off_n > 0):
                side, off = ("left", left) if abs(left) > abs(right) else ("right", right)
                self.latch("tension_off", f"the {side} tendon is {off:+.3g} N off its command", now)

    def late(self, now: float, late_s: float, missed: int) -> None:
        """Count deadlines: `late_s` past the last one, with `missed` ticks left out."""
        if late_s > self._safety.late_s:
            self.latch("late_loop", f"a tick came {1e3 * late_s:.3g} ms late", now)
        if now - self._second >= 1.0:
            self._second, self._missed = now, 0
        self._missed += missed
        if self._missed * self._period > self._safety.missed_share:
            self.latch("deadlines_missed", f"{self._missed} in a second", now)

    def _limit(self, name: str, value: float, most: float, unit: str, now: float) -> None:
        if value > most:  # false for NaN
            self.latch(name, f"{value:.4g} {unit} is over {most:g}", now)


class _Sensor:
    """When a sensor last said something good, and why what came since is not."""

    def __init__(self, stale: str, nan: str, limit_s: float, what: str):
        self._stale, self._nan, self.limit_s, self.what = stale, nan, limit_s, what
        self.why, self.detail = stale, "nothing new"
        self.t = self._newest = -math.inf

    def new(self, now: float, t: float) -> bool:
        if t > self._newest and t > -math.inf:
            self._newest = min(t, now)
            return True
        return False

    def good(self, value: float) -> bool:
        if math.isfinite(value):
            self.why, self.detail = self._stale, "nothing new"
            return True
        self.bad(self._nan, "no number")
        return False

    def bad(self, why: str, detail: str) -> None:
        self.why, self.detail = why, detail


class _Stuck:
    """Whether a value stays the same to the last bit for too long since its command left where it was."""

    def __init__(self, change: float, seconds: float):
        self._change, self._seconds = change, seconds
        self._value = self._command = NAN
        self._since = math.inf

    def too_long(self, now: float, value: float, command: float) -> bool:
        if value != self._value:
            self._value, self._command, self._since = value, command, math.inf
        elif abs(command - self._command) > self._change > 0 and self._since == math.inf:
            self._since = now
        return now - self._since > self._seconds > 0


class _Since:
    """Whether something has been so for too long without a break."""

    def __init__(self, seconds: float):
        self._seconds, self._since = seconds, math.inf

    def too_long(self, now: float, so: bool) -> bool:
        self._since = min(self._since, now) if so else math.inf
        return now - self._since > self._seconds
