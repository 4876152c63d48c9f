"""The emulated rig: one loop that answers the bus and the gauge, moves the robot in real time, and takes pictures."""

from __future__ import annotations

import contextlib
import json
import math
import os
import select
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from ljjax.rig import xm430
from ljjax.rig.emulator.bus import Bus
from ljjax.rig.emulator.faults import Fault, Faults
from ljjax.rig.emulator.lines import Line
from ljjax.rig.emulator.plant import Plant
from ljjax.rig.emulator.servo import Servo
from ljjax.rig.emulator.tag import TagPainter, View
from ljjax.rig.emulator.vacuum import VacuumLine
from ljjax.rig.frames import Frame, FrameWriter
from ljjax.rig.keys import Keys
from ljjax.rig.spools import Spools

SPOOLS = {"spool_radius_m": 0.01, "torque_constant_nm_a": 1.78, "friction_ma": 20.0, "direction": [1, -1]}
FRAMES = "ljjax_frames_"
BEHIND_S = 0.1
"""Time that the robot is late by and makes up for; what is more is dropped."""


def _frames_file() -> str:
    """A file of this process's own for the pictures, in memory where the system can; those of emulators that were
    killed, and so could not take theirs away, are removed."""
    folder = Path("/dev/shm" if os.path.isdir("/dev/shm") else tempfile.gettempdir())
    for left in folder.glob(FRAMES + "*"):
        with contextlib.suppress(OSError, ValueError):
            pid = int(left.name.removeprefix(FRAMES).split("_")[0])
            if not _runs(pid):
                left.unlink()
    handle, path = tempfile.mkstemp(prefix=f"{FRAMES}{os.getpid()}_", dir=folder)
    os.close(handle)
    return path


