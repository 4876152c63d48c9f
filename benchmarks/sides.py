"""Timing side by side: rounds in which every side runs once after the other, so that other load hits all alike."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np


class Row(NamedTuple):
    """One line of the table: a value, its unit, the goal (at least, or at most) and whether it is met; beside it other
    values in the same unit."""

    name: str
    value: float
    unit: str
    goal: str
    met: bool | None
    peers: dict[str, float]
    note: str = ""


def interleaved(sides: Mapping[str, Callable[[], Any]], rounds: int, least_s: float = 0.0) -> dict[str, np.ndarray]:
    """Seconds a call of every side in each round. A side is called until it has run for `least_s`, so that quick sides
    meet as much of the other load as slow ones."""
    for side in sides.values():
        side()
    out: dict[str, list[float]] = {name: [] for name in sides}
    for _ in range(rounds):
        for name, side in sides.items():
            calls, start = 0, time.perf_counter()
            while calls == 0 or time.perf_counter() - start < least_s:
                side()
                calls += 1
            out[name].append((time.perf_counter() - start) / calls)
    return {name: np.array(x) for name, x in out.items()}


def ratio(times: Mapping[str, np.ndarray], over: str, under: str) -> float:
    """The median over the rounds of over/under."""
    return float(np.median(times[over] / times[under]))
