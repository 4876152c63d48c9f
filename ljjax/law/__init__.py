"""The control law as it runs: plain arithmetic, no JAX, no NumPy.

    from ljjax import law
    robot_law = law.load("law.json")
    state = law.start(robot_law, q_sum, vacuum, left, right)
    state, output = law.tick(robot_law, state, law.Measured(q_sum, vacuum), law.Command(theta, stiffness))

`ljjax.control` designs a law from a model, simulates it in closed loop and exports it.
"""

from __future__ import annotations

import math

from ljjax.errors import InputError
from ljjax.law import ops
from ljjax.law.file import load
from ljjax.law.parts import KINDS, UNITS, Command, Gains, Law, Limits, Measured, Output, Robot, State, Tables
from ljjax.law.reach import refuse_beyond
from ljjax.law.step import start, step

__all__ = [
    "KINDS",
    "UNITS",
    "Command",
    "Gains",
    "Law",
    "Limits",
    "Measured",
    "Output",
    "Robot",
    "State",
    "Tables",
    "load",
    "refuse_beyond",
    "start",
    "step",
    "tick",
]


def tick(law: Law, state: State, measured: Measured, command: Command) -> tuple[State, Output]:
    """`step` on Python floats.

    Raises:
        InputError: a measurement or a command that is no finite number; the state has not changed.
    """
    for given in (measured, command):
        for name, value in zip(given._fields, given, strict=True):
            if not math.isfinite(value):
                raise InputError(
                    f"{type(given).__name__.lower()}.{name} is {value}: hold the last output, and check the sensor"
                )
    return step(ops, law, state, measured, command)
