"""What can be planted: causes, how strong they can be, and which answers about them are right."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.blind.plant import FORM, JOINTS
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
class Shape:
    """One of the mathematical forms that a cause can take.

    Attributes:
        start: a strength to begin the search from, in the unit of `largest`.
        largest: the strongest that a robot can have.
        numbers: its further numbers, drawn.
        axes: region axes that are right for it beside its cause's.
    """

    start: float
    largest: float
    numbers: Draw
    axes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Cause:
    """One cause.

    Attributes:
        block: of the model, as `gap.json` names it; None for a cause that no listed effect stands for.
        axes: region axes that are right, each by itself.
        shapes: all equally likely.
        signed: whether it can go both ways.
    """

    id: str
    block: str | None
    axes: tuple[str, ...]
    shapes: tuple[Shape, ...]
    signed: bool = False


def row(form: int, strength: float, numbers: Sequence[float]) -> list[float]:
    """A cause's numbers as the simulators want them."""
    return [strength, *numbers, *[0.0] * (FORM - 1 - len(numbers)), float(form)]


def _none(rng: np.random.Generator, setting: Setting) -> list[float]:
    return []


def _between(*ranges: tuple[float, float]) -> Draw:
    return lambda rng, setting: [rng.uniform(low, high) for low, high in ranges]


def _fixed(*numbers: float) -> Draw:
    return lambda rng, setting: list(numbers)


def _then(*draws: Draw) -> Draw:
    """The numbers of one draw after those of another."""
    return lambda rng, setting: [x for draw in draws for x in draw(rng, setting)]


def _alike(start: float, largest: float, *draws: Draw) -> tuple[Shape, ...]:
    """Shapes of like strengths."""
    return tuple(Shape(start, largest, draw) for draw in draws)


def _sides(low: float, high: float) -> Draw:
    """One tendon all of it, the other so much."""

    def draw(rng: np.random.Generator, setting: Setting) -> list[float]:
        sides = [1.0, rng.uniform(low, high)]
        rng.shuffle(sides)
        return sides

    return draw


def _ripple(rng: np.random.Generator, setting: Setting) -> list[float]:
    turn = rng.uniform(0, 2 * np.pi, 4)
    return [rng.uniform(2000, 6000), rng.uniform(0.008, 0.015), float(rng.integers(7, 13)), *turn]


def _climbed(rng: np.random.Generator, setting: Setting) -> list[float]:
    """The length of tendon [m] beyond which each spool winds on a second layer."""
    return list(rng.uniform(0.1, 0.5, 2) * 0.12 * setting.tip_m / 0.756)


def _liners(rng: np.random.Generator, setting: Setting) -> list[float]:
    return list(rng.uniform(0.3, 1.7, JOINTS))


def _lifted(rng: np.random.Generator, setting: Setting) -> list[float]:
    """The load [N] from which guides press on the layers."""
    return [rng.uniform(0.2, 0.45) * setting.peak_n]


def _peak(rng: np.random.Generator, setting: Setting) -> list[float]:
    return [setting.peak_n]


def _curved(rng: np.random.Generator, setting: Setting) -> list[float]:
    return list(1 + 0.35 * rng.standard_normal(JOINTS).clip(-2, 2))


def _kinked(rng: np.random.Generator, setting: Setting) -> list[float]:
    """All of it in two neighbouring joints."""
    x = np.zeros(JOINTS)
    at = int(rng.integers(JOINTS - 1))
    x[at : at + 2] = rng.uniform(1, 3, 2)
    return list(x / x.mean())


def _level(x: Array) -> list[float]:
    """With mean 0 and size 1."""
    x = x - x.mean()
    return list(x / np.sqrt(np.mean(x**2)))


def _uneven(rng: np.random.Generator, setting: Setting) -> list[float]:
    return _level(rng.standard_normal(JOINTS))


