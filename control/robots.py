"""Robots that an uncertain model may turn out to be."""

from __future__ import annotations

from collections.abc import Mapping
from statistics import NormalDist

import jax
import numpy as np

from ljjax.errors import InputError
from ljjax.model import Model, check, get, replace

TRIES = 200


def sample(
    model: Model, uncertainty: Mapping[str, float], count: int, *, seed: int = 0, vacuum_max_kpa: float = 0.0
) -> list[Model]:
    """The model itself, and count − 1 robots drawn around it, stratified in each parameter.

    Args:
        uncertainty: standard deviations by path, in the parameter's unit; parameters are drawn from independent normal
            distributions, as model.toml holds no correlations, and anew where a robot is impossible.
        vacuum_max_kpa: up to where α₂ and φ must be positive.

    Raises:
        InputError: fewer than one robot; standard deviations with which hardly any robot is possible.
    """
    if count < 1:
        raise InputError(f"samples = {count}: expected at least one robot")
    spread = {path: float(sd) for path, sd in uncertainty.items() if sd > 0}
    if not spread:
        return [model]
    rng, normal = np.random.default_rng(seed), NormalDist()
    strata = np.stack([rng.permutation(count - 1) for _ in spread], axis=1) if count > 1 else np.zeros((0, len(spread)))
    robots = [model]
    for row in strata:
        for k in range(TRIES):
            at = (row + rng.random(len(spread))) / (count - 1) if k == 0 else rng.random(len(spread))
            drawn = {
                path: float(get(model, path)) + sd * normal.inv_cdf(min(max(p, 1e-4), 1 - 1e-4))
                for (path, sd), p in zip(spread.items(), at, strict=True)
            }
            robot = replace(model, drawn)
            try:
                check(robot, (0.0, vacuum_max_kpa), "sample")
            except InputError:
                continue
            robots.append(robot)
            break
        else:
            raise InputError(
                f"uncertainty: none of {TRIES} robots drawn within it is possible (positive α₂, φ, μ_C ≤ μ_S); "
                "lower the standard deviations of model.toml"
            )
    return robots


def stack(robots: list[Model]) -> Model:
    """The same robots as one model, an entry a robot on every leaf's first axis."""
    return jax.tree.map(lambda *x: np.stack([np.asarray(y) for y in x]), *robots)
