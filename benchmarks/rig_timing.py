"""`python -m benchmarks.rig_timing [--seconds 20]`: how long a tick of a law takes, and how late the rig's loop comes.

Beside it, in turns of a second each, a bare loop that waits for the same deadlines and does nothing: what it is late is
the machine's, not ours. Writes out/bench/rig.json.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import tempfile
import time
from pathlib import Path
from typing import Any

from ljjax import law
from ljjax.law import Command, Law, Measured
from ljjax.law.parts import Kind
from ljjax.rig import config
from ljjax.rig.clock import Clock
from ljjax.rig.loop import RUN, Tick, run
from ljjax.rig.mock import MockRobot
from ljjax.rig.recorder import Recorder
from ljjax.rig.task import Follow, Point

PERIOD_S = 0.005
META = {"run_id": "timing", "robot_id": "mock", "experiment": "timing", "p_atm_pa": "101325", "start_utc": "2026-01-01"}
LIMITS = config.Limits(30.0, 200.0, 40.0, 50.0, 0.6)
NEVER = config.Safety(shape_s=60, tendons_s=60, pressure_s=60, late_s=60, missed_share=1e6, ramp_s=0.1, log_s=60)


def mock_law(kind: Kind = "observer") -> Law:
    """A law for the mock's body: two segments, no gravity, friction that hardly matters; by default the costliest."""
    root = 40.0 / (40.0 + 1e-4) ** 0.5
    return Law(
        kind,
        PERIOD_S,
        law.Gains(0.3, 20.0, 0.02, 1.0, 0.0, 0.002, 0.5, 0.02),
        law.Robot(2.0, 0.02, 0.0, 1.0, 1.6, 0.0025, 0.003, 0.045),
        law.Limits(0.5, 30.0, 2.0, 200.0, 40.0, 50.0, 0.25, 3000.0, 9000.0),
        law.Tables(
            tuple(2.0 + 0.08 * 40.0 * (k / 20.0) ** 2 for k in range(21)),
            tuple(12.0 + k for k in range(21)),
            (0.0, 0.5 * root, root),
        ),
    )


def spread(seconds: list[float]) -> dict[str, float]:
    """Median, 99 and 99.9 % and the worst [µs]."""
    ranked = sorted(seconds)
    shares = {"median": 0.5, "p99": 0.99, "p99.9": 0.999, "worst": 1.0}
    return {name: round(1e6 * ranked[min(len(ranked) - 1, int(x * len(ranked)))], 2) for name, x in shares.items()}


def law_ticks(given: Law, count: int = 20_000) -> list[float]:
    """How long each of `count` ticks takes [s]."""
    state, took = law.start(given, 0.0, 0.0, 0.0, 0.0), []
    for k in range(count):
        measured, command = Measured(0.1 + 1e-3 * (k % 17), 10.0), Command(0.1, 5000.0)
        begun = time.perf_counter()
        state, _ = law.tick(given, state, measured, command)
        took.append(time.perf_counter() - begun)
    return took


def bare(seconds: float) -> list[float]:
    """How late a loop comes that does nothing [s]."""
    clock, late = Clock(), []
    deadline = end = clock.now()
    end += seconds
    while deadline < end:
        deadline += PERIOD_S
        clock.wait(deadline)
        now = clock.now()
        late.append(now - deadline)
        deadline += PERIOD_S * int((now - deadline) / PERIOD_S)
    return late


class Lateness:
    """A log that passes ticks on and keeps how late they came."""

    def __init__(self, log: Recorder):
        self._log, self.late, self.busy = log, [], []

    def tick(self, tick: Tick) -> None:
        self._log.tick(tick)
        if tick.state == RUN:
            self.late.append(tick.late_s)
            self.busy.append(tick.busy_s)

    def trouble(self) -> str:
        return self._log.trouble()


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0, help="of each loop")
    parser.add_argument("--out", type=Path, default=Path("out/bench"))
    chosen = parser.parse_args()
    given = mock_law()
    ours: dict[str, list[float]] = {"late": [], "busy": []}
    idle: list[float] = []
    about = config.Config("benchmark", "mock", "mock", 101325.0, LIMITS, NEVER)
    with tempfile.TemporaryDirectory() as folder:
        for k in range(max(1, round(chosen.seconds))):
            idle += bare(1.0)
            with Recorder(Path(folder) / f"{k}.mcap", META, 101325.0, t=time.monotonic(), most_s=60.0) as recorder:
                log = Lateness(recorder)
                run(Follow(given, [Point(0.0, Command(0.1, 5000.0))], 1.0, 0.1), MockRobot(), about, log)
                recorder.end("completed")
            ours["late"] += log.late
            ours["busy"] += log.busy
    found: dict[str, Any] = {
        "law_tick_us": spread(law_ticks(given)),
        "loop_late_us": spread(ours["late"]),
        "bare_loop_late_us": spread(idle),
        "loop_busy_us": spread(ours["busy"]),
        "ticks": len(ours["late"]),
        "period_s": PERIOD_S,
        "machine": {"python": platform.python_version(), "cpus": os.cpu_count(), "load": os.getloadavg()},
    }
    for name, value in found.items():
        print(f"{name}: {value}")
    chosen.out.mkdir(parents=True, exist_ok=True)
    (chosen.out / "rig.json").write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
