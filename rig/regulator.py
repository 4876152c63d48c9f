"""Vacuum regulator and gauge: one port, serial or analog, and a thread that sets the one and reads the other.

Ports speak raw units, which [pressure] of rig.toml turns into kPa below the atmosphere: kPa = scale·raw + offset. A
regulator has no watchdog: the vacuum it was told it holds, also where the controller is gone.
"""

from __future__ import annotations

import contextlib
import importlib
import math
import threading
import time
from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

from ljjax.errors import InputError
from ljjax.rig.keys import Keys
from ljjax.rig.robot import NAN, RigError


class Gauge(NamedTuple):
    """When the gauge was read [s], the vacuum [kPa] below the atmosphere, and what is wrong."""

    t: float = -math.inf
    vacuum_kpa: float = NAN
    faults: tuple[str, ...] = ()


class Port(Protocol):
    """A regulator and its gauge in raw units. Both may raise OSError or ValueError."""

    def set(self, raw: float) -> None:
        """Set the regulator."""
        ...

    def get(self) -> float:
        """Read the gauge."""
        ...

    def close(self) -> None: ...


class SerialPort:
    """Lines of ASCII: `V 12.50` sets, answered by `OK`; `P` asks, answered by `P 12.48`."""

    def __init__(self, name: str, baud: int, reply_s: float):
        try:
            serial: Any = importlib.import_module("serial")
        except ImportError:
            raise RigError("pressure: the package pyserial is not installed; pip install 'ljjax[rig]'") from None
        self._line: Any = serial.Serial(name, baud, timeout=reply_s, write_timeout=1.0, exclusive=True)

    def _ask(self, text: str) -> str:
        self._line.reset_input_buffer()
        self._line.write(text.encode() + b"\n")
        answer = self._line.read_until(b"\n")
        if not answer.endswith(b"\n"):
            raise ValueError(f"no answer to {text.split()[0]!r}")
        return answer.decode(errors="replace").strip()

    def set(self, raw: float) -> None:
        if (answer := self._ask(f"V {raw:.4f}")) != "OK":
            raise ValueError(f"answered {answer!r} to 'V'; expected 'OK'")

    def get(self) -> float:
        answer = self._ask("P")
        name, _, value = answer.partition(" ")
        if name != "P" or not math.isfinite(float(value)):
            raise ValueError(f"answered {answer!r} to 'P'; expected 'P' and a number")
        return float(value)

    def close(self) -> None:
        self._line.close()


class AnalogPort:
    """Volts, through any object with `write_volts(x)` and `read_volts()`, and `close()` if it has one."""

    def __init__(self, device: Any):
        self._device = device

    def set(self, raw: float) -> None:
        self._device.write_volts(raw)

    def get(self) -> float:
        return float(self._device.read_volts())

    def close(self) -> None:
        getattr(self._device, "close", lambda: None)()


class Vacuum:
    """Regulator and gauge behind connect, read, command and stop.

    Args:
        table: [pressure] of rig.toml: kind ("serial": port, baud, reply_ms; "analog": device = "PACKAGE.MODULE:NAME", a
            callable that returns the object), set_scale and set_offset_kpa of the regulator, gauge_scale and
            gauge_offset_kpa, vacuum_max_kpa, rate_hz, lost_reads (failures in a row that count as a fault).

    Raises:
        InputError: a key that is missing, unknown or wrong.
    """

    def __init__(self, table: Mapping[str, Any]):
        keys = Keys("pressure", table)
        self._kind = keys.text("kind", "serial")
        if self._kind == "serial":
            self._name = keys.text("port", expected="a serial port, such as /dev/ttyUSB1")
            self._baud = keys.whole("baud", 115_200, 300, 4_000_000)
            self._reply = keys.number("reply_ms", 50.0, "ms", 1.0, 5000.0) / 1000
        elif self._kind == "analog":
            self._name = keys.text("device", expected="PACKAGE.MODULE:NAME")
        else:
            raise InputError(f'rig.toml: pressure.kind is {self._kind!r}; expected "serial" or "analog"')
        self._set = _scale(keys, "set")
        self._gauge = _scale(keys, "gauge")
        self._max = keys.number("vacuum_max_kpa", 101.325, "kPa", 0.0, 101.325)
        self._period = 1 / keys.number("rate_hz", 50.0, "Hz", 0.1, 10_000.0)
        self._lost = keys.whole("lost_reads", 5, 1, 10_000)
        keys.done()
        self._port: Port | None = None
        self._thread: threading.Thread | None = None
        self._ending = threading.Event()
        self._wanted: float | None = None
        self._last = Gauge()

    def connect(self) -> None:
        """Open the port and read the gauge once. Raises RigError."""
        self._ending.clear()
        self._wanted, self._last = None, Gauge()
        try:
            self._port = self._open()
            self._last = Gauge(time.monotonic(), self._kpa(self._port))
        except RigError:
            self.stop()
            raise
        except Exception as error:  # whatever a device of the user's raises
            self.stop()
            raise RigError(f"pressure {self._name}: {error}; check cable, power and permissions") from None
        self._thread = threading.Thread(target=self._serve, args=(self._port,), name="pressure", daemon=True)
        self._thread.start()

    def read(self) -> Gauge:
        """What the gauge last said."""
        return self._last

    def command(self, vacuum_kpa: float) -> None:
        """The vacuum wanted [kPa], cut to what the table allows; returns at once."""
        self._wanted = min(max(0.0, vacuum_kpa), self._max)

    def stop(self, vent: bool = False) -> None:
        """Close the port; the regulator keeps the vacuum, or is told to vent. Never raises."""
        self._ending.set()
        if self._thread is not None:
            self._thread.join(10.0)
            self._thread = None
        port, self._port = self._port, None
        if port is None:
            return
        for _ in range(3 if vent else 0):
            with contextlib.suppress(Exception):
                port.set(self._raw(0.0))
                break
        with contextlib.suppress(Exception):
            port.close()

    def _open(self) -> Port:
        if self._kind == "serial":
            return SerialPort(self._name, self._baud, self._reply)
        return AnalogPort(device(self._name))

    def _kpa(self, port: Port) -> float:
        scale, offset = self._gauge
        return scale * port.get() + offset

    def _raw(self, vacuum_kpa: float) -> float:
        scale, offset = self._set
        return (vacuum_kpa - offset) / scale

    def _serve(self, port: Port) -> None:
        told: float | None = None
        failed = 0
        while not self._ending.wait(self._period):
            try:
                if (wanted := self._wanted) is not None and wanted != told:
                    port.set(self._raw(wanted))
                    told = wanted
                self._last = Gauge(time.monotonic(), self._kpa(port))
                failed = 0
            except Exception as error:  # an adapter pulled out of its socket: OSError, termios.error, SerialException …
                failed += 1
                if failed >= self._lost:
                    text = f"pressure {self._name}: {error}; check its cable and power"
                    self._last = self._last._replace(faults=(text,))


def device(name: str) -> Any:
    """A device of the user's, made by the callable PACKAGE.MODULE:NAME."""
    module, _, member = name.partition(":")
    return getattr(importlib.import_module(module), member)()


def _scale(keys: Keys, name: str) -> tuple[float, float]:
    """kPa a raw unit, and kPa at raw 0."""
    scale = keys.number(f"{name}_scale", 1.0, "kPa")
    if scale == 0:
        raise InputError(f"rig.toml: pressure.{name}_scale is 0; expected kPa a raw unit")
    return scale, keys.number(f"{name}_offset_kpa", 0.0, "kPa")
