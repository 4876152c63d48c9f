"""What is known of a function between the points where it was computed: a Gaussian process through its values and
derivatives (gradient-enhanced kriging; Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006, §9.4).

The kernel is exp(−|u − u'|²/2ℓ²). Length ℓ and the roughness that values and derivatives have on top of what the
process can follow (a loop with stiction has corners in its gains) are those of the largest likelihood on a grid.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

LENGTHS = (0.1, 0.2, 0.4, 0.8, 1.6)
ROUGH_VALUES, ROUGH_SLOPES = (1e-4, 1e-2), (1e-2, 0.1, 1.0)
"""Variances, in those of the process: of values, and of derivatives."""
KEPT = 24
"""Points that a surrogate rests on."""
FAR = 1e3
"""Where points stand that are not there, so that shapes do not change."""


class Surrogate(NamedTuple):
    """p functions of k coordinates: `points` (KEPT, k), `weights` (KEPT (1 + k), p), `mean` (p,) and the length ℓ."""

    points: np.ndarray
    weights: np.ndarray
    mean: np.ndarray
    length: float

    def at(self, u: Array) -> Array:
        """(p,) the functions at u (k,); differentiable."""
        apart = u[None] - jnp.asarray(self.points)
        value = jnp.exp(-0.5 * jnp.sum(apart * apart, axis=1) / self.length**2)[:, None]
        row = jnp.concatenate([value, value * apart / self.length**2], axis=1)
        return jnp.asarray(self.mean) + row.reshape(-1) @ jnp.asarray(self.weights)


def fit(points: np.ndarray, values: np.ndarray, slopes: np.ndarray) -> Surrogate:
    """A surrogate from n ≤ KEPT points (n, k), values (n, p) and derivatives (n, p, k)."""
    n, k = points.shape
    mean = np.median(values, axis=0)
    known = np.concatenate([(values - mean)[:, None], slopes.transpose(0, 2, 1)], axis=1).reshape(n * (1 + k), -1)
    best, chosen = np.inf, (known, 1.0)
    for length in LENGTHS:
        kernel = _gram(points, length)
        for value, slope in itertools.product(ROUGH_VALUES, ROUGH_SLOPES):
            rough = np.tile(np.r_[value, np.full(k, slope / length**2)], n)
            lower = np.linalg.cholesky(kernel + np.diag(rough))
            weights = np.linalg.solve(lower.T, np.linalg.solve(lower, known))
            variance = np.maximum(np.sum(known * weights, axis=0) / len(known), 1e-12)
            surprise = 0.5 * np.mean(np.log(variance)) + np.mean(np.log(np.diag(lower)))  # −log likelihood a number
            if surprise < best:
                best, chosen = surprise, (weights, length)
    weights, length = chosen
    absent = KEPT - n
    return Surrogate(
        np.concatenate([points, np.full((absent, k), FAR)]),
        np.concatenate([weights, np.zeros((absent * (1 + k), weights.shape[1]))]),
        mean,
        length,
    )


def _gram(points: np.ndarray, length: float) -> np.ndarray:
    """Covariances (n (1 + k), n (1 + k)) of a value and k derivatives at each point."""
    n, k = points.shape
    apart = (points[:, None] - points[None]) / length
    value = np.exp(-0.5 * np.sum(apart * apart, axis=-1))
    out = np.empty((n, 1 + k, n, 1 + k))
    out[:, 0, :, 0] = value
    out[:, 0, :, 1:] = value[:, :, None] * apart / length
    out[:, 1:, :, 0] = -(value[:, :, None] * apart / length).transpose(0, 2, 1)
    turned = np.eye(k) - apart[..., :, None] * apart[..., None, :]
    out[:, 1:, :, 1:] = (value[:, :, None, None] * turned / length**2).transpose(0, 2, 1, 3)
    return out.reshape(n * (1 + k), n * (1 + k))
