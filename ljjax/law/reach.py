"""Whether a law can do what is asked of it."""

from __future__ import annotations

import math

from ljjax.errors import InputError
from ljjax.law import ops
from ljjax.law.parts import Command, Law
from ljjax.law.step import vacuum_of


def refuse_beyond(law: Law, command: Command, where: str = "command") -> None:
    """Refuse a command that the law would cut to its limits.

    Raises:
        InputError: an angle or a stiffness that is no finite number, or out of reach, with what is in reach.
    """
    for name, value in command._asdict().items():
        if not math.isfinite(value):
            raise InputError(f"{where}: {name} is {value}; expected a finite number")
    limits = law.limits
    if abs(command.theta) > limits.theta_max_rad * (1 + 1e-9):
        raise InputError(
            f"{where}: theta = {command.theta:.4g} rad ({math.degrees(command.theta):.3g}°) is out of reach; the law "
            f"reaches ±{limits.theta_max_rad:.4g} rad ({math.degrees(limits.theta_max_rad):.3g}°)"
        )
    low, high = limits.stiffness_min_n_m, limits.stiffness_max_n_m
    if not low * (1 - 1e-9) <= command.stiffness <= high * (1 + 1e-9):
        raise InputError(
            f"{where}: stiffness = {command.stiffness:.4g} N/m is out of reach; the law reaches {low:.4g} to "
            f"{high:.4g} N/m, at {vacuum_of(ops, law.tables.root[0]):.3g} to {limits.vacuum_max_kpa:g} kPa"
        )
