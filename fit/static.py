"""Identify α₁, c₁, c₂, c₃ from steady operating points, then c₄, c₅ from probe stiffness.

Two stages, so that a misfit of the probe data cannot bend what the steady data say; the second stage carries the
uncertainty of the first. Steady points: u₁ − u₂ = [α₁ sin(nθ) + α₂(u_P)θ]/g. Probe: K_T = 1/(aᵀK⁻¹a) with
K = α₁1_{n×n} + [α₂ + σ₀φ]I (model sections 2, 3, 6).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ljjax.errors import InputError
from ljjax.fit.least_squares import Solution, solve, undetermined
from ljjax.fit.points import Points
from ljjax.model import Model, get, replace
from ljjax.stiffness import probe_stiffness, steady_tension

PARAMETERS = {
    "steady": ("gravity.alpha1", "elastic.c1", "elastic.c2", "elastic.c3"),
    "probe": ("jamming.c4", "jamming.c5"),
}
NEEDED_LEVELS = {"elastic.c1": 3, "elastic.c2": 2, "jamming.c5": 2}
"""Pressure levels without which a parameter cannot be found, whatever the noise."""
POSITIVE_IN_PAPER = ("gravity.alpha1", "elastic.c2", "elastic.c3")

Weights = Literal["equal", "published"]
Constraints = Literal["none", "paper"]


@dataclass(frozen=True, eq=False)
class Stage:
    """One regression: what was free, on which points, and how it went.

    Attributes:
        names: free parameters by path; `solution` is over them, in their order.
        points: what was fitted; `predicted` (N,) the model's values, in the points' unit.
        scale: (N,) what residuals were divided by.
        held_out: (N,) prediction errors (measured − predicted) of each point from a fit without its pressure level,
            NaN where the other levels do not suffice.
        jackknife_sd: (k,) standard deviation from leaving each pressure level out, or NaN.
    """

    names: tuple[str, ...]
    points: Points
    solution: Solution
    predicted: np.ndarray
    scale: np.ndarray
    held_out: np.ndarray
    jackknife_sd: np.ndarray

    @property
    def error(self) -> np.ndarray:
        """(N,) measured − predicted."""
        return self.points.value - self.predicted

    @property
    def rmse(self) -> float:
        return float(np.sqrt(np.mean(self.error**2)))

    @property
    def r_squared(self) -> float:
        spread = self.points.value - self.points.value.mean()
        total = float(spread @ spread)
        return 1 - float(self.error @ self.error) / total if total > 0 else float("nan")


@dataclass(frozen=True, eq=False)
class StaticFit:
    """The identified model and its covariance (k, k) over `names`, NaN where a bound holds a parameter."""

    model: Model
    stages: dict[str, Stage]
    names: tuple[str, ...]
    covariance: np.ndarray
    warnings: list[str] = field(default_factory=list)

    def sd(self, name: str) -> float:
        i = self.names.index(name)
        return float(np.sqrt(self.covariance[i, i]))


def predict(model: Model, points: Points) -> jax.Array:
    """(N,) what the model says in place of `points.value`: net tension [N] or tip stiffness [N/m]."""
    theta, pressure = jnp.asarray(points.theta), jnp.asarray(points.pressure_kpa)
    return _predict(model, points.kind == "steady", theta, pressure)


def _predict(model, steady: bool, theta, pressure):
    if steady:
        return jax.vmap(lambda th, p: steady_tension(model, th, p))(theta, pressure)
    return jax.vmap(lambda p: probe_stiffness(model, p))(pressure)


@eqx.filter_jit
def _value_and_jacobian(model, names: tuple[str, ...], x, steady: bool, theta, pressure):
    def f(values):
        return _predict(replace(model, dict(zip(names, values, strict=True))), steady, theta, pressure)

    return f(x), jax.jacfwd(f)(x)


def value_and_jacobian(model: Model, points: Points, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """(N,) the model's values at the points, and their derivatives (N, k) by the parameters `names`."""
    return _evaluate(model, points, tuple(names), _values(model, tuple(names)))