def _runs(pid: int) -> bool:
    """Whether there is such a process."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


class EmulatedRig:
    """A rig around a plant. A context manager: a thread serves it meanwhile; or call `run`.

    Args:
        plant: the robot.
        faults: what goes wrong, and when.
        rate_hz: pictures a second.
        seed: of noise and lost packets.

    Attributes:
        faults: to put faults in and take them out meanwhile.
        tensions: of the tendons now [N]; `vacuum_kpa`, the line's vacuum.
        dropped_s: time by which the robot lagged behind real time and that was dropped [s].
    """

    def __init__(self, plant: Plant, faults: Sequence[Fault] = (), rate_hz: float = 210.0, seed: int = 0):
        self.plant, self.faults = plant, Faults(tuple(faults))
        self.tensions = 0.0, 0.0
        self.dropped_s = 0.0
        self._segments = len(plant.joints)
        self._spools = Spools(Keys("servos", SPOOLS))
        self._servos = Servo(1), Servo(2)
        self._bus = Bus(Line(), self._servos, seed)
        self._vacuum = VacuumLine(Line())
        self._painter, self._view = TagPainter(seed=seed), View(self._segments, plant.half_length_m)
        self.frames_path = _frames_file()
        self._frames = FrameWriter(self.frames_path, self._painter.width, self._painter.height)
        self._rate = rate_hz
        self._picture = self._painter.blank()
        self._begun = self._moved = self._drawn = time.monotonic()
        self._failed = False
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def vacuum_kpa(self) -> float:
        return self._vacuum.vacuum_kpa

    def tables(self) -> dict[str, dict[str, Any]]:
        """The tables of a rig.toml that reaches this rig."""
        return {
            "servos": {"port": self._bus.line.path, "ids": [1, 2], "watchdog_ms": 500.0, "reply_ms": 20.0, **SPOOLS},
            "camera": {"source": f"file:{self.frames_path}", "segments": self._segments, "rate_hz": self._rate},
            "pressure": {"kind": "serial", "port": self._vacuum.line.path, "reply_ms": 1000.0},
        }

    def toml(self, more: Mapping[str, Mapping[str, Any]]) -> str:
        """A rig.toml that reaches this rig, with more tables, such as the limits."""
        lines = ['schema = "ljjax.rig/1"', 'robot_id = "emulated"', 'driver = "reference"', "p_atm_pa = 101325"]
        for name, table in {**more, **self.tables()}.items():
            lines += ["", f"[{name}]", *(f"{key} = {json.dumps(value)}" for key, value in table.items())]
        return "\n".join(lines) + "\n"

    def run(self) -> None:
        """Serve until `end`."""
        while not self._ending.is_set():
            now = time.monotonic()
            lines = [line.master for line in (self._bus.line, self._vacuum.line) if line.open]
            due = min(self._moved + self.plant.step_s, self._drawn + 1 / self._rate)
            select.select(lines, [], [], max(0.0, due - now))
            self.turn(time.monotonic())

    def turn(self, now: float) -> None:
        """One round: apply faults, answer what came in, move the robot to a time [s], take a picture if one is due."""
        self._apply_faults(now - self._begun)
        if now - self._moved > BEHIND_S:
            self.dropped_s += now - self._moved - BEHIND_S
            self._moved = now - BEHIND_S
        if self._bus.line.open:
            self._bus.serve(now - self.dropped_s)  # a machine that stood still is no controller that is gone
        self._vacuum.serve()
        self._move(now)
        if now >= self._drawn + 1 / self._rate:
            self._drawn = max(self._drawn + 1 / self._rate, now - 1 / self._rate)
            self._take_picture(now)

    def end(self) -> None:
        """Let `run` return."""
        self._ending.set()

    def close(self) -> None:
        """Take the lines and the pictures away. Once `run` has returned."""
        self._bus.line.close()
        self._vacuum.line.close()
        self._frames.close()
        with contextlib.suppress(OSError):
            Path(self.frames_path).unlink()

    def __enter__(self) -> Self:
        self._thread = threading.Thread(target=self.run, name="emulated rig", daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.end()
        if self._thread is not None:
            self._thread.join()
        self.close()

    def _apply_faults(self, since: float) -> None:
        faults = self.faults
        self._bus.loss, self._bus.corrupt = faults.share("packet_loss", since), faults.share("packet_corrupt", since)
        unplugged = faults.active("servo_unplugged", since)
        for side, servo in zip(("left", "right"), self._servos, strict=True):
            servo.power(unplugged is None or unplugged.value != side)
        if unplugged is not None and unplugged.value == "bus":
            self._bus.line.close()
        wrong = faults.active("servo_error", since)
        if wrong is not None and not self._failed:
            self._servos[0].fail(1 << int(wrong.number))
        self._failed = wrong is not None
        self._vacuum.leak = faults.share("vacuum_leak", since)
        self._vacuum.stuck = faults.active("gauge_stuck", since) is not None
        self._vacuum.no_number = faults.active("gauge_nan", since) is not None

    def _move(self, now: float) -> None:
        step, spools = self.plant.step_s, self._spools
        travel = self.plant.lever_arm_m * self.plant.bend / spools.radius_m
        for servo, sign, way in zip(self._servos, spools.direction, (1, -1), strict=True):
            servo.travel_rad = sign * way * travel
        currents = [servo.update(now - self.dropped_s) * xm430.CURRENT_MA for servo in self._servos]
        pulls = [current * sign for current, sign in zip(currents, spools.direction, strict=True)]
        self.tensions = spools.tension_n(pulls[0]), spools.tension_n(pulls[1])
        while self._moved + step <= now:
            self._vacuum.advance(step)
            self.plant.advance(*self.tensions, self._vacuum.vacuum_kpa)
            self._moved += step

    def _take_picture(self, now: float) -> None:
        since = now - self._begun
        if self.faults.active("camera_frozen", since) is None:
            if self.faults.active("tag_lost", since) is not None:
                self._picture = self._painter.blank()
            else:
                x, y, angle = self._view.tip(self.plant.joints)
                angle += self.faults.share("tag_jump", since)
                self._picture = self._painter.paint(x, y, math.remainder(angle, 2 * math.pi))
        self._frames.put(Frame(now, self._picture))
