"""The control law as it runs: plain arithmetic, no JAX, no NumPy.

    from ljjax import law
    robot_law = law.load("law.json")
    state = law.start(robot_law, q_sum, vacuum, left, right)
    state, output = law.tick(robot_law, state, law.Measured(q_sum, vacuum), law.Command(theta, stiffness))

`ljjax.control` designs a law from a model, simulates it in closed loop and exports it.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from ljjax.errors import InputError
from ljjax.law import ops
from ljjax.law.file import load
from ljjax.law.parts import KINDS, UNITS, Command, Gains, Law, Limits, Measured, Output, Robot, State, Tables
from ljjax.law.reach import refuse_beyond
from ljjax.law.step import start as begin
from ljjax.law.step import step

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


def start(law: Law, q_sum: Any, vacuum: Any, left: Any, right: Any) -> State:
    """The state in which a law takes over without a bump: the bend [rad] and vacuum [kPa] measured, and the tensions
    [N] that are applied.

    Raises:
        InputError: one of them is no finite number.
    """
    for name, value in {"q_sum": q_sum, "vacuum": vacuum, "left": left, "right": right}.items():
        _finite(f"start: {name}", value, "measure it again")
    state = begin(law, q_sum, vacuum, left, right)
    _all_finite(state, "start nearer")
    return state


def tick(law: Law, state: State, measured: Measured, command: Command) -> tuple[State, Output]:
    """`step` on Python floats.

    Raises:
        InputError: a measurement, a command or the state that is no finite number, or would not be; there is no new
            state then, and the one given may be used again where it was finite.
    """
    for given in (measured, command):
        _all_finite(given, "hold the last output, and check the sensor")
    _all_finite(state, "hold the last output, and start the law again")
    result = step(ops, law, state, measured, command)
    for made in result:
        _all_finite(made, "hold the last output, and start the law again")
    return result


def _all_finite(given: NamedTuple, mend: str) -> None:
    for name, value in given._asdict().items():
        _finite(f"{type(given).__name__.lower()}.{name}", value, mend)


def _finite(name: str, value: Any, mend: str) -> None:
    if not math.isfinite(value):
        raise InputError(f"{name} is {value}: {mend}")
