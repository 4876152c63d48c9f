"""CMA-ES in the unit box: weighted recombination, cumulative step-size adaptation, rank-one and rank-μ updates.

Hansen's (μ/μ_w, λ)-CMA-ES with his default constants. A point outside the box is moved to the box's nearest one, which
is what is evaluated and learnt from. A generator: points out, their values in.
"""

from __future__ import annotations

import math
from collections.abc import Generator

import numpy as np


def cmaes(start: np.ndarray, spread: float, seed: int) -> Generator[np.ndarray, np.ndarray, None]:
    """Generations (λ, k) of points in [0, 1]^k, λ = 4 + 3 log k; their losses (λ,) are sent back.

    Args:
        start: (k,) the first mean; `spread` the first standard deviation.
    """
    rng, k = np.random.default_rng(seed), len(start)
    count = 4 + int(3 * math.log(k))
    half = count // 2
    weights = math.log((count + 1) / 2) - np.log(np.arange(1, half + 1))
    weights /= weights.sum()
    effective = 1 / float(weights @ weights)
    c_sigma = (effective + 2) / (k + effective + 5)
    damping = 1 + 2 * max(0.0, math.sqrt((effective - 1) / (k + 1)) - 1) + c_sigma
    c_path = (4 + effective / k) / (k + 4 + 2 * effective / k)
    c_one = 2 / ((k + 1.3) ** 2 + effective)
    c_mu = min(1 - c_one, 2 * (effective - 2 + 1 / effective) / ((k + 2) ** 2 + effective))
    usual = math.sqrt(k) * (1 - 1 / (4 * k) + 1 / (21 * k * k))  # the length of a standard normal vector

    mean, sigma, cov = np.array(start, float), spread, np.eye(k)
    path, step_path, generation = np.zeros(k), np.zeros(k), 0
    while True:
        generation += 1
        square, axes = np.linalg.eigh(0.5 * (cov + cov.T))
        width = np.sqrt(np.maximum(square, 1e-20))
        points = np.clip(mean + sigma * (rng.standard_normal((count, k)) * width) @ axes.T, 0.0, 1.0)
        losses = yield points
        moves = (points[np.argsort(losses, kind="stable")[:half]] - mean) / sigma
        move = weights @ moves
        mean = mean + sigma * move
        step_path = (1 - c_sigma) * step_path + math.sqrt(c_sigma * (2 - c_sigma) * effective) * (
            axes @ ((axes.T @ move) / width)
        )
        length = float(np.linalg.norm(step_path))
        short = length / math.sqrt(1 - (1 - c_sigma) ** (2 * generation)) < (1.4 + 2 / (k + 1)) * usual
        path = (1 - c_path) * path + short * math.sqrt(c_path * (2 - c_path) * effective) * move
        left = 1 - c_one - c_mu + (0.0 if short else c_one * c_path * (2 - c_path))
        cov = left * cov + c_one * np.outer(path, path) + c_mu * (moves.T * weights) @ moves
        sigma *= math.exp(min(1.0, c_sigma / damping * (length / usual - 1)))
