"""`rig.toml` (schema ljjax.rig/1): one robot's hardware, limits and what counts as a fault."""

from __future__ import annotations

import dataclasses
import math
import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from ljjax.errors import InputError, read_file

SCHEMA = "ljjax.rig/1"
PARTS = ("servos", "camera", "pressure", "sensors", "ros2", "mock")
"""Sections that only a driver reads."""
_NOTHING: Mapping[str, Any] = MappingProxyType({})


@dataclass(frozen=True)
class Limits:
    """What no command ever passes, and beyond which a measurement is a fault.

    Attributes:
        tension_max_n, tension_slew_n_s: of the tension commanded to a tendon, and its rate [N, N/s].
        vacuum_max_kpa, vacuum_slew_kpa_s: of the vacuum commanded [kPa, kPa/s].
        theta_max_rad: of the measured mean segment angle [rad].
        tension_trip_n: of the measured tension [N]; by default a quarter above `tension_max_n`.
        vacuum_trip_kpa: of the measured vacuum [kPa]; by default a quarter above `vacuum_max_kpa`.
        current_max_ma, temperature_max_c: of a motor [mA, °C].
    """

    tension_max_n: float
    tension_slew_n_s: float
    vacuum_max_kpa: float
    vacuum_slew_kpa_s: float
    theta_max_rad: float
    tension_trip_n: float = 0.0
    vacuum_trip_kpa: float = 0.0
    current_max_ma: float = math.inf
    temperature_max_c: float = 70.0

    def __post_init__(self) -> None:
        for name, most in (("tension_trip_n", self.tension_max_n), ("vacuum_trip_kpa", self.vacuum_max_kpa)):
            object.__setattr__(self, name, getattr(self, name) or 1.25 * most)


@dataclass(frozen=True)
class Safety:
    """What counts as a fault, and what is done then. 0 for a time means: no such sensor, do not watch it.

    Attributes:
        release_n_s: how fast tensions fall to zero after a fault and at the end of a run [N/s].
        vacuum: `vent` or `hold`, after a fault and at the end of a run.
        ramp_s: how long a run is ramped in [s].
        first_s: how long sensors have to say something before a run begins [s].
        shape_s, tendons_s, pressure_s: how old a sensor's last good reading may be [s].
        jump_rad: between two readings of the angle; a larger one is not believed [rad].
        stuck_n, stuck_kpa, stuck_s: an angle (a gauge) that says the same to the last bit for this long, though the
            net tension (the vacuum) commanded has changed by as much, is stuck.
        leak_kpa, leak_s: a vacuum that misses the command by this much for this long.
        tension_off_n, tension_off_s: a measured tension that misses the command by this much for this long.
        late_s: a tick this late [s]; missed_share: of the deadlines of a second.
        log_s: how long what has been measured may wait for the disk [s].
        stop_file: a file whose appearance stops the robot. stop_gpio: a GPIO's `value` file that reads 1 while all is
            well, so that a broken wire stops it too.
    """

    release_n_s: float = 20.0
    vacuum: str = "vent"
    ramp_s: float = 1.0
    first_s: float = 3.0
    shape_s: float = 0.1
    tendons_s: float = 0.1
    pressure_s: float = 0.5
    jump_rad: float = 0.1
    stuck_n: float = 5.0
    stuck_kpa: float = 5.0
    stuck_s: float = 1.0
    leak_kpa: float = 5.0
    leak_s: float = 2.0
    tension_off_n: float = 10.0
    tension_off_s: float = 0.5
    late_s: float = 0.1
    missed_share: float = 0.2
    log_s: float = 0.5
    stop_file: str = ""
    stop_gpio: str = ""


