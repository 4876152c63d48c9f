"""Simulate on a fixed step with the solver of `ljjax.step`: inputs averaged over steps, output between steps."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ljjax.dynamics import State
from ljjax.inputs import Inputs
from ljjax.model import Model
from ljjax.step import Drive, How, Unrolled, advance, begin, constants, unroll


class Motion(NamedTuple):
    """q [rad], v [rad/s], z [rad] and the joint angles that are logged [rad], each (T, n)."""

    q: Array
    v: Array
    z: Array
    seen: Array


def grid(inputs: Inputs, at: Any, step_s: float) -> tuple[float, int]:
    """The start of the first step and the number of steps of `step_s` that cover the stamps `at` (T,)."""
    at = np.asarray(at)
    start = min(float(inputs.t[0]), float(at[0]))
    return start, max(1, math.ceil((float(at[-1]) - start) / step_s - 1e-9))


def means(inputs: Inputs, edges: Array) -> tuple[Array, Array, Array | None]:
    """Mean tensions (N, 2), vacuum (N,) and torques (N, n) over the intervals between N+1 edges."""
    tendons = mean(inputs.t, inputs.tendons, edges, inputs.hold)
    vacuum = mean(inputs.t, inputs.pressure_kpa[:, None], edges, inputs.hold)[:, 0]
    return tendons, vacuum, None if inputs.torque is None else mean(inputs.t, inputs.torque, edges, inputs.hold)


def mean(t: Any, values: Any, edges: Any, hold: bool, xp: Any = jnp) -> Any:
    """Means of values (T, c), held or linear between the stamps t (T,), over the intervals between N+1 edges, exactly:
    (N, c) differences of the running integral. `xp` is jax.numpy or numpy."""
    middle = values[:-1] if hold else 0.5 * (values[:-1] + values[1:])
    total = xp.concatenate([xp.zeros_like(values[:1]), xp.cumsum(middle * xp.diff(t)[:, None], axis=0)])
    index = xp.clip(xp.searchsorted(t, edges, side="right") - 1, 0, t.shape[0] - 1)
    after = (edges - t[index])[:, None]
    integral = total[index] + values[index] * after
    if not hold:
        following = xp.minimum(index + 1, t.shape[0] - 1)
        gap = (t[following] - t[index])[:, None]
        slope = (values[following] - values[index]) / xp.where(gap > 0, gap, xp.ones_like(gap))
        integral = integral + 0.5 * xp.where(after > 0, slope, xp.zeros_like(slope)) * after**2
    return xp.diff(integral, axis=0) / xp.diff(edges)[:, None]


def drives(model: Model, inputs: Inputs, edges: Array) -> Drive:
    """Mean inputs (N,) over the steps between N+1 edges [s], commands delayed where an effect says so."""
    tendons, pressure, torque = means(inputs, edges)
    for effect in model.effects:
        if (delay := effect.delay_s()) is not None:
            tendons = means(inputs, edges - delay)[0]
    return Drive(
        tendons[:, 0],
        tendons[:, 1],
        pressure,
        None if torque is None else tuple(torque[:, i] for i in range(model.n)),
        t=edges[:-1],
    )


def path(model: Model, first: Unrolled, drive: Drive, h: Array, how: How) -> Unrolled:
    """The states after each of the steps that `drive` (N,) drives, every entry (N,)."""
    c = constants(model)

    def body(state: Unrolled, d: Drive) -> tuple[Unrolled, Unrolled]:
        new = advance(model, c, state, d, h, how)
        return new, new

    return jax.lax.scan(body, first, drive)[1]


def run(
    model: Model, inputs: Inputs, initial: State, at: Array, start: Array, h: Array, steps: int, iterations: int
) -> Motion:
    """The motion at the stamps `at` (T,), every entry (T, n).

    Fixed steps from `start`, cubic Hermite between them for q, linear for v and z. Pure and without checks, for use
    under jit, vmap and differentiation; `ljjax.simulate` is the front door.

    Args:
        initial: state at `start`.
        start, h: start of the first step and length of a step [s].
        steps: number of steps; they must reach the last stamp.
        iterations: Newton iterations a stage.
    """
    edges = start + h * jnp.arange(steps + 1, dtype=inputs.t.dtype)
    drive = drives(model, inputs, edges)
    q, v, z = (unroll(x) for x in initial)
    first = begin(model, q, v, z, jax.tree.map(lambda x: x[0], drive))
    after = path(model, first, drive, h, How(iterations))

    def joined(a: Any, b: Any) -> Array:
        return jnp.stack([jnp.concatenate([x[None], y]) for x, y in zip(a, b, strict=True)], axis=1)

    bent, rate, bristle = joined(first.q, after.q), joined(first.v, after.v), joined(first.z, after.z)
    index, w = _between(at, edges, h)
    shape = hermite(bent, rate, index, w, h)
    state = shape, _linear(rate, index, w), _linear(bristle, index, w)
    late = [d for e in model.effects if (d := e.latency_s()) is not None]
    if first.sensed is None and not late:
        return Motion(*state, shape)
    index, w = _between(jnp.clip(at - sum(late), edges[0], edges[-1]), edges, h) if late else (index, w)
    seen = hermite(bent, rate, index, w, h)
    if first.sensed is not None:
        seen = seen + _linear(joined(first.sensed, after.sensed) - bent, index, w)
    return Motion(*state, seen)


def _between(at: Array, edges: Array, h: Array) -> tuple[Array, Array]:
    index = jnp.clip(jnp.floor((at - edges[0]) / h).astype(int), 0, edges.shape[0] - 2)
    return index, ((at - edges[index]) / h)[:, None]


def _linear(x: Array, index: Array, w: Array) -> Array:
    return x[index] + w * (x[index + 1] - x[index])


def hermite(q: Array, v: Array, index: Array, w: Array, h: Array) -> Array:
    """(T, n) cubic through q (N+1, n) with slopes v at the fraction w (T, 1) of the steps `index` (T,)."""
    q0, q1, v0, v1 = q[index], q[index + 1], v[index] * h, v[index + 1] * h
    return q0 + w * (v0 + w * (3 * (q1 - q0) - 2 * v0 - v1 + w * (2 * (q0 - q1) + v0 + v1)))


def halved(
    model: Model, inputs: Inputs, initial: State, at: Array, start: Array, h: Array, steps: int, iterations: int
) -> tuple[Motion, Array]:
    """`run` with steps of h/2, and the step-halving estimate of its error: max over stamps and joints of
    |q_h − q_{h/2}| [rad].

    The estimate is of the coarser run: at a scheme's second order the finer one is four times better. Where it is
    large and does not fall with h the motion itself is sensitive (stick-slip).
    """
    coarse = run(model, inputs, initial, at, start, h, steps, iterations)
    fine = run(model, inputs, initial, at, start, h / 2, 2 * steps, iterations)
    return fine, jnp.max(jnp.abs(fine.q - coarse.q))
