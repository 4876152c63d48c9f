"""Gains tuned by gradient through the simulated closed loop."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from ljjax.control.loop import Loop
from ljjax.control.problem import Count, Problem
from ljjax.control.robots import sample
from ljjax.control.spec import Spec, default, refuse
from ljjax.control.statics import Hardware
from ljjax.control.synthesis import Design, design
from ljjax.errors import InputError
from ljjax.law.parts import Kind
from ljjax.model import Model, astype

RATE, SPREAD = 0.03, 0.2
"""Adam's first step, and how far restarts begin from the start (standard deviation), in widths of the box."""


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
    iterations: int = 30,
    progress: Callable[[str, int, int], None] | None = None,
    where: str = "model",
    spec_where: str = "specification",
) -> Tuned:
    """Tune a law's gains to a specification, on the robots that an uncertain model may be.

    Adam on the loss's logarithm, over coordinates in a box all of which is feasible (`ljjax.control.box`), from the
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
    """Losses (I, R), coordinates and gains (I, R, k) on the way of Adam, projected into the box."""
    start = problem.box.coordinates(problem.start)
    rng = np.random.default_rng([seed, 2])
    around = start + SPREAD * rng.standard_normal((restarts - 1, len(start)))
    u = jnp.asarray(np.concatenate([start[None], np.clip(around, 0.02, 0.98)]))
    schedule = optax.cosine_decay_schedule(RATE, iterations, alpha=0.05)
    descent = optax.adam(schedule, b1=0.8, b2=0.95)
    to_gains = jax.jit(jax.vmap(problem.box.gains))
    slopes = jax.jit(jax.vmap(jax.jacfwd(problem.box.gains)))
    state = jax.vmap(descent.init)(u)

    @jax.jit
    def move(u: Any, state: Any, gradient: Any) -> tuple[Any, Any]:
        def one(u: Any, state: Any, gradient: Any) -> tuple[Any, Any]:
            change, state = descent.update(gradient, state, u)
            return jnp.clip(u + change, 0.0, 1.0), state

        with jax.numpy_dtype_promotion("standard"):  # Optax takes whole numbers to a power
            return jax.vmap(one)(u, state, gradient)

    losses, places, points = [], [], []
    for k in range(iterations):
        gains = np.array(to_gains(u))
        if k == 0:
            gains[0] = problem.start  # to the last digit
        value, gradient = problem.value_and_gradient(gains)
        for kept, x in ((losses, value), (places, np.asarray(u)), (points, gains)):
            kept.append(x)
        downhill = np.einsum("rk,rkj->rj", gradient, np.asarray(slopes(u))) / value[:, None]  # of the log of the loss
        u, state = move(u, state, jnp.asarray(downhill))
        if progress:
            progress("tuning", k + 1, iterations)
    return np.stack(losses), np.stack(places), np.stack(points)


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
