"""What the loop knows of a robot: connect, read, command, stop."""

from __future__ import annotations

import math
from types import TracebackType
from typing import NamedTuple, Protocol, Self

from ljjax.errors import InputError

NAN = math.nan


class RigError(InputError):
    """The rig does not do what it should; the text names the part, what was found, and the mend."""


class Reading(NamedTuple):
    """What a robot last measured. Stamps are of `time.monotonic()`; a value that no sensor gives is NaN.

    Attributes:
        t_shape, theta: when the shape was seen [s], and the mean segment angle [rad], + toward the left tendon.
        t_pressure, vacuum_kpa: when the gauge was read [s], and the vacuum below the atmosphere [kPa].
        t_tendons: when the tendons were read [s].
        left_n, right_n: tensions [N]; `left_m`, `right_m` spool travel [m], + pulls in.
        by_current: 1 where the tensions are what the motor currents tell. They know nothing of gearbox and routing,
            so they are watched, and not logged as measured tensions, which a diagnosis would believe.
        left_ma, right_ma: motor currents [mA].
        temperature_c: the warmest motor's [°C].
        t_probe: when a linear probe was read [s]; `probe_m`, `probe_n` its position [m] and force [N, + pushes the tip
            toward +x].
        joints: each joint's angle [rad], where each has a marker.
        faults: what the hardware says is wrong with it, empty where nothing is.
    """

    t_shape: float = -math.inf
    theta: float = NAN
    t_pressure: float = -math.inf
    vacuum_kpa: float = NAN
    t_tendons: float = -math.inf
    left_n: float = NAN
    right_n: float = NAN
    left_m: float = NAN
    right_m: float = NAN
    by_current: float = 0.0
    left_ma: float = NAN
    right_ma: float = NAN
    temperature_c: float = NAN
    t_probe: float = -math.inf
    probe_m: float = NAN
    probe_n: float = NAN
    joints: tuple[float, ...] = ()
    faults: tuple[str, ...] = ()


class Robot(Protocol):
    """A robot behind four verbs; a context manager that always stops. Drivers inherit from it.

    `read` returns at once with the latest of every sensor, and `command` does not wait for the hardware longer than a
    tick of the loop; drivers that block have a thread or process of their own. A dead loop must not be masked: what
    feeds a servo's watchdog is `command` alone.
    """

    def connect(self) -> None:
        """Open and check the hardware. Raises RigError; nothing moves yet."""
        ...

    def read(self) -> Reading:
        """The latest of every sensor."""
        ...

    def command(self, left_n: float, right_n: float, vacuum_kpa: float) -> tuple[float, float] | None:
        """Tensions [N] and vacuum [kPa] wanted from now on. Returns the tensions as the hardware takes them, rounded to
        its units, which is what the log says was commanded; None where they are taken as they are."""
        ...

    def stop(self, vent: bool = False) -> None:
        """Tensions off, hardware released, whatever state it is in; the vacuum is kept, or vented. Never raises."""
        ...

    def __enter__(self) -> Self:
        self.connect()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
