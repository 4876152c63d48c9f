"""`fit(model, runs)`: the one verb of this room."""

from __future__ import annotations

from collections.abc import Sequence

from ljjax import modelfile
from ljjax.data import OCTROBOT
from ljjax.errors import InputError
from ljjax.fit.points import collect
from ljjax.fit.result import NOMINAL, FitResult
from ljjax.fit.static import Constraints, Weights, fit_static
from ljjax.logs import Run
from ljjax.model import UNITS, check
from ljjax.modelfile import ModelFile


def fit(
    model: ModelFile | None,
    runs: Sequence[Run],
    *,
    frozen: Sequence[str] = (),
    weights: Weights = "equal",
    constraints: Constraints = "none",
    seed: int = 0,
    model_from: str = "the given model",
) -> FitResult:
    """Identify a robot from its runs: for now what is at rest, steady operating points and probe stiffness.

    Args:
        model: geometry, starting values and what is frozen; None for OctRobot-I's geometry with assumed friction.
        runs: logs of one robot, as `ljjax.logs.read_all` gives them.
        frozen: parameters not to move, by path, beside those the model file freezes.
        weights: `"equal"`, or `"published"` to divide by the standard deviations the logs state.
        constraints: `"paper"` keeps α₁, c₂, c₃ ≥ 0 as the paper does.
        seed: for what is random (nothing in a static fit).
        model_from: where the model came from, for the record.

    Raises:
        InputError: no usable data, parameters that the data cannot fix, several robots, unknown paths.
    """
    for path in frozen:
        if path not in UNITS:
            raise InputError(f"--freeze {path}: no such parameter; expected one of {', '.join(UNITS)}")
    robots = sorted({r.robot_id for r in runs})
    if len(robots) > 1:
        raise InputError(f"logs of {len(robots)} robots ({', '.join(robots)}); fit one robot at a time")
    if model is None:
        model, model_from = modelfile.load(OCTROBOT / "nominal.toml"), NOMINAL
    held = tuple(dict.fromkeys((*model.frozen, *frozen)))
    steady, probe, said = collect(runs)
    static = fit_static(model.model, steady, probe, frozen=held, weights=weights, constraints=constraints)
    pressures = [float(p) for s in static.stages.values() for p in s.points.pressure_kpa]
    check(static.model, pressures, "the fit")
    options = {"frozen": held, "weights": weights, "constraints": constraints, "seed": seed}
    return FitResult(static, model, model_from, runs, said, options)
