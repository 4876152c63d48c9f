"""The solver against scipy's, and what it says about parameters that data do not fix."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares

from ljjax.fit.least_squares import solve, undetermined

RNG = np.random.default_rng(3)
A = RNG.normal(size=(30, 4))
Y = A @ np.array([1.0, -2.0, 0.5, 3.0]) + 0.3 * RNG.normal(size=30)
SCALES = np.array([1e-4, 1.0, 1e3, 1e6])
NEAR = A.copy()
NEAR[:, 3] = A[:, 2] + 1e-4 * RNG.normal(size=30)
T = np.linspace(0, 3, 40)
DECAY = 2.0 * np.exp(-1.3 * T) + 0.4 + 0.02 * RNG.normal(size=40)

Function = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


def decay(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    e = np.exp(-x[1] * T)
    return x[0] * e + x[2] - DECAY, np.stack([e, -x[0] * T * e, np.ones_like(T)], axis=1)


def rosenbrock(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]]), np.array([[-20 * x[0], 10.0], [-1.0, 0.0]])


FREE = {
    "linear": (lambda x: (A @ x - Y, A), np.zeros(4)),
    "badly scaled": (lambda x: ((A * SCALES) @ x - Y, A * SCALES), np.zeros(4)),
    "nearly collinear": (lambda x: (NEAR @ x - Y, NEAR), np.zeros(4)),
    "no residual left": (lambda x: (A @ x - A.sum(axis=1), A), np.zeros(4)),
    "decay": (decay, np.array([1.0, 0.3, 0.0])),
    "rosenbrock": (rosenbrock, np.array([-1.2, 1.0])),
}
BOUNDED = {
    "linear": (FREE["linear"], [0, 0, 0, 0], [2, 2, 2, 2]),
    "linear, one sided": (FREE["linear"], [-np.inf, -1, -np.inf, -np.inf], [np.inf] * 4),
    "bounds that do not bind": (FREE["linear"], [-9] * 4, [9] * 4),
    "start outside": ((FREE["linear"][0], np.full(4, 50.0)), [0, -1, 0, 0], [5, 5, 5, 2]),
    "badly scaled": (FREE["badly scaled"], [0, 0, 0, 0], [np.inf] * 4),
    "nearly collinear": (FREE["nearly collinear"], [-1, -1, 0, 0], [5, 5, 5, 5]),
    "decay": (FREE["decay"], [0, 0, 0.5], [5, 5, 5]),
    "rosenbrock": (FREE["rosenbrock"], [-2, -2], [0.5, 2]),
}


def scipys(fun: Function, x0, lower, upper):
    inside = np.clip(x0, np.asarray(lower) + 1e-9, np.asarray(upper) - 1e-9)
    jacobian: Any = lambda x: fun(x)[1]  # noqa: E731 (its stubs know of strings only)
    tight = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15, "x_scale": "jac", "max_nfev": 5000}
    return least_squares(lambda x: fun(x)[0], inside, jacobian, (lower, upper), **tight)


@pytest.mark.parametrize("name", FREE)
def test_without_bounds(name):
    fun, x0 = FREE[name]
    none = np.full(len(x0), np.inf)
    mine, other = solve(fun, x0, -none, none), scipys(fun, x0, -none, none)
    assert mine.converged and not mine.at_bound.any()
    assert mine.residual @ mine.residual <= 2 * other.cost * (1 + 1e-12) + 1e-24
    np.testing.assert_allclose(mine.x, other.x, rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("name", BOUNDED)
def test_with_bounds(name):
    (fun, x0), lower, upper = BOUNDED[name]
    lower, upper = np.array(lower, float), np.array(upper, float)
    mine, other = solve(fun, x0, lower, upper), scipys(fun, x0, lower, upper)
    assert mine.converged
    assert np.all((mine.x >= lower) & (mine.x <= upper))
    assert mine.residual @ mine.residual <= 2 * other.cost * (1 + 1e-6)
    assert set(np.flatnonzero(mine.at_bound)) == set(np.flatnonzero((mine.x == lower) | (mine.x == upper)))
    gradient = mine.jacobian.T @ mine.residual
    size = np.linalg.norm(mine.jacobian, axis=0) * np.linalg.norm(mine.residual)
    assert np.all(np.abs(gradient / size)[mine.free] < 1e-6)
    assert np.all(gradient[mine.x == lower] >= 0) and np.all(gradient[mine.x == upper] <= 0)
    assert mine.at_bound.any() == (name != "bounds that do not bind")


def test_covariance_and_variance_are_those_of_linear_regression():
    none = np.full(4, np.inf)
    fit = solve(FREE["badly scaled"][0], np.zeros(4), -none, none)
    x = A * SCALES
    np.testing.assert_allclose(fit.variance, fit.residual @ fit.residual / 26, rtol=1e-12)
    np.testing.assert_allclose(fit.unit_covariance(), np.linalg.inv(A.T @ A) / np.outer(SCALES, SCALES), rtol=1e-9)
    assert x.shape[0] - fit.degrees_of_freedom == 4


def test_a_parameter_at_its_bound_counts_as_known():
    fit = solve(FREE["linear"][0], np.zeros(4), np.array([-np.inf, 0, -np.inf, -np.inf]), np.full(4, np.inf))
    assert list(fit.at_bound) == [False, True, False, False]
    rest = A[:, [0, 2, 3]]
    np.testing.assert_allclose(fit.x[fit.free], np.linalg.lstsq(rest, Y, rcond=None)[0], rtol=1e-9)
    c = fit.unit_covariance()
    assert np.isnan(c[1]).all() and np.isnan(c[:, 1]).all()
    np.testing.assert_allclose(c[np.ix_(fit.free, fit.free)], np.linalg.inv(rest.T @ rest), rtol=1e-9)
    assert fit.degrees_of_freedom == 27


def test_running_out_of_iterations_is_said():
    none = np.full(2, np.inf)
    assert not solve(rosenbrock, np.array([-1.2, 1.0]), -none, none, max_iterations=3).converged


ONES = np.ones(30)
RANK = {
    "all fixed": (A, [False] * 4),
    "badly scaled": (A * SCALES, [False] * 4),
    "nearly collinear, still fixed": (NEAR, [False] * 4),
    "two alike": (np.column_stack([A[:, 0], A[:, 1], 3 * A[:, 1]]), [False, True, True]),
    "a sum of two others": (np.column_stack([A[:, :3], A[:, 0] - 3 * A[:, 2]]), [True, False, True, True]),
    "no effect": (np.column_stack([A[:, 0], 0 * ONES, A[:, 1]]), [False, True, False]),
    "fewer data than parameters": (A[:2], [True] * 4),
    "one datum for one": (A[:1, :1], [False]),
    "nothing has an effect": (np.zeros((5, 2)), [True, True]),
}


@pytest.mark.parametrize("name", RANK)
def test_undetermined(name):
    jacobian, expected = RANK[name]
    assert list(undetermined(jacobian)) == expected
