"""Robots and inputs for the tests of the model: one table of parameters, and random admissible ones."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from ljjax.constraints import constrain, unconstrain
from ljjax.inputs import Inputs
from ljjax.model import UNITS, Chain, Elastic, Friction, Gravity, Jamming, Model, replace

PRESSURE_MAX_KPA = 40.0


def make_robot(n: int = 3, parameters: dict[str, float] | None = None, **options: Any) -> Model:
    """A robot in which every term of the model matters; `parameters` (path → value) are changed."""
    model = Model(
        Chain(0.021, 0.025, 0.02, 0.06, segments=n),
        Gravity(0.4),
        Elastic(-6e-4, 0.04, 0.8),
        Jamming(3.0, 0.7),
        Friction(0.004, 0.012, 1.6, 0.025, 0.03, 0.045),
        **options,
    )
    return replace(model, parameters or {})


def make_random_robot(seed: int, n: int = 3, **options: Any) -> Model:
    """An admissible robot up to a pressure of 40 kPa: each free number a random step from `make_robot`'s."""
    rng = np.random.default_rng(seed)
    like = make_robot(n, **options)
    free = unconstrain(like, PRESSURE_MAX_KPA)
    step = {path: jnp.asarray(rng.normal(scale=0.3)) for path in UNITS}
    return constrain({path: free[path] + step[path] for path in UNITS}, like, PRESSURE_MAX_KPA)


def make_random_inputs(seed: int, *, n: int = 3, hold: bool = True, torque: bool = False, end: float = 1.0) -> Inputs:
    """Moving tensions and a moving vacuum on six stamps, 0 … `end` s; external torques if asked for."""
    rng = np.random.default_rng(seed)
    t = end * np.array([0.0, 0.13, 0.35, 0.6, 0.8, 1.0])
    return Inputs(
        jnp.asarray(t),
        jnp.asarray(rng.uniform(0, 30, (6, 2))),
        jnp.asarray(rng.uniform(0, PRESSURE_MAX_KPA, 6)),
        jnp.asarray(rng.normal(scale=0.1, size=(6, n))) if torque else None,
        hold=hold,
    )


@pytest.fixture(scope="session")
def robot() -> Callable[..., Model]:
    """`robot(n=3, parameters={}, **options)`: the example robot."""
    return make_robot


@pytest.fixture(scope="session")
def random_robot() -> Callable[..., Model]:
    """`random_robot(seed, n=3, **options)`: a random admissible robot, up to 40 kPa."""
    return make_random_robot


@pytest.fixture(scope="session")
def random_inputs() -> Callable[..., Inputs]:
    """`random_inputs(seed, n=3, hold=True, torque=False, end=1.0)`: random tensions and vacuum."""
    return make_random_inputs
