"""Adam on random batches of windows, for data too large to go through at every step; optax does the steps."""

from __future__ import annotations

import jax
import numpy as np
import optax

from ljjax.fit.dynamic import Search, estimate
from ljjax.fit.problem import ROUNDS, Estimate, Problem, Round
from ljjax.fit.shooting import TILE, Asking
from ljjax.fit.windows import cut

STEPS, RATE = 150, 0.05


def descend(problem: Problem, x0: np.ndarray | None, rng: np.random.Generator, steps: int = STEPS) -> Asking[Estimate]:
    """Stochastic descent from the windows' own starts, then free runs for the covariance and the last digits.

    Adam's own scaling evens out that parameters' effects differ by orders.
    """
    how: Round = ROUNDS[0]
    everything = cut(problem.motions, how.step_s)
    x = np.array(problem.coordinates.start if x0 is None else x0, float)
    rule = optax.adam(optax.cosine_decay_schedule(RATE, steps))
    state = rule.init(x)
    for _ in range(steps):
        keep = np.sort(rng.permutation(len(everything))[:TILE])
        search = Search(problem, everything.only(keep), how)
        gradient = yield from search.gradient(x)
        with jax.numpy_dtype_promotion("standard"):  # optax mixes whole numbers and floats
            update, state = rule.update(gradient, state)
        step = np.asarray(update) * problem.coordinates.spread / 3.0
        while not problem.coordinates.admissible(x + step):
            step = step / 2
        x = x + step
    return (yield from estimate(problem, x, ROUNDS[1:]))
