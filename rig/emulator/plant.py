"""What an emulated rig asks of the robot it moves."""

from __future__ import annotations

from typing import Protocol


class Plant(Protocol):
    """A robot that is advanced step by step.

    Attributes:
        step_s: the step [s].
        half_length_m, lever_arm_m: half a segment's length and the tendons' lever arm [m].
        joints: joint angles as the camera sees them [rad].
        bend: q_Σ as the tendons feel it [rad].
    """

    step_s: float
    half_length_m: float
    lever_arm_m: float

    @property
    def joints(self) -> tuple[float, ...]: ...

    @property
    def bend(self) -> float: ...

    def advance(self, left_n: float, right_n: float, vacuum_kpa: float) -> None:
        """One step under tensions [N] and the line's vacuum [kPa]."""
        ...
