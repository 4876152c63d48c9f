"""All candidates at once by one Jacobian: how much each would gain, which look alike, how small one could be seen.

The residuals' derivatives by every effect's parameters at their nulls, with the base's own and the starting angles
projected off, are a score test: to first order they give each candidate's gain with the base refitted, the angle
between two candidates' traces, and the distribution of the largest gain where there is no effect at all.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from ljjax.effect import Effect
from ljjax.fit.coordinates import Coordinates
from ljjax.fit.covariance import bandwidth
from ljjax.fit.dynamic import Search
from ljjax.fit.problem import Estimate, Problem, Round
from ljjax.fit.shooting import Asking
from ljjax.fit.windows import Motion, cut
from ljjax.gap.candidates import path, sizes
from ljjax.model import Model, limits, replace

ROOM = 24
"""Columns that fit in one program."""
DRAWS = 2000
USUAL = 3.0
"""Parameters that the runs leave open start within so many of their typical sizes."""


@dataclass(frozen=True)
class Column:
    """One derivative: effect, which of its forms, parameter, unit, the null's distance to its bounds, typical size."""

    id: str
    form: int
    name: str
    low: float
    high: float
    scale: float


@dataclass(frozen=True, eq=False)
class Screen:
    """What the Jacobian says.

    Attributes:
        columns: (m) what each column is; `forms` values of the forms by (effect, form).
        gram: (m, m) and `score` (m,): JᵀJ and Jᵀr of the projected columns, residuals in units of their own RMS.
        gains: by (effect, form), the drop of χ² to first order; `firm` the same in each run by the others' parameters,
            which traces that only fit what cannot be foretold do not have.
        steps: by (effect, form), parameter → value at that gain.
        base_step: by (effect, form), (k,) how far the base's coordinates move along.
        base_jacobian: (N, c, k + 1) derivatives of the predictions by the base's coordinates and the starting angles.
    """

    columns: Sequence[Column]
    forms: Mapping[tuple[str, int], Mapping[str, float]]
    gram: np.ndarray
    score: np.ndarray
    sigma: np.ndarray
    gains: Mapping[tuple[str, int], float]
    firm: Mapping[tuple[str, int], float]
    steps: Mapping[tuple[str, int], Mapping[str, float]]
    base_step: Mapping[tuple[str, int], np.ndarray]
    base_jacobian: np.ndarray

    def of(self, key: tuple[str, int]) -> list[int]:
        """The columns of an effect's form."""
        return [i for i, c in enumerate(self.columns) if (c.id, c.form) == key]

    def best(self, effect: str) -> tuple[str, int]:
        """The form of an effect that gains most."""
        return max((k for k in self.gains if k[0] == effect), key=lambda k: self.gains[k])

    @property
    def ids(self) -> list[str]:
        return list(dict.fromkeys(c.id for c in self.columns))

    def alike(self, a: tuple[str, int], b: tuple[str, int]) -> float:
        """Cosine of the least angle between the traces of two candidates, 1 for traces that cannot be told apart."""
        i, j = self.of(a), self.of(b)
        ra, rb = _root(self.gram[np.ix_(i, i)]), _root(self.gram[np.ix_(j, j)])
        if ra is None or rb is None:
            return 0.0
        cosines = np.linalg.svd(ra @ self.gram[np.ix_(i, j)] @ rb.T, compute_uv=False)
        return float(min(cosines.max(), 1.0))

    def null(self, rng: np.random.Generator) -> np.ndarray:
        """(DRAWS,) the largest gain of any candidate in data without an effect, for white noise of variance 1."""
        values, vectors = np.linalg.eigh(self.gram)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        draws = root @ rng.standard_normal((len(self.columns), DRAWS))
        return np.max([self._gain(k, draws) for k in self.gains], axis=0)

    def promised(self, count: int) -> list[tuple[tuple[str, str], dict[str, dict[str, float]]]]:
        """The pairs of effects, each in its best form, that gain most together to first order, and by effect the
        values at that gain: what two share alone can hide each of them among the singles."""
        found: list[tuple[float, tuple[str, str], dict[str, dict[str, float]]]] = []
        for keys in itertools.combinations([self.best(i) for i in self.ids], 2):
            i = [j for key in keys for j in self.of(key)]
            mine, own = [self.columns[j] for j in i], np.ix_(i, i)
            x = _least(self.gram[own], self.score[i], mine)
            values: dict[str, dict[str, float]] = {key[0]: dict(self.forms[key]) for key in keys}
            for c, v in zip(mine, x, strict=True):
                values[c.id][c.name] = float(v)
            found.append((_gained(self.gram[own], self.score[i], x), (keys[0][0], keys[1][0]), values))
        return [(ids, values) for _, ids, values in sorted(found, key=lambda f: -f[0])[:count]]

    def _gain(self, key: tuple[str, int], score: np.ndarray) -> np.ndarray:
        """(D,) the drop of χ² that scores (m, D) promise a candidate."""
        i = self.of(key)
        root = _root(self.gram[np.ix_(i, i)])
        if root is None:
            return np.zeros(score.shape[1])
        own = score[i].copy()
        if len(i) == 1:  # on the wrong side of a bound nothing is gained
            c = self.columns[i[0]]
            own = np.where((own > 0) & (c.high <= 0) | (own < 0) & (c.low >= 0), 0.0, own)
        return np.sum((root @ own) ** 2, axis=0)

    def detectable(self, key: tuple[str, int], noise: float, sigmas: float = 3.5) -> tuple[str, float]:
        """The first parameter of a candidate and the size that stands out by so many standard deviations, for noise of
        so large a standard deviation in units of the residuals' RMS."""
        i = self.of(key)[0]
        information = self.gram[i, i]
        return self.columns[i].name, float(sigmas * noise / np.sqrt(information)) if information > 1e-9 else np.inf


