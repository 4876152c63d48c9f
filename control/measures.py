"""How good a simulated loop is: smooth measures for a loss, and plain ones to be told.

Both are in the order of `ljjax.control.spec.MEASURES`. The smooth ones have derivatives almost everywhere that point
the right way even where the plain measure does not move (a loop that never settles).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ljjax.control.loop import Loop
from ljjax.control.spec import MEASURES, Spec

FADE = 0.3
"""In how many e-folds of the error settling counts from all to nothing."""


class Asked(NamedTuple):
    """What one loop was asked for: the angle [rad], the stiffness [N/m], and K_T of its robot [N/m]."""

    theta: Array
    stiffness: Array
    felt: Array


def _last(loop: Loop, spec: Spec) -> int:
    """The tick at which the last part of the loop begins."""
    count = loop.t.shape[0]
    return min(count - 2, round(count * (1 - spec.rest_share)))


def smooth(loop: Loop, asked: Asked, spec: Spec, period: Array) -> Array:
    """(m,) the measures, differentiable; pure, for one loop.

    The settling time is ∫ s(log(E/b)/w) dt with E(t) the largest |e| from t on, s the logistic function, b the band and
    w = `FADE`: exact where E falls exponentially through the band. The largest values are means weighted by exp(x/τ).
    """
    e = (loop.theta - asked.theta) / asked.theta
    error = e * asked.theta
    envelope = jax.lax.cummax(e * e, reverse=True)
    outside = jax.nn.sigmoid(0.5 * jnp.log((envelope + 1e-16) / spec.band**2) / FADE)
    rest = error[_last(loop, spec) :]
    tensions = jnp.stack([loop.left, loop.right])
    rates = (tensions[:, 1:] - tensions[:, :-1]) / period
    off = (asked.felt - asked.stiffness) / asked.stiffness
    return jnp.stack(
        [
            period * jnp.sum(outside),
            _largest(jax.nn.softplus(e / 1e-3) * 1e-3, 1e-3),
            jnp.sqrt(jnp.mean(rest * rest) + 1e-12),
            jnp.sqrt(jnp.mean(tensions * tensions)),
            _largest(tensions.reshape(-1), 0.2),
            jnp.sqrt(jnp.mean(rates * rates) + 1e-6),
            jnp.sqrt(off * off + 1e-8),
        ]
    )


def _largest(x: Array, width: float) -> Array:
    return jnp.sum(jax.nn.softmax(x / width) * x)


def exact(xp: Any, loop: Loop, asked: Asked, spec: Spec, period: Any) -> Any:
    """(m,) the measures as defined, of one loop, in the arithmetic of `xp` (NumPy or jax.numpy); a loop that never
    settles has a settling time of infinity."""
    theta, wanted = loop.theta, asked.theta
    error = theta - wanted
    tick = xp.arange(1, theta.shape[0] + 1).astype(theta.dtype)
    settling = period * xp.max(xp.where(xp.abs(error) > spec.band * xp.abs(wanted), tick, 0.0 * tick))
    tensions = xp.stack([loop.left, loop.right])
    beyond = xp.max(error * xp.sign(wanted)) / xp.abs(wanted)
    return xp.stack(
        [
            xp.where(settling < theta.shape[0] * period - 1e-3 * period, settling, xp.inf),
            xp.where(beyond > 0, beyond, 0.0 * xp.abs(beyond)),
            xp.sqrt(xp.mean(error[_last(loop, spec) :] ** 2)),
            xp.sqrt(xp.mean(tensions**2)),
            xp.max(tensions),
            xp.sqrt(xp.mean(((tensions[:, 1:] - tensions[:, :-1]) / period) ** 2)),
            xp.abs(asked.felt / asked.stiffness - 1.0),
        ]
    )


def plain(loop: Loop, asked: Asked, spec: Spec, period: float) -> dict[str, float]:
    """`exact`, by name."""
    loop, asked = jax.tree.map(np.asarray, (loop, asked))
    return dict(zip(MEASURES, exact(np, loop, asked, spec, period).tolist(), strict=True))
