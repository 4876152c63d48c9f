"""An emulated rig around a robot that is a spring, so that tests of the drivers need no JAX and no model."""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import MappingProxyType
from typing import Any, NamedTuple

from benchmarks.rig_parts import Spring
from ljjax.rig.config import Limits
from ljjax.rig.emulator.rig import EmulatedRig
from ljjax.rig.robot import Reading
from ljjax.rig.sensors import Sensed

PATIENCE_S = 60.0
"""How long a test waits for what must come, on a machine with other work."""


LIMITS = Limits(30.0, 200.0, 40.0, 50.0, 0.6)


class Parts(NamedTuple):
    """What a loader of rig.toml makes of it, as far as the drivers look."""

    servos: dict[str, Any]
    camera: dict[str, Any]
    pressure: dict[str, Any]
    limits: Limits = LIMITS
    sensors: Mapping[str, Any] = MappingProxyType({})


@contextmanager
def emulated(rate_hz: float = 40.0) -> Iterator[EmulatedRig]:
    with EmulatedRig(Spring(), rate_hz=rate_hz) as rig:
        yield rig


def config(rig: EmulatedRig, *parts: str) -> Parts:
    """The tables of an emulated rig, but for the parts not named, as patient as tests are."""
    tables = rig.tables()
    tables["servos"] |= {"watchdog_ms": 2000.0, "reply_ms": 60.0}
    tables["camera"] |= {"wait_s": PATIENCE_S}
    chosen = {name: tables[name] if name in parts or not parts else {} for name in tables}
    return Parts(chosen["servos"], chosen["camera"], chosen["pressure"])


def until(condition: Callable[[], object], meanwhile: Callable[[], object] = lambda: None) -> None:
    """Wait for a condition, doing something every few milliseconds."""
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, "it did not come to pass"
        meanwhile()
        time.sleep(0.005)


def close(a: float, b: float, within: float) -> bool:
    return abs(a - b) <= within


def named(reading: Reading | Sensed, text: str) -> bool:
    return any(text in fault for fault in reading.faults)