def _root(gram: np.ndarray) -> np.ndarray | None:
    """R with RᵀR = gram⁻¹ over the directions that gram holds; None for none."""
    values, vectors = np.linalg.eigh(gram)
    keep = values > 1e-8 * max(values.max(initial=0.0), 1e-300)
    if not keep.any() or values.max() < 1e-10:
        return None
    return (vectors[:, keep] / np.sqrt(values[keep])).T


def screen(
    model: Model,
    names: Sequence[str],
    kinds: Sequence[type[Effect]],
    motions: Sequence[Motion],
    pressure: float,
    how: Round,
    forms_of: Callable[[type[Effect]], list[dict[str, float]]],
) -> tuple[list[Asking[Search]], list[list[Column]], dict[tuple[str, int], dict[str, float]]]:
    """The searches to run side by side, and what each one's last columns are: `gather` makes a Screen of them."""
    free = {n.split(".")[1] for n in names if n.startswith("effects.")}
    logged = motions[0].y.shape[1]
    forms: dict[tuple[str, int], dict[str, float]] = {}
    bins: list[dict[str, tuple[int, list[Column]]]] = []
    within = limits(model)
    for kind in kinds:
        if kind.id in free:
            continue
        about = kind.fields()
        for form, values in enumerate(forms_of(kind)):
            forms[kind.id, form] = values
            columns = []
            for name in sizes(kind, model.n, logged):
                low, high = within[path(kind, name)]
                null = about[name]["null"]
                columns.append(Column(kind.id, form, name, low - null, high - null, about[name]["scale"]))
            for b in bins:
                if kind.id not in b and sum(len(c) for _, c in b.values()) + len(columns) <= ROOM:
                    b[kind.id] = form, columns
                    break
            else:
                bins.append({kind.id: (form, columns)})
    windows = cut(motions, how.step_s)
    like = Coordinates(model, names, pressure)
    asked, said = [_look(Search(Problem(like, motions), windows, how))], [[]]
    for b in bins:
        values = {f"effects.{i}.{n}": x for i, (form, _) in b.items() for n, x in forms[i, form].items()}
        columns = [c for _, own in b.values() for c in own]
        like = replace(model, values)
        coordinates = Coordinates(like, [f"effects.{c.id}.{c.name}" for c in columns], pressure)
        asked.append(_look(Search(Problem(coordinates, motions), windows, how)))
        said.append(columns)
    return asked, said, forms


WAVES = np.arange(4.0, 120.0, 0.4)
"""Waves over the body's whole bend that are looked for [1/rad]."""


def waves(found: Estimate) -> list[float]:
    """Waves over the body's whole bend [1/rad] from which a search may come to any: the `ladder` of this bend and,
    above it, those of which the residuals have most, at three pressures each."""
    windows, error = found.windows, found.shape_error.mean(axis=1)
    bend = windows.shape(windows.y).mean(axis=1) * len(found.problem.motions[0].q0)
    pieces = []
    for i, m in enumerate(found.problem.motions):
        mine = np.flatnonzero(windows.sample_run == i)
        vacuum = np.interp(windows.sample_t[mine], m.input_t, m.vacuum)
        group = np.digitize(vacuum, np.quantile(vacuum, [1 / 3, 2 / 3]))
        pieces += [(bend[mine[group == g]], error[mine[group == g]]) for g in np.unique(group)]
    rungs = ladder(max(float(np.ptp(bend[windows.sample_run == i])) for i in np.unique(windows.sample_run)))
    return [*rungs, *(w for w in waves_in(pieces) if w > rungs[-1])]


