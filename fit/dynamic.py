"""Identification from moving logs: multiple shooting, then free runs, by Levenberg–Marquardt.

Three rounds on the same kernel (`ljjax.fit.shooting`). First every window starts from the data, which converges from
far off. Then windows start where the one before them ends: the free run from rest, still parallel in time, because a
window's start moves along with the parameters by its derivatives and is corrected until the windows meet. Last the
same with half the step. Noise is estimated from the residuals, samples far off count less (Huber), and every run's
starting angle is a parameter of its own, eliminated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax
import numpy as np

from ljjax.fit.coordinates import Coordinates
from ljjax.fit.covariance import score_variance
from ljjax.fit.problem import ROUNDS, Estimate, Problem, Round
from ljjax.fit.shooting import Answer, Asking, Request, Starts
from ljjax.fit.static import value_and_jacobian
from ljjax.fit.windows import Motion, Windows, cut

FAR = 0.25
"""A step goes no further than this share of a coordinate's spread: parameters change by a factor of 2 at most."""
HUBER = 4.0
"""Residuals beyond this many standard deviations count linearly."""
EXPLODED = 1e12
"""Derivatives [rad] beyond which a motion counts as one that does not simulate."""


@dataclass(eq=False)
class _Point:
    """Where the search stands: coordinates, offsets of the starting angles (G,), and what they give."""

    x: np.ndarray
    offset: np.ndarray
    answer: Answer
    statics: list[tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True, eq=False)
class _Scale:
    """What residuals are divided by, fixed while steps are compared: σ (c,), Huber's weights (N, c), the points' σ."""

    sigma: np.ndarray
    weight: np.ndarray
    statics: list[float]


def estimate(
    problem: Problem, x0: np.ndarray | None = None, rounds: Sequence[Round] = ROUNDS, max_iterations: int = 40
) -> Asking[Estimate]:
    """Fit one robot, as a generator for `ljjax.fit.shooting.together`. `x0` (k,) is where it begins."""
    x = np.array(problem.coordinates.start if x0 is None else x0, float)
    history: list[tuple[int, int, float, float, np.ndarray]] = []
    search: Search | None = None
    for which, how in enumerate(rounds):
        how = _for(problem, how)
        windows = cut(problem.motions, how.step_s).some(how.windows)
        search = Search(problem, windows, how, search)
        x = yield from search.run(x, max_iterations, history, which)
    assert search is not None
    return search.result(history)


def predict(found: Estimate, motions: Sequence[Motion]) -> Asking[Estimate]:
    """What an estimate says of other runs: the same, over their windows."""
    p = found.problem
    like = Coordinates(found.model, p.coordinates.names, p.coordinates.pressure)
    problem = Problem(like, motions)
    how = _for(problem, ROUNDS[-1])
    search = Search(problem, cut(motions, how.step_s), how)
    yield from search.look(like.start)
    return search.result([])


def _for(problem: Problem, how: Round) -> Round:
    """What effects remember does not move along with a window's start: their free runs go window after window."""
    return replace(how, onward=True) if how.free and problem.coordinates.like.effects else how


