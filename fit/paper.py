"""The same identification in the paper's own units: g = 1, θ in degrees, tension in N, stiffness in N/m.

u = α₁ sin(nθ) + (c₁u_P² + c₂u_P + c₃)θ with α₁ in N and α₂ in N/deg; K_T = c₄ + c₅√u_P. Plain least squares on the
points as they are, as published; `PUBLISHED` holds the paper's figures for OctRobot-I.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ljjax.fit.points import Points

PUBLISHED = {
    "alpha1": 1.0227,
    "c1": -0.0015,
    "c2": 0.0890,
    "c3": 1.7056,
    "c4": 110.9847,
    "c5": 29.1067,
    "r_squared": 0.9216,
}
PUBLISHED_FOR = "OctRobot-I"


def paper_units(steady: Points, probe: Points, segments: int, robot_id: str) -> dict[str, Any]:
    """The `"paper"` entry of fit.json: values, `sd` beside them, and `published` where the robot is the paper's.

    Keys of data that are missing or do not determine the values are left out.
    """
    out: dict[str, Any] = {
        "units": {
            **{
                "alpha1": "N",
                "c1": "N/deg/kPa²",
                "c2": "N/deg/kPa",
                "c3": "N/deg",
                "c4": "N/m",
                "c5": "N/m/√kPa",
            },
            "rmse_n": "N",
        }
    }
    sds: dict[str, float] = {}
    degrees, p = np.degrees(steady.theta), steady.pressure_kpa
    sine = np.sin(segments * steady.theta)
    elastic = np.stack([p**2 * degrees, p * degrees, degrees], axis=1)
    elastic_and_gravity = np.column_stack([sine, elastic])
    root = np.stack([np.ones(len(probe)), np.sqrt(np.maximum(probe.pressure_kpa, 0))], axis=1)
    if fit := _regress(elastic_and_gravity, steady.value):
        x, sd, error = fit
        for name, value, deviation in zip(("alpha1", "c1", "c2", "c3"), x, sd, strict=True):
            out[name], sds[name] = float(value), float(deviation)
        out["rmse_n"] = float(np.sqrt(np.mean(error**2)))
    if fit := _regress(elastic, steady.value):
        x, sd, error = fit
        out["c3_without_alpha1"], sds["c3_without_alpha1"] = float(x[2]), float(sd[2])
        out["rmse_without_alpha1_n"] = float(np.sqrt(np.mean(error**2)))
    if fit := _regress(root, probe.value):
        x, sd, error = fit
        for name, value, deviation in zip(("c4", "c5"), x, sd, strict=True):
            out[name], sds[name] = float(value), float(deviation)
        spread = probe.value - probe.value.mean()
        out["r_squared"] = float(1 - error @ error / (spread @ spread))
        out["rmse_n_per_m"] = float(np.sqrt(np.mean(error**2)))
    out["sd"] = sds
    out["left_out"] = {
        "steady_inner_n": _left_out(elastic_and_gravity, steady, inner=True),
        "probe_n_per_m": _left_out(root, probe, inner=False),
    }
    if robot_id == PUBLISHED_FOR:
        published: dict[str, Any] = dict(PUBLISHED)
        out["published"] = published
        if len(steady):
            at = np.array([PUBLISHED[name] for name in ("alpha1", "c1", "c2", "c3")])
            error = steady.value - elastic_and_gravity @ at
            worst = int(np.argmax(np.abs(error)))
            published["rmse_n"] = float(np.sqrt(np.mean(error**2)))
            published["largest_residual"] = {
                "n": float(error[worst]),
                "theta_deg": float(degrees[worst]),
                "pressure_kpa": float(p[worst]),
            }
    return out


def _regress(a: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Ordinary least squares: estimates, standard errors and errors; None where the columns do not determine them."""
    if len(y) <= a.shape[1] or np.linalg.matrix_rank(a / np.maximum(np.linalg.norm(a, axis=0), 1e-300)) < a.shape[1]:
        return None
    x, *_ = np.linalg.lstsq(a, y, rcond=None)
    error = y - a @ x
    s2 = error @ error / (len(y) - a.shape[1])
    return x, np.sqrt(s2 * np.diag(np.linalg.inv(a.T @ a))), error


def _left_out(a: np.ndarray, points: Points, inner: bool) -> float | None:
    """RMS error at pressure levels left out of the fit: the inner ones, or all; None where a level cannot be spared."""
    levels = points.levels
    count = levels.max(initial=-1) + 1
    errors = []
    for level in range(1, count - 1) if inner else range(count):
        out = levels == level
        fit = _regress(a[~out], points.value[~out])
        if fit is None:
            return None
        errors.append(points.value[out] - a[out] @ fit[0])
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2))) if errors else None
