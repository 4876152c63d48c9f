"""Candidates over steady data as many small linear regressions, quick enough to repeat on simulated data.

At given values of what enters nonlinearly (a knee, an offset of the pressure), tension and stiffness are linear in the
rest to first order; so a candidate is a set of cells, one a value on a grid: y ≈ f + X δ. Folds are whole pressure
levels. A model's score is in units of log likelihood,

    S = −½ Σ_b n_b log(misfit_b) − ½ k log n,

where the tested block's misfit is the geometric mean of that of the fit and of that at left-out pressures (the mean
over levels of its logarithm), each with the measurements' variance added so that nothing is gained below the noise; k
counts parameters, those on grids included; n_b counts independent points, fewer than there are where neighbours err
alike.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ljjax.fit.points import Points
from ljjax.gap.statics import Laws

GRID = 14
"""Values on a grid."""
NONLINEAR = 0.02
"""A candidate counts as linear in its size where two sizes' traces differ from proportional by less than this share."""
MULTIPLES, FEWER = np.array([0.3, 1.0, 2.0, 3.5, 6.0, 10.0, 18.0]), np.array([0.3, 1.0, 1.7])
"""Sizes on the grid of one that is not linear, in its typical size, both ways; of one that has forms besides."""
DROPPABLE = {"steady": ("elastic.c1", "elastic.c2", "gravity.alpha1"), "probe": ("jamming.c5",)}
"""Terms that a model may go without where the data do not ask for them."""


@dataclass(frozen=True, eq=False)
class Block:
    """Points of one kind: `noise` their standard deviation, `independent` how many independent ones they are worth."""

    points: Points
    noise: float
    independent: float
    stated: bool = True

    @property
    def count(self) -> int:
        return int(self.points.levels.max()) + 1


