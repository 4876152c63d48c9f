"""`python -m benchmarks.rig_timing [--seconds 20]`: how long a tick of a law takes, how late the rig's loop comes, how
long after a picture its angle is there, and how true it is.

Beside the loop, in turns of a second each, a bare loop that waits for the same deadlines and does nothing: what it is
late is the machine's, not ours. Writes out/bench/rig.json.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.rig_parts import PERIOD_S, emulated, mock_law
from ljjax import law
from ljjax.law import Command, Law, Measured
from ljjax.rig import config
from ljjax.rig.camera import TagCamera
from ljjax.rig.clock import Clock
from ljjax.rig.emulator.tag import TagPainter
from ljjax.rig.eye import TagFinder
from ljjax.rig.loop import RUN, Tick, run
from ljjax.rig.mock import MockRobot
from ljjax.rig.recorder import Recorder
from ljjax.rig.task import Follow, Point

META = {"run_id": "timing", "robot_id": "mock", "experiment": "timing", "p_atm_pa": "101325", "start_utc": "2026-01-01"}
LIMITS = config.Limits(30.0, 200.0, 40.0, 50.0, 0.6)
NEVER = config.Safety(shape_s=60, tendons_s=60, pressure_s=60, late_s=60, missed_share=1e6, ramp_s=0.1, log_s=60)


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


def camera(seconds: float) -> list[float]:
    """How long after a picture was taken its angle can be read, from an emulated camera at 100 Hz [s]."""
    took = []
    with emulated() as rig:
        eye = TagCamera(rig.tables()["camera"])
        eye.connect()
        end, last = time.monotonic() + seconds, -math.inf
        while (now := time.monotonic()) < end:
            if (shape := eye.read()).t > last:
                last = shape.t
                took.append(now - last)
            time.sleep(2e-4)
        eye.stop()
    return took


def tags(count: int = 200) -> dict[str, Any]:
    """Time to find a tag near where it was and in the whole picture, and the error of its angle: as the detector's
    corners have it, and held against the tag's pattern."""
    painter, rng = TagPainter(), np.random.default_rng(0)
    near, whole, corners = TagFinder(0), [], TagFinder(0, refine=False)
    took, errors, raw = [], [], []
    for k in range(count):
        angle = float(rng.uniform(-0.3, 0.3))
        picture = painter.paint(320 + rng.uniform(-1, 1), 250 + rng.uniform(-1, 1), angle)
        begun = time.perf_counter()
        seen = near.find(picture)
        took.append(time.perf_counter() - begun)
        if k % 10 == 0:
            begun = time.perf_counter()
            TagFinder(0).find(picture)
            whole.append(time.perf_counter() - begun)
        rough = corners.find(picture)
        if seen is not None and rough is not None:
            errors.append(math.degrees(seen.angle - angle))
            raw.append(math.degrees(rough.angle - angle))
    return {
        "tag_near_us": spread(took[1:]),
        "tag_whole_us": spread(whole),
        "tag_error_deg": {"rms": round(float(np.std(errors)), 4), "of corners": round(float(np.std(raw)), 4)},
    }


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
        "picture_to_angle_us": spread(camera(chosen.seconds / 4)),
        **tags(),
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
