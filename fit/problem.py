"""What a dynamic fit is asked and what it finds: its rounds, the data and parameters, the estimate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ljjax.fit.coordinates import Coordinates
from ljjax.fit.points import Points
from ljjax.fit.shooting import TILE
from ljjax.fit.windows import Motion, Windows
from ljjax.model import Model


@dataclass(frozen=True)
class Round:
    """One round: step of the solver [s], whether windows meet (free runs) and how closely [rad], how many windows are
    used, and when it ends: when a step would lower χ² by no more than `done`, or that share of it. `onward`: free runs
    one window after the other, for many fits side by side."""

    step_s: float
    free: bool
    meet_rad: float
    windows: int
    done: float
    share: float
    onward: bool = False


ROUNDS = (
    Round(0.005, False, np.inf, 2 * TILE, 0.1, 1e-2),
    Round(0.005, True, 3e-5, 1_000_000, 0.1, 1e-4),
    Round(0.0025, True, 1e-6, 1_000_000, 0.02, 0.0),
)


ROUNDING, BISECTIONS = 1e-9, 20
"""By how much of a bounded parameter's range it may lie beyond; halvings of a step that would take one further."""


def within(value: float, ends: tuple[float, float]) -> bool:
    """Whether a value lies between two ends, to rounding."""
    low, high = ends
    return bool(low - ROUNDING * (high - low) <= value <= high + ROUNDING * (high - low))


@dataclass(frozen=True, eq=False)
class Problem:
    """What a dynamic fit is asked: the data of one robot and how its parameters may move.

    Attributes:
        coordinates: the free parameters.
        motions: the moving runs.
        points: steady and probe points, which count with their own scatter.
        priors: mean and standard deviation by path, in the parameter's unit.
        bounds: lowest and highest value by path, in the parameter's unit.
    """

    coordinates: Coordinates
    motions: Sequence[Motion]
    points: Sequence[Points] = ()
    priors: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def limits(self, x: np.ndarray) -> list[tuple[np.ndarray, float, float]]:
        """Bounded parameters at x (k,): their slope (k,), and how far they may fall and rise; of one that has a
        coordinate of its own, that coordinate's."""
        c = self.coordinates
        bounds = {**c.bounds, **self.bounds}
        if not bounds:
            return []
        value, slope = c.physical(x), c.jacobian(x)
        out = []
        for name, pair in bounds.items():
            if name in c.names:
                i = c.names.index(name)
                own = c.ends(i, *pair)
                along, here, (low, high) = (slope[i], value[i], pair) if own is None else (np.eye(len(x))[i], x[i], own)
                out.append((along, min(float(low - here), 0.0), max(float(high - here), 0.0)))
        return out

    def room(self, x: np.ndarray, step: np.ndarray) -> float:
        """The share of a step (k,) from x (k,), which heeds `limits` to first order, that stays within the bounds."""
        c = self.coordinates
        index = {c.names.index(name): ends for name, ends in self.bounds.items() if name in c.names}

        def inside(share: float) -> bool:
            value = c.physical(x + share * step)
            return all(within(value[i], ends) for i, ends in index.items())

        least, most = 0.0, 1.0
        if not index or inside(most):
            return most
        for _ in range(BISECTIONS):
            middle = 0.5 * (least + most)
            least, most = (middle, most) if inside(middle) else (least, middle)
        return least


@dataclass(frozen=True, eq=False)
class Estimate:
    """What a dynamic fit found.

    Attributes:
        x: (k,) coordinates; `model` the robot.
        covariance: (k, k) of x, with the residuals' colour; `white` the same were they white.
        windows, predicted: the last round's windows and what their samples should read (N, c).
        jacobian: (N, c, k) derivatives of `predicted`, the runs' starting angles projected off.
        pull: (k,) −½ dχ²/dx there, the starting angles at their best: 0 at an optimum that no bound holds.
        sigma: (c,) standard deviation of the residuals [rad]; `weight` (N, c) of each sample, 1 or less.
        offset: (R,) correction of each run's starting angle [rad].
        statics: predictions and scatter for each of the problem's points.
        chi2: weighted sum of squares; `history` the course: round, passes over the data in it,
            RMS error [rad], damping, x.
        converged: whether the last round ended by its own rule.
        step_error: (R,) the largest change of a prediction from halving the solver's step [rad], or None.
    """

    problem: Problem
    x: np.ndarray
    model: Model
    covariance: np.ndarray
    white: np.ndarray
    windows: Windows
    predicted: np.ndarray
    jacobian: np.ndarray
    pull: np.ndarray
    sigma: np.ndarray
    weight: np.ndarray
    offset: np.ndarray
    statics: list[tuple[np.ndarray, float]]
    chi2: float
    history: list[tuple[int, int, float, float, np.ndarray]]
    converged: bool
    step_error: np.ndarray | None = None

    @property
    def error(self) -> np.ndarray:
        """(N, c) measured − predicted [rad]."""
        return self.windows.y - self.predicted

    @property
    def shape_error(self) -> np.ndarray:
        """(N, c) the same of the shape alone, where the tip is compared beside it."""
        return self.windows.shape(self.error)

    def chi2_by(self, scale: Estimate) -> float:
        """χ² of this estimate by another's scale of residuals, of the same data."""
        out = np.sum(scale.weight * (self.error / scale.sigma) ** 2)
        out += np.sum((self.offset / np.array([m.q0_sd for m in self.problem.motions])) ** 2)
        for p, (value, _), (_, s) in zip(self.problem.points, self.statics, scale.statics, strict=True):
            out += np.sum(((value - p.value) / s) ** 2)
        return float(out)
