"""What differs from loop to loop beside the robot: noise, delays, the shape to begin with, a push, effects.

Part of a specification, as `[vary]` (`ljjax.control.spec`); `usual` is what holds without it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from ljjax.control.entries import number, only, pair, table
from ljjax.effects import REGISTRY
from ljjax.errors import InputError

Range = tuple[float, float]


@dataclass(frozen=True)
class Vary:
    """Ranges are uniform, from the lower to the higher; None stands for what `[loop]` says.

    Attributes:
        noise_rad: standard deviation of the noise on the measured segment angle [rad].
        compute_ticks: periods of the law from a measurement to its command's effect.
        sensor_s: delay of the sensor [s].
        shape_rad: standard deviation of every joint's angle at rest in the beginning [rad].
        push_n: force on the tip across the unbent body, + toward tendon_left [N].
        push_at_s: when it begins [s]; `push_for_s` how long it lasts [s].
        effects: mean and standard deviation of effects' parameters, by path (`effects.<id>.<name>`).
    """

    noise_rad: Range | None = None
    compute_ticks: Range | None = None
    sensor_s: Range | None = None
    shape_rad: float = 0.0
    push_n: Range | None = None
    push_at_s: Range = (0.0, 0.0)
    push_for_s: Range = (0.1, 0.1)
    effects: Mapping[str, Range] = field(default_factory=dict)


_LEAST: Mapping[str, tuple[float, float, str]] = {
    "noise_rad": (0.0, 0.1, "between 0 and 0.1 rad"),
    "compute_ticks": (0.0, 100.0, "between 0 and 100 periods"),
    "sensor_s": (0.0, 1.0, "between 0 and 1 s"),
    "push_n": (-1e4, 1e4, "between -10000 and 10000 N"),
    "push_at_s": (0.0, 600.0, "between 0 and 600 s"),
    "push_for_s": (0.0, 600.0, "between 0 and 600 s"),
}


def usual(noise_rad: float, compute_ticks: float, sensor_s: float, period_s: float) -> Vary:
    """Without `[vary]`: noise from a half to twice that of the loop, the computation's delay from a half to one and a
    half times, the sensor's up to a period longer, joints off 0 by 0.002 rad, no push, no effects."""
    return Vary(
        (0.5 * noise_rad, 2.0 * noise_rad),
        (0.5 * compute_ticks, 1.5 * compute_ticks),
        (sensor_s, sensor_s + period_s),
        0.002,
    )


def read(where: str, given: Any) -> Vary:
    """The table `[vary]` of a specification.

    Raises:
        InputError: naming file, key, what was found and what is expected.
    """
    entries = table(where, "vary", given)
    only(where, "vary", entries, [f.name for f in fields(Vary)])
    out: dict[str, Any] = {}
    for name, (low, high, said) in _LEAST.items():
        if name in entries:
            key, value = f"vary.{name}", entries[name]
            ends = (
                pair(where, key, value, "low", "high") if isinstance(value, list) else (number(where, key, value),) * 2
            )
            if not low <= ends[0] <= ends[1] <= high:
                raise InputError(f"{where}: {key} is {value}: must be {said}, the lower first")
            out[name] = ends
    if "shape_rad" in entries:
        out["shape_rad"] = number(where, "vary.shape_rad", entries["shape_rad"])
        if not 0 <= out["shape_rad"] <= 0.5:
            raise InputError(f"{where}: vary.shape_rad = {out['shape_rad']:g}: must be between 0 and 0.5 rad")
    for name in ("push_at_s", "push_for_s"):
        if name in entries and "push_n" not in entries:
            raise InputError(
                f"{where}: vary.{name} without a push; give vary.push_n = [low, high] in N, or leave it out"
            )
    if "effects" in entries:
        out["effects"] = _effects(where, table(where, "vary.effects", entries["effects"]))
    return Vary(**out)


def _effects(where: str, given: dict[str, Any]) -> dict[str, Range]:
    out = {}
    for name, entries in given.items():
        if name not in REGISTRY:
            raise InputError(f"{where}: vary.effects.{name}: no such effect; expected one of {', '.join(REGISTRY)}")
        about = REGISTRY[name].fields()
        place = f"vary.effects.{name}"
        entries = table(where, place, entries)
        only(where, place, entries, about)
        for key, value in entries.items():
            mean, sd = pair(where, f"{place}.{key}", value, "mean", "sd")
            low, high = about[key]["low"], about[key]["high"]
            if not (low <= mean <= high and sd >= 0):
                raise InputError(
                    f"{where}: {place}.{key} is {value}: the mean must lie between {low:g} and {high:g} "
                    f"{about[key]['unit']}, and the standard deviation be ≥ 0"
                )
            out[f"effects.{name}.{key}"] = mean, sd
    return out
