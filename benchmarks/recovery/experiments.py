"""What a laboratory would do with one robot: eight training runs, two held-out runs of other signals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.recovery.plant import Array, Plant
from benchmarks.recovery.robots import Robot

PERIOD_S = 0.005
REST = 1 / 14
REACH_RAD = np.radians(10.0)


@dataclass(frozen=True)
class Experiment:
    """Commands of one run, each holding for `PERIOD_S`.

    Attributes:
        tendons: (T, 2) tensions [N].
        pressure_kpa: (T,) vacuum u_P.
    """

    name: str
    tendons: Array
    pressure_kpa: Array
    held_out: bool = False


def plan(robot: Robot, seconds: float = 14.0, seed: int = 0) -> list[Experiment]:
    """The runs of one robot, `seconds` long each, with sizes and times of its own.

    Tensions are sized as a laboratory would after a few trials: to bend each joint by about `REACH_RAD` against the
    stiffness and the friction of the pressure at hand.
    """
    rng = np.random.default_rng([seed, int(robot.robot_id.split("-")[1]), 1])
    t = np.arange(round(seconds / PERIOD_S)) * PERIOD_S
    active = seconds * (1 - 2 * REST)
    x = (t - seconds * REST) / active  # 0 … 1 between two rests
    side = rng.choice([-1, 1])
    plant = Plant({path: np.array([value]) for path, value in robot.truth.items()})

    def size(pressure: Array | float) -> Array:
        p = np.asarray(pressure, float)
        friction = plant.phi(p) * plant.p["mu_c"] / plant.p["lever_arm_m"]
        return plant.net_tension(REACH_RAD, p) + friction

    def about(value: float, spread: float = 0.15) -> float:
        return value * rng.uniform(1 - spread, 1 + spread)

    def lines(knots: Sequence[tuple[float, float]]) -> Array:
        """Straight lines between (x, value)."""
        at, value = np.array(knots).T
        return np.interp(x, at, value)

    def holds(values: list[float], ramp_s: float = 0.15) -> Array:
        """Each value held for an equal share of the time, ramps between them, from and to 0."""
        edges = np.linspace(0, 1, len(values) + 1)
        ramp, steps = ramp_s / active, [0.0, *values, 0.0]
        return lines([k for e, a, b in zip(edges, steps, steps[1:], strict=False) for k in ((e, a), (e + ramp, b))])

    def multisine(low_hz: float, high_hz: float, count: int = 6) -> Array:
        hz = np.geomspace(low_hz, high_hz, count)
        wave = np.sin(2 * np.pi * (hz * t[:, None] + rng.uniform(size=count))) / hz**0.5
        inside = np.clip(np.minimum(x, 1 - x) / 0.08, 0, 1)
        wave = wave.sum(axis=1) * inside
        return wave / np.abs(wave).max()

    def triangles() -> Array:
        """One slow, one at a middle rate, two fast."""
        tops = [about(v) for v in (1.0, -1.0, 0.8, -0.9, 0.7, -0.8, 0.9, -0.6)]
        at = [0.17, 0.42, 0.60, 0.70, 0.77, 0.82, 0.87, 0.92]
        return lines([(0, 0), *zip(at, tops, strict=True), (0.96, 0)])

    def made(name: str, net: Array, pressure: Array | float, base: Array | float | None = None, held_out=False):
        """Antagonistic tensions from the net one, on top of an equal base in both."""
        both = rng.uniform(0.1, 0.5) if base is None else base
        u = np.stack([both + np.maximum(side * net, 0), both + np.maximum(-side * net, 0)], axis=1)
        return Experiment(name, u, np.broadcast_to(np.asarray(pressure, float), t.shape).copy(), held_out)

    bend = lines([(a + b, v) for a in (0.0, 0.5) for b, v in ((0, 0), (0.02, 1), (0.2, 1), (0.22, 0))])
    bend *= np.where(x < 0.5, about(1.0), -about(1.0))
    seal = ((0.1, 0), (0.13, 1), (0.36, 1), (0.39, 0.3), (0.43, 0.3), (0.46, 0))
    vacuum = lines([(a + b, share * top) for a, top in ((0.0, 30), (0.5, 40)) for b, share in seal])
    climb = lines([(k / 5 + b, 10.0 * k) for k in range(5) for b in (0.03, 0.2)])
    to_and_fro = [(k / 5 + b, v) for k in range(5) for b, v in ((0.05, 0), (0.1, 1), (0.16, -1), (0.2, 0))]
    chirp = np.sin(2 * np.pi * np.cumsum(np.geomspace(0.2, about(2.5), len(t))) * PERIOD_S)
    chirp *= np.clip(np.minimum(x, 1 - x) / 0.05, 0, 1) * about(0.9)
    jumps = holds([about(v) for v in (0.5, -0.7, 0.9, -0.4, 0.6, -1.0, 0.8, -0.6)], 0.06)
    drop = lines([(0.5, 20), (0.52, 3)])
    pull, changes = holds([1.0, 1.0, 1.0, -1.0]) * about(size(10).item()), holds([5, 20, 0, 30, 12, 40, 0], 0.3)
    slow = 20 + 15 * np.sin(2 * np.pi * (x * 1.3 + rng.uniform()))
    levels = holds(list(rng.choice([0.0, 8.0, 16.0, 25.0, 36.0], 5)), 0.5)
    walk = holds(list(rng.uniform(0.3, 1, 9) * rng.choice([-1, 1], 9)), 0.25)
    both = 8 * np.abs(multisine(0.1, 0.4, 2))
    return [
        made("lock", bend * size(0), vacuum),
        made("triangle", triangles() * size(0), 0),
        made("triangle", triangles() * size(15), 15),
        made("multisine", about(1.1) * multisine(0.15, 2.5) * size(40), 40, both),
        made("pressure_staircase", lines(to_and_fro) * size(climb), climb),
        made("pressure_steps", pull, changes),
        made("chirp", chirp * size(5), 5),
        made("steps", jumps * size(drop), drop),
        made("multisine", multisine(0.2, 1.8) * size(slow), slow, held_out=True),
        made("walk", walk * size(levels), levels, held_out=True),
    ]
