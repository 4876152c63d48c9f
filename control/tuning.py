"""Gains tuned by gradient through the simulated closed loop."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array

from ljjax.control.loop import Loop
from ljjax.control.problem import Count, Problem, cost
from ljjax.control.robots import sample
from ljjax.control.spec import MEASURES, Spec, default, refuse
from ljjax.control.statics import Hardware
from ljjax.control.surrogate import KEPT, Surrogate, fit
from ljjax.control.synthesis import Design, design
from ljjax.errors import InputError
from ljjax.law.parts import Kind
from ljjax.model import Model, astype

SPREAD = 0.2
"""How far restarts begin from the start (standard deviation), in widths of the box."""
FIRST, WIDEST, NARROWEST = 0.15, 0.3, 0.02
"""Half the width of the trust region, in widths of the box."""
SMALL = 0.02
"""A measure's share of its limit below which it hardly matters."""
TRIES, STEPS = 4, 200
"""Points from which the surrogate's lowest loss is sought, and Adam's steps from each."""


@dataclass(frozen=True)
class Side:
    """A law before or after tuning.

    Attributes:
        gains: those that were tuned, by name, in `ljjax.law.UNITS`.
        loss: on the robots tuned on; `unseen` on as many others (None without uncertainty).
        measures: by target and robot (the first is the model itself), plain, of the robots tuned on.
        unseen_measures: the same of the others.
        loops: on the model itself, one a target.
    """

    gains: dict[str, float]
    loss: float
    unseen: float | None
    measures: list[list[dict[str, float]]]
    unseen_measures: list[list[dict[str, float]]]
    loops: list[Loop]


@dataclass(frozen=True)
class Tuned:
    """A tuned law and how it came about.

    Attributes:
        made: the law and what it reaches, for `control.export`.
        spec: what it was tuned to.
        before, after: the law that tuning began with, and the tuned one.
        history: (iterations, restarts) losses.
        coordinates: (iterations, restarts, k) of the gains in the box, 0 to 1.
        best: iteration and restart at which the law was taken.
        search: closed loops simulated by the search; `count` by everything, evaluation included.
        options: of the call.
    """

    made: Design
    spec: Spec
    before: Side
    after: Side
    history: np.ndarray
    coordinates: np.ndarray
    best: tuple[int, int]
    search: Count
    count: Count
    options: dict[str, Any]


def tune(
    model: Model,
    kind: Kind = "integral",
    spec: Spec | None = None,
    *,
    gains: Mapping[str, float] | None = None,
    free: Sequence[str] | None = None,
    hardware: Hardware | None = None,
    uncertainty: Mapping[str, float] | None = None,
    samples: int = 8,
    seed: int = 0,
    restarts: int = 2,
    iterations: int = 20,
    progress: Callable[[str, int, int], None] | None = None,
    where: str = "model",
    spec_where: str = "specification",
) -> Tuned:
    """Tune a law's gains to a specification, on the robots that an uncertain model may be.

    Measures and their derivatives, simulated, make a surrogate (`ljjax.control.surrogate`) whose lowest loss within a
    trust region is simulated next, over coordinates in a box all of which is feasible (`ljjax.control.box`), from the
    start and from points around it side by side; of all points seen the best is taken, the start included.

    Args:
        spec: None for `spec.default` of the law's reach.
        gains: to start from, as for `design`.
        free: gains to tune; None for all that the law uses.
        uncertainty: standard deviations by path (`ModelFile.uncertainty`); without any, only the model itself counts.
        samples: robots to tune on, the model itself among them.
        progress: `progress(stage, done, count)`, after every iteration.
        where, spec_where: what to call the model and the specification in messages.

    Raises:
        InputError: as `design`; targets out of reach; numbers out of range.
    """
    for name, value, least in (("samples", samples, 1), ("restarts", restarts, 1), ("iterations", iterations, 1)):
        if value < least:
            raise InputError(f"{name} = {value}: expected a whole number from {least} on")
    model = astype(model, float)
    hardware = hardware or Hardware()
    made = design(model, kind, gains=gains, hardware=hardware, where=where)
    spec = spec or default(made.law)
    refuse(spec, made.law, spec_where)
    spread = {k: sd for k, sd in (uncertainty or {}).items() if sd > 0}
    highest = hardware.vacuum_max_kpa
    robots = sample(model, spread, samples, seed=seed, vacuum_max_kpa=highest)
    problem = Problem(made, model, hardware, spec, robots, seed=seed, free=free)

    history, coordinates, points = descend(problem, restarts, iterations, seed, progress)
    best, made = _best(problem, model, made, hardware, history, points)
    search = replace(problem.count)
    other = None
    if spread and samples > 1:
        others = sample(model, spread, samples + 1, seed=seed + 1, vacuum_max_kpa=highest)[1:]
        other = problem.on(others, seed + 1)
    before, after = (_side(problem, other, np.asarray(x)) for x in (problem.start, points[best]))
    options = {"law": kind, "samples": samples, "seed": seed, "restarts": restarts, "iterations": iterations}
    options |= {
        "start": {name: float(x) for name, x in (gains or {}).items()},
        "free": list(problem.names),
        "uncertainty": spread,
    }
    options["hardware"] = hardware._asdict()
    count = problem.count
    if other is not None:
        count = Count(count.values + other.count.values, count.gradients + other.count.gradients)
    return Tuned(made, spec, before, after, history, coordinates, best, search, count, options)


