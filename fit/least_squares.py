"""Bounded nonlinear least squares with what a user needs to judge the answer: covariance, rank, bounds hit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Residuals = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""x (k,) ↦ residuals (N,) and their Jacobian (N, k)."""


@dataclass(frozen=True, eq=False)
class Solution:
    """Where ½|r(x)|² is least within the bounds.

    Attributes:
        x: (k,) the parameters; `at_bound` (k,) marks those held by a bound.
        residual: (N,) r(x); `jacobian` (N, k) ∂r/∂x.
        converged: whether the projected gradient vanished; `iterations` accepted steps.
    """

    x: np.ndarray
    residual: np.ndarray
    jacobian: np.ndarray
    at_bound: np.ndarray
    converged: bool
    iterations: int

    @property
    def free(self) -> np.ndarray:
        """Indices of the parameters that no bound holds."""
        return np.flatnonzero(~self.at_bound)

    @property
    def degrees_of_freedom(self) -> int:
        return len(self.residual) - len(self.free)

    @property
    def variance(self) -> float:
        """s² = |r|²/(N − k), the residual variance; NaN without degrees of freedom."""
        dof = self.degrees_of_freedom
        return float(self.residual @ self.residual) / dof if dof > 0 else float("nan")

    def unit_covariance(self) -> np.ndarray:
        """(k, k) (JᵀJ)⁻¹ over the free parameters, NaN rows and columns for those at a bound. Times s², the
        covariance of the estimate."""
        out = np.full((len(self.x), len(self.x)), np.nan)
        j = self.jacobian[:, self.free]
        scale = np.linalg.norm(j, axis=0)
        inverse = np.linalg.inv((j / scale).T @ (j / scale)) / np.outer(scale, scale)
        out[np.ix_(self.free, self.free)] = inverse
        return out


def solve(fun: Residuals, x0: np.ndarray, lower: np.ndarray, upper: np.ndarray, max_iterations: int = 200) -> Solution:
    """Levenberg–Marquardt with Marquardt's scaling and projection on the bounds.

    Args:
        fun: residuals and Jacobian.
        x0, lower, upper: (k,) start and bounds (±inf for none); the start is moved inside them.
    """
    x = np.clip(np.asarray(x0, float), lower, upper)
    r, j = fun(x)
    damping, iterations, converged = 1e-3, 0, False
    for _ in range(max_iterations):
        gradient = j.T @ r
        held = ((x <= lower) & (gradient > 0)) | ((x >= upper) & (gradient < 0))
        free = np.flatnonzero(~held)
        scale = np.linalg.norm(j, axis=0)
        scale[scale == 0] = 1.0
        if len(free) == 0 or np.max(np.abs(gradient / scale)[free]) <= 1e-12 * max(np.linalg.norm(r), 1e-300):
            converged = True
            break
        stacked = np.vstack([j[:, free] / scale[free], np.sqrt(damping) * np.eye(len(free))])
        step = np.zeros_like(x)
        step[free] = np.linalg.lstsq(stacked, -np.r_[r, np.zeros(len(free))], rcond=None)[0] / scale[free]
        trial = np.clip(x + step, lower, upper)
        r_trial, j_trial = fun(trial)
        if np.all(np.isfinite(r_trial)) and r_trial @ r_trial < r @ r:
            gain = 1 - (r_trial @ r_trial) / (r @ r)
            x, r, j = trial, r_trial, j_trial
            damping, iterations = max(damping / 10, 1e-15), iterations + 1
            if gain < 1e-15:
                converged = True
                break
        elif np.max(np.abs((trial - x) * scale)) <= 1e-14 * max(np.linalg.norm(r), np.linalg.norm(x * scale)):
            converged = True  # nothing left but rounding
            break
        elif damping > 1e12:
            break
        else:
            damping = max(damping, 1e-9) * 10
    gradient = j.T @ r
    at_bound = (np.isfinite(lower) & (x <= lower) & (gradient >= 0)) | (
        np.isfinite(upper) & (x >= upper) & (gradient <= 0)
    )
    return Solution(x, r, j, at_bound, converged, iterations)


def undetermined(jacobian: np.ndarray, tolerance: float = 1e-7) -> np.ndarray:
    """(k,) mask of the parameters that the residuals do not fix: those with a part in the Jacobian's null space."""
    norm = np.linalg.norm(jacobian, axis=0)
    dead = norm <= 1e-300
    scaled = jacobian / np.where(dead, 1.0, norm)
    _, s, vt = np.linalg.svd(scaled, full_matrices=True)
    small = np.r_[s, np.zeros(vt.shape[0] - len(s))] <= tolerance * max(s.max(initial=0.0), 1e-300)
    null = vt[small]
    return dead | (np.abs(null) > 1e-3).any(axis=0)
