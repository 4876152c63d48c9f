"""Candidates' cells solved as linear regressions, on all points and without each pressure level, and scored."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ljjax.gap.static_cells import Cells, Data
from ljjax.gap.statics import Laws


@dataclass(frozen=True, eq=False)
class Judged:
    """How one candidate in one variant does on B data sets.

    Attributes:
        possible: (B,) whether any cell lies within the bounds; `cell` (B,) the best one.
        fit, left_out: misfits of the blocks (B, blocks) and of the tested block's left-out levels (B, L; NaN where the
            other levels do not tell), in squares of the noise.
        delta, rest: the linear parameters' change (B, k), and what is left (B, N).
    """

    possible: np.ndarray
    cell: np.ndarray
    fit: np.ndarray
    left_out: np.ndarray
    delta: np.ndarray
    rest: np.ndarray


class Solver:
    """The regressions of one candidate in one variant, factored once."""

    def __init__(self, c: Cells, data: Data):
        self.cells, self.data = c, data
        self.folds = [np.ones(c.f.shape[1], bool), *data.folds()]
        rank = np.zeros(len(c.f), int)
        self.inverse, self.span, self.settled = [], [], []
        for keep in self.folds:
            size = np.maximum(np.linalg.norm(c.x, axis=1), 1e-300)
            u, s, vt = np.linalg.svd(c.x[:, keep] / size[:, None], full_matrices=False)
            good = s > 1e-6
            if not self.settled:
                rank = good.sum(axis=1)
            self.settled.append(good.sum(axis=1) == rank)  # else what is left out would have to be known
            self.span.append(np.swapaxes(u * good[:, None], 1, 2))
            scaled = np.where(good, 1 / np.where(good, s, 1.0), 0.0)
            self.inverse.append(np.swapaxes(vt, 1, 2) * scaled[:, None] @ self.span[-1] / size[:, :, None])

    def judge(self, y: np.ndarray) -> Judged:
        """On data sets y (B, N), in units of the noise."""
        c, data = self.cells, self.data
        away = y.T[None] - c.f[:, :, None]  # (C, N, B)
        sets = np.arange(y.shape[0])
        left = np.empty((len(sets), data.tested.count))
        levels, rows = data.tested.points.levels, data.rows[-1]
        first = None
        for fold, (keep, inverse, span) in enumerate(zip(self.folds, self.inverse, self.span, strict=True)):
            kept = away[:, keep]
            sse = np.sum(kept**2, axis=1) - np.sum((span @ kept) ** 2, axis=1)  # (C, B)
            own = inverse[:, c.sizes] @ kept
            outside = np.any((own < c.low[:, :, None]) | (own > c.high[:, :, None]), axis=1)
            sse = np.where(outside, np.inf, sse)
            best = np.argmin(sse, axis=0)
            possible = np.isfinite(sse[best, sets])
            delta = np.einsum("bkn,bn->bk", inverse[best], kept[best, :, sets])
            if fold == 0:
                rest = away[best, :, sets] - np.einsum("bnk,bk->bn", c.x[best], delta)
                first = best, possible, rest, delta
            else:
                out = c.x[best][:, rows][:, levels == fold - 1]
                error = away[best, rows, sets][:, levels == fold - 1] - np.einsum("bnk,bk->bn", out, delta)
                left[:, fold - 1] = np.where(possible & self.settled[fold][best], np.mean(error**2, axis=1), np.nan)
        assert first is not None
        best, possible, rest, delta = first
        fit = np.stack([np.mean(rest[:, r] ** 2, axis=1) for r in data.rows], axis=1)
        return Judged(possible, best, fit, left, delta, rest)

    def score(self, judged: Judged, others: np.ndarray | None) -> np.ndarray:
        """S (B,); a level of which the rest of the data does not tell counts as in the model without the effect, whose
        misfit of left-out levels `others` (B, L) is."""
        unknown = np.full_like(judged.left_out, 1e12) if others is None else others
        left = np.where(np.isfinite(judged.left_out), judged.left_out, unknown)
        return np.where(judged.possible, scores(self.data, judged.fit, left, self.cells.k), -np.inf)

    def start(self, judged: Judged, laws: Laws, b: int = 0) -> np.ndarray:
        """(P,) the parameters found on data set b, from which to refine."""
        x = self.cells.at[judged.cell[b]].copy()
        x[laws.index(self.cells.free)] += judged.delta[b]
        return np.clip(x, laws.low, laws.high)


def scores(data: Data, fit: np.ndarray, left: np.ndarray, k: int) -> np.ndarray:
    """S (B,) from the blocks' mean squared misfits (B, blocks) and those of left-out levels (B, L)."""
    n = np.array([b.independent for b in data.blocks])
    misfit = np.log(fit + 1)
    out = -0.5 * misfit[:, :-1] @ n[:-1]
    out = out - 0.25 * n[-1] * (misfit[:, -1] + np.mean(np.log(left + 1), axis=1))
    return out - 0.5 * k * np.log(n.sum())