def _tapered(rng: np.random.Generator, setting: Setting) -> list[float]:
    return _level(rng.choice([-1.0, 1.0]) * np.arange(JOINTS) ** rng.uniform(0.7, 1.5))


def _alternating(rng: np.random.Generator, setting: Setting) -> list[float]:
    """Layers that overlap at every second joint."""
    return _level(rng.choice([-1.0, 1.0]) * (-1.0) ** np.arange(JOINTS) * rng.uniform(0.6, 1.4, JOINTS))


def _weak(rng: np.random.Generator, setting: Setting) -> list[float]:
    """One joint has given way."""
    x = np.zeros(JOINTS)
    x[rng.integers(JOINTS)] = -2.0
    return list(x)


def _stepped(rng: np.random.Generator, setting: Setting) -> list[float]:
    """Of two materials, one up to some joint and one beyond it."""
    return _level(rng.choice([-1.0, 1.0]) * (np.arange(JOINTS) < rng.integers(2, JOINTS - 1)))


def _lump(rng: np.random.Generator, setting: Setting) -> list[float]:
    """All of the weight at the end of one of the middle links."""
    last = int(rng.integers(1, JOINTS - 1))
    return [1.5 * (i <= last) for i in range(JOINTS)]


def _harness(rng: np.random.Generator, setting: Setting) -> list[float]:
    """As heavy along all of the body, and how far [m] to one side."""
    return [*[1.0] * JOINTS, rng.choice([-1, 1]) * rng.uniform(0.004, 0.012)]


def _loop(rng: np.random.Generator, setting: Setting) -> list[float]:
    """The link, the side to which the stand is, how far [m], and the pull to there as a share of the weight."""
    return [float(rng.integers(1, 5)), rng.choice([-1.0, 1.0]), rng.uniform(0.12, 0.3), rng.uniform(0.1, 0.3)]


def _payload(rng: np.random.Generator, setting: Setting) -> list[float]:
    return [rng.uniform(0.005, 0.03), rng.uniform(-0.003, 0.003), 0.015]


def _hung(rng: np.random.Generator, setting: Setting) -> list[float]:
    """A hook, and a thread below it."""
    return [rng.uniform(0, 0.015), 0.0, 0.0, rng.uniform(0.05, 0.25)]


def _gripper(rng: np.random.Generator, setting: Setting) -> list[float]:
    length = rng.uniform(0.06, 0.14)
    return [length / 2, rng.uniform(-0.01, 0.01), length / 4.8**0.5]


def _bracket(rng: np.random.Generator, setting: Setting) -> list[float]:
    """What sits far to one side."""
    return [rng.uniform(0, 0.02), rng.choice([-1, 1]) * rng.uniform(0.02, 0.045), rng.uniform(0.03, 0.06)]


def _between_runs(rng: np.random.Generator, setting: Setting) -> list[float]:
    return [(int(rng.integers(2, 6)) - 0.2) * setting.apart_s]


def _picked(rng: np.random.Generator, setting: Setting) -> list[float]:
    """When it is picked up, and when it is let go [s]."""
    return [rng.uniform(0.15, 0.35) * setting.seconds, rng.uniform(0.6, 0.85) * setting.seconds]


def _obstacle(rng: np.random.Generator, setting: Setting) -> list[float]:
    side = int(rng.integers(2))
    return [rng.uniform(0.45, 0.65) * setting.tip_m[side], (1.0, -1.0)[side]]


def _tube(rng: np.random.Generator, setting: Setting) -> list[float]:
    """A wall to either side."""
    where, side = _obstacle(rng, setting)
    return [where, side, rng.uniform(0.45, 0.65) * setting.tip_m[int(side > 0)]]


def _midway(rng: np.random.Generator, setting: Setting) -> list[float]:
    """At the end of one of the middle links, which goes less far to the side than the tip."""
    where, side = _obstacle(rng, setting)
    last = int(rng.integers(2, 4))
    return [where * ((last + 1) / (JOINTS - 0.5)) ** 2, side, float(last)]


