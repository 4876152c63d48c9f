"""Simulate on a fixed step with the solver of `ljjax.step`: inputs averaged over steps, output between steps."""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ljjax import energy
from ljjax.dynamics import State
from ljjax.inputs import Inputs
from ljjax.model import Model
from ljjax.step import Drive, Unrolled, advance, constants, unroll


def grid(inputs: Inputs, at: Any, step_s: float) -> tuple[float, int]:
    """The start of the first step and the number of steps of `step_s` that cover the stamps `at` (T,)."""
    at = np.asarray(at)
    start = min(float(inputs.t[0]), float(at[0]))
    return start, max(1, math.ceil((float(at[-1]) - start) / step_s - 1e-9))


def means(inputs: Inputs, edges: Array) -> tuple[Array, Array, Array | None]:
    """Mean tensions (N, 2), vacuum (N,) and torques (N, n) over the intervals between N+1 edges, exactly: differences
    of the inputs' running integral."""
    width = jnp.diff(inputs.t)

    def mean(x: Array) -> Array:
        values = x if x.ndim == 2 else x[:, None]
        middle = values[:-1] if inputs.hold else 0.5 * (values[:-1] + values[1:])
        total = jnp.concatenate([jnp.zeros_like(values[:1]), jnp.cumsum(middle * width[:, None], axis=0)])
        index = jnp.clip(jnp.searchsorted(inputs.t, edges, side="right") - 1, 0, inputs.t.shape[0] - 1)
        after = edges - inputs.t[index]
        following = jnp.minimum(index + 1, inputs.t.shape[0] - 1)
        gap = inputs.t[following] - inputs.t[index]
        slope = (values[following] - values[index]) / jnp.where(gap > 0, gap, jnp.ones_like(gap))[:, None]
        slope = jnp.zeros_like(slope) if inputs.hold else jnp.where((after > 0)[:, None], slope, jnp.zeros_like(slope))
        integral = total[index] + values[index] * after[:, None] + 0.5 * slope * (after**2)[:, None]
        out = jnp.diff(integral, axis=0) / jnp.diff(edges)[:, None]
        return out if x.ndim == 2 else out[:, 0]

    torque = None if inputs.torque is None else mean(inputs.torque)
    return mean(inputs.tendons), mean(inputs.pressure_kpa), torque


def run(
    model: Model, inputs: Inputs, initial: State, at: Array, start: Array, h: Array, steps: int, iterations: int
) -> State:
    """States at the stamps `at` (T,): fixed steps from `start`, cubic Hermite between them for q, linear for v and z.

    Pure and without checks, for use under jit, vmap and differentiation; `ljjax.simulate` is the front door.

    Args:
        initial: state at `start`.
        start, h: start of the first step and length of a step [s].
        steps: number of steps; they must reach the last stamp.
        iterations: Newton iterations a stage.
    """
    edges = start + h * jnp.arange(steps + 1, dtype=inputs.t.dtype)
    tendons, pressure, torque = means(inputs, edges)
    c = constants(model)
    drive = Drive(
        tendons[:, 0] - tendons[:, 1],
        jax.vmap(lambda p: energy.alpha2(model, p))(pressure),
        jax.vmap(lambda p: energy.phi(model, p))(pressure),
        None if torque is None else tuple(torque[:, i] for i in range(model.n)),
    )
    first = Unrolled(*(unroll(x) for x in initial))

    def body(state: Unrolled, d: Drive) -> tuple[Unrolled, Unrolled]:
        new = advance(model, c, state, d, h, iterations)
        return new, new

    _, path = jax.lax.scan(body, first, drive)
    q, v, z = (
        jnp.stack([jnp.concatenate([a[None], b]) for a, b in zip(x, y, strict=True)], axis=1)
        for x, y in zip(first, path, strict=True)
    )
    index = jnp.clip(jnp.floor((at - start) / h).astype(int), 0, steps - 1)
    w = ((at - edges[index]) / h)[:, None]
    q0, q1, v0, v1 = q[index], q[index + 1], v[index] * h, v[index + 1] * h
    bent = q0 + w * (v0 + w * (3 * (q1 - q0) - 2 * v0 - v1 + w * (2 * (q0 - q1) + v0 + v1)))
    return State(bent, v[index] + w * (v[index + 1] - v[index]), z[index] + w * (z[index + 1] - z[index]))
