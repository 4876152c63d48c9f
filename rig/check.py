"""Whether a rig is as its rig.toml says: sensors that speak, zeros that are zero, signs that are right."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable
from typing import NamedTuple

from ljjax.rig.clock import Clock
from ljjax.rig.config import Config
from ljjax.rig.gate import Sent
from ljjax.rig.loop import Tick, run
from ljjax.rig.robot import Reading, Robot
from ljjax.rig.safety import Seen

PULL_N, DRAW_KPA, PART_S = 3.0, 5.0, 3.0
"""What a moving check asks for [N, kPa], and for how long each [s]."""
ZERO_RAD, ZERO_KPA, ZERO_N = 0.02, 1.0, 1.0
"""How far from zero a robot at rest may read."""
Range = Callable[[Reading], float]


class Finding(NamedTuple):
    """One thing that was looked at: what was found, what was expected, and whether that is good."""

    name: str
    good: bool
    found: str
    expected: str

    def __str__(self) -> str:
        return f"{'ok ' if self.good else 'OFF'} {self.name}: {self.found}" + (
            "" if self.good else f"; expected {self.expected}"
        )


class _Listen:
    """A task that asks for nothing, then (if it may) for a little of each, and keeps what was read."""

    name, period_s = "check", 0.01

    def __init__(self, rest_s: float, move: bool, most_n: float, most_kpa: float):
        self._rest_s, self._pull, self._draw = rest_s, min(PULL_N, most_n), min(DRAW_KPA, most_kpa)
        self.seconds = rest_s + (3 * PART_S if move else 0.0)
        self.parts: dict[str, list[Reading]] = {"rest": [], "left": [], "right": [], "vacuum": []}
        self._part = "rest"

    def tick(self, t: float, seen: Seen, sent: Sent) -> tuple[float, float, float]:
        k = 0 if t < self._rest_s else 1 + min(2, int((t - self._rest_s) / PART_S))
        self._part = list(self.parts)[k]
        return (0, self._pull, 0, 0)[k], (0, 0, self._pull, 0)[k], (0, 0, 0, self._draw)[k]


class _Keep:
    """A log that keeps readings in memory: a check is short."""

    def __init__(self, task: _Listen):
        self._task = task

    def tick(self, tick: Tick) -> None:
        self._task.parts[self._task._part].append(tick.reading)

    def trouble(self) -> str:
        return ""


def check(robot: Robot, config: Config, *, seconds: float = 2.0, move: bool = False, clock: Clock | None = None,
          stopped: Callable[[], str] = str) -> list[Finding]:  # fmt: skip
    """What was looked at, and what is off. All that moves passes the gate and is watched, as in a run.

    Raises:
        RigError: the hardware cannot be opened.
    """
    task = _Listen(seconds, move, config.limits.tension_max_n, config.limits.vacuum_max_kpa)
    outcome = run(task, robot, config, _Keep(task), clock=clock, vent=True, stopped=stopped)
    rest, safety = task.parts["rest"], config.safety
    out = [Finding(f.name, False, f.detail, "no fault") for f in outcome.faults.values()]
    out += _sensor("shape", rest, lambda r: r.t_shape, lambda r: r.theta, safety.shape_s, ZERO_RAD, "rad")
    out += _sensor("gauge", rest, lambda r: r.t_pressure, lambda r: r.vacuum_kpa, safety.pressure_s, ZERO_KPA, "kPa")
    out += _sensor("left tendon", rest, lambda r: r.t_tendons, lambda r: r.left_n, safety.tendons_s, ZERO_N, "N")
    out += _sensor("right tendon", rest, lambda r: r.t_tendons, lambda r: r.right_n, safety.tendons_s, ZERO_N, "N")
    if move and outcome.fault is None:
        out += _moved(task, safety.tendons_s > 0, safety.pressure_s > 0)
    return out


def _sensor(name: str, rest: list[Reading], when: Range, what: Range, limit_s: float, zero: float,
            unit: str) -> list[Finding]:  # fmt: skip
    if not limit_s:
        return []
    new = [b for a, b in zip(rest, rest[1:], strict=False) if when(b) > when(a) and math.isfinite(what(b))]
    if len(new) < 3:
        return [Finding(name, False, f"{len(new)} good readings at rest", "a sensor that speaks; check its section")]
    values, gap = [what(r) for r in new], max(when(b) - when(a) for a, b in zip(new, new[1:], strict=False))
    mean, noise = statistics.fmean(values), statistics.pstdev(values)
    rate = (len(new) - 1) / (when(new[-1]) - when(new[0]))
    return [
        Finding(f"{name} rate", gap < limit_s, f"{rate:.3g} Hz, longest gap {gap:.3g} s", f"gaps below {limit_s:g} s"),
        Finding(f"{name} zero", abs(mean) < zero, f"{mean:.3g} {unit} at rest, noise {noise:.2g} {unit}",
                f"less than {zero:g} {unit}; set its zero"),
    ]  # fmt: skip


def _end(readings: list[Reading], what: Range) -> float:
    """The mean of the last third of what is a number."""
    values = [x for x in map(what, readings[-len(readings) // 3 :]) if math.isfinite(x)]
    return statistics.fmean(values) if values else math.nan


def _moved(task: _Listen, tendons: bool, gauge: bool) -> list[Finding]:
    out = []
    rest = _end(task.parts["rest"], lambda r: r.theta)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        part = task.parts[side]
        bend = _end(part, lambda r: r.theta) - rest
        good = sign * bend > 0
        out.append(Finding(f"{side} pull bends", good, f"{bend:+.3g} rad at {task._pull:g} N",
                           f"{'+' if sign > 0 else '−'}; the tendons or the camera's sign are swapped"))  # fmt: skip
        if tendons:
            pull = _end(part, lambda r, side=side: getattr(r, f"{side}_n"))
            good = abs(pull - task._pull) < max(ZERO_N, 0.25 * task._pull)
            out.append(Finding(f"{side} tension", good, f"{pull:.3g} N at {task._pull:g} N",
                               "about as much; calibrate current to tension"))  # fmt: skip
        travel = _end(part, lambda r, side=side: getattr(r, f"{side}_m"))
        if math.isfinite(travel):
            before = _end(task.parts["rest"], lambda r, side=side: getattr(r, f"{side}_m"))
            good = travel > before
            out.append(Finding(f"{side} travel", good, f"{1e3 * (travel - before):+.3g} mm",
                               "+, which pulls in; the spool's sign is wrong"))  # fmt: skip
    if gauge:
        kpa = _end(task.parts["vacuum"], lambda r: r.vacuum_kpa)
        good = abs(kpa - task._draw) < max(ZERO_KPA, 0.2 * task._draw)
        out.append(
            Finding("vacuum", good, f"{kpa:.3g} kPa at {task._draw:g} kPa", "about as much; check pump and line")
        )
    return out
