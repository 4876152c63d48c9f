"""Tension sensors and a linear probe: volts of an analog device's channels, read by a thread, in newtons and metres."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Mapping
from typing import Any, NamedTuple

from ljjax.rig.keys import Keys
from ljjax.rig.regulator import device
from ljjax.rig.robot import NAN, RigError

CHANNELS = ("left_n", "right_n", "probe_m", "probe_n")


class Sensed(NamedTuple):
    """When the channels were read [s], tensions [N], the probe's position [m] and force [N], and what is wrong."""

    t: float = -float("inf")
    left_n: float = NAN
    right_n: float = NAN
    probe_m: float = NAN
    probe_n: float = NAN
    faults: tuple[str, ...] = ()


class Sensors:
    """Analog sensors behind connect, read and stop.

    Args:
        table: [sensors] of rig.toml: device = "PACKAGE.MODULE:NAME", a callable that returns an object with
            `read_volts(channel)`, and `close()` if it has one; of left_n, right_n, probe_m and probe_n those that are
            there, each [channel, scale, offset]: value = scale·volts + offset; rate_hz; lost_reads (failures in a row
            that count as a fault).

    Raises:
        InputError: a key that is missing, unknown or wrong.
    """

    def __init__(self, table: Mapping[str, Any]):
        keys = Keys("sensors", table)
        self._name = keys.text("device", expected="PACKAGE.MODULE:NAME")
        self._channels = {name: keys.calibrated(name) for name in CHANNELS if name in table}
        self._period = 1 / keys.number("rate_hz", 200.0, "Hz", 0.1, 10_000.0)
        self._lost = keys.whole("lost_reads", 5, 1, 10_000)
        keys.done()
        self._device: Any = None
        self._thread: threading.Thread | None = None
        self._ending = threading.Event()
        self._last = Sensed()

    @property
    def of_tension(self) -> bool:
        """Whether both tensions are measured."""
        return {"left_n", "right_n"} <= set(self._channels)

    def connect(self) -> None:
        """Make the device and read it once. Raises RigError."""
        self._ending.clear()
        try:
            self._device = device(self._name)
            self._last = self._look()
        except Exception as error:  # whatever a device of the user's raises
            self.stop()
            raise RigError(f"sensors {self._name}: {error}; check cable, power and permissions") from None
        self._thread = threading.Thread(target=self._serve, name="sensors", daemon=True)
        self._thread.start()

    def read(self) -> Sensed:
        """What the channels last said."""
        return self._last

    def stop(self) -> None:
        """Let the device go. Never raises."""
        self._ending.set()
        if self._thread is not None:
            self._thread.join(10.0)
            self._thread = None
        with contextlib.suppress(Exception):
            getattr(self._device, "close", lambda: None)()
        self._device = None

    def _look(self) -> Sensed:
        left, right, way, force = (self._value(name) for name in CHANNELS)
        return Sensed(time.monotonic(), left, right, way, force)

    def _value(self, name: str) -> float:
        if name not in self._channels:
            return NAN
        channel, scale, offset = self._channels[name]
        return scale * float(self._device.read_volts(channel)) + offset

    def _serve(self) -> None:
        failed = 0
        while not self._ending.wait(self._period):
            try:
                self._last, failed = self._look(), 0
            except Exception as error:  # whatever a device of the user's raises
                failed += 1
                if failed >= self._lost:
                    self._last = self._last._replace(faults=(f"sensors {self._name}: {error}; check its cable",))
