"""What a control loop is asked for: targets, limits on the way there, the robots and noise to bear."""

from __future__ import annotations

import math
import os
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from ljjax.control.entries import number, only, table
from ljjax.control.vary import Vary, read
from ljjax.errors import InputError, read_file
from ljjax.law.parts import Command, Law
from ljjax.law.reach import refuse_beyond

SCHEMA = "ljjax.spec/1"


@dataclass(frozen=True)
class Requirement:
    """A measure is wanted at or below `limit` (> 0), and counts `weight` (≥ 0) in the loss."""

    limit: float
    weight: float = 1.0


@dataclass(frozen=True)
class Target:
    """A segment angle [rad] to go to from the straight robot at rest, at a transverse tip stiffness [N/m]."""

    theta_rad: float
    stiffness_n_m: float


MEASURES: Mapping[str, tuple[str, str, Requirement]] = {
    "settling_s": ("s", "time until θ stays within the band around θ*", Requirement(1.0)),
    "overshoot": ("1", "largest way beyond θ*, as a share of θ*", Requirement(0.02)),
    "steady_error_rad": ("rad", "RMS of θ − θ* over the last part of the loop", Requirement(0.001)),
    "effort_n": ("N", "RMS of the two tensions", Requirement(20.0, 0.05)),
    "tension_n": ("N", "largest tension", Requirement(60.0, 0.05)),
    "slew_n_s": ("N/s", "RMS of the tensions' rates", Requirement(60.0, 0.05)),
    "stiffness_error": ("1", "|K_T − K_T*|/K_T* of the unbent robot at the vacuum commanded", Requirement(0.02, 0.05)),
}  # fmt: skip
"""What is measured of a loop, by name: unit, meaning, and what is required by default."""


@dataclass(frozen=True)
class Spec:
    """A specification. `load` reads one from TOML, `default` makes one from a law's reach.

    Attributes:
        targets: where to go, each in a loop of its own.
        require: by name (`MEASURES`); a measure that is not there does not count.
        duration_s: length of every loop [s].
        band: half-width of the settling band, as a share of θ*.
        rest_share: the last part of the loop, over which the steady error is taken, as a share of it.
        noise_rad: standard deviation of white noise on the measured segment angle [rad].
        compute_ticks: periods of the law from a measurement to its command's effect.
        sensor_s: delay of the sensor [s].
        cvar_share: the worst share of the robots, whose mean cost is the CVaR.
        cvar_weight: what the CVaR counts in the loss, beside the mean.
        vary: what else differs from loop to loop in a robustness study; None for `vary.usual`. Not for tuning.
    """

    targets: tuple[Target, ...]
    require: Mapping[str, Requirement] = field(default_factory=lambda: {k: r for k, (_, _, r) in MEASURES.items()})
    duration_s: float = 3.0
    band: float = 0.02
    rest_share: float = 0.2
    noise_rad: float = 1e-4
    compute_ticks: float = 1.0
    sensor_s: float = 0.0
    cvar_share: float = 0.2
    cvar_weight: float = 0.5
    vary: Vary | None = None

    def as_dict(self) -> dict[str, Any]:
        """As JSON and TOML have it."""
        return {"schema": SCHEMA, **asdict(self)}


def default(law: Law) -> Spec:
    """Three targets, at a quarter, a half and three quarters of what the law reaches in angle, both ways, and in
    stiffness; `MEASURES`' requirements."""
    limits = law.limits
    low, high, most = limits.stiffness_min_n_m, limits.stiffness_max_n_m, limits.theta_max_rad
    shares = (0.25, 0.5, 0.75)
    signs = (1.0, -1.0, 1.0)
    targets = (Target(a * s * most, low + s * (high - low)) for a, s in zip(signs, shares, strict=True))
    return Spec(tuple(targets))


_LOOP = ("duration_s", "band", "rest_share", "noise_rad", "compute_ticks", "sensor_s")
_ROBOTS = ("cvar_share", "cvar_weight")
_RANGES: Mapping[str, tuple[float, float, str]] = {
    "duration_s": (0.1, 600.0, "between 0.1 and 600 s"),
    "band": (1e-4, 0.5, "a share of the angle between 0.0001 and 0.5"),
    "rest_share": (0.01, 0.9, "a share of the loop between 0.01 and 0.9"),
    "noise_rad": (0.0, 0.1, "between 0 and 0.1 rad"),
    "compute_ticks": (0.0, 100.0, "between 0 and 100 periods"),
    "sensor_s": (0.0, 1.0, "between 0 and 1 s"),
    "cvar_share": (1e-3, 1.0, "a share of the robots above 0, at most 1"),
    "cvar_weight": (0.0, 1.0, "between 0 and 1"),
}


