"""The serial port under the maker's SDK, mended where the SDK would block or hide a dead bus."""

from __future__ import annotations

import contextlib
import importlib
import time
from typing import Any

from ljjax.rig.robot import RigError


def load_sdk() -> Any:
    """The maker's SDK. Raises RigError where it is not installed."""
    try:
        return importlib.import_module("dynamixel_sdk")
    except ImportError:
        raise RigError("servos: the package dynamixel-sdk is not installed; pip install 'ljjax[rig]'") from None


def open_port(sdk: Any, name: str, baud: int, reply_s: float) -> Any:
    """The SDK's port, mended where it would block a tick: it waits 34 ms for a lost reply, spins while it waits,
    measures by the wall clock, and stays in use for good after an error."""

    class Port(sdk.PortHandler):
        @property
        def is_using(self) -> bool:
            return False  # one thread owns the bus

        @is_using.setter
        def is_using(self, value: bool) -> None:
            pass

        def setPacketTimeout(self, packet_length: int) -> None:
            self.setPacketTimeoutMillis(self.tx_time_per_byte * packet_length + 1000 * reply_s)

        def getCurrentTime(self) -> float:
            return 1000 * time.monotonic()

    port: Any = Port(name)
    if not port.setBaudRate(baud):
        raise RigError(f"servos.baud {baud}: the SDK does not know this rate; such as 1000000")
    port.ser.timeout = 0.001
    port.ser.write_timeout = 1.0
    with contextlib.suppress(Exception):  # no adapter with a latency timer, or no Linux
        port.ser.set_low_latency_mode(True)
    port.ser.exclusive = True  # two controllers on one bus would feed each other's watchdog
    return port
