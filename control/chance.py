"""What samples say of probabilities, of what drives a result, and of what failures have in common."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from ljjax.control.robots import TRIES

Z95 = 1.959963984540054
"""Of a standard normal number, 95 % lie within ± this."""


def wilson(met: int, count: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a probability of which `count` independent trials met `met`."""
    if count == 0:
        return 0.0, 1.0
    p, z2 = met / count, Z95**2
    middle = (p + z2 / (2 * count)) / (1 + z2 / count)
    half = Z95 / (1 + z2 / count) * math.sqrt(p * (1 - p) / count + z2 / (4 * count**2))
    low, high = max(0.0, middle - half), min(1.0, middle + half)
    return (0.0 if met == 0 else low), (1.0 if met == count else high)


class Index(NamedTuple):
    """Sobol's indices of a group: the share of the variance that it explains alone (`first`) and with all others
    (`total`), each with a 95 % interval from the bootstrap."""

    first: float
    first_ci95: tuple[float, float]
    total: float
    total_ci95: tuple[float, float]


def design(
    rng: np.random.Generator,
    rows: int,
    groups: Mapping[str, tuple[int, ...]],
    d: int,
    possible: Callable[[np.ndarray], np.ndarray] | None = None,
) -> np.ndarray:
    """(G + 2, rows, d) ξ of Saltelli's design: two independent sets A and B, and for every group A with its
    coordinates out of B.

    `possible` tells of ξ (N, d) which can be (N,); rows of which one entry cannot are drawn anew, `TRIES` times.
    """
    a, b = rng.standard_normal((2, rows, d))
    bad = np.arange(rows)
    for _ in range(TRIES):
        if possible is None:
            break
        rowwise = _mixed(a[bad], b[bad], groups)
        bad = bad[~possible(rowwise.reshape(-1, d)).reshape(rowwise.shape[:2]).all(axis=0)]
        if not len(bad):
            break
        a[bad], b[bad] = rng.standard_normal((2, len(bad), d))
    return _mixed(a, b, groups)


def _mixed(a: np.ndarray, b: np.ndarray, groups: Mapping[str, tuple[int, ...]]) -> np.ndarray:
    mixed = [a, b]
    for members in groups.values():
        own = a.copy()
        own[:, list(members)] = b[:, list(members)]
        mixed.append(own)
    return np.stack(mixed)


def sobol(
    values: np.ndarray, names: tuple[str, ...], rng: np.random.Generator, resamples: int = 500
) -> dict[str, Index]:
    """Estimates from values (G + 2, rows) of a result on `design`: Saltelli's V(y)S_i = ⟨y_B(y_i − y_A)⟩, y from its
    mean, and Jansen's V(y)T_i = ⟨(y_A − y_i)²⟩/2. Empty where nothing varies or fewer than 8 rows are whole."""
    values = values[:, np.isfinite(values).all(axis=0)]
    rows = values.shape[1]
    if rows < 8 or not np.ptp(values) > 1e-12 * np.abs(values).max():
        return {}
    chosen = np.concatenate([np.arange(rows)[None], rng.integers(0, rows, (resamples, rows))])
    a, b = values[0][chosen], values[1][chosen]
    both = np.concatenate([a, b], axis=1)
    mean, variance = both.mean(axis=1, keepdims=True), both.var(axis=1)
    variance = np.where(variance > 0, variance, np.inf)
    out = {}
    for name, own in zip(names, values[2:], strict=True):
        y = own[chosen]
        first = np.mean((b - mean) * (y - a), axis=1) / variance
        total = np.mean((a - y) ** 2, axis=1) / (2 * variance)
        out[name] = Index(float(first[0]), _middle(first[1:]), float(total[0]), _middle(total[1:]))
    return out


def _middle(x: np.ndarray) -> tuple[float, float]:
    low, high = np.quantile(x, [0.025, 0.975])
    return float(low), float(high)


class Difference(NamedTuple):
    """How a quantity differs between failing and other samples.

    Attributes:
        name: the quantity.
        away: whether its distance from its mean is meant, not the quantity itself.
        size: difference of the means over the pooled standard deviation, + where failures have more.
        failing, passing: means, in the quantity's unit.
    """

    name: str
    away: bool
    size: float
    failing: float
    passing: float


def differences(columns: Mapping[str, np.ndarray], failing: np.ndarray) -> list[Difference]:
    """Those quantities (N,) that differ by more than three standard errors, the most telling first; none where fewer
    than 5 samples fail or pass."""
    bad, good = int(np.sum(failing)), int(np.sum(~failing))
    if min(bad, good) < 5:
        return []
    least, out = 3 * math.sqrt(1 / bad + 1 / good), []
    for name, x in columns.items():
        found = []
        for away in (False, True):
            y = np.abs(x - x.mean()) if away else x
            spread = math.sqrt((bad * np.var(y[failing]) + good * np.var(y[~failing])) / (bad + good))
            if spread > 0:
                means = float(y[failing].mean()), float(y[~failing].mean())
                found.append(Difference(name, away, (means[0] - means[1]) / spread, *means))
        best = max(found, key=lambda f: abs(f.size) * (1.0 if f.away else 1.5), default=None)  # plainer first
        if best is not None and abs(best.size) > least:
            out.append(best)
    return sorted(out, key=lambda f: -abs(f.size))
