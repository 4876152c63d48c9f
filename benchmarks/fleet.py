"""The robots and commands of the simulation benchmarks: random, admissible, near a real robot's numbers."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from ljjax.constraints import FREE, constrain, unconstrain
from ljjax.dynamics import State
from ljjax.inputs import Inputs
from ljjax.model import Chain, Elastic, Friction, Gravity, Jamming, Model
from ljjax.simulation import rest

PRESSURE_MAX_KPA = 40.0
SPREAD = 0.15
"""Standard deviation of the free numbers, most of them logarithms: 15 % of each parameter."""
RATE_HZ = 100


def typical() -> Model:
    """Six segments, as identified on a real robot, but for μ_S/μ_C = 1.08: above about 1.15 stick-slip makes some
    motions depend on any step, and a benchmark of accuracy would measure luck."""
    model = Model(
        Chain(*(jnp.asarray(x) for x in (0.021, 0.025, 0.02, 0.0512016)), segments=6),
        Gravity(jnp.asarray(0.0962367)),
        Elastic(*(jnp.asarray(x) for x in (-0.000568836, 0.0676109, 1.48672))),
        Jamming(*(jnp.asarray(x) for x in (7.90146, 3.78583))),
        Friction(*(jnp.asarray(x) for x in (0.00412982, 0.0124512, 1.61922, 0.00315435, 0.0034067, 0.0447352))),
    )
    return jax.tree.map(lambda leaf: leaf.astype(float), model)


def fleet(robots: int, seconds: float, seed: int = 0, hold: bool = False) -> tuple[Model, Inputs, State]:
    """Models, commands (at 100 Hz, held or linear between) and first states: every leaf with the robots in front, but
    for the commands' stamps (T,), which are shared.

    Tensions are sums of three slow sines a robot, up to about 27 N, on 1 N of co-contraction; the vacuum moves between
    2 and 38 kPa.
    """
    rng = np.random.default_rng(seed)
    like = typical()
    free = unconstrain(like, PRESSURE_MAX_KPA)
    moved = {path: free[path] + jnp.asarray(rng.normal(scale=SPREAD, size=robots)) for path in FREE}
    models = jax.jit(jax.vmap(lambda x: constrain(x, like, PRESSURE_MAX_KPA)))(moved)

    t = np.arange(round(RATE_HZ * seconds) + 1) / RATE_HZ
    hertz, turn, size = rng.uniform([0.1, 0, 3], [1.0, 2 * np.pi, 9], (robots, 3, 3)).transpose(2, 0, 1)[..., None]
    pull = np.sum(size * np.sin(2 * np.pi * hertz * t + turn), axis=1) * np.minimum(2 * t, 1)
    tendons = 1 + np.stack([np.maximum(pull, 0), np.maximum(-pull, 0)], axis=-1)
    hertz, turn = rng.uniform([0.05, 0], [0.3, 2 * np.pi], (robots, 2)).T[..., None]
    vacuum = 20 + 18 * np.sin(2 * np.pi * hertz * t + turn)
    inputs = Inputs(jnp.asarray(t), jnp.asarray(tendons), jnp.asarray(vacuum), hold=hold)
    states = jax.jit(jax.vmap(lambda m, u, p: rest(m, of_one(inputs, u, p))))(
        models, inputs.tendons, inputs.pressure_kpa
    )
    return models, inputs, states


def of_one(inputs: Inputs, tendons: jax.Array, vacuum: jax.Array) -> Inputs:
    """One robot's commands, on the stamps of the batch."""
    return Inputs(inputs.t, tendons, vacuum, hold=inputs.hold)


def element(tree, index: int):
    """One robot of a batch."""
    return jax.tree.map(lambda x: x[index], tree)