def fit_static(
    model: Model,
    steady: Points,
    probe: Points,
    *,
    frozen: Sequence[str] = (),
    weights: Weights = "equal",
    constraints: Constraints = "none",
) -> StaticFit:
    """Least squares on steady points, then on probe stiffness.

    Args:
        model: geometry, starting values, and the values of what is frozen or not in the data.
        steady, probe: the points; either may be empty.
        frozen: paths that are not to move.
        weights: every point equally, or divided by its stated standard deviation.
        constraints: `"paper"` keeps α₁, c₂, c₃ ≥ 0.

    Raises:
        InputError: parameters that these points cannot fix, named with the reason; too few points; weights without
            stated standard deviations.
    """
    stages: dict[str, Stage] = {}
    warnings: list[str] = []
    names: tuple[str, ...] = ()
    covariance = np.empty((0, 0))
    for points in (steady, probe):
        if not len(points):
            continue
        free = tuple(name for name in PARAMETERS[points.kind] if name not in frozen)
        scale = _scale(points, weights)
        if not free:
            raise InputError(f"every parameter that {points.kind} points could fix is frozen; free one of them")
        _determined(points, free, _jacobian(model, points, free, np.ones(len(points))))
        lower = np.array([0.0 if constraints == "paper" and n in POSITIVE_IN_PAPER else -np.inf for n in free])
        solution = _solve(model, points, free, scale, lower, np.ones(len(points), bool))
        if not solution.converged:
            warnings.append(f"the {points.kind} fit stopped before it converged")
        if points.kind == "probe" and not len(steady):
            warnings.append("no steady points: α₁ and α₂ in K_T are the given model's, their error not counted")
        for name in (n for n, held in zip(free, solution.at_bound, strict=True) if held):
            warnings.append(f"{name} is at its bound 0: the data pull it below")
        covariance = _extend(covariance, names, model, points, free, solution, scale)
        names += free
        held_out, jackknife = _leave_level_out(model, points, free, scale, lower)
        model = replace(model, dict(zip(free, solution.x, strict=True)))
        stages[points.kind] = Stage(
            free, points, solution, np.asarray(predict(model, points)), scale, held_out, jackknife
        )
    return StaticFit(model, stages, names, covariance, warnings)


def _scale(points: Points, weights: Weights) -> np.ndarray:
    if weights == "equal":
        return np.ones(len(points))
    if not np.all(points.sd > 0):
        raise InputError(
            f"--weights published: {np.sum(~(points.sd > 0))} of {len(points)} {points.kind} points state no standard "
            "deviation; use --weights equal, or log them on the topic's /sd"
        )
    return points.sd


def _evaluate(model: Model, points: Points, names: tuple[str, ...], x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N,) the model's values at the points with the parameters `names` at x, and their Jacobian (N, k)."""
    theta, pressure = jnp.asarray(points.theta), jnp.asarray(points.pressure_kpa)
    value, jacobian = _value_and_jacobian(model, names, jnp.asarray(x), points.kind == "steady", theta, pressure)
    return np.asarray(value), np.asarray(jacobian)


def _solve(
    model: Model, points: Points, free: tuple[str, ...], scale: np.ndarray, lower: np.ndarray, keep: np.ndarray
) -> Solution:
    """The fit to the points of the mask `keep`; all are evaluated, so that every subset shares one compilation."""

    def residuals(x):
        value, jacobian = _evaluate(model, points, free, x)
        return ((value - points.value) / scale)[keep], (jacobian / scale[:, None])[keep]

    return solve(residuals, _values(model, free), lower, np.full(len(free), np.inf))


def _values(model: Model, names: tuple[str, ...]) -> np.ndarray:
    return np.array([float(get(model, name)) for name in names])


