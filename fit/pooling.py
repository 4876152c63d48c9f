"""Partial pooling: robots of one make share what each alone shows poorly."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ljjax.fit.moving import DynamicResult


@dataclass(frozen=True, eq=False)
class Pooled:
    """Robots seen as a sample of a population, normal in the fits' coordinates.

    Attributes:
        names: (k,) parameters; mean, spread: (k,) of the population, as physical mean and relative spread over robots.
        value, sd: by robot, (k,) estimates drawn toward the population, and their standard deviations.
    """

    names: tuple[str, ...]
    mean: np.ndarray
    spread: np.ndarray
    value: Mapping[str, np.ndarray]
    sd: Mapping[str, np.ndarray]


def pool(results: Mapping[str, DynamicResult], rounds: int = 200) -> Pooled | None:
    """Empirical Bayes over robots fitted with the same free parameters; None for fewer than three of them.

    With estimates xᵢ ~ N(ξᵢ, Vᵢ) and ξᵢ ~ N(m, diag τ²), m and τ² are found by expectation–maximisation, and each
    robot's ξᵢ given its own data and the others': what a robot shows well stays, what it hardly shows goes to m.
    """
    names: Sequence[tuple[str, ...]] = [r.names for r in results.values()]
    if len(results) < 3 or len(set(names)) > 1:
        return None
    x = np.array([r.estimate.x for r in results.values()])
    v = np.array([r.estimate.covariance for r in results.values()])
    information = np.linalg.pinv(v, hermitian=True)
    mean, tau2 = np.median(x, axis=0), np.var(x, axis=0, ddof=1) + 1e-12
    covariance, drawn = v, x
    for _ in range(rounds):
        covariance = np.linalg.inv(information + np.diag(1 / tau2))
        drawn = np.einsum("rkl,rl->rk", covariance, np.einsum("rkl,rl->rk", information, x) + mean / tau2)
        mean = drawn.mean(axis=0)
        tau2 = np.mean((drawn - mean) ** 2 + np.diagonal(covariance, axis1=1, axis2=2), axis=0) + 1e-12
    value, sd = {}, {}
    for i, (robot, r) in enumerate(results.items()):
        c = r.estimate.problem.coordinates
        slope = c.jacobian(drawn[i])
        value[robot] = c.physical(drawn[i])
        sd[robot] = np.sqrt(np.diag(slope @ covariance[i] @ slope.T))
    like = next(iter(results.values())).estimate.problem.coordinates
    centre = like.physical(mean)
    slope = like.jacobian(mean)
    wide = np.sqrt(np.diag(slope @ np.diag(tau2) @ slope.T))
    return Pooled(like.names, centre, wide / np.abs(centre), value, sd)
