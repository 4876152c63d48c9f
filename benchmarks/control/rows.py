"""A row of the study, and how large a run of it is."""

from __future__ import annotations

from typing import Any, NamedTuple


class Row(NamedTuple):
    """One line of the table.

    Attributes:
        value: a number in `unit`.
        goal: what was asked for, in words; empty where the value is only told.
        met: whether the value meets the goal; None where there is none.
        cases: what the value rests on: scenarios, robots, seeds, inputs.
        note: how it was measured, and what does not fit.
        beside: further numbers, by name.
    """

    name: str
    value: float
    unit: str
    goal: str
    met: bool | None
    cases: int
    note: str
    beside: dict[str, Any] = {}


class Size(NamedTuple):
    """How large a run is; the quick one is for a test, whose values of accuracy, tuning and speed mean nothing.

    Attributes:
        segments: of the robots of accuracy, tuning and speed; the published experiments always have six.
        robots: for the accuracy; `probed` of them are pushed as well.
        seeds, iterations, patience: of the tuning: its repetitions, the descent's steps, and how many times the
            descent's loops a search without derivatives may take.
        loops, loop_s: closed loops timed, and their length [s].
        ticks: random inputs of the parity.
    """

    segments: int = 6
    robots: int = 1000
    probed: int = 64
    seeds: int = 5
    iterations: int = 20
    patience: int = 25
    loops: int = 1024
    loop_s: float = 10.0
    ticks: int = 100_000


QUICK = Size(2, 16, 4, 1, 3, 3, 32, 1.0, 2000)
