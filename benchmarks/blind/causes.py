"""What can be planted: causes, how strong they can be, and which answers about them are right."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.blind.plant import JOINTS
from benchmarks.recovery.experiments import Array

Draw = Callable[[np.random.Generator, "Setting"], list[float]]


@dataclass(frozen=True)
class Setting:
    """What a cause's numbers may depend on.

    Attributes:
        peak_n: largest commanded tension of either tendon.
        tip_m: (2,) farthest the tip goes to each side without any cause.
        seconds: length of a run.
        apart_s: from the start of one run to the next.
    """

    peak_n: float
    tip_m: Array
    seconds: float
    apart_s: float


@dataclass(frozen=True)
class Cause:
    """One cause.

    Attributes:
        block: of the model, as `gap.json` names it; None for a cause that no listed effect stands for.
        axes: region axes that are right, each by itself.
        start: a strength to begin the search from, in the unit of `largest`.
        largest: the strongest that a robot can have.
        shape: its further numbers, drawn.
        signed: whether it can go both ways.
    """

    id: str
    block: str | None
    axes: tuple[str, ...]
    start: float
    largest: float
    shape: Draw
    signed: bool = False


def _none(rng: np.random.Generator, setting: Setting) -> list[float]:
    return []


def _between(*ranges: tuple[float, float]) -> Draw:
    return lambda rng, setting: [rng.uniform(low, high) for low, high in ranges]


def _sides(rng: np.random.Generator, setting: Setting) -> list[float]:
    """One tendon all of it, the other little or the other way."""
    sides = [1.0, rng.uniform(-0.4, 0.4)]
    rng.shuffle(sides)
    return sides


def _ripple(rng: np.random.Generator, setting: Setting) -> list[float]:
    turn = rng.uniform(0, 2 * np.pi, 4)
    return [rng.uniform(2000, 6000), rng.uniform(0.008, 0.015), float(rng.integers(7, 13)), *turn]


def _peak(rng: np.random.Generator, setting: Setting) -> list[float]:
    return [setting.peak_n]


def _curved(rng: np.random.Generator, setting: Setting) -> list[float]:
    return list(1 + 0.35 * rng.standard_normal(JOINTS).clip(-2, 2))


def _uneven(rng: np.random.Generator, setting: Setting) -> list[float]:
    x = rng.standard_normal(JOINTS)
    x -= x.mean()
    return list(x / np.sqrt(np.mean(x**2)))


def _payload(rng: np.random.Generator, setting: Setting) -> list[float]:
    return [rng.uniform(0.005, 0.03), rng.uniform(-0.003, 0.003)]


def _obstacle(rng: np.random.Generator, setting: Setting) -> list[float]:
    side = int(rng.integers(2))
    return [rng.uniform(0.45, 0.65) * setting.tip_m[side], (1.0, -1.0)[side]]


def _which(rng: np.random.Generator, setting: Setting) -> list[float]:
    return [float(rng.integers(2))]


def _joint(rng: np.random.Generator, setting: Setting) -> list[float]:
    return [float(rng.integers(JOINTS)), rng.uniform(0, 6)]


def _break(rng: np.random.Generator, setting: Setting) -> list[float]:
    """In the middle of a run, near the middle of the session."""
    return [int(rng.integers(2, 6)) * setting.apart_s + rng.uniform(0.3, 0.6) * setting.seconds]


def _waves(rng: np.random.Generator, setting: Setting) -> list[float]:
    return [rng.uniform(0.8, 2.5), rng.uniform(0, 6)]


def _spells(rng: np.random.Generator, setting: Setting) -> list[float]:
    return [setting.seconds * (share + rng.uniform(-0.08, 0.08)) for share in (0.25, 0.5, 0.75)]


def _markers(rng: np.random.Generator, setting: Setting) -> list[float]:
    return list(rng.uniform(0.3, 1.0, JOINTS) * rng.choice([1, 1, 1, -1], JOINTS))


def _seed(rng: np.random.Generator, setting: Setting) -> list[float]:
    return [float(rng.integers(2**31))]


LISTED = (
    Cause("tendon_friction", "actuation", ("direction", "load", "angle"), 0.05, 0.5, _between((0.03, 0.15))),
    Cause("tendon_slack", "actuation", ("direction", "load"), 0.3, 6, _none),
    Cause("actuator_lag", "actuation", ("rate", "direction", "time"), 0.02, 0.5, _none),
    Cause("actuator_delay", "actuation", ("rate", "direction", "time"), 0.02, 0.3, _between((0.05, 0.3), (0, 6))),
    Cause("actuator_deadband", "actuation", ("load", "angle"), 0.4, 5, _none),
    Cause("actuator_gain", "actuation", ("load", "angle", "everywhere", "direction"), 0.05, 0.5, _sides, True),
    Cause("actuator_ripple", "actuation", ("angle", "load"), 0.3, 4, _ripple),
    Cause("actuator_saturation", "actuation", ("load", "angle"), 0.3, 0.8, _peak),
    Cause("pressure_lag", "jamming", ("pressure", "time", "rate"), 0.5, 6, _between((0.5, 2.2))),
    Cause("pressure_leak", "jamming", ("pressure", "time"), 1, 8, _between((3, 9), (3, 8))),
    Cause("pressure_bias", "jamming", ("pressure",), 1, 8, _none, True),
    Cause("stiffness_saturation", "jamming", ("pressure",), 1, 8, _none),
    Cause("friction_saturation", "jamming", ("pressure",), 1, 8, _none),
    Cause("layer_hysteresis", "jamming", ("direction",), 0.02, 0.3, _none),
    Cause("layer_wear", "jamming", ("time", "run"), 0.3, 0.9, _between((3, 10))),
    Cause("viscoelastic_creep", "structure", ("time", "rate"), 0.3, 6, _none),
    Cause("viscous_damping", "structure", ("rate", "direction"), 0.05, 1.5, _none),
    Cause("stiffness_hardening", "structure", ("angle", "load"), 3, 60, _none),
    Cause("rest_curvature", "structure", ("everywhere", "angle", "pressure"), 0.01, 0.25, _curved, True),
    Cause("base_tilt", "structure", ("everywhere", "angle", "pressure"), 0.1, 1.0, _none, True),
    Cause("tip_payload", "structure", ("angle", "segment", "rate"), 0.03, 0.4, _payload),
    Cause("gravity_distribution", "structure", ("angle", "segment"), 0.5, 3, _none),
    Cause("nonuniform_stiffness", "structure", ("segment",), 0.1, 0.7, _uneven),
    Cause("contact", "structure", ("angle", "load"), 100, 1e4, _obstacle),
    Cause("friction_asymmetry", "friction", ("direction",), 0.1, 0.65, _none, True),
    Cause("load_dependent_friction", "friction", ("load", "pressure"), 0.2, 4, _none),
    Cause("thermal_drift", "friction", ("time", "run"), 0.2, 2.5, _which),
    Cause("sensor_bias", "sensing", ("everywhere",), 0.001, 0.05, _markers, True),
    Cause("sensor_scale", "sensing", ("everywhere", "angle"), 0.02, 0.12, _none, True),
    Cause("sensor_delay", "sensing", ("rate", "direction", "time"), 0.02, 0.3, _between((0.05, 0.2), (0, 6))),
    Cause("sensor_filter", "sensing", ("rate", "time", "direction"), 0.05, 0.8, _none),
)
UNLISTED = (
    Cause("jammed_joint", None, (), 0.5, 12, _joint),
    Cause("base_vibration", None, (), 0.03, 0.6, _waves),
    Cause("buckling_friction", None, (), 1, 30, _between((0.05, 0.09))),
    Cause("glue_failure", None, (), 0.1, 0.8, _break),
    Cause("snap_through", None, (), 0.01, 0.5, _between((50, 100))),
    Cause("hidden_pendulum", None, (), 0.05, 3, _between((5, 11))),
    Cause("dropout", None, (), 0.1, 1.2, _spells),
    Cause("camera_wander", None, (), 0.001, 0.05, _seed),
)
CAUSES = {cause.id: cause for cause in (*LISTED, *UNLISTED)}
SENSING = ("sensor_bias", "sensor_scale", "sensor_delay", "sensor_filter", "camera_wander")
BLOCKS = {cause.id: cause.block for cause in LISTED}


DELAYS, DRIFTS = {"actuator_delay", "sensor_delay"}, {"layer_wear", "thermal_drift"}
ALIKE = (DELAYS, DRIFTS, {"rest_curvature", "base_tilt", "sensor_bias"})
"""Known confusions of effects.md."""


def confusable(cause: str, tension_measured: bool, temperature_logged: bool) -> set[str]:
    """The effects that count as this one: itself, and what effects.md says cannot be told from it in such logs."""
    out = {cause}
    if not tension_measured and cause in DELAYS:
        out |= DELAYS
    if not temperature_logged and cause in DRIFTS:
        out |= DRIFTS
    return out
