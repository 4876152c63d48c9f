"""The reference rig: two servos on the tendons, a camera on the tip's tag, a vacuum regulator with its gauge."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from types import TracebackType
from typing import Any, Protocol, Self

from ljjax.rig.camera import Shape, TagCamera
from ljjax.rig.dynamixel import Servos
from ljjax.rig.regulator import Gauge, Vacuum
from ljjax.rig.robot import Reading


class Config(Protocol):
    """What a rig.toml says of the three parts, as plain tables; a part whose table is empty is not there."""

    @property
    def servos(self) -> Mapping[str, Any]: ...

    @property
    def camera(self) -> Mapping[str, Any]: ...

    @property
    def pressure(self) -> Mapping[str, Any]: ...


class ReferenceRig:
    """The reference rig as a `ljjax.rig.robot.Robot`. Raises InputError naming the key of rig.toml that is wrong."""

    def __init__(self, config: Config):
        self._servos = Servos(config.servos)
        self._camera = TagCamera(config.camera) if config.camera else None
        self._vacuum = Vacuum(config.pressure) if config.pressure else None

    def connect(self) -> None:
        """Open all parts, or none. Raises RigError; nothing moves."""
        try:
            for part in (self._camera, self._vacuum, self._servos):
                if part is not None:
                    part.connect()
        except BaseException:
            self.stop()
            raise

    def read(self) -> Reading:
        """The latest of every sensor; tensions are those that the motor currents tell."""
        tendons = self._servos.read()
        shape = Shape() if self._camera is None else self._camera.read()
        gauge = Gauge() if self._vacuum is None else self._vacuum.read()
        return Reading(
            t_shape=shape.t,
            theta=shape.theta,
            t_pressure=gauge.t,
            vacuum_kpa=gauge.vacuum_kpa,
            t_tendons=tendons.t,
            left_n=tendons.n[0],
            right_n=tendons.n[1],
            left_m=tendons.m[0],
            right_m=tendons.m[1],
            left_ma=tendons.ma[0],
            right_ma=tendons.ma[1],
            temperature_c=tendons.temperature_c,
            faults=(*tendons.faults, *shape.faults, *gauge.faults),
        )

    def command(self, left_n: float, right_n: float, vacuum_kpa: float) -> None:
        """Tensions [N] and vacuum [kPa] wanted; hands them to the parts' threads. Raises RigError for a dead bus."""
        if self._vacuum is not None:
            self._vacuum.command(vacuum_kpa)
        self._servos.command(left_n, right_n)

    def stop(self, vent: bool = False) -> None:
        """Tensions off first, then the vacuum kept or vented, then the camera. Never raises."""
        self._servos.stop()
        for stop in (
            lambda: self._vacuum and self._vacuum.stop(vent),
            lambda: self._camera and self._camera.stop(),
        ):
            with contextlib.suppress(Exception):
                stop()

    def __enter__(self) -> Self:
        self.connect()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
