"""fit.json: everything a fit found, as plain JSON values."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

import numpy as np

from ljjax.fit.paper import paper_units
from ljjax.fit.points import UNIT, Points
from ljjax.fit.result import StaticResult
from ljjax.fit.static import Stage
from ljjax.logs import Run

SCHEMA = "ljjax.fit/1"


def record(result: StaticResult) -> dict[str, Any]:
    """The content of fit.json; what is not finite or not known is None."""
    stages = result.static.stages
    names, correlation = result.correlation
    steady, probe = (stages[kind].points if kind in stages else Points.none(kind) for kind in ("steady", "probe"))
    robots = sorted({r.robot_id for r in result.runs})
    return plain(
        {
            "schema": SCHEMA,
            "version": version("ljjax"),
            "robot_id": robots[0] if len(robots) == 1 else robots,
            "options": dict(result.options),
            "start": result.start_from,
            "inputs": [
                {
                    **about_run(r, "train"),
                    **{kind: int(np.sum(stage.points.run == i)) for kind, stage in stages.items()},
                }
                for i, r in enumerate(result.runs)
            ],
            "said": list(result.said),
            "gauge": "sigma0 = 1 1/rad: c4, c5 are bristle stiffness",
            "lever_arm_m": float(result.model.chain.lever_arm_m),
            "parameters": {
                p.name: {k: v for k, v in vars(p).items() if k != "name"} for p in result.parameters.values()
            },
            "correlation": {"names": names, "matrix": correlation},
            "residuals": {kind: _residuals(stage) for kind, stage in stages.items()},
            "held_out": {kind: _held_out(stage) for kind, stage in stages.items()},
            "warnings": result.warnings,
            "paper": paper_units(steady, probe, result.model.n, robots[0] if len(robots) == 1 else ""),
        }
    )


def _residuals(stage: Stage) -> dict[str, Any]:
    p = stage.points
    worst = int(np.argmax(np.abs(stage.error)))
    return {
        "unit": UNIT[p.kind],
        "count": len(p),
        "rmse": stage.rmse,
        "r_squared": stage.r_squared,
        "stated_scatter": p.scatter,
        "largest": {
            "error": stage.error[worst],
            "theta_deg": np.degrees(p.theta[worst]),
            "pressure_kpa": p.pressure_kpa[worst],
        },
        "points": {
            "run": p.run,
            "t_s": p.t,
            "pressure_kpa": p.pressure_kpa,
            "theta_rad": p.theta,
            "measured": p.value,
            "sd": p.sd,
            "model": stage.predicted,
            "error": stage.error,
        },
    }


def _held_out(stage: Stage) -> dict[str, Any]:
    """Leave-one-pressure-out errors: of each level, over the inner levels, over all."""
    levels = stage.points.levels
    rms = [float(np.sqrt(np.mean(stage.held_out[levels == k] ** 2))) for k in range(int(levels.max()) + 1)]
    inner = rms[1:-1]
    return {
        "by": "pressure",
        "unit": UNIT[stage.points.kind],
        "pressure_kpa": stage.points.level_pressures(),
        "rmse": rms,
        "rmse_inner": float(np.sqrt(np.mean(np.square(inner)))) if inner else None,
        "rmse_all": float(np.sqrt(np.mean(stage.held_out**2))),
    }


def about_run(r: Run, role: str) -> dict[str, Any]:
    """Where a run came from."""
    return {
        "file": r.path,
        "sha256": r.sha256,
        "run_id": r.run_id,
        "robot_id": r.robot_id,
        "experiment": r.experiment,
        "role": role,
        "partial": None if r.damage is None else f"{r.damage.why} at {r.damage.where}",
    }


def plain(x: Any) -> Any:
    """Plain JSON values: arrays to lists, what is not finite to null."""
    if isinstance(x, Mapping):
        return {k: plain(v) for k, v in x.items()}
    if isinstance(x, np.ndarray):
        return plain(x.tolist())
    if isinstance(x, list | tuple):
        return [plain(v) for v in x]
    if isinstance(x, float | np.floating):
        return float(x) if np.isfinite(x) else None
    return int(x) if isinstance(x, np.integer) else x
