"""Robots and inputs for the tests of the model: one table of parameters, and random admissible ones."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ljjax.constraints import FREE, constrain, unconstrain
from ljjax.inputs import Inputs
from ljjax.model import Chain, Elastic, Friction, Gravity, Jamming, Model, replace

PRESSURE_MAX_KPA = 40.0


def make_robot(n: int = 3, parameters: dict[str, float] | None = None, **options: Any) -> Model:
    """A robot in which every term of the model matters; `parameters` (path → value) are changed."""
    x = jnp.asarray
    model = Model(
        Chain(x(0.021), x(0.025), x(0.02), x(0.06), segments=n),
        Gravity(x(0.4)),
        Elastic(x(-6e-4), x(0.04), x(0.8)),
        Jamming(x(3.0), x(0.7)),
        Friction(x(0.004), x(0.012), x(1.6), x(0.025), x(0.03), x(0.045)),
        **options,
    )
    model = jax.tree.map(lambda leaf: leaf.astype(float), model)  # strong types, as in a loaded model
    return replace(model, parameters or {})


def make_random_robot(seed: int, n: int = 3, **options: Any) -> Model:
    """An admissible robot up to a pressure of 40 kPa: each free number a random step from `make_robot`'s."""
    rng = np.random.default_rng(seed)
    like = make_robot(n, **options)
    free = unconstrain(like, PRESSURE_MAX_KPA)
    step = {path: jnp.asarray(rng.normal(scale=0.3)) for path in FREE}
    return constrain({path: free[path] + step[path] for path in FREE}, like, PRESSURE_MAX_KPA)


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