def _bent(low: float, high: float) -> Draw:
    """An angle of every joint, as a share of the farthest to a side, and that side."""

    def draw(rng: np.random.Generator, setting: Setting) -> list[float]:
        side = int(rng.integers(2))
        return [rng.uniform(low, high) * setting.tip_m[side] / 0.756, (1.0, -1.0)[side]]

    return draw


def _derailed(rng: np.random.Generator, setting: Setting) -> list[float]:
    angle, side = _bent(0.5, 0.75)(rng, setting)
    return [float(side < 0), angle]


def _slit(rng: np.random.Generator, setting: Setting) -> list[float]:
    """A joint, and the side of it."""
    return [float(rng.integers(JOINTS)), rng.choice([-1.0, 1.0])]


def _side(rng: np.random.Generator, setting: Setting) -> list[float]:
    return [rng.choice([-1.0, 1.0])]


def _which(rng: np.random.Generator, setting: Setting) -> list[float]:
    return [float(rng.integers(2))]


def _warming(rng: np.random.Generator, setting: Setting) -> list[float]:
    return [float(rng.integers(2)), rng.choice([-1.0, 1.0])]


def _lean(rng: np.random.Generator, setting: Setting) -> list[float]:
    """How much more to one side."""
    return [rng.choice([-1.0, 1.0]) * rng.uniform(0.4, 0.8)]


def _joint(rng: np.random.Generator, setting: Setting) -> list[float]:
    return [float(rng.integers(JOINTS)), rng.uniform(0, 6)]


def _break(rng: np.random.Generator, setting: Setting) -> list[float]:
    """In the middle of a run, near the middle of the session."""
    return [int(rng.integers(2, 6)) * setting.apart_s + rng.uniform(0.3, 0.6) * setting.seconds]


def _knock(rng: np.random.Generator, setting: Setting) -> list[float]:
    """Run and time."""
    return [float(rng.integers(1, 5)), rng.uniform(0.3, 0.6) * setting.seconds]


def _waves(rng: np.random.Generator, setting: Setting) -> list[float]:
    return [rng.uniform(0.8, 2.5), rng.uniform(0, 6)]


def _spells(rng: np.random.Generator, setting: Setting) -> list[float]:
    return [setting.seconds * (share + rng.uniform(-0.08, 0.08)) for share in (0.25, 0.5, 0.75)]


def _beside(rng: np.random.Generator, setting: Setting) -> list[float]:
    """Where the tip passes it, and how far it reaches."""
    side = int(rng.integers(2))
    return [rng.uniform(0.25, 0.7) * setting.tip_m[side] * (1, -1)[side], rng.uniform(0.01, 0.025)]


def _edges(rng: np.random.Generator, setting: Setting) -> list[float]:
    """The last angle of each joint that is seen well, to each side."""
    return list(rng.uniform(0.35, 0.8, 2) * setting.tip_m / 0.756)


def _markers(rng: np.random.Generator, setting: Setting) -> list[float]:
    return list(rng.uniform(0.3, 1.0, JOINTS) * rng.choice([1, 1, 1, -1], JOINTS))


def _one_marker(rng: np.random.Generator, setting: Setting) -> list[float]:
    """Of two neighbouring angles what one gains the other loses; the last marker has one angle."""
    x = np.zeros(JOINTS + 1)
    at = int(rng.integers(JOINTS))
    x[at], x[at + 1] = 1, -1
    return list(1.7 * x[:JOINTS])


def _seed(rng: np.random.Generator, setting: Setting) -> list[float]:
    return [float(rng.integers(2**31))]