def descend(
    problem: Problem, restarts: int, iterations: int, seed: int, progress: Callable[[str, int, int], None] | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Losses (I, R), coordinates and gains (I, R, k) on the way.

    Every step simulates a point for each start: where, no further from that start's best point than its trust region
    allows, the loss of the predicted measures is least. The measures are predicted, not the loss, as the corners of
    requirements and of the worst robots are then known exactly.
    """
    start = problem.box.coordinates(problem.start)
    rng = np.random.default_rng([seed, 2])
    around = start + SPREAD * rng.standard_normal((restarts - 1, len(start)))
    trials = np.concatenate([start[None], np.clip(around, 0.02, 0.98)])
    to_gains = jax.jit(jax.vmap(problem.box.gains))
    slopes = jax.jit(jax.vmap(jax.jacfwd(problem.box.gains)))
    aims = [_Aim() for _ in range(restarts)]
    known = _Known(problem)
    losses, places, points = [], [], []
    for i in range(iterations):
        gains = np.array(to_gains(jnp.asarray(trials)))
        if i == 0:
            gains[0] = problem.start  # to the last digit
        value = known.add(trials, gains, np.asarray(slopes(jnp.asarray(trials))))
        for kept, x in ((losses, value), (places, trials), (points, gains)):
            kept.append(x)
        for aim, u, loss in zip(aims, trials, value, strict=True):
            aim.learn(u, loss)
        if i + 1 < iterations:
            trials = np.stack([known.next(aim, rng) for aim in aims])
        if progress:
            progress("tuning", i + 1, iterations)
    return np.stack(losses), np.stack(places), np.stack(points)


class _Aim:
    """A start's best point so far, and how far from it the predictions have held."""

    def __init__(self):
        self.u, self.loss, self.predicted, self.radius = np.zeros(0), np.inf, np.inf, FIRST

    def learn(self, u: np.ndarray, loss: float) -> None:
        if np.isfinite(self.loss):
            hoped = np.log(self.loss) - np.log(self.predicted)
            held = (np.log(self.loss) - np.log(loss)) / max(hoped, 1e-12)
            if held > 0.7:
                self.radius = min(2 * self.radius, WIDEST)
            elif held < 0.25:
                self.radius = max(self.radius / 2, NARROWEST)
        if loss < self.loss or not self.u.size:
            self.u, self.loss = u, loss


class _Known:
    """The measures that count at the points simulated, as logarithms of their share of what is required."""

    def __init__(self, problem: Problem):
        self._problem, spec = problem, problem.spec
        self._used = [i for i, name in enumerate(MEASURES) if name in spec.require]
        self._limits = np.array([spec.require[name].limit for name in MEASURES if name in spec.require])
        self._points: list[np.ndarray] = []
        self._values: list[np.ndarray] = []
        self._slopes: list[np.ndarray] = []
        self._lowest = jax.jit(self._lowest_loss)

    def add(self, trials: np.ndarray, gains: np.ndarray, turns: np.ndarray) -> np.ndarray:
        """(R,) losses of points (R, k) with gains (R, k) and their derivatives (R, k, k) by the coordinates."""
        measures, ok, slopes = self._problem.measures(gains)
        for r, u in enumerate(trials):
            if not ok[r].all():
                continue  # no surrogate knows where loops fail; the trust region keeps away
            shares = measures[r][..., self._used] / self._limits
            turned = slopes[r][..., self._used, :] @ turns[r] / self._limits[:, None]
            held = np.maximum(shares, 0.0) + SMALL
            self._points.append(u)
            self._values.append(np.log(held).reshape(-1))
            self._slopes.append((turned / held[..., None]).reshape(-1, len(u)))
        return self._problem.priced(measures, ok)

    def next(self, aim: _Aim, rng: np.random.Generator) -> np.ndarray:
        """(k,) the point to simulate next."""
        low, high = np.maximum(aim.u - aim.radius, 0.0), np.minimum(aim.u + aim.radius, 1.0)
        begun = np.concatenate([aim.u[None], rng.uniform(low, high, (TRIES - 1, len(aim.u)))])
        if not self._points:
            return begun[-1]
        near = np.argsort(np.max(np.abs(np.stack(self._points) - aim.u), axis=1), kind="stable")[:KEPT]
        guess = fit(*(np.stack([x[i] for i in near]) for x in (self._points, self._values, self._slopes)))
        u, loss = self._lowest(guess, jnp.asarray(begun), jnp.asarray(low), jnp.asarray(high))
        aim.predicted = float(loss)
        return np.asarray(u)

    def _lowest_loss(self, guess: Surrogate, begun: Array, low: Array, high: Array) -> tuple[Array, Array]:
        """The point (k,) of the lowest predicted loss that Adam finds between `low` and `high`, and that loss."""
        spec, shape = self._problem.spec, (*self._problem.size, len(self._used))
        limits, radius = jnp.broadcast_to(jnp.asarray(self._limits), shape), jnp.max(high - low) / 2

        def log_loss(u: Array) -> Array:
            shares = jnp.exp(jnp.clip(guess.at(u), -12.0, 6.0)).reshape(shape) - SMALL
            measures = jnp.zeros((*shape[:2], len(MEASURES))).at[..., jnp.asarray(self._used)].set(shares * limits)
            return jnp.log(cost(measures, jnp.ones(shape[:2], bool), spec))

        descent = optax.adam(optax.cosine_decay_schedule(0.08, STEPS, alpha=0.01))

        def from_one(u: Array) -> tuple[Array, Array]:
            def step(carry: Any, _: None) -> tuple[Any, None]:
                u, state, best, where = carry
                value, slope = jax.value_and_grad(log_loss)(u)
                where = jnp.where(value < best, u, where)
                with jax.numpy_dtype_promotion("standard"):  # Optax takes whole numbers to a power
                    change, state = descent.update(slope, state)
                moved = u + radius * jnp.asarray(change)
                return (jnp.clip(moved, low, high), state, jnp.minimum(value, best), where), None

            (_, _, best, where), _ = jax.lax.scan(step, (u, descent.init(u), jnp.inf, u), None, length=STEPS)
            return where, best

        where, best = jax.vmap(from_one)(begun)
        i = jnp.argmin(best)
        return where[i], jnp.exp(best[i])


def _best(
    problem: Problem, model: Model, start: Design, hardware: Hardware, history: np.ndarray, points: np.ndarray
) -> tuple[tuple[int, int], Design]:
    """The point of the lowest loss of which a law can be designed; the start, which is one, at the worst."""
    given = start.law.gains._asdict()
    refused = None
    for flat in np.argsort(history, axis=None, kind="stable"):
        i, r = np.unravel_index(flat, history.shape)
        if not np.isfinite(history[i, r]):
            break
        chosen = given | dict(zip(problem.names, map(float, points[i, r]), strict=True))
        try:
            made = design(model, start.law.kind, gains=chosen, hardware=hardware)
            refuse(problem.spec, made.law, "targets")
        except InputError as error:
            refused = error
            continue
        return (int(i), int(r)), made
    raise InputError(f"no gains on the way make a law: {refused or 'no loop had finite numbers'}")


def _side(problem: Problem, other: Problem | None, gains: np.ndarray) -> Side:
    named = dict(zip(problem.names, map(float, gains), strict=True))
    loss, measures, loops = problem.told(gains)
    unseen, others, _ = (None, [], []) if other is None else other.told(gains)
    return Side(named, loss, unseen, measures, others, loops)