def ahead(screen: Screen, count: int) -> list[tuple[str, int]]:
    """Of each effect its best form: those that promise most, and those that promise most firmly, in turns."""
    best = [screen.best(i) for i in screen.ids]
    most, firm = (sorted(best, key=lambda k: -by[k]) for by in (screen.gains, screen.firm))
    return list(dict.fromkeys(k for pair in zip(most, firm, strict=True) for k in pair))[:count]


def ladder(wide: float) -> list[float]:
    """Low waves [1/rad], so close that over a bend of this width [rad] a search comes from one to the next. Residuals
    alone do not tell them: what stretches goes with the load, and what a wave leaves of the base with its length."""
    low, high, most = 4.0, 30.0, 30
    return list(np.arange(low, high, max(3.0 / max(wide, 1e-3), (high - low) / most)))


def waves_in(pieces: Sequence[tuple[np.ndarray, np.ndarray]], count: int = 4) -> list[float]:
    """The waves [1/rad] of which errors over bends have most, pieces (N,), (N,) at a time: a periodogram of what a
    curve of third order leaves of each."""
    power, widest = np.zeros(len(WAVES)), 0.2
    for x, e in pieces:
        wide = float(np.ptp(x)) if len(x) > 4 else 0.0
        if wide < 0.2:
            continue
        curve = np.vander(x, 4)
        e = e - curve @ np.linalg.lstsq(curve, e, rcond=None)[0]
        phase = np.exp(1j * np.outer(WAVES, x))
        power += np.where(WAVES * wide > 2 * np.pi, np.abs(phase @ e) ** 2 / len(x), 0.0)
        widest = max(widest, wide)
    out: list[float] = []
    for k in np.argsort(-power):
        if power[k] > 0 and all(abs(WAVES[k] - w) > 2 * np.pi / widest for w in out):
            out.append(float(WAVES[k]))
        if len(out) == count:
            break
    return sorted(out)


BEAT_HZ, AROUND = 1 / 60, 30
"""By how much the beats at which a clock may be set differ, as they are looked for, and how many on either side of one
say what there is beside it."""
BEATS_HZ = np.arange(2, 1200) * BEAT_HZ
SLOW_HZ, STANDS_OUT = 1.0, 25.0
"""Beats up to which errors have more the slower they are, whatever the clock; and how many times as much as beside it
they have at a faster one that is heard, as chance does not make."""


GROSS, RARE, STEPS, OWN, FASTEST, FASTEST_HZ = 30.0, 0.01, 60.0, 0.3, 0.45, 50.0
"""Squares of jumps beyond so many times their median, or a hundredth of their mean, count as that; how much louder than
beside it a beat of them is that is heard, and how much of that commands may have themselves; and the fastest one, as a
share of the samples' rate and in all."""
OVERTONES = (1, 2, 3, 4, 5)
"""Of a beat, itself the first, by which it is told from others."""


def clock_of(found: Estimate) -> dict[str, float]:
    """`clock`, of the shape's errors and its predicted rate."""
    w, predicted = found.windows, found.windows.shape(found.predicted)
    return clock(w.sample_t, found.shape_error, rates(w.sample_t, predicted, w.sample_run))


def rates(t: np.ndarray, x: np.ndarray, run: np.ndarray) -> np.ndarray:
    """The rates (N, c) of x (N, c), run by run; 0 in runs too short for one."""
    out = np.zeros_like(x)
    for i in np.unique(run):
        mine = np.flatnonzero(run == i)
        if len(mine) > 2:
            out[mine] = np.gradient(x[mine], t[mine], axis=0)
    return out