@dataclass(frozen=True, eq=False)
class Data:
    """What one stage looks at: its blocks; the last is the one that is tested, the levels of which are left out."""

    blocks: tuple[Block, ...]

    @property
    def tested(self) -> Block:
        return self.blocks[-1]

    @property
    def y(self) -> np.ndarray:
        """(N,) measured values in units of their noise."""
        return np.concatenate([b.points.value / b.noise for b in self.blocks])

    @property
    def rows(self) -> list[slice]:
        """Where each block's values stand."""
        ends = np.cumsum([0, *(len(b.points) for b in self.blocks)])
        return [slice(a, b) for a, b in itertools.pairwise(ends)]

    @property
    def extent(self) -> dict[str, float]:
        """The largest tension [N] and joint angle [rad] there are, for forms that are shares of them."""
        steady = [b.points for b in self.blocks if b.points.kind == "steady"]
        if not steady:
            return {}
        return {k: float(np.abs(v).max()) for k, v in (("tension", steady[0].value), ("angle", steady[0].theta))}

    def values(self, laws: Laws, x: np.ndarray) -> np.ndarray:
        """(…, N) what robots with parameters x (…, P) do, in units of the noise."""
        return np.concatenate([laws.values(x, b.points) / b.noise for b in self.blocks], axis=-1)

    def slopes(self, laws: Laws, x: np.ndarray, active: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(…, N) and (…, N, k) values and derivatives by the active parameters."""
        parts = [laws.slopes(x, b.points, active) for b in self.blocks]
        return (
            np.concatenate([v / b.noise for (v, _), b in zip(parts, self.blocks, strict=True)], axis=-1),
            np.concatenate([j / b.noise for (_, j), b in zip(parts, self.blocks, strict=True)], axis=-2),
        )

    def folds(self) -> list[np.ndarray]:
        """(N,) masks of what is kept when each level of the tested block is left out."""
        levels = self.tested.points.levels
        out = []
        for k in range(self.tested.count):
            keep = np.ones(len(self.y), bool)
            keep[self.rows[-1]] = levels != k
            out.append(keep)
        return out


@dataclass(frozen=True, eq=False)
class Cells:
    """One candidate in one variant.

    Attributes:
        effect: its id, or "" for the model without one more effect; `dropped`, base terms set to 0.
        free: names of the linear parameters, `sizes` places among them of the candidate's own.
        at: (C, P) parameters at which the cells stand; `f` (C, N) their values, `x` (C, N, k) slopes by `free`.
        low, high: (C, s) bounds of the sizes' change.
        k: parameters counted; `own` those of the candidate.
    """

    effect: str
    dropped: tuple[str, ...]
    free: tuple[str, ...]
    sizes: np.ndarray
    at: np.ndarray
    f: np.ndarray
    x: np.ndarray
    low: np.ndarray
    high: np.ndarray
    k: int
    own: tuple[str, ...] = ()


def pilots(about: Mapping[str, Any], extent: Mapping[str, float]) -> np.ndarray:
    """Values of a form's parameter from which searches begin."""
    values = np.array(about["pilots"]) * extent.get(about["of"], 1.0)
    return np.clip(values, about["low"], about["high"])


def grid(about: Mapping[str, Any], extent: Mapping[str, float]) -> np.ndarray:
    """Values at which a form's parameter is tried, around those from which searches begin."""
    values = pilots(about, extent)
    size = np.abs(values)
    if not size.all():  # a share
        return np.linspace(about["low"], about["high"], GRID)
    spread = np.geomspace(size.min() / 2.5, size.max() * 1.6, GRID if len(size) < GRID else 2 * len(size))
    signs = np.unique(np.sign(values))
    return np.clip(np.concatenate([s * spread for s in signs]), about["low"], about["high"])


def cells(
    laws: Laws, data: Data, x: np.ndarray, active: Sequence[str], candidates: Sequence[str]
) -> dict[str, list[Cells]]:
    """Around x in every variant, the cells of the model without more (""), and of each candidate of which the data show
    something."""
    active = list(active)
    f, j = data.slopes(laws, x, laws.index(active))
    kinds = [b.points.kind for b in data.blocks]
    droppable = [n for kind in kinds for n in DROPPABLE[kind] if n in active]
    none, empty = np.empty(0, int), np.empty((1, 0))
    made = {"": [Cells("", (), tuple(active), none, x[None], f[None], j[None], empty, empty, len(active))]}
    for effect in candidates:
        if found := _extended(laws, data, x, active, effect, f, j):
            made[effect] = found
    return {
        e: [_without(c, dropped, laws) for c in found for dropped in _subsets(droppable)] for e, found in made.items()
    }


def _subsets(names: Sequence[str]) -> list[tuple[str, ...]]:
    """Of terms in rising order of need; c₂ stays where c₁ does, or the law over pressure is none to speak of."""
    found = [s for r in range(len(names) + 1) for s in itertools.combinations(names, r)]
    return [s for s in found if "elastic.c2" not in s or "elastic.c1" in s or "elastic.c1" not in names]


def _without(c: Cells, dropped: tuple[str, ...], laws: Laws) -> Cells:
    """The same with some terms at 0."""
    if not dropped:
        return c
    places = [c.free.index(n) for n in dropped]
    index = laws.index(dropped)
    f = c.f - np.einsum("cnk,ck->cn", c.x[:, :, places], c.at[:, index])
    at = c.at.copy()
    at[:, index] = 0.0
    keep = [i for i in range(len(c.free)) if i not in places]
    sizes = np.array([keep.index(i) for i in c.sizes], int)
    free = tuple(c.free[i] for i in keep)
    return Cells(c.effect, dropped, free, sizes, at, f, c.x[:, :, keep], c.low, c.high, c.k - len(dropped), c.own)


def _extended(laws, data, x, active, effect, f, j) -> list[Cells]:
    sizes, forms = laws.of(effect, "size"), laws.of(effect, "form")
    if any(laws.about[n]["of"] == "waves" for n in forms):
        return []  # a few points over the bend show none
    at = np.array([x])
    if forms:
        grids = np.meshgrid(*(grid(laws.about[n], data.extent) for n in forms), indexing="ij")
        at = np.tile(x, (grids[0].size, 1))
        for name, values in zip(forms, grids, strict=True):
            at[:, laws.index([name])[0]] = values.ravel()
    index = laws.index(sizes)
    step = np.where(laws.x0[index] + laws.scale[index] <= laws.high[index], 1.0, -1.0) * laws.scale[index]
    moved = np.repeat(at[:, None], 3 * len(sizes), axis=1)
    ways = np.ones((3, len(sizes)))
    for i, place in enumerate(index):
        for k, way in enumerate((1.0, 3.0, -3.0)):
            inside = laws.low[place] <= x[place] + way * step[i] <= laws.high[place]
            ways[k, i] = way if inside else 0.5
            moved[:, k * len(sizes) + i, place] += ways[k, i] * step[i]
    change = (data.values(laws, moved) - f).reshape(len(at), 3, len(sizes), -1)
    whole = change[:, 0] / ways[0][:, None]
    size = np.linalg.norm(whole, axis=2)
    seen = np.any(np.linalg.norm(change, axis=3) > 1e-6 * len(f), axis=(0, 1))
    if not np.any(seen):
        return []
    bend = np.linalg.norm(change / ways[:, :, None] - whole[:, None], axis=3)
    bent = bend > NONLINEAR * size[:, None] + 1e-9
    shown = _independent(whole[len(at) // 2], [i for i in range(len(sizes)) if seen[i]])
    if not np.any(bent):
        slopes = np.swapaxes(whole[:, shown] / step[shown, None], 1, 2)
        wide = np.concatenate([np.repeat(j[None], len(at), 0), slopes], axis=2)
        low, high = (np.repeat((b[index] - x[index])[None, shown], len(at), 0) for b in (laws.low, laws.high))
        own = np.arange(len(shown)) + len(active)
        names = (*active, *(sizes[i] for i in shown))
        mine = (*(sizes[i] for i in shown), *forms)
        count = len(active) + len(mine)
        return [Cells(effect, (), names, own, at, np.repeat(f[None], len(at), 0), wide, low, high, count, mine)]
    return [_nodes(laws, data, active, effect, at, [index[i] for i in shown], [sizes[i] for i in shown], forms)]


def _nodes(laws, data, active, effect, at, places, shown, forms) -> Cells:
    """Cells of a candidate that is not linear in its size: at sizes of its own first parameters, one at a time, with
    what is its own linear about each."""
    tried, reach = [], []
    multiples = FEWER if forms else MULTIPLES
    for place in places:
        around = np.r_[-multiples[::-1], multiples]
        values = laws.x0[place] + laws.scale[place] * around
        widths = 0.7 * laws.scale[place] * np.maximum(np.abs(np.gradient(around)), 0.5 * np.abs(around))
        inside = (values > laws.low[place]) & (values < laws.high[place])
        for value, width in zip(values[inside], widths[inside], strict=True):
            for one in at:
                other = one.copy()
                other[place] = value
                tried.append(other)
                reach.append((place, width))
    stood = np.array(tried)
    own = [*shown, *forms]
    index = laws.index(own)
    fs, xs = data.slopes(laws, stood, laws.index([*active, *own]))
    wide = np.zeros((len(stood), len(own)))  # others than the one on the grid stand still
    for row, (place, width) in enumerate(reach):
        wide[row, index == place] = width
    for i, name in enumerate(own):
        if name in forms:
            wide[:, i] = 0.25 * np.abs(stood[:, index[i]])
    low = np.maximum(laws.low[index] - stood[:, index], -wide)
    high = np.minimum(laws.high[index] - stood[:, index], wide)
    xs[:, :, len(active) :] *= np.any(wide > 0, axis=1)[:, None, None] * (wide > 0)[:, None, :]
    ok = np.all(np.isfinite(fs), axis=1) & np.all(np.isfinite(xs), axis=(1, 2))
    places_of = np.arange(len(own)) + len(active)
    count = len(active) + len(own)
    free = (*active, *own)
    return Cells(effect, (), free, places_of, stood[ok], fs[ok], xs[ok], low[ok], high[ok], count, tuple(own))


def _independent(traces: np.ndarray, among: list[int]) -> list[int]:
    """Of sizes with traces (s, N) those that show something the earlier ones do not."""
    kept: list[int] = []
    for i in among:
        rest = traces[i]
        if kept:
            basis = np.linalg.qr(traces[kept].T)[0]
            rest = rest - basis @ (basis.T @ rest)
        if np.linalg.norm(rest) > 1e-2 * np.linalg.norm(traces[i]) and np.linalg.norm(traces[i]) > 0:
            kept.append(i)
    return kept or among[:1]
