"""How strong must a cause be so that a refitted base model is left with a gap of so many times the noise?

The gap is what a refit leaves of the difference that the cause makes to all angles of all training runs: its projection
on the angles' derivatives by the base model's parameters (each held by a wide prior) is taken off, then the base model
is simulated where that leads, and the same is done again with the same derivatives.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.blind import plant, sensing
from benchmarks.recovery.experiments import Array, Experiment
from benchmarks.recovery.robots import CENTRE, Robot

KEEP = 2
"""Every so many of the shapes count."""
ROUGH = 10
"""Steps in a period: 0.5 ms."""
FREE_SD = 0.5
"""How far a base parameter may go, as a share of itself."""
DERIVATIVE_STEP = 0.01
REFITS = 2
"""Times that the base model is simulated anew with what the refit found."""


@dataclass(frozen=True)
class Base:
    """A robot without any cause, on its training runs.

    Attributes:
        angles: (S, columns) what its camera gives, all runs in a row [rad].
        absorb: takes a difference of that shape to what a linear refit leaves of it, and to the refit: changes of
            parameters by path, as shares of themselves.
        tip_m: (2,) farthest the tip goes to each side.
    """

    robot: Robot
    runs: Sequence[Experiment]
    session: plant.Session
    angles: Array
    absorb: Callable[[Array], tuple[Array, dict[str, float]]]
    tip_m: Array


def base(robot: Robot, runs: Sequence[Experiment], session: plant.Session = plant.session) -> Base:
    """Simulate the robot as it is, by `session`, and with each free parameter moved a little, by the plant in C."""
    motions = session(robot.truth, {}, runs, ROUGH)
    angles = _angles(motions, robot.columns, {})
    free = [p for p in CENTRE if not p.startswith("chain.")] + ["chain.segment_mass_kg"] * (robot.columns > 1)
    derivatives = []
    for path in free:
        moved = {**robot.truth, path: robot.truth[path] * (1 + DERIVATIVE_STEP)}
        there = _angles(plant.session(moved, {}, runs, ROUGH // 2), robot.columns, {})
        derivatives.append(there.ravel())
    here = _angles(plant.session(robot.truth, {}, runs, ROUGH // 2), robot.columns, {}).ravel()
    jacobian = (np.stack(derivatives, axis=1) - here[:, None]) / DERIVATIVE_STEP
    scaled = jacobian * (FREE_SD / sensing.noise_sd(robot.columns))
    q, r = np.linalg.qr(np.concatenate([scaled, np.eye(len(free))]))
    top = q[: len(scaled)]

    def absorb(difference: Array) -> tuple[Array, dict[str, float]]:
        along = top.T @ difference.ravel()
        change = np.linalg.solve(r, along) * FREE_SD / sensing.noise_sd(robot.columns)
        return difference - (top @ along).reshape(difference.shape), dict(zip(free, change.tolist(), strict=True))

    length = np.array([2.0] * (plant.JOINTS - 1) + [1.0]) * robot.truth["chain.half_length_m"]
    tip = np.concatenate([np.sin(np.cumsum(m.q, axis=1)) @ length for m in motions])
    return Base(robot, runs, session, angles, absorb, np.array([tip.max(), -tip.min()]))


def gap(of: Base, causes: plant.Causes) -> float:
    """The gap that is left, over the noise: RMS of all angles, or of their mean where that shows more.

    Raises Diverged where the cause makes the robot diverge.
    """
    columns = of.robot.columns
    there = _angles(of.session(of.robot.truth, causes, of.runs, ROUGH), columns, causes)
    left, change = of.absorb(there - of.angles)
    least, moved = _size(left, columns), dict(of.robot.truth)
    for _ in range(REFITS):
        moved |= {path: x * float(np.clip(1 + change[path], 0.5, 2)) for path, x in moved.items() if path in change}
        moved["friction.mu_s"] = max(moved["friction.mu_s"], moved["friction.mu_c"])
        moved["friction.sigma3"] = float(np.clip(moved["friction.sigma3"], 1, 3))
        try:
            here = _angles(plant.session(moved, {}, of.runs, ROUGH), columns, {})
        except plant.Diverged:
            break
        left, change = of.absorb(there - here)
        least = min(least, _size(left, columns))
    return least


def _size(left: Array, columns: int) -> float:
    each = float(np.sqrt(np.mean(left**2))) / sensing.noise_sd(columns)
    if columns == 1:
        return each
    return max(each, float(np.sqrt(np.mean(left.mean(axis=1) ** 2))) / sensing.THETA_SD_RAD)


def strength(
    of: Base, causes: Callable[[float], plant.Causes], target: float, start: float, largest: float, turns: int = 14
) -> tuple[float, float]:
    """The strength of a cause that leaves a gap of `target` × noise, within a tenth, by bisection in its logarithm.

    Returns strength and gap; the gap is lower than asked where even `largest` does not reach it.
    """
    low, high = 0.0, np.inf
    s, best = min(start, largest), (largest, 0.0)
    for _ in range(turns):
        try:
            g = gap(of, causes(s))
        except plant.Diverged:
            g = np.inf
        g = g if np.isfinite(g) else np.inf
        if np.isfinite(g) and (best[1] == 0 or abs(np.log(max(g, 1e-9) / target)) < abs(np.log(best[1] / target))):
            best = (s, max(g, 1e-9))
        if abs(g / target - 1) < 0.1:
            return s, g
        if g < target:
            if s >= largest:
                break
            low = s
        else:
            high = s
        guess = s * float(np.clip(target / max(g, 1e-9), 0.2, 5))
        if np.isfinite(high) and not low < guess < high:
            guess = float(np.sqrt(low * high)) if low > 0 else high / 4
        elif guess <= low:
            guess = float(np.sqrt(low * min(high, largest)))
        s = min(guess, largest)
    return best


def _angles(motions: Sequence[plant.Motion], columns: int, causes: plant.Causes) -> Array:
    return np.concatenate([sensing.shape(m, columns, causes, i)[::KEEP] for i, m in enumerate(motions)])