def _jacobian(model: Model, points: Points, free: tuple[str, ...], scale: np.ndarray) -> np.ndarray:
    return _evaluate(model, points, free, _values(model, free))[1] / scale[:, None]


def _determined(points: Points, free: tuple[str, ...], jacobian: np.ndarray) -> None:
    """Refuse parameters that no noise level could make these points, with the Jacobian (N, k), show."""
    pressures = points.level_pressures()
    lost = [name for name in free if NEEDED_LEVELS.get(name, 1) > len(pressures)]
    if lost:
        needed = max(NEEDED_LEVELS.get(name, 1) for name in lost)
        at = ", ".join(f"{p:.4g}" for p in pressures)
        raise InputError(
            f"{points.kind} points are all at {len(pressures)} pressure{'s'[: len(pressures) > 1]} ({at} kPa): "
            f"{', '.join(lost)} cannot be found from them; add points at {needed} pressures or more, or freeze "
            f"{'it' if len(lost) == 1 else 'them'}: --freeze {' '.join(lost)}"
        )
    loose = [name for name, bad in zip(free, undetermined(jacobian), strict=True) if bad]
    if loose:
        raise InputError(
            f"{len(points)} {points.kind} points cannot tell {', '.join(loose)} apart; add points at other angles and "
            f"pressures, or freeze some of them: --freeze {loose[0]}"
        )
    if len(points) <= len(free):
        raise InputError(
            f"{len(points)} {points.kind} points for {len(free)} parameters leave no error to judge; add points"
        )


def _extend(covariance, names, model, points, free, solution: Solution, scale):
    """Covariance over names + free: s²(JᵀJ)⁻¹ of this stage, plus what the earlier parameters' errors do to it."""
    own = solution.variance * solution.unit_covariance()
    k, m = len(names), len(free)
    out = np.full((k + m, k + m), np.nan)
    out[:k, :k] = covariance
    out[k:, k:] = own
    if k:
        fitted = replace(model, dict(zip(free, solution.x, strict=True)))
        earlier = _jacobian(fitted, points, names, scale)
        known = np.nan_to_num(covariance, nan=0.0)  # what a bound holds counts as known
        moved = np.zeros((m, k))
        moved[solution.free] = -np.linalg.lstsq(solution.jacobian[:, solution.free], earlier, rcond=None)[0]
        out[k:, k:] = own + moved @ known @ moved.T
        out[k:, :k] = moved @ known
        out[:k, k:] = out[k:, :k].T
        lost = ~np.isfinite(np.diag(out))
        out[lost], out[:, lost] = np.nan, np.nan
    return out


def _leave_level_out(model, points, free, scale, lower) -> tuple[np.ndarray, np.ndarray]:
    """Errors at each pressure level of a fit without it, and the jackknife deviation of the parameters over levels."""
    levels = points.levels
    count = levels.max() + 1
    errors = np.full(len(points), np.nan)
    estimates = []
    jacobian = _jacobian(model, points, free, np.ones(len(points)))
    for level in range(count):
        rest, out = levels != level, levels == level
        try:
            _determined(points.take(rest), free, jacobian[rest])
        except InputError:
            continue
        found = _solve(model, points, free, scale, lower, rest).x
        estimates.append(found)
        errors[out] = points.value[out] - _evaluate(model, points, free, found)[0][out]
    if len(estimates) < count or count < 3:
        return errors, np.full(len(free), np.nan)
    spread = np.array(estimates) - np.mean(estimates, axis=0)
    return errors, np.sqrt((count - 1) / count * np.sum(spread**2, axis=0))


def prediction_sd(fit: StaticFit, points: Points) -> np.ndarray:
    """(N,) standard deviation of the model's values from the parameters' errors; NaN where a bound holds one."""
    jacobian = _jacobian(fit.model, points, fit.names, np.ones(len(points)))
    return np.sqrt(np.einsum("ij,jk,ik->i", jacobian, fit.covariance, jacobian))