def beat(t: np.ndarray, x: np.ndarray, commanded: np.ndarray, run: np.ndarray) -> tuple[float, float] | None:
    """The beat [Hz] at which x (N, c), held in between, changes, as what is commanded (N, c) does not, at times t (N,)
    of runs (N,); and how much of one has gone by half a beat before each change, when a run begins (as in `clock`).
    None where none is heard."""
    later = np.flatnonzero(run[1:] == run[:-1]) + 1
    if not len(later):
        return None
    middle, every = 0.5 * (t[later] + t[later - 1]), max(float(np.median(t[later] - t[later - 1])), 1e-6)
    hz = np.arange(2 * AROUND, int(min(FASTEST / every, FASTEST_HZ) / BEAT_HZ)) * BEAT_HZ
    if len(hz) < 4 * AROUND:
        return None
    jumps = [(signal[later] - signal[later - 1]) ** 2 for signal in (x, commanded)]
    gross = GROSS * np.maximum(np.median(jumps[0], axis=0), RARE * np.mean(jumps[0], axis=0))

    def spectrum(jump: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of squares of jumps, and how loud each beat is beside those next to it."""
        size = np.minimum(jump, gross).sum(axis=1)
        turn, wave = size - size.mean() + 0j, np.exp(-2j * np.pi * BEAT_HZ * middle)
        turn *= wave ** (2 * AROUND)
        of = np.empty(len(hz), complex)
        for k in range(len(hz)):
            of[k] = turn.sum()
            turn *= wave
        power = np.abs(of) ** 2
        beside = [np.median(power[max(k - AROUND, 0) : k + AROUND + 1]) for k in range(len(hz))]
        return of, power / np.maximum(beside, 1e-300)

    (of, loud), (_, own) = map(spectrum, jumps)
    loud = np.where(own < OWN * loud, loud, 0.0)
    slowest, heard = 2 * AROUND, np.zeros(len(hz))
    for k in range(len(hz)):  # a beat and its overtones are as loud
        at = [m * (slowest + k) - slowest for m in OVERTONES]
        near = (loud[i - m // 2 : i + m // 2 + 1] for i, m in zip(at, OVERTONES, strict=True))
        heard[k] = np.median([x.max() for x in near if len(x)])
    if heard.max() < STEPS:
        return None
    first = int(np.argmax(heard > 0.5 * heard.max()))
    first += int(np.argmax(loud[first : first + AROUND]))
    change = -np.angle(of[first]) / (2 * np.pi)  # the share of a beat from a run's start to a change
    return float(hz[first]), float((0.5 - change) % 1.0)


def clock(t: np.ndarray, error: np.ndarray, rate: np.ndarray) -> dict[str, float]:
    """How the delay of a clock that is set again and again would change, by what errors (N, c) have of the rate (N, c)
    at times t (N,) of their runs: `drift` 1 or −1 for one that falls behind or gets ahead of itself, `reset_s` the time
    between two settings [s], and `phase`, the share of it that has gone by when a run begins."""
    score, weight = -np.sum(error * rate, axis=1), np.sum(rate**2, axis=1)

    def fitted(*delays: np.ndarray) -> tuple[float, float]:
        """What delays (N,) beside a constant one take away of the squared residuals, and the share of the last one."""
        by = np.vstack([np.ones(len(t)), *delays])
        x = np.linalg.lstsq((by * weight) @ by.T, by @ score, rcond=None)[0]
        return float(by @ score @ x), float(x[-1])

    own = score - weight * (score.sum() / max(weight.sum(), 1e-300))
    power = np.array([np.abs(np.exp(-2j * np.pi * hz * t) @ own) ** 2 for hz in BEATS_HZ])
    beside = [np.median(power[max(k - AROUND, 0) : k + AROUND + 1]) for k in range(len(power))]
    slow, loud = BEATS_HZ < SLOW_HZ, power > STANDS_OUT * np.array(beside)
    heard = loud & ~slow  # of a beat and its overtones it is the loudest
    beat = BEATS_HZ[np.argmax(np.where(heard if heard.any() else slow, power, 0.0))]
    nearby = beat + BEAT_HZ * np.linspace(-0.5, 0.5, 5)
    forms = [(hz, phase) for hz in nearby for phase in np.arange(0.0, 1.0, 1 / 16)]
    delays = [fitted((t * hz + phase + 0.5) % 1.0 - 0.5) for hz, phase in forms]
    best = max(range(len(forms)), key=lambda k: delays[k][0])
    drift, (hz, phase) = np.sign(delays[best][1]), forms[best]
    return {"drift": float(drift), "reset_s": float(1 / hz), "phase": float(phase)}


def _look(search: Search) -> Asking[Search]:
    yield from search.look(search.problem.coordinates.start)
    return search


def gather(
    searches: Sequence[Search], said: Sequence[Sequence[Column]], forms: Mapping[tuple[str, int], Mapping[str, float]]
) -> Screen:
    """One Jacobian out of many."""
    columns = [c for own in said for c in own]
    first = searches[0]
    base, r, sigma = _projected(first)
    count = base.shape[2]
    extra = np.concatenate([_projected(s, first)[0] for s in searches[1:]], axis=2)
    for slopes in (base, extra):
        slopes[..., ~np.isfinite(slopes).all(axis=(0, 1))] = 0.0  # what has no slope somewhere promises nothing
    n, c, m = extra.shape
    flat_base, flat, flat_r = base.reshape(n * c, count), extra.reshape(n * c, m), r.reshape(-1)
    q, triangle = np.linalg.qr(flat_base)
    along = q.T @ flat
    flat_r = flat_r - q @ (q.T @ flat_r)
    run = np.repeat(first.windows.sample_run, c)
    parts = []
    for k in np.unique(run):  # one at a time: all columns of all runs are large
        mine = run == k
        j = flat[mine] - q[mine] @ along
        parts.append((j.T @ j, j.T @ flat_r[mine]))
    grams, scores = (np.stack(x) for x in zip(*parts, strict=True))
    gram, score = grams.sum(axis=0), scores.sum(axis=0)
    inverse = np.linalg.pinv(triangle)
    gains, firm, steps, base_steps = {}, {}, {}, {}
    for key in dict.fromkeys((x.id, x.form) for x in columns):
        i = [j for j, x in enumerate(columns) if (x.id, x.form) == key]
        mine, own = [columns[j] for j in i], np.ix_(i, i)
        x = _least(gram[own], score[i], mine)
        gains[key] = _gained(gram[own], score[i], x)
        firm[key] = 0.0
        for g, s in zip(grams, scores, strict=True):
            other = _least((gram - g)[own], (score - s)[i], mine)
            firm[key] += _gained(g[own], s[i], other)
        steps[key] = {c.name: float(v) for c, v in zip(mine, x, strict=True)}
        base_steps[key] = inverse @ (q.T @ r.reshape(-1) - along[:, i] @ x)
    assert first.point is not None
    whole = first.point.answer.jacobian
    return Screen(columns, forms, gram, score, sigma, gains, firm, steps, base_steps, whole)


def _gained(gram: np.ndarray, score: np.ndarray, x: np.ndarray) -> float:
    """The drop of χ² to first order at the parameters x (m,)."""
    return float(2 * score @ x - x @ gram @ x)


def _least(gram: np.ndarray, score: np.ndarray, columns: Sequence[Column]) -> np.ndarray:
    """The parameters (m,) within their bounds that gain most."""
    size, low, high = (np.array([getattr(c, name) for c in columns]) for name in ("scale", "low", "high"))
    g = gram * np.outer(size, size)
    if np.trace(g) <= 1e-9:
        return np.zeros(len(columns))
    root = np.linalg.cholesky(g + (1e-9 * np.trace(g) + 1 / USUAL**2) * np.eye(len(columns))).T
    target = np.linalg.solve(root.T, score * size)
    bounds = (np.minimum(low / size, -1e-12), np.maximum(high / size, 1e-12))
    return lsq_linear(root, target, bounds=bounds).x * size


def _projected(search: Search, scaled_by: Search | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns (N, c, m) and residuals (N, c) in units of the residuals' RMS, robustly weighted, the starting angles
    projected off."""
    point = search.point
    assert point is not None
    reference = scaled_by or search
    assert reference.point is not None
    scale = reference._scale(reference.point)
    root = np.sqrt(scale.weight) / scale.sigma
    along = point.answer.jacobian[..., -1] * root
    error = (search.windows.y - point.answer.predicted) * root
    columns = point.answer.jacobian[..., :-1] * root[..., None]
    group = search.sample_group
    total = np.bincount(group, np.sum(along**2, axis=1), search.groups) + 1 / search.offset_sd**2
    shares = np.stack(
        [
            np.bincount(group, np.sum(along * columns[..., i], axis=1), search.groups) / total
            for i in range(columns.shape[2])
        ],
        axis=1,
    )
    own = np.bincount(group, np.sum(along * error, axis=1), search.groups) / total
    columns = columns - along[..., None] * shares[group][:, None, :]
    return columns.astype(float), error - along * own[group][:, None], scale.sigma


def colour(error: np.ndarray, run: np.ndarray) -> float:
    """By how much the residuals' (N, c) colour widens the variance of a mean: 1 for white ones."""
    total = white = 0.0
    for r in np.unique(run):
        e = error[run == r]
        e = e - e.mean(axis=0)
        lags = min(bandwidth(e.mean(axis=1)), len(e) // 4)
        white += float(np.sum(e * e))
        total += float(np.sum(e * e))
        for lag in range(1, lags + 1):
            total += 2 * (1 - lag / (lags + 1)) * float(np.sum(e[lag:] * e[:-lag]))
    return max(total / max(white, 1e-300), 1.0)
