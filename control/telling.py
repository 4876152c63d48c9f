"""How measures are told: to people in their units, and to JSON."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

SHOWN: dict[str, tuple[str, str, Callable[[float], float]]] = {
    "settling_s": ("settling time", "s", float),
    "overshoot": ("overshoot", "%", lambda x: 100 * x),
    "steady_error_rad": ("steady error", "°", math.degrees),
    "effort_n": ("effort, RMS tension", "N", float),
    "tension_n": ("largest tension", "N", float),
    "slew_n_s": ("RMS rate of the tensions", "N/s", float),
    "stiffness_error": ("stiffness error", "%", lambda x: 100 * x),
}
"""Measures for people: name, unit, and the value in it."""


def finite(x: Any) -> Any:
    """JSON's values: infinities and NaN are null."""
    if isinstance(x, dict):
        return {k: finite(v) for k, v in x.items()}
    if isinstance(x, list | tuple):
        return [finite(v) for v in x]
    return None if isinstance(x, float) and not math.isfinite(x) else x
