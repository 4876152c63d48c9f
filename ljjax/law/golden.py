"""Golden vectors: what a law must do, tick by tick, on a scripted sequence that drives it into each of its limits."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from ljjax.law import ops
from ljjax.law.parts import Command, Law, Measured, Output, State
from ljjax.law.step import start, step

TICKS = 200
TOLERANCE = 1e-12
"""Largest error that passes, relative to the larger of the value and a hundredth of its column's largest."""
COLUMNS = (
    *(f"measured.{name}" for name in Measured._fields),
    *(f"command.{name}" for name in Command._fields),
    *(f"state.{name}" for name in State._fields),
    *(f"output.{name}" for name in Output._fields),
)
_GIVEN = len(Measured._fields) + len(Command._fields)


class Golden(NamedTuple):
    """A state to begin from, and a row a tick: inputs, the state after the tick, outputs (`COLUMNS`)."""

    initial: State
    rows: tuple[tuple[float, ...], ...]


def script(law: Law) -> tuple[State, list[tuple[Measured, Command]]]:
    """Inputs that step, creep, reverse and overstep every limit: commands beyond reach, a bend that follows late, rests
    within the dead zone, is held a quarter turn away and jumps, and a vacuum that lags behind its command."""
    limits, n = law.limits, law.robot.segments
    width = limits.stiffness_max_n_m - limits.stiffness_min_n_m
    initial = start(law, 0.0, 0.0, 0.0, 0.0)
    inputs = []
    bend, vacuum = 0.0, 0.0
    for k in range(TICKS):
        part = k // 20
        theta = limits.theta_max_rad * (0.3, 0.3, 1.4, 1.4, -0.8, -0.8, -0.8, -0.8, 0.05, 0.05)[part]
        stiffness = limits.stiffness_min_n_m + width * (0.2, 0.9, 1.5, 0.6, -0.4, -0.4, 0.5, 0.5, 0.5, 0.01)[part]
        wanted = n * max(-limits.theta_max_rad, min(limits.theta_max_rad, theta))
        wanted = wanted - 0.5 * math.pi * (0.0, 0.0, 1.0, 1.0, -1.0, -1.0, -1.0, -1.0, 0.0, 0.0)[part]  # held away
        near = wanted + n * law.gains.dead_zone_rad * (0.5 * math.sin(1.7 * k) + (3.0 if part % 2 else 0.0))
        bend = bend + (0.25 if k % 20 < 12 else 0.9) * (near - bend)
        if k % 53 == 52:
            bend = bend + 0.4 * (-1) ** k
        vacuum = vacuum + 0.2 * (limits.vacuum_max_kpa * (0.5 + 0.6 * math.sin(0.11 * k)) - vacuum)
        inputs.append((Measured(bend, vacuum), Command(theta, stiffness)))
    return initial, inputs


def record(law: Law) -> Golden:
    """The golden vectors of a law whose numbers are Python floats."""
    state, inputs = script(law)
    initial, rows = state, []
    for measured, command in inputs:
        state, output = step(ops, law, state, measured, command)
        rows.append((*measured, *command, *state, *output))
    return Golden(initial, tuple(rows))


def mismatch(law: Law, golden: Golden) -> str:
    """Where the law as it runs here departs from its golden vectors, in words; empty where it does not."""
    if not golden.rows:
        return "there are none"
    scale = [max(abs(row[i]) for row in golden.rows) for i in range(len(COLUMNS))]
    state = golden.initial
    for k, row in enumerate(golden.rows):
        measured, command = Measured(*row[:2]), Command(*row[2:_GIVEN])
        state, output = step(ops, law, state, measured, command)
        for i, (found, expected) in enumerate(zip((*state, *output), row[_GIVEN:], strict=True), _GIVEN):
            if not error(found, expected, scale[i]) <= TOLERANCE:
                return f"tick {k}, {COLUMNS[i]}: {found!r} here, {expected!r} in the file"
    return ""


def error(found: Any, expected: Any, scale: Any) -> float:
    """|found − expected| over the larger of |expected| and a hundredth of the column's largest."""
    return abs(found - expected) / max(abs(expected), 0.01 * scale, 1e-300)
