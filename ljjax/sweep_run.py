"""A sweep's runs and batches: every run as arrays of one shape, parameter sets through one compiled program."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ljjax import batch, fast
from ljjax.dynamics import State
from ljjax.errors import InputError
from ljjax.inputs import Inputs, from_run
from ljjax.logs.run import Run
from ljjax.model import UNITS, Model, check, replace
from ljjax.simulation import ITERATIONS, initial_shape, rest

STAMPS = 500
"""Reported stamps of a run, unless asked for others."""
LARGEST_BATCH = 1024
SAME_SHAPE = 1.25
"""Runs whose numbers of steps differ by less than this factor are padded to one length, and compiled once."""


class Case(NamedTuple):
    """A run ready to simulate: inputs, the first shape (n,) [rad], all stamps (T,) [s], the indices (K,) of those that
    are reported, measured θ (T,) [rad] with NaN where there is none, the first step's start [s] and the steps."""

    inputs: Inputs
    shape: np.ndarray
    stamps: np.ndarray
    keep: np.ndarray
    measured: np.ndarray
    start: float
    steps: int


def case(
    run: Run | Inputs, where: str, n: int, source: Literal["commands", "measured"], at: Any, step_s: float
) -> Case:
    """A run as a case. `at`: the stamps to report, or None for the run's shape stamps, at most `STAMPS` of them.

    Raises:
        InputError: signals that are missing, numbers that are not finite, stamps that go back.
    """
    inputs = from_run(run, source) if isinstance(run, Run) else run
    for name in ("t", "tendons", "pressure_kpa", "torque"):
        x = getattr(inputs, name)
        if x is not None and not np.isfinite(np.asarray(x)).all():
            raise InputError(f"{where}: inputs: {name} holds values that are not finite numbers")
    if isinstance(run, Run):
        shape, first = run.signal("shape"), np.asarray(initial_shape(run, n))
        seen, theta = np.unique(shape.t, return_index=True)
        theta = shape.value.mean(axis=1)[theta]
        every = seen[:: -(-len(seen) // STAMPS)]
    else:
        t = np.asarray(inputs.t)
        seen, theta, first = t[:0], t[:0], np.zeros(n)
        every = np.linspace(t[0], t[-1], STAMPS + 1) if t[-1] > t[0] else t[-1:]
    reported = every if at is None else np.atleast_1d(np.asarray(at, dtype=float))
    if reported.ndim != 1 or not len(reported) or not np.isfinite(reported).all() or np.any(np.diff(reported) <= 0):
        raise InputError(f"{where}: at: expected a row of stamps [s] that increase")
    if np.any(np.diff(np.asarray(inputs.t)) < 0):
        raise InputError(f"{where}: the stamps t go back in time; sort them")
    stamps = np.union1d(reported, seen if len(seen) else every)
    measured = np.full(len(stamps), np.nan)
    measured[np.searchsorted(stamps, seen)] = theta
    start, steps = fast.grid(inputs, stamps, step_s)
    return Case(inputs, first, stamps, np.searchsorted(stamps, reported), measured, start, steps)


def alike(cases: Sequence[Case]) -> list[Case]:
    """The same runs, those of similar length padded to one shape: the last values and stamps are repeated, and steps
    go on behind the last stamp."""

    def longer(x: Any, size: int) -> np.ndarray:
        x = np.asarray(x)
        return np.concatenate([x, np.repeat(x[-1:], size - len(x), axis=0)])

    out: dict[int, Case] = {}
    waiting = sorted(range(len(cases)), key=lambda i: cases[i].steps)
    while waiting:
        group = [i for i in waiting if cases[i].steps <= SAME_SHAPE * cases[waiting[0]].steps]
        waiting = waiting[len(group) :]
        length, stamps, kept, steps = (
            max(size(cases[i]) for i in group)
            for size in (lambda c: len(c.inputs.t), lambda c: len(c.stamps), lambda c: len(c.keep), lambda c: c.steps)
        )
        for i in group:
            c = cases[i]
            inputs = jax.tree.map(lambda x, length=length: jnp.asarray(longer(x, length)), c.inputs)
            measured = np.concatenate([c.measured, np.full(stamps - len(c.stamps), np.nan)])
            out[i] = Case(inputs, c.shape, longer(c.stamps, stamps), longer(c.keep, kept), measured, c.start, steps)
    return [out[i] for i in range(len(cases))]


def shapes(columns: Mapping[str, np.ndarray], base: np.ndarray, count: int) -> np.ndarray:
    """(count, n) initial shapes [rad]: `base` (n,), `initial.theta` for all joints, `initial.q1` … for one."""
    q = np.tile(base, (count, 1))
    for path in sorted(columns, key=lambda path: path != "initial.theta"):
        if path == "initial.theta":
            q[:] = columns[path][:, None]
        elif path.startswith("initial.q"):
            q[:, int(path[9:]) - 1] = columns[path]
    return q


def inadmissible(model: Model, columns: Mapping[str, np.ndarray], count: int, pressures: Sequence[float]) -> list[str]:
    """For each parameter set, why it is impossible within the pressures [kPa]; empty where it is possible."""
    copy = jax.tree.map(np.asarray, model)  # changed in place below: far faster than a new model each
    own = [(getattr(copy, path.split(".")[0]), path.split(".")[1], x) for path, x in columns.items() if path in UNITS]
    reasons = []
    for i in range(count):
        reason = next(
            (f"{path} = {x[i]:g}: must be a finite number" for path, x in columns.items() if not np.isfinite(x[i])), ""
        )
        for table, name, x in own:
            object.__setattr__(table, name, x[i])
        try:
            check(copy, (min(pressures), max(pressures)), where="")
        except InputError as error:
            reason = reason or str(error).removeprefix(": ")
        reasons.append(reason)
    return reasons


@cache
def _program(paths: tuple[str, ...], errors: bool, free_start: bool) -> Callable:
    """The compiled function of a batch; `free_start`: elements start at rest in their own shapes."""

    def one(values, shape, model: Model, initial, case: Any, h, steps: int):
        own = replace(model, dict(zip(paths, values, strict=True)))
        first = rest(own, case.inputs, shape) if free_start else initial
        given = (own, case.inputs, first, case.stamps, jnp.asarray(case.start, h.dtype), h, steps, ITERATIONS)
        motion, error = fast.halved(*given) if errors else (fast.run(*given), jnp.full_like(h, jnp.nan))
        theta = jnp.mean(motion.seen, axis=-1)
        known = jnp.isfinite(case.measured)
        square = jnp.where(known, theta - case.measured, jnp.zeros_like(theta)) ** 2
        u = fast.means(case.inputs, case.stamps)[0]
        pull = jnp.where(jnp.diff(case.stamps) > 0, u[:, 0] - u[:, 1], jnp.zeros_like(u[:, 0]))
        finite = jnp.all(jnp.isfinite(jnp.concatenate(motion, axis=-1)), axis=-1)
        return {
            "theta": theta[case.keep],
            "theta_final": theta[-1],
            "theta_max": jnp.max(theta),
            "theta_min": jnp.min(theta),
            "rms_error": jnp.sqrt(jnp.sum(square) / jnp.sum(known).astype(h.dtype)),
            "loop_area": jnp.sum(pull * jnp.diff(theta)),
            "error_estimate": error,
            "lost_at": jnp.where(jnp.all(finite), jnp.full_like(h, jnp.nan), case.stamps[jnp.argmin(finite)]),
        }

    many = jax.vmap(one, in_axes=(0, 0, None, None, None, None, None))
    return jax.jit(many, static_argnums=6, compiler_options=batch.options())


def simulate_batch(
    model: Model,
    case: Case,
    columns: Mapping[str, np.ndarray],
    shape: np.ndarray,
    initial: State | None,
    step_s: float,
    errors: bool,
) -> dict[str, np.ndarray]:
    """Outputs of a batch, each (B,) and θ (B, K): parameters `columns` (path → (B,)), first shapes `shape` (B, n)."""
    paths = tuple(path for path in columns if path in UNITS)
    dtype = case.inputs.t.dtype
    values = jnp.asarray(np.stack([columns[p] for p in paths], axis=1) if paths else np.zeros((len(shape), 0)), dtype)
    arrays = case._replace(stamps=jnp.asarray(case.stamps, dtype), measured=jnp.asarray(case.measured, dtype), steps=0)
    run = _program(paths, errors, initial is None)
    out = run(values, jnp.asarray(shape, dtype), model, initial, arrays, jnp.asarray(step_s, dtype), case.steps)
    return {name: np.asarray(x) for name, x in out.items()}


def batch_size(count: int, cases: Sequence[Case], n: int, errors: bool) -> int:
    """Elements at a time: as many as a quarter of the free memory holds, at most `LARGEST_BATCH`, and evenly shared."""
    steps = max((c.steps for c in cases), default=1)
    stamps = max((len(c.stamps) for c in cases), default=1)
    an_element = 8 * (12 * n * steps * (2 if errors else 1) + 16 * n * stamps)
    most = int(max(1, min(LARGEST_BATCH, free_bytes() / 4 // an_element)))
    batches = -(-count // most)
    return max(1, -(-count // batches))


def free_bytes() -> float:
    """Memory to count on: the accelerator's, or what the system calls available; 2 GiB where nobody says."""
    said = jax.devices()[0].memory_stats() if jax.default_backend() != "cpu" else None
    if said and "bytes_limit" in said:
        return said["bytes_limit"] - said.get("bytes_in_use", 0)
    try:
        with open("/proc/meminfo", encoding="ascii") as lines:
            return next(1024.0 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable"))
    except (OSError, StopIteration):
        pass
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2
    except (AttributeError, ValueError, OSError):
        return 2.0**31


def standard_manoeuvre() -> dict[str, Inputs]:
    """For sweeps without a log, 7 s: bend with 15 N, draw 30 kPa, let go (the shape is locked), vent, pull back with
    15 N, let go."""
    t = [0.0, 1.0, 1.5, 2.0, 2.5, 3.0, 3.8, 4.3, 4.8, 5.8, 6.2, 6.7, 7.0]
    left = [0.0, 15.0, 15.0, 15.0, 15.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    right = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 15.0, 15.0, 0.0, 0.0]
    vacuum = [0.0, 0.0, 0.0, 30.0, 30.0, 30.0, 30.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    tendons = jnp.stack([jnp.asarray(left), jnp.asarray(right)], axis=1)
    return {"standard manoeuvre": Inputs(jnp.asarray(t), tendons, jnp.asarray(vacuum), hold=False)}