@dataclass(frozen=True)
class Config:
    """A rig.toml: which robot, which driver, its limits, and the driver's own sections as they are."""

    path: str
    robot_id: str
    driver: str
    p_atm_pa: float
    limits: Limits
    safety: Safety = Safety()
    servos: Mapping[str, Any] = field(default_factory=lambda: _NOTHING)
    camera: Mapping[str, Any] = field(default_factory=lambda: _NOTHING)
    pressure: Mapping[str, Any] = field(default_factory=lambda: _NOTHING)
    sensors: Mapping[str, Any] = field(default_factory=lambda: _NOTHING)
    ros2: Mapping[str, Any] = field(default_factory=lambda: _NOTHING)
    mock: Mapping[str, Any] = field(default_factory=lambda: _NOTHING)
    text: str = ""


def load(path: str | os.PathLike[str]) -> Config:
    """The configuration in a rig.toml.

    Raises:
        InputError: no such file, not TOML, a key that is missing, unknown or impossible.
    """
    text, data = read_file(path, tomllib.loads, "TOML", "give a rig.toml, as docs/rig.md shows one")
    return parse(data, os.fspath(path), text)


def parse(data: Mapping[str, Any], where: str, text: str = "") -> Config:
    """The configuration in the contents of a rig.toml, checked as `load` says."""
    if data.get("schema") != SCHEMA:
        raise InputError(f"{where}: schema is {data.get('schema')!r}; expected {SCHEMA!r}")
    known = ("schema", "robot_id", "driver", "p_atm_pa", "limits", "safety", *PARTS)
    for key in data:
        if key not in known:
            raise InputError(f"{where}: unknown key {key!r}; expected {', '.join(known)}")
    for key in ("robot_id", "driver", "p_atm_pa", "limits"):
        if key not in data:
            raise InputError(f"{where}: {key} is missing; docs/rig.md says what it is")
    for key in ("robot_id", "driver"):
        if not isinstance(data[key], str) or not data[key]:
            raise InputError(f"{where}: {key} is {data[key]!r}; expected a name in quotes")
    for key in ("limits", "safety", *PARTS):
        if not isinstance(data.get(key, {}), dict):
            raise InputError(f"{where}: {key} is {data[key]!r}; expected a section [{key}]")
    p_atm = _number(where, "p_atm_pa", data["p_atm_pa"])
    if not 2e4 < p_atm < 1.2e5:
        raise InputError(f"{where}: p_atm_pa = {p_atm:g}; expected the atmosphere's pressure in Pa, such as 101325")
    limits = _section(Limits, data["limits"], where, "limits")
    safety = _section(Safety, data.get("safety", {}), where, "safety")
    if safety.vacuum not in ("vent", "hold"):
        raise InputError(f"{where}: safety.vacuum is {safety.vacuum!r}; expected 'vent' or 'hold'")
    for key in ("release_n_s", "first_s", "late_s", "missed_share", "log_s", "jump_rad"):
        if not getattr(safety, key) > 0:
            raise InputError(f"{where}: safety.{key} = {getattr(safety, key):g}; must be > 0")
    parts = {name: MappingProxyType(dict(data.get(name, {}))) for name in PARTS}
    return Config(where, data["robot_id"], data["driver"], p_atm, limits, safety, **parts, text=text)


def _section(kind: type, given: Mapping[str, Any], where: str, name: str) -> Any:
    fields = {f.name: f for f in dataclasses.fields(kind)}
    for key in given:
        if key not in fields:
            raise InputError(f"{where}: {name}: unknown key {key!r}; expected {', '.join(fields)}")
    values: dict[str, Any] = {}
    for key, f in fields.items():
        if key not in given:
            if f.default is dataclasses.MISSING:
                raise InputError(f"{where}: {name}.{key} is missing; state it for this robot")
        elif isinstance(f.default, str):
            if not isinstance(given[key], str):
                raise InputError(f"{where}: {name}.{key} is {given[key]!r}; expected text in quotes")
            values[key] = given[key]
        else:
            values[key] = _number(where, f"{name}.{key}", given[key])
            if values[key] < 0 or (values[key] == 0 and f.default is dataclasses.MISSING):
                raise InputError(f"{where}: {name}.{key} = {values[key]:g}; must be > 0")
    return kind(**values)


def _number(where: str, key: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"{where}: {key} is {value!r}; expected a finite number")
    return float(value)
