"""One motion for tests of effects: tensions and vacuum, and what a robot shows of it."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ljjax import fast
from ljjax.inputs import Inputs
from ljjax.simulation import rest

AT = np.linspace(0.0, 1.2, 61)


def drive() -> Inputs:
    """Tensions to and fro and vacuum up and down."""
    t = np.linspace(0.0, 1.2, 241)
    net = 14.0 * np.sin(2 * np.pi * 1.3 * t) * np.clip(4 * t, 0, 1)
    u = 0.3 + np.stack([np.maximum(net, 0), np.maximum(-net, 0)], axis=1)
    pressure = np.where((t > 0.4) & (t < 0.9), 15.0, 4.0)
    return Inputs(jnp.asarray(t), jnp.asarray(u), jnp.asarray(pressure))


@eqx.filter_jit
def seen(model, inputs):
    start = rest(model, inputs)
    h = jnp.asarray(0.005)
    return fast.run(model, inputs, start, jnp.asarray(AT), jnp.asarray(0.0), h, 240, 3).seen