class Search:
    """Levenberg–Marquardt over x and the starting angles, of windows (from the data) or runs (`free`)."""

    def __init__(self, problem: Problem, windows: Windows, how: Round, before: Search | None = None):
        self.problem, self.windows, self.how = problem, windows, how
        self.group = windows.run if how.free else np.arange(len(windows))
        self.groups = int(self.group.max()) + 1
        self.offset_sd = np.array([m.q0_sd for m in problem.motions]) if how.free else windows.q_sd
        self.sample_group = self.group[windows.window]
        self.start_from: Starts | None = None
        self.start_offset = np.zeros(self.groups)
        self.point: _Point | None = None
        self.converged = False
        self.asked = 0
        self.coarse: np.ndarray | None = None
        self.step_error: np.ndarray | None = None
        if how.free and not how.onward and before is not None and before.point is not None:
            self._go_on(before.windows, before.how, before.point)

    def _go_on(self, windows: Windows, how: Round, point: _Point) -> None:
        """Begin where the round before ended, where its windows are these, or twice as long."""
        answer = point.answer
        if how.free:
            self.start_offset = point.offset
        if answer.used is None:
            return
        if how.free and np.isclose(windows.h, 2 * self.windows.h):
            counts = np.bincount(self.windows.run), np.bincount(windows.run)
            index = np.concatenate([f + np.arange(c) for f, c in zip(_first(counts[1]) * 2, counts[0], strict=True)])

            def between(start: np.ndarray, middle: np.ndarray) -> np.ndarray:
                return np.stack([start, middle], axis=-1).reshape(*start.shape[:-1], -1)[..., index]

            self.start_from = jax.tree.map(between, answer.used, answer.middle)
            self.coarse = answer.predicted
        elif windows.h == self.windows.h and len(windows) == len(self.windows):
            self.start_from = self._chained(answer)

    # --- what the model says

    def _ask(self, x: np.ndarray, offset: np.ndarray, starts: Starts | None) -> Asking[Answer]:
        c = self.problem.coordinates
        self.asked += 1
        return (yield Request(self.windows, c.numbers(x), c.slopes(x), offset[self.group], starts, self.how.onward))

    def _evaluate(self, x: np.ndarray, offset: np.ndarray, starts: Starts | None) -> Asking[_Point]:
        """The model's predictions; in a free run repeated until its windows meet."""
        answer = yield from self._ask(x, offset, starts)
        if self.how.free and not self.how.onward:
            for _ in range(int(np.bincount(self.windows.run).max()) + 2):
                following = self._chained(answer)
                assert answer.used is not None
                if not _gap(following, answer.used) > self.how.meet_rad:
                    break
                answer = yield from self._ask(x, offset, following)
        statics, c = [], self.problem.coordinates
        for points in self.problem.points:
            value, jacobian = value_and_jacobian(c.model(x), points, c.names)
            statics.append((value, jacobian @ c.jacobian(x)))
        return _Point(x, offset, answer, statics)

    def _chained(self, answer: Answer) -> Starts:
        """Every window starts where the one before it ended, with what that one's own new start will add to its end;
        opening windows start as they were."""

        def shift(end: np.ndarray, used: np.ndarray) -> np.ndarray:
            return np.where(self.windows.opens, used, np.roll(end, 1, axis=-1))

        assert answer.used is not None and answer.passed is not None
        following: Starts = jax.tree.map(shift, answer.end, answer.used)
        new, old = (np.array([s.state.q, s.state.z]) for s in (following, answer.used))  # (2, n, W)
        total = new - old
        for w in np.flatnonzero(~self.windows.opens):
            total[..., w] += np.einsum("abn,bn->an", answer.passed[..., w - 1], total[..., w - 1])
        q, z = (tuple(x) for x in old + total)
        return Starts(following.state._replace(q=q, z=z), following.slope)

    # --- how well that fits

    def _scale(self, point: _Point) -> _Scale:
        error = self.windows.y - point.answer.predicted
        robust = 1.4826 * np.median(np.abs(error), axis=0)
        inside = np.abs(error) <= HUBER * robust
        sigma = np.sqrt(np.sum(np.where(inside, error, 0.0) ** 2, axis=0) / np.maximum(inside.sum(axis=0), 1))
        noise = np.sqrt(np.mean([m.seen_noise**2 for m in self.problem.motions], axis=0))
        sigma = np.maximum(sigma, 0.5 * noise + 1e-9)
        weight = np.minimum(1.0, HUBER * sigma / np.maximum(np.abs(error), 1e-300))
        statics = []
        for points, (value, _) in zip(self.problem.points, point.statics, strict=True):
            stated = points.sd[np.isfinite(points.sd)]
            least = np.sqrt(np.mean(stated**2)) if len(stated) else 1e-3 * np.abs(points.value).mean() + 1e-9
            statics.append(float(max(np.sqrt(np.mean((points.value - value) ** 2)), least)))
        return _Scale(sigma, weight, statics)

    def _rows(self, point: _Point, scale: _Scale) -> tuple[np.ndarray, np.ndarray]:
        """Residuals and their derivatives (…, k) of all that is not a motion: points and priors."""
        c = self.problem.coordinates
        r, j = [(point.x - c.start) / c.spread], [np.diag(1 / c.spread)]
        for points, (value, slope), s in zip(self.problem.points, point.statics, scale.statics, strict=True):
            r.append((value - points.value) / s)
            j.append(slope / s)
        if self.problem.priors:
            physical, slope = c.physical(point.x), c.jacobian(point.x)
            for name, (mean, sd) in self.problem.priors.items():
                if name in c.names:
                    i = c.names.index(name)
                    r.append(np.array([(physical[i] - mean) / sd]))
                    j.append(slope[i : i + 1] / sd)
        return np.concatenate(r), np.concatenate(j)

    def _chi2(self, point: _Point, scale: _Scale) -> float:
        """Weighted squares; ∞ where the motion or its derivatives are beyond what numbers hold."""
        if not np.all(np.abs(point.answer.jacobian) < EXPLODED):
            return float("inf")
        error = (self.windows.y - point.answer.predicted) / scale.sigma
        rows, _ = self._rows(point, scale)
        out = np.sum(scale.weight * error**2) + rows @ rows + np.sum((point.offset / self.offset_sd) ** 2)
        return float(out) if np.isfinite(out) else float("inf")

    def _normal(self, point: _Point, scale: _Scale):
        """JᵀJ and −Jᵀr over x with the starting angles eliminated, and what gives those back."""
        weight = scale.weight / scale.sigma**2
        j, along = point.answer.jacobian[..., :-1], point.answer.jacobian[..., -1]
        error = self.windows.y - point.answer.predicted
        weighted = j * weight[..., None]
        rows, slope = self._rows(point, scale)
        a = np.einsum("nck,ncl->kl", weighted, j, optimize=True) + slope.T @ slope
        g = np.einsum("nck,nc->k", weighted, error, optimize=True) - slope.T @ rows

        def summed(x: np.ndarray) -> np.ndarray:
            return np.stack([np.bincount(self.sample_group, column, self.groups) for column in x.reshape(len(x), -1).T])

        own = summed(np.sum(weight * along**2, axis=1))[0] + 1 / self.offset_sd**2
        cross = summed(np.einsum("nck,nc->nk", weighted, along, optimize=True))
        pull = summed(np.sum(weight * along * error, axis=1))[0] - point.offset / self.offset_sd**2
        return a - (cross / own) @ cross.T, g - (cross / own) @ pull, (own, cross, pull)

    # --- the search

    def run(self, x: np.ndarray, max_iterations: int, history: list, which: int) -> Asking[np.ndarray]:
        """Search from x (k,); where it ends. `point` and `converged` say more."""
        point = yield from self._evaluate(x, self.start_offset, self.start_from)
        if self.coarse is not None:
            change = np.abs(point.answer.predicted - self.coarse).max(axis=1)
            self.step_error = np.array([change[self.windows.sample_run == i].max() for i in range(self.groups)])
        damping, converged = 1e-3, False
        done = self.how.done
        for _ in range(max_iterations):
            scale = self._scale(point)
            chi2 = self._chi2(point, scale)
            if not np.isfinite(chi2):
                raise FloatingPointError("the starting model does not simulate: its motion is not finite")
            a, g, (own, cross, pull) = self._normal(point, scale)
            rms = float(np.sqrt(np.mean((self.windows.y - point.answer.predicted) ** 2)))
            history.append((which, self.asked, rms, damping, point.x.copy()))
            limits = self.problem.limits(point.x)
            rejected = 0
            while True:
                step = self._step(a, g, damping, limits)
                step = step * self.problem.room(point.x, step)
                step = self.problem.coordinates.within(point.x + step) - point.x
                gain = float(2 * g @ step - step @ a @ step)
                if gain <= max(done, self.how.share * chi2) * (1.0 if damping <= 1e-2 else 1e-3):
                    converged = True
                    break
                shift = (pull - step @ cross) / own
                trial = point.x + step
                better = None
                if self.problem.coordinates.admissible(trial):
                    better = yield from self._moved(point, step, shift)
                    new = self._chi2(better, scale)
                    if new < chi2:
                        ratio = (chi2 - new) / gain
                        converged = chi2 - new < self.how.share * chi2
                        damping = max(damping * (0.1 if ratio > 0.7 else 0.5 if ratio > 0.3 else 2.0), 1e-9)
                        point = better
                        break
                damping = max(damping, 1e-6) * 8
                rejected += 1
                if damping > 1e8 or (
                    rejected >= 2 and gain < max(1.0, self.how.share * chi2)
                ):  # nothing left but the kinks' roughness
                    converged = True
                    break
            if converged:
                break
        self.point, self.converged = point, converged
        return point.x

    def _step(self, a: np.ndarray, g: np.ndarray, damping: float, limits: list) -> np.ndarray:
        """The damped step, least on the bounds it would cross; coordinates that would go further than `FAR` go that
        far, and the others make the best of it."""
        d = np.sqrt(np.diag(a))
        matrix, g = a / np.outer(d, d) + damping * np.eye(len(d)), g / d  # in steps times d
        most = FAR * self.problem.coordinates.spread * d
        limits = [(slope / d, low, high) for slope, low, high in limits]
        step, free = np.zeros_like(g), np.ones(len(g), bool)
        held: dict[int, float] = {}
        while free.any():
            rows = np.array([limits[i][0] for i in held]).reshape(len(held), len(g))
            right = np.array(list(held.values())) - rows[:, ~free] @ step[~free]
            corner = np.zeros((len(held), len(held)))
            whole = np.block([[matrix[np.ix_(free, free)], rows[:, free].T], [rows[:, free], corner]])
            pull = np.r_[(g - matrix[:, ~free] @ step[~free])[free], right]
            step[free] = np.linalg.solve(whole, pull)[: int(free.sum())]
            over = free & (np.abs(step) > most)
            beyond = [
                (i, float(np.clip(slope @ step, low, high)))
                for i, (slope, low, high) in enumerate(limits)
                if i not in held and not low - 1e-12 <= slope @ step <= high + 1e-12
            ]
            if over.any():
                worst = int(np.argmax(np.where(over, np.abs(step) / most, 0.0)))
                step[worst], free[worst] = np.sign(step[worst]) * most[worst], False
                for slope, low, high in limits:  # its own bound may be nearer
                    if slope[worst] and np.count_nonzero(slope) == 1:
                        step[worst] = np.clip(slope[worst] * step[worst], low, high) / slope[worst]
            elif beyond and len(held) < int(free.sum()):
                held[beyond[0][0]] = beyond[0][1]
            else:
                break
        return step / d

    def look(self, x: np.ndarray) -> Asking[None]:
        """Evaluate at x (k,), without a search."""
        self.point = yield from self._evaluate(x, self.start_offset, None)

    def settle(self, x: np.ndarray) -> Asking[None]:
        """Evaluate at x (k,) with the starting angles at their best, to first order."""
        point = yield from self._evaluate(x, self.start_offset, None)
        _, _, (own, _, pull) = self._normal(point, self._scale(point))
        self.point = yield from self._evaluate(x, point.offset + pull / own, None)

    def gradient(self, x: np.ndarray) -> Asking[np.ndarray]:
        """(k,) gradient of ½χ² per sample at x, the starting angles at their best to first order."""
        point = yield from self._evaluate(x, self.start_offset, None)
        _, g, _ = self._normal(point, self._scale(point))
        return -g / self.windows.y.size

    def _moved(self, point: _Point, step: np.ndarray, shift: np.ndarray) -> Asking[_Point]:
        starts = None
        if self.how.free and not self.how.onward:
            both = np.concatenate([np.repeat(step[:, None], len(self.windows), 1), shift[self.group][None]])
            starts = self._chained(point.answer).moved(both)
        moved = yield from self._evaluate(point.x + step, point.offset + shift, starts)
        return moved

    # --- the result

    def result(self, history: list) -> Estimate:
        """The estimate, with its covariance, of a search that has run."""
        point = self.point
        assert point is not None
        scale = self._scale(point)
        a, pull, (own, cross, _) = self._normal(point, scale)
        along = point.answer.jacobian[..., -1]
        own_part = (cross / own).T[self.sample_group]
        jacobian = point.answer.jacobian[..., :-1] - along[..., None] * own_part[:, None, :]
        error = self.windows.y - point.answer.predicted
        white = np.linalg.pinv(a, rcond=1e-14, hermitian=True)
        coloured = white @ self._meat(jacobian, error, scale, point) @ white
        statics = [(value, s) for (value, _), s in zip(point.statics, scale.statics, strict=True)]
        model = self.problem.coordinates.model(point.x)
        offset = point.offset if self.how.free else np.zeros(len(self.problem.motions))
        return Estimate(
            self.problem,
            point.x,
            model,
            coloured,
            white,
            self.windows,
            point.answer.predicted,
            jacobian,
            pull,
            scale.sigma,
            scale.weight,
            offset,
            statics,
            self._chi2(point, scale),
            history,
            self.converged,
            self.step_error,
        )

    def _meat(self, jacobian: np.ndarray, error: np.ndarray, scale: _Scale, point: _Point) -> np.ndarray:
        """(k, k) variance of the score, the residuals' colour counted."""
        score = np.einsum("nck,nc->nk", jacobian, scale.weight * error / scale.sigma**2, optimize=True)
        out = score_variance(score, error.mean(axis=1), self.windows.sample_run)
        rows, slope = self._rows(point, scale)
        return out * len(score) / max(len(score) - len(point.x), 1) + slope.T @ slope


def _first(counts: np.ndarray) -> np.ndarray:
    """Index of each run's first window."""
    return np.cumsum(counts) - counts


def _gap(a: Starts, b: Starts) -> float:
    """The largest difference of shape and bristle deflection [rad]."""
    pairs = zip((*a.state.q, *a.state.z), (*b.state.q, *b.state.z), strict=True)
    return max(float(np.max(np.abs(x - y))) for x, y in pairs)