LISTED = (
    Cause(
        *("tendon_friction", "actuation", ("direction", "load", "angle")),
        (
            *_alike(0.05, 0.5, _between((0.03, 0.15)), _none, _sides(0.05, 0.3)),
            Shape(0.1, 1, _liners, ("segment",)),
            Shape(0.05, 0.5, _none),
            Shape(0.05, 0.5, _between((800, 3000))),
            Shape(0.05, 0.5, _between((0.2, 0.45)), ("rate",)),
            Shape(0.05, 0.5, _between((4, 15)), ("run", "time")),
        ),
    ),
    Cause(
        *("tendon_slack", "actuation", ("direction", "load")),
        (
            *_alike(0.3, 6, _none, _none),
            Shape(2, 30, _between((15, 60)), ("time", "rate")),
            Shape(2, 40, _between((10, 40)), ("time", "rate", "angle")),
            Shape(0.3, 6, _between((0.05, 0.3))),
            Shape(0.5, 8, _between((100, 400)), ("run", "time")),
            Shape(0.1, 1.5, _none),
            Shape(0.5, 8, _none, ("angle",)),
        ),
    ),
    Cause(
        *("actuator_lag", "actuation", ("rate", "direction", "time")),
        (
            *_alike(0.02, 0.5, _none, _none, _between((0.3, 0.6))),
            Shape(0.02, 0.5, _between((1.5, 4), (2, 8)), ("load",)),
            Shape(0.05, 0.5, _between((8, 20))),
            Shape(0.02, 0.5, _none),
            Shape(0.02, 0.5, _between((150, 700))),
            Shape(0.05, 1.5, _between((0.25, 0.6))),
        ),
    ),
    Cause(
        *("actuator_delay", "actuation", ("rate", "direction", "time")),
        (
            *_alike(0.02, 0.3, _between((0.05, 0.3), (0, 6)), _none, _seed, _sides(0.2, 0.6), _between((0, 1))),
            Shape(0.02, 0.3, _seed, ("run",)),
            Shape(0.02, 0.3, _between((2, 6), (2, 6), (0, 1))),
            Shape(0.02, 0.3, _then(_seed, _between((2, 4)))),
        ),
    ),
    Cause(
        *("actuator_deadband", "actuation", ("load", "angle")),
        (
            *_alike(0.4, 5, _none, _none, _sides(0.2, 0.6), _between((0.8, 2.5)), _none),
            Shape(0.4, 5, _between((0.5, 3)), ("time",)),
            Shape(0.4, 5, _none, ("direction",)),
            Shape(0.8, 6, _between((60, 300)), ("run", "time")),
        ),
    ),
    Cause(
        *("actuator_gain", "actuation", ("load", "angle", "everywhere", "direction")),
        (
            *_alike(0.05, 0.5, _sides(-0.4, 0.4), _sides(0, 0), _none, _then(_sides(-0.4, 0.4), _between((4, 12)))),
            Shape(0.05, 0.5, _then(_sides(-0.4, 0.4), _between((2, 8))), ("time",)),
            Shape(0.05, 0.5, _climbed),
            Shape(0.1, 0.6, _then(_sides(-0.4, 0.4), _between((4, 15)), _peak), ("time",)),
            Shape(0.05, 0.5, _seed, ("run",)),
        ),
        signed=True,
    ),
    Cause(
        *("actuator_ripple", "actuation", ("angle", "load")),
        (
            *_alike(0.3, 4, *[_ripple] * 4, _then(_ripple, _between((0.2, 0.45))), _ripple),
            Shape(0.3, 4, _then(_ripple, _between((0.05, 0.3))), ("rate",)),
            Shape(0.3, 4, _then(_ripple, _seed)),
        ),
    ),
    Cause(
        *("actuator_saturation", "actuation", ("load", "angle")),
        (
            *_alike(0.3, 0.8, _peak, _peak),
            Shape(0.3, 0.8, _then(_peak, _between((0.2, 0.8))), ("time",)),
            Shape(0.4, 0.85, _peak),
            Shape(0.3, 0.8, _then(_peak, _between((0.05, 0.15))), ("rate",)),
            Shape(0.2, 0.8, _then(_peak, _between((0.2, 0.8)))),
            Shape(0.3, 0.8, _then(_peak, _between((0.2, 1))), ("time", "direction")),
            Shape(0.3, 0.8, _then(_peak, _between((0.55, 0.85))), ("direction",)),
        ),
    ),
    Cause(
        *("pressure_lag", "jamming", ("pressure", "time", "rate")),
        (
            Shape(0.5, 6, _between((0.5, 2.2))),
            *_alike(0.3, 4, *[_between((0.4, 2.5))] * 4),
            Shape(0.15, 3, _between((0.25, 0.6))),
            Shape(0.05, 4, _between((3, 8))),
            Shape(0.1, 2, _between((0.4, 1.5))),
        ),
    ),
    Cause(
        *("pressure_leak", "jamming", ("pressure", "time")),
        (
            Shape(1, 8, _between((3, 9), (3, 8))),
            Shape(0.4, 0.95, _between((1.5, 6))),
            Shape(1, 12, _between((0.2, 1)), ("angle",)),
            Shape(1, 12, _between((0.2, 1)), ("rate",)),
            Shape(0.3, 0.95, _between((150, 500)), ("run",)),
            Shape(1, 10, _break, ("run",)),
            Shape(0.3, 0.95, _between((2.5, 7))),
            Shape(1, 15, _slit, ("angle",)),
        ),
    ),
    Cause(
        *("pressure_bias", "jamming", ("pressure",)),
        (
            *_alike(1, 8, _none, _none, _none),
            Shape(1, 8, _seed, ("run",)),
            Shape(1, 8, _none, ("run", "time")),
            Shape(1, 8, _between((3, 10)), ("time",)),
            Shape(1, 8, _between((1, 4)), ("direction", "time")),
            Shape(1, 8, _none),
        ),
        signed=True,
    ),
    Cause(
        *("stiffness_saturation", "jamming", ("pressure",)),
        (
            *_alike(1, 8, _none, _none, _none),
            *_alike(0.3, 1, _between((6, 12)), _between((5, 14))),
            Shape(0.2, 0.85, _none),
            Shape(3, 30, _none),
            Shape(0.3, 1, _between((4, 10)), ("direction", "time")),
            Shape(0.3, 1, _between((14, 24))),
        ),
    ),
    Cause(
        *("friction_saturation", "jamming", ("pressure",)),
        (
            Shape(1, 8, _none),
            *_alike(0.3, 1, _between((1.5, 6)), _between((2, 7)), _between((5, 12)), _between((4, 12))),
            Shape(0.3, 1, _between((12, 22))),
            Shape(0.3, 1, _between((0.03, 0.3))),
            Shape(0.3, 1, _between((2, 7)), ("direction", "time")),
        ),
    ),
    Cause(
        *("layer_hysteresis", "jamming", ("direction",)),
        (
            Shape(0.02, 0.3, _none),
            Shape(0.02, 0.3, _between((0.02, 0.07), (1, 2))),
            Shape(0.04, 1, _between((0.02, 0.05)), ("angle",)),
            Shape(0.02, 0.3, _none, ("pressure",)),
            Shape(0.02, 0.3, _between((0.02, 0.06))),
            Shape(0.02, 0.3, _between((0.02, 0.06), (0.01, 0.04)), ("time", "rate")),
            Shape(0.01, 0.3, _between((0.05, 0.2)), ("segment",)),
            Shape(0.02, 0.3, _between((0.04, 0.12)), ("pressure", "time")),
        ),
    ),
    Cause(
        *("layer_wear", "jamming", ("time", "run")),
        (
            *_alike(0.3, 0.9, _between((3, 10)), _between((3, 15))),
            Shape(0.3, 4, _between((1, 5))),
            Shape(0.3, 0.9, _between((4, 12))),
            Shape(0.3, 0.9, _between((4, 15)), ("pressure",)),
            Shape(0.3, 0.9, _between((0.3, 1.5)), ("angle",)),
            Shape(0.3, 0.9, _between((6, 18))),
            Shape(0.3, 0.9, _between((3, 12)), ("pressure",)),
        ),
    ),
    Cause(
        *("viscoelastic_creep", "structure", ("time", "rate")),
        (
            *_alike(0.3, 6, _none, _between((0.5, 6)), _between((2, 10)), _between((0.5, 4), (3, 8))),
            Shape(0.3, 5, _between((0.5, 5), (0.08, 0.16)), ("angle",)),
            Shape(0.3, 6, _between((0.2, 0.8), (0.04, 0.1)), ("angle",)),
            Shape(0.3, 6, _between((0.4, 4)), ("pressure",)),
            Shape(0.3, 6, _between((0.4, 3)), ("segment",)),
        ),
    ),
    Cause(
        *("viscous_damping", "structure", ("rate", "direction")),
        (
            *_alike(0.05, 1.5, _none, _none),
            Shape(0.1, 6, _none),
            Shape(0.1, 3, _none, ("angle",)),
            Shape(0.05, 1.5, _none, ("pressure",)),
            Shape(0.1, 3, _between((2, 8), (0.05, 0.2)), ("time",)),
            Shape(3, 60, _none, ("segment",)),
            Shape(0.02, 0.6, _none, ("segment",)),
        ),
    ),
    Cause(
        *("stiffness_hardening", "structure", ("angle", "load")),
        (
            *(Shape(3, 60, _none), Shape(15, 400, _none)),
            Shape(1, 20, _between((0.07, 0.14)), ("pressure",)),
            Shape(2, 40, _between((0.06, 0.12))),
            Shape(0.5, 20, _between((0.28, 0.45))),
            Shape(3, 400, _lean),
            Shape(0.3, 40, _between((0.05, 0.12)), ("segment",)),
            Shape(15, 600, _between((1.5, 4)), ("segment",)),
        ),
    ),
    Cause(
        *("rest_curvature", "structure", ("everywhere", "angle", "pressure")),
        (
            *_alike(0.01, 0.25, _curved, _fixed(*[1.0] * JOINTS)),
            Shape(0.01, 0.2, _kinked, ("segment",)),
            Shape(0.01, 0.2, _curved),
            Shape(0.01, 0.25, _then(_curved, _between((60, 250))), ("run", "time")),
            Shape(0.01, 0.25, _then(_curved, _between((3, 12))), ("run", "time")),
            Shape(0.01, 0.25, _then(_curved, _seed), ("run",)),
            Shape(0.01, 0.25, _then(_curved, _between((4, 15))), ("time",)),
        ),
        signed=True,
    ),
    Cause(
        *("base_tilt", "structure", ("everywhere", "angle", "pressure")),
        (
            *_alike(0.1, 1.0, _none, _none),
            Shape(0.1, 0.8, _seed, ("run",)),
            Shape(0.1, 1.0, _between((60, 200)), ("run", "time")),
            Shape(0.1, 1.0, _break, ("run", "time")),
            Shape(0.1, 1.0, _none, ("direction", "load")),
            Shape(0.05, 1.0, _none, ("segment",)),
            Shape(0.1, 1.0, _between((0.4, 1.2)), ("rate", "time")),
        ),
        signed=True,
    ),
    Cause(
        *("tip_payload", "structure", ("angle", "segment", "rate")),
        (
            *_alike(0.03, 0.4, _payload, _fixed(0, 0, 0), _gripper),
            Shape(0.03, 0.4, _bracket, ("everywhere", "pressure")),
            Shape(0.03, 0.4, _then(_payload, _between_runs), ("run",)),
            Shape(0.03, 0.4, _hung, ("time",)),
            Shape(0.03, 0.4, _then(_payload, _between((80, 400))), ("run", "time")),
            Shape(0.03, 0.4, _then(_payload, _picked), ("time",)),
        ),
    ),
    Cause(
        *("gravity_distribution", "structure", ("angle", "segment")),
        (
            *_alike(0.5, 3, _fixed(*(1 - 0.12 * (i - 2.5) for i in range(JOINTS))), _fixed(*[1.0] * JOINTS), _lump),
            Shape(0.5, 3, _lump, ("load",)),
            Shape(0.5, 3, _lump, ("rate",)),
            Shape(0.5, 3, _between((0.8, 2), (3.2, 5), (3, 12)), ("run", "time")),
            Shape(0.5, 3, _harness, ("everywhere", "pressure")),
            Shape(0.3, 3, _loop, ("everywhere", "pressure")),
        ),
    ),
    Cause(
        *("nonuniform_stiffness", "structure", ("segment",)),
        (
            *_alike(0.1, 0.7, _then(_uneven, _fixed(1, 0.6)), _then(_uneven, _fixed(1, 1))),
            Shape(0.1, 0.6, _then(_tapered, _fixed(0.3, 1.5)), ("pressure",)),
            Shape(0.1, 0.45, _then(_weak, _fixed(1, 1))),
            Shape(0.1, 0.7, _then(_uneven, _fixed(1, 1)), ("angle",)),
            Shape(0.1, 0.6, _then(_stepped, _fixed(1, 1))),
            Shape(0.1, 0.45, _then(_uneven, _between((3, 12))), ("run", "time")),
            Shape(0.1, 0.6, _then(_alternating, _fixed(0, 1.6)), ("pressure",)),
            Shape(0.1, 0.4, _then(_weak, _between((0.03, 0.1))), ("angle",)),
        ),
    ),
    Cause(
        *("contact", "structure", ("angle", "load")),
        (
            *_alike(100, 1e4, _obstacle, _obstacle),
            Shape(3, 100, _bent(0.45, 0.65)),
            Shape(100, 1e4, _then(_obstacle, _between((0.004, 0.015)))),
            Shape(100, 1e4, _midway, ("segment",)),
            Shape(100, 1e4, _then(_obstacle, _between((0.5, 4))), ("time", "rate")),
            Shape(10, 1e4, _tube),
            Shape(0.1, 8, _obstacle, ("time", "direction")),
        ),
    ),
    Cause(
        *("friction_asymmetry", "friction", ("direction",)),
        (
            *_alike(0.1, 0.65, _none, _none, _none),
            Shape(0.1, 0.65, _none, ("angle",)),
            Shape(0.1, 0.65, _none, ("pressure",)),
            Shape(0.1, 0.65, _none, ("rate",)),
            Shape(0.1, 0.65, _side, ("angle",)),
        ),
        signed=True,
    ),
    Cause(
        *("load_dependent_friction", "friction", ("load", "pressure")),
        (
            *_alike(0.2, 4, _none, _none),
            Shape(0.2, 4, _none, ("segment",)),
            Shape(0.2, 4, _none, ("angle",)),
            Shape(0.2, 4, _none),
            Shape(0.2, 4, _between((1.5, 6)), ("time",)),
            Shape(0.2, 4, _lifted),
            Shape(0.2, 6, _none),
        ),
    ),
    Cause(
        *("thermal_drift", "friction", ("time", "run")),
        (
            *_alike(0.2, 2.5, _which, _warming),
            Shape(0.2, 0.8, _between((1.5, 4))),
            *_alike(0.2, 2.5, _between((4, 12)), _between((4, 12))),
            Shape(0.2, 2.5, _between((40, 150))),
            Shape(0.2, 2.5, _none, ("segment",)),
            Shape(0.2, 2.5, _none, ("rate",)),
        ),
    ),
    Cause(
        *("sensor_bias", "sensing", ("everywhere",)),
        (
            *_alike(0.001, 0.05, _markers, _fixed(*[1.0] * JOINTS)),
            Shape(0.001, 0.05, _one_marker, ("segment",)),
            Shape(0.001, 0.05, _then(_markers, _knock), ("run", "time")),
            Shape(0.001, 0.05, _then(_markers, _seed), ("run",)),
            Shape(0.001, 0.05, _then(_markers, _between((20, 150))), ("run", "time")),
            Shape(0.002, 0.08, _markers, ("time",)),
            Shape(0.002, 0.08, _then(_markers, _between((-0.8, 0.8))), ("angle",)),
        ),
        signed=True,
    ),
    Cause(
        *("sensor_scale", "sensing", ("everywhere", "angle")),
        (
            *_alike(0.02, 0.12, _none, _none),
            Shape(0.02, 0.3, _none),
            *[Shape(0.02, most, _none, ("segment",)) for most in (0.22, 0.3)],
            Shape(0.02, 0.2, _seed, ("run",)),
            Shape(0.02, 0.3, _between((60, 300)), ("run", "time")),
            Shape(0.02, 0.3, _seed, ("time",)),
        ),
        signed=True,
    ),
    Cause(
        *("sensor_delay", "sensing", ("rate", "direction", "time")),
        (
            *_alike(0.02, 0.3, _between((0.05, 0.2), (0, 6)), _none, _between((1.5, 4), (0, 4)), _seed, _seed),
            Shape(0.02, 0.3, _between((0.2, 1))),
            Shape(0.02, 0.3, _none, ("segment",)),
            Shape(0.02, 0.3, _between((0, 1))),
        ),
    ),
    Cause("sensor_filter", "sensing", ("rate", "time", "direction"), _alike(0.05, 0.8, *[_none] * 8)),
)
UNLISTED = (
    Cause("jammed_joint", None, (), _alike(0.5, 12, _joint)),
    Cause("base_vibration", None, (), _alike(0.03, 0.6, _waves)),
    Cause("buckling_friction", None, (), _alike(1, 30, _between((0.05, 0.09)))),
    Cause("glue_failure", None, (), _alike(0.1, 0.8, _break)),
    Cause("snap_through", None, (), _alike(0.01, 0.5, _between((50, 100)))),
    Cause("hidden_pendulum", None, (), _alike(0.05, 3, _between((5, 11)))),
    Cause("dropout", None, (), _alike(0.1, 1.2, _spells)),
    Cause("camera_wander", None, (), _alike(0.001, 0.05, _seed)),
    Cause(
        "draught", None, (), _alike(0.02, 1, _then(_between((0.05, 0.1), (0.1, 0.3), (0.3, 0.6), (0.6, 1.2)), _seed))
    ),
    Cause("derailed_tendon", None, (), _alike(0.1, 0.9, _derailed)),
    Cause("lost_frames", None, (), _alike(0.3, 1.6, _seed)),
    Cause("pump_pulses", None, (), _alike(2, 15, _between((0.3, 1.5)))),
    Cause("magnet", None, (), _alike(0.1, 5, _beside)),
    Cause("rough_patch", None, (), _alike(0.1, 5, _beside)),
    Cause("edge_of_view", None, (), _alike(0.1, 0.95, _edges)),
    Cause("column_softening", None, (), _alike(0.01, 0.06, _none)),
    Cause("brownout", None, (), _alike(0.2, 0.95, _between((0.5, 2)))),
    Cause("shaken_loose", None, (), _alike(0.2, 0.95, _between((4, 9), (0, 6)))),
    Cause("servo_hunting", None, (), _alike(1, 10, _between((0.6, 1.6), (0, 6)))),
    Cause("false_detections", None, (), _alike(0.02, 0.4, _seed)),
    Cause("coarse_pixels", None, (), _alike(0.005, 0.1, _none)),
)
CAUSES = {cause.id: cause for cause in (*LISTED, *UNLISTED)}
SENSING = (
    "sensor_bias",
    "sensor_scale",
    "sensor_delay",
    "sensor_filter",
    "camera_wander",
    "lost_frames",
    "edge_of_view",
    "false_detections",
    "coarse_pixels",
)
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
