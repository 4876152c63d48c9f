"""What a control law is made of: its numbers in groups, its state, what it is told and what it commands.

Every number is a scalar and every table a sequence, so that the same groups hold Python floats on a rig, arrays under
JAX and symbols where C is written.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

Kind = Literal["passivity", "integral", "observer"]
KINDS: Mapping[Kind, str] = {
    "passivity": "energy shaping and damping, as published",
    "integral": "the same with integral action on the shaped error",
    "observer": "the same with integral action and friction compensated from a LuGre observer",
}
"""The laws, and what each is in a few words."""

USED: Mapping[Kind, tuple[str, ...]] = {
    "passivity": ("gamma", "damping", "filter_s"),
    "integral": ("gamma", "damping", "filter_s", "integral", "leak_per_s", "dead_zone_rad", "still_rad_s"),
    "observer": (
        "gamma",
        "damping",
        "filter_s",
        "integral",
        "leak_per_s",
        "dead_zone_rad",
        "still_rad_s",
        "compensation",
    ),
}
"""The gains that each law uses."""


class Gains(NamedTuple):
    """What tuning may change."""

    gamma: Any
    damping: Any
    filter_s: Any
    integral: Any
    leak_per_s: Any
    dead_zone_rad: Any
    compensation: Any
    still_rad_s: Any


class Robot(NamedTuple):
    """What the law knows of the robot beside its tables."""

    segments: Any
    lever_arm_m: Any
    alpha1: Any
    sigma0: Any
    sigma3: Any
    mu_c: Any
    mu_s: Any
    v_s: Any


class Limits(NamedTuple):
    """What the law keeps within, whatever it is told."""

    tension_min_n: Any
    tension_max_n: Any
    co_contraction_n: Any
    tension_slew_n_s: Any
    vacuum_max_kpa: Any
    vacuum_slew_kpa_s: Any
    theta_max_rad: Any
    stiffness_min_n_m: Any
    stiffness_max_n_m: Any


class Tables(NamedTuple):
    """Values between which the law goes in straight lines, each at evenly spaced places.

    `alpha2` and `phi` lie over w(u_P) from 0 to w of the highest vacuum, w(u_P) = u_P/√(u_P + ε) being the model's
    smooth √u_P, of which φ is linear; `root` holds w over the transverse stiffness, from the lowest to the highest.
    """

    alpha2: Any
    phi: Any
    root: Any


UNITS: Mapping[str, str] = {
    "period_s": "s",
    "gains.gamma": "N·m",
    "gains.damping": "N·s/m",
    "gains.filter_s": "s",
    "gains.integral": "N·m/(rad·s)",
    "gains.leak_per_s": "1/s",
    "gains.dead_zone_rad": "rad",
    "gains.compensation": "1",
    "gains.still_rad_s": "rad/s",
    "robot.segments": "1",
    "robot.lever_arm_m": "m",
    "robot.alpha1": "N·m",
    "robot.sigma0": "1/rad",
    "robot.sigma3": "1",
    "robot.mu_c": "1",
    "robot.mu_s": "1",
    "robot.v_s": "rad/s",
    "limits.tension_min_n": "N",
    "limits.tension_max_n": "N",
    "limits.co_contraction_n": "N",
    "limits.tension_slew_n_s": "N/s",
    "limits.vacuum_max_kpa": "kPa",
    "limits.vacuum_slew_kpa_s": "kPa/s",
    "limits.theta_max_rad": "rad",
    "limits.stiffness_min_n_m": "N/m",
    "limits.stiffness_max_n_m": "N/m",
    "tables.alpha2": "N·m/rad",
    "tables.phi": "N·m",
    "tables.root": "√kPa",
}
"""The unit of every number of a law, by path."""


@dataclass(frozen=True)
class Law:
    """A control law: its kind, its loop's period [s], and its numbers (`UNITS` has their units)."""

    kind: Kind
    period_s: Any
    gains: Gains
    robot: Robot
    limits: Limits
    tables: Tables


class State(NamedTuple):
    """What the law remembers from tick to tick.

    Attributes:
        q_sum: the bend last measured [rad]; `rate` its filtered rate [rad/s].
        integral: torque on every joint by integral action [N·m].
        bristle: observed mean deflection of the bristles [rad].
        net: u₁ − u₂ last commanded [N]; `level` the mean of the two tensions.
        vacuum: vacuum last commanded [kPa].
    """

    q_sum: Any
    rate: Any
    integral: Any
    bristle: Any
    net: Any
    level: Any
    vacuum: Any


class Measured(NamedTuple):
    """The body's bend q_Σ = nθ [rad], and the vacuum in the line [kPa] (or that commanded, where no gauge is)."""

    q_sum: Any
    vacuum: Any


class Command(NamedTuple):
    """The mean segment angle wanted [rad] and the transverse tip stiffness wanted [N/m]."""

    theta: Any
    stiffness: Any


class Output(NamedTuple):
    """Tensions to the left and right tendon [N], both ≥ 0, and the vacuum [kPa below atmosphere]."""

    left: Any
    right: Any
    vacuum: Any


STATE_UNITS: Mapping[str, str] = dict(zip(State._fields, ("rad", "rad/s", "N·m", "rad", "N", "N", "kPa"), strict=True))
