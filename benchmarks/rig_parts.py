"""A law, a spring for a robot and an emulated rig around it, for what is measured of the rig and for its tests."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager

from ljjax import law
from ljjax.law import Law
from ljjax.law.parts import Kind
from ljjax.rig.emulator.rig import EmulatedRig

PERIOD_S = 0.005


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


class Spring:
    """Two segments whose bend follows the net tension, 0.02 rad a newton; remembers the largest tension."""

    step_s = 0.005
    half_length_m = 0.05
    lever_arm_m = 0.02
    bend = 0.0
    most_n = 0.0
    slack_since = -math.inf

    @property
    def joints(self) -> tuple[float, ...]:
        return (self.bend / 2,) * 2

    def advance(self, left_n: float, right_n: float, vacuum_kpa: float) -> None:
        self.bend += 0.1 * (0.02 * (left_n - right_n) - self.bend)
        self.most_n = max(self.most_n, left_n, right_n)
        if left_n or right_n:
            self.slack_since = math.inf
        else:
            self.slack_since = min(self.slack_since, time.monotonic())


@contextmanager
def emulated(rate_hz: float = 100.0) -> Iterator[EmulatedRig]:
    """An emulated rig around a spring, served by a thread."""
    with EmulatedRig(Spring(), rate_hz=rate_hz) as rig:
        yield rig