def load(path: str | os.PathLike[str]) -> Spec:
    """Read a specification (TOML, schema ljjax.spec/1).

    Raises:
        InputError: naming file, key, what was found and what is expected.
    """
    where = str(path)
    _, data = read_file(path, tomllib.loads, "TOML", "give a specification, or none for the default")
    if data.get("schema") != SCHEMA:
        raise InputError(f'{where}: schema is {data.get("schema")!r}; expected schema = "{SCHEMA}"')
    only(where, "", data, ("schema", "targets", "loop", "robots", "require", "vary"))
    given: dict[str, Any] = {}
    for part, known in (("loop", _LOOP), ("robots", _ROBOTS)):
        entries = table(where, part, data.get(part, {}))
        only(where, part, entries, known)
        given |= {name: number(where, f"{part}.{name}", value) for name, value in entries.items()}
    for part, known in (("loop", _LOOP), ("robots", _ROBOTS)):
        for name in set(known) & set(given):
            low, high, said = _RANGES[name]
            if not low <= given[name] <= high:
                raise InputError(f"{where}: {part}.{name} = {given[name]:g}: must be {said}")
    if "require" in data:
        given["require"] = _require(where, table(where, "require", data["require"]))
    if "vary" in data:
        given["vary"] = read(where, data["vary"])
    return Spec(_targets(where, data.get("targets")), **given)


def _targets(where: str, given: Any) -> tuple[Target, ...]:
    if not isinstance(given, list) or not given:
        raise InputError(
            f"{where}: targets is {given!r}; expected tables [[targets]], each with theta_rad and stiffness_n_m"
        )
    names = [f.name for f in fields(Target)]
    out = []
    for i, entries in enumerate(given):
        place = f"targets[{i}]"
        entries = table(where, place, entries)
        only(where, place, entries, names)
        for name in names:
            if name not in entries:
                raise InputError(f"{where}: missing key {place}.{name}")
        target = Target(**{name: number(where, f"{place}.{name}", entries[name]) for name in names})
        if abs(target.theta_rad) < 1e-3:
            raise InputError(
                f"{where}: {place}.theta_rad = {target.theta_rad:g}: loops begin at 0, where there is nothing to tune; "
                "give an angle of at least 0.001 rad either way"
            )
        out.append(target)
    return tuple(out)


def _require(where: str, given: dict[str, Any]) -> dict[str, Requirement]:
    only(where, "require", given, MEASURES)
    out = {}
    for name, entries in given.items():
        place = f"require.{name}"
        entries = table(where, place, entries)
        only(where, place, entries, ("limit", "weight"))
        usual = MEASURES[name][2]
        limit = number(where, f"{place}.limit", entries.get("limit", usual.limit))
        weight = number(where, f"{place}.weight", entries.get("weight", usual.weight))
        if not limit > 0:
            raise InputError(f"{where}: {place}.limit = {limit:g}: must be > 0 {MEASURES[name][0]}")
        if weight < 0:
            raise InputError(f"{where}: {place}.weight = {weight:g}: must be ≥ 0")
        out[name] = Requirement(limit, weight)
    if not any(r.weight > 0 for r in out.values()):
        raise InputError(f"{where}: require: no measure has a weight > 0; give one of {', '.join(MEASURES)}")
    return out


def refuse(spec: Spec, law: Law, where: str) -> None:
    """Refuse targets that a law does not reach, and a loop too short to say anything.

    Raises:
        InputError: naming the target and what is in reach.
    """
    for i, target in enumerate(spec.targets):
        refuse_beyond(law, Command(target.theta_rad, target.stiffness_n_m), f"{where}: targets[{i}]")
    ticks = math.floor(spec.duration_s * spec.rest_share / float(law.period_s))
    if ticks < 2:
        raise InputError(
            f"{where}: loop.rest_share = {spec.rest_share:g} of {spec.duration_s:g} s is less than two periods of the "
            "law; raise it, or loop.duration_s"
        )
