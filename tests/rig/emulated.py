"""An emulated rig around a robot that is a spring, so that tests of the drivers need no JAX and no model."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from ljjax.rig.emulator.rig import EmulatedRig
from ljjax.rig.robot import Reading

PATIENCE_S = 60.0
"""How long a test waits for what must come, on a machine with other work."""


class Parts(NamedTuple):
    """What a loader of rig.toml makes of it, as far as the drivers look."""

    servos: dict[str, Any]
    camera: dict[str, Any]
    pressure: dict[str, Any]


class Spring:
    """Two segments whose bend follows the net tension, 0.02 rad a newton."""

    step_s = 0.005
    half_length_m = 0.05
    lever_arm_m = 0.02
    bend = 0.0

    @property
    def joints(self) -> tuple[float, ...]:
        return (self.bend / 2,) * 2

    def advance(self, left_n: float, right_n: float, vacuum_kpa: float) -> None:
        self.bend += 0.1 * (0.02 * (left_n - right_n) - self.bend)


@contextmanager
def emulated(rate_hz: float = 40.0) -> Iterator[EmulatedRig]:
    with EmulatedRig(Spring(), rate_hz=rate_hz) as rig:
        yield rig


def config(rig: EmulatedRig, *parts: str) -> Parts:
    """The tables of an emulated rig, but for the parts not named, as patient as tests are."""
    tables = rig.tables()
    tables["servos"] |= {"watchdog_ms": 2000.0, "reply_ms": 60.0}
    tables["camera"] |= {"wait_s": PATIENCE_S}
    return Parts(**{name: tables[name] if name in parts or not parts else {} for name in tables})


def until(condition: Callable[[], object], meanwhile: Callable[[], object] = lambda: None) -> None:
    """Wait for a condition, doing something every few milliseconds."""
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, "it did not come to pass"
        meanwhile()
        time.sleep(0.005)


def close(a: float, b: float, within: float) -> bool:
    return abs(a - b) <= within


def named(reading: Reading, text: str) -> bool:
    return any(text in fault for fault in reading.faults)
