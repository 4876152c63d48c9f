"""How far the residuals' colour widens what is known of the parameters."""

from __future__ import annotations

import numpy as np

LAGS = 30
"""Lags that are summed one by one; where residuals hang together over many more, samples are added up first."""


def score_variance(score: np.ndarray, error: np.ndarray, run: np.ndarray) -> np.ndarray:
    """(k, k) variance of the sum of scores (N, k): Newey and West's sum over lags within each run (N,), the lags by
    Andrews' rule for the errors (N,)."""
    out = np.zeros((score.shape[1],) * 2)
    for r in np.unique(run):
        s, e = score[run == r], error[run == r]
        lags = bandwidth(e)
        block = max(1, lags // LAGS)  # sums of so many samples hang together over so many fewer lags
        s = np.add.reduceat(s, np.arange(0, len(s), block), axis=0)
        lags = -(-lags // block)
        own = s.T @ s
        for lag in range(1, min(lags, len(s) - 1) + 1):
            c = s[lag:].T @ s[:-lag]
            own += (1 - lag / (lags + 1)) * (c + c.T)
        out += own
    values, vectors = np.linalg.eigh(out)
    return (vectors * np.maximum(values, 0.0)) @ vectors.T


def bandwidth(e: np.ndarray) -> int:
    """Lags over which residuals hang together: Andrews' (1991) rule for Bartlett's kernel and an AR(1)."""
    e = e - e.mean()
    power = float(e @ e)
    rho = float(np.clip(e[1:] @ e[:-1] / power, -0.97, 0.999)) if power > 0 else 0.0
    alpha = 4 * rho**2 / ((1 - rho) ** 2 * (1 + rho) ** 2)
    return int(np.ceil(1.1447 * (alpha * len(e)) ** (1 / 3)))
