"""What a fit says of runs that are left out of it, to first order: no fit is made anew."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from scipy.optimize import lsq_linear

from ljjax.fit.dynamic import FAR
from ljjax.fit.problem import Estimate
from ljjax.fit.windows import Motion

ON_BOUND = 1e-6
"""How near its bound, in units of its reach, a parameter is on it."""
STEADY_KPA = 3.0
"""Runs whose vacuum moves by less are at one pressure, and at the same one where theirs are closer."""


def left_out(estimate: Estimate, fold: np.ndarray, held: Collection[int] = ()) -> np.ndarray:
    """(N, c) measured − predicted [rad] of each sample where its whole fold is left out of the fit: one Gauss–Newton
    step on the other folds, which makes up for a search that stopped short of its optimum too.

    Parameters move no further than first order reaches (`FAR`), however little the other folds say of them, nor beyond
    their bounds; those on a bound stay there, as first order asks of an optimum under constraints.

    Args:
        fold: (R,) which fold each run is in.
        held: coordinates that stay as they were fitted to all runs.
    """
    e, weight = estimate, estimate.weight / estimate.sigma**2
    reach = FAR * e.problem.coordinates.spread
    box = -np.ones(len(e.x)), np.ones(len(e.x))  # of what is taken back: the parameters move the other way
    for slope, *ends in e.problem.limits(e.x):
        if np.count_nonzero(slope) == 1:
            k = int(np.argmax(slope != 0))
            low, high = sorted(-end / (slope[k] * reach[k]) for end in ends)
            on = min(-low, high) < ON_BOUND
            box[0][k], box[1][k] = (-ON_BOUND, ON_BOUND) if on else (max(low, -1.0), min(high, 1.0))
    for k in held:
        box[0][k], box[1][k] = -ON_BOUND, ON_BOUND
    whole = np.linalg.pinv(e.white, rcond=1e-14, hermitian=True)
    out = np.empty_like(e.error)
    for k in np.unique(fold):
        mine = np.isin(e.windows.sample_run, np.flatnonzero(fold == k))
        j, error = e.jacobian[mine], e.error[mine]
        own = np.einsum("nck,nc,ncl->kl", j, weight[mine], j, optimize=True)
        back = np.einsum("nck,nc,nc->k", j, weight[mine], error, optimize=True) - e.pull
        rest = (whole - own) * np.outer(reach, reach)
        values, vectors = np.linalg.eigh(rest)
        root = np.sqrt(np.maximum(values, 0.0) + 1)
        moved = reach * lsq_linear(root[:, None] * vectors.T, vectors.T @ (reach * back) / root, box).x
        out[mine] = error + np.einsum("nck,k->nc", j, moved)
    return out


def conditions(motions: Sequence[Motion]) -> tuple[str, np.ndarray]:
    """What folds are made of, `pressure` or `run`, and (R,) the fold of each run: all runs at one vacuum where each
    keeps to one and there are three or more of them, else every run by itself."""
    level = np.array([np.median(m.vacuum) for m in motions])
    if all(np.ptp(m.vacuum) < STEADY_KPA for m in motions):
        order = np.argsort(level)
        fold = np.zeros(len(level), int)
        fold[order] = np.cumsum(np.diff(level[order], prepend=level[order[0]]) > STEADY_KPA)
        if fold.max() >= 2:
            return "pressure", fold
    return "run", np.arange(len(level))
