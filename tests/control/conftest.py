"""Robots and laws for the tests of the control: OctRobot-I's numbers as identified, with few segments."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import pytest

from ljjax.control import Design, Hardware, design
from ljjax.effects import REGISTRY
from ljjax.law import KINDS
from ljjax.model import Chain, Elastic, Friction, Gravity, Jamming, Model

LAWS = tuple(KINDS)


def make_robot(n: int = 2, effects: Mapping[str, Mapping[str, float]] | None = None) -> Model:
    x = jnp.asarray
    added: Any = tuple(REGISTRY[name](**{k: x(v) for k, v in given.items()}) for name, given in (effects or {}).items())
    model = Model(
        Chain(x(0.021), x(0.025), x(0.02), x(0.35 / 6), segments=n),
        Gravity(x(0.0205)),
        Elastic(x(-0.0017), x(0.102), x(1.861)),
        Jamming(x(12.0), x(3.416)),
        Friction(x(0.004), x(0.012), x(1.6), x(0.0025), x(0.003), x(0.045)),
        effects=added,
    )
    return jax.tree.map(lambda leaf: leaf.astype(float), model)


@pytest.fixture(scope="session")
def robot() -> Callable[..., Model]:
    """`robot(n=2, effects={})`: OctRobot-I, of n segments, with effects by id and what they are given."""
    return make_robot


@pytest.fixture(scope="session")
def designs() -> dict[str, Design]:
    """A law of every kind for `robot()`, with damping (by default this robot needs none beside its friction's)."""
    hardware = Hardware(theta_max_rad=0.25)
    return {kind: design(make_robot(), kind, gains={"damping": 50.0}, hardware=hardware) for kind in LAWS}
