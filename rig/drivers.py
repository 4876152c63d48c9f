"""Which robot a rig.toml means."""

from __future__ import annotations

from collections.abc import Callable

from ljjax.errors import InputError
from ljjax.rig.config import Config
from ljjax.rig.robot import Robot


def _mock(config: Config) -> Robot:
    from ljjax.rig.mock import MockRobot

    return MockRobot(config.mock)


def _reference(config: Config) -> Robot:
    from ljjax.rig.reference import ReferenceRig

    return ReferenceRig(config)


def _ros2(config: Config) -> Robot:
    from ljjax.rig.ros2 import Ros2Robot

    return Ros2Robot(config)


DRIVERS: dict[str, Callable[[Config], Robot]] = {"mock": _mock, "reference": _reference, "ros2": _ros2}


def open_robot(config: Config) -> Robot:
    """The robot that the configuration's `driver` names, not connected yet.

    Raises:
        InputError: no such driver, or the driver cannot use its sections.
    """
    if config.driver not in DRIVERS:
        raise InputError(f"{config.path}: driver is {config.driver!r}; expected {', '.join(DRIVERS)}")
    return DRIVERS[config.driver](config)
