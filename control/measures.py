"""How good a simulated loop is: smooth measures for a loss, and plain ones to be told.

Both are in the order of `ljjax.control.spec.MEASURES`. The smooth ones have derivatives almost everywhere that point
the right way even where the plain measure does not move (a loop that never settles).
"""

from __future__ import annotations

from typing import NamedTuple

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


def plain(loop: Loop, asked: Asked, spec: Spec, period: float) -> dict[str, float]:
    """The measures of one loop as defined, by name; a loop that never settles has a settling time of infinity."""
    theta = np.asarray(loop.theta)
    wanted = float(asked.theta)
    error = theta - wanted
    outside = np.flatnonzero(np.abs(error) > spec.band * abs(wanted))
    settling = 0.0 if not len(outside) else (outside[-1] + 1) * period
    tensions = np.stack([np.asarray(loop.left), np.asarray(loop.right)])
    values = (
        settling if settling < len(theta) * period - 1e-12 else np.inf,
        max(0.0, float(np.max(error * np.sign(wanted))) / abs(wanted)),
        float(np.sqrt(np.mean(error[_last(loop, spec) :] ** 2))),
        float(np.sqrt(np.mean(tensions**2))),
        float(np.max(tensions)),
        float(np.sqrt(np.mean((np.diff(tensions, axis=1) / period) ** 2))),
        abs(float(asked.felt) / float(asked.stiffness) - 1),
    )
    return dict(zip(MEASURES, map(float, values), strict=True))
