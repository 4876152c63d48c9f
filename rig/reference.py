"""The reference rig: two servos on the tendons, a camera on the tip's tag, a vacuum regulator with its gauge, and where
they are there tension sensors and a probe."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from typing import Any, Protocol

from ljjax.rig.camera import Shape, TagCamera
from ljjax.rig.config import Limits
from ljjax.rig.dynamixel import Servos
from ljjax.rig.regulator import Gauge, Vacuum
from ljjax.rig.robot import Reading, Robot
from ljjax.rig.sensors import Sensed, Sensors


class Config(Protocol):
    """What a rig.toml says of limits and, as plain tables, the parts; one whose table is empty is not there."""

    @property
    def limits(self) -> Limits: ...

    @property
    def servos(self) -> Mapping[str, Any]: ...

    @property
    def camera(self) -> Mapping[str, Any]: ...

    @property
    def pressure(self) -> Mapping[str, Any]: ...

    @property
    def sensors(self) -> Mapping[str, Any]: ...


class ReferenceRig(Robot):
    """The reference rig as a `ljjax.rig.robot.Robot`. Raises InputError naming the key of rig.toml that is wrong."""

    def __init__(self, config: Config):
        self._servos = Servos(config.servos, config.limits.tension_max_n)
        self._camera = TagCamera(config.camera) if config.camera else None
        self._vacuum = Vacuum(config.pressure) if config.pressure else None
        self._sensors = Sensors(config.sensors) if config.sensors else None

    def connect(self) -> None:
        """Open all parts, or none. Raises RigError; nothing moves."""
        try:
            for part in (self._camera, self._vacuum, self._sensors, self._servos):
                if part is not None:
                    part.connect()
        except BaseException:
            self.stop()
            raise

    def read(self) -> Reading:
        """The latest of every sensor; where none measures the tensions, those that the motor currents tell."""
        tendons = self._servos.read()
        shape = Shape() if self._camera is None else self._camera.read()
        gauge = Gauge() if self._vacuum is None else self._vacuum.read()
        sensed = Sensed() if self._sensors is None else self._sensors.read()
        measured = self._sensors is not None and self._sensors.of_tension
        left_n, right_n = (sensed.left_n, sensed.right_n) if measured else tendons.n
        return Reading(
            t_shape=shape.t,
            theta=shape.theta,
            t_pressure=gauge.t,
            vacuum_kpa=gauge.vacuum_kpa,
            t_tendons=sensed.t if measured else tendons.t,
            left_n=left_n,
            right_n=right_n,
            left_m=tendons.m[0],
            right_m=tendons.m[1],
            by_current=float(not measured),
            left_ma=tendons.ma[0],
            right_ma=tendons.ma[1],
            temperature_c=tendons.temperature_c,
            t_probe=sensed.t,
            probe_m=sensed.probe_m,
            probe_n=sensed.probe_n,
            faults=(*tendons.faults, *shape.faults, *gauge.faults, *sensed.faults),
        )

    def command(self, left_n: float, right_n: float, vacuum_kpa: float) -> tuple[float, float]:
        """Tensions [N] and vacuum [kPa] wanted; hands them to the parts' threads. Returns the tensions in whole units
        of current. Raises RigError for a dead bus."""
        if self._vacuum is not None:
            self._vacuum.command(vacuum_kpa)
        return self._servos.command(left_n, right_n)

    def stop(self, vent: bool = False) -> None:
        """Tensions off first, then the vacuum kept or vented, then the camera. Never raises."""
        self._servos.stop()
        for stop in (
            lambda: self._vacuum and self._vacuum.stop(vent),
            lambda: self._camera and self._camera.stop(),
            lambda: self._sensors and self._sensors.stop(),
        ):
            with contextlib.suppress(Exception):
                stop()
