"""Sweep a robot over parameters, runs and initial shapes, in batches, into one file that explains itself.

    from ljjax.sweep import sweep
    result = sweep("model.toml", run, {"friction.mu_s": np.linspace(0.003, 0.008, 50)}, out="out/sweep")
    result["theta_final"]  # (runs, 50) [rad]

An element is one run with one parameter set. One that cannot be simulated is named in the result and leaves the others
alone.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal, NamedTuple

import jax
import numpy as np

from ljjax import modelfile, sweep_file, sweep_run
from ljjax.dynamics import State
from ljjax.errors import InputError
from ljjax.inputs import Inputs
from ljjax.logs.run import Run
from ljjax.model import UNITS, Model, get
from ljjax.simulation import SENSITIVE_RAD
from ljjax.sweep_file import Unfinished
from ljjax.sweep_plan import How, Plan, plan
from ljjax.sweep_result import FILE, Sweep, describe, load
from ljjax.sweep_run import Case

__all__ = ["Sweep", "load", "sweep"]

PARTIAL = "sweep.partial"
"""Folder, beside the result to be, of the batches that are done."""


def sweep(
    model: Model | str | os.PathLike[str],
    runs: Run | Inputs | Sequence[Run | Inputs] | Mapping[str, Run | Inputs],
    vary: Mapping[str, Any] | None = None,
    *,
    how: How = "grid",
    samples: int | None = None,
    seed: int = 0,
    initial: State | float | Sequence[float] | np.ndarray | None = None,
    at: Any = None,
    inputs: Literal["commands", "measured"] = "commands",
    step_s: float = 0.0025,
    errors: bool = True,
    trajectories: bool = True,
    batch: int | None = None,
    out: str | os.PathLike[str] | None = None,
    progress: bool | Callable[[int, int], None] | None = None,
) -> Sweep:
    """Simulate every run with every parameter set.

    With `out`, finished batches are kept in `out/sweep.partial` until the sweep is whole: the same call after a crash
    goes on where it was, and a call that finds its own `sweep.nc` reads it.

    Args:
        model: the robot, or its model.toml.
        runs: logged runs or synthetic inputs, one or many; names for them as a mapping's keys.
        vary: path → values, for parameters as in `ljjax.model.UNITS`, and `initial.theta` [rad] (all joints) or
            `initial.q1`, … (one joint) for the shape at rest from which a run starts. See `ljjax.sweep_plan.plan`.
        how: `"grid"`, `"zip"` (columns side by side) or `"samples"` (of ranges).
        samples, seed: of samples, how many and from which seed.
        initial: a state, or a shape [rad] (a number, or one a joint) at rest; by default at rest in the shape that the
            run shows before its commands move, straight for synthetic inputs.
        at: (K,) stamps [s] at which θ is reported; by default the run's shape stamps, thinned to at most 500.
        inputs: drive logged runs by their commands, or by measured tension and pressure.
        step_s: length of a step [s].
        errors: estimate each element's error by halving the step, at three times the cost.
        trajectories: report θ over time, not only the outputs of `OUTPUTS`.
        batch: elements at a time; chosen from the memory that is free by default.
        out: a folder for `sweep.nc` and `report.html`.
        progress: a function of (elements done, elements in all); or whether to show a bar, by default on a terminal.

    Raises:
        InputError: input that is no use, an `out` that holds another sweep, or no element that is admissible.
    """
    source = "" if isinstance(model, Model) else os.fspath(model)
    robot = model if isinstance(model, Model) else modelfile.load(model).model
    if not 1e-6 <= step_s <= 0.1:
        raise InputError(f"step_s is {step_s:g}; expected a step between 1e-6 and 0.1 s, such as 0.0025")
    if batch is not None and batch < 1:
        raise InputError(f"batch is {batch}; expected a number of elements ≥ 1")
    named = _named(runs)
    sets = plan(vary or {}, how, samples, seed)
    _check_joints(sets, robot.n)
    first = _first(initial, robot.n, sets)
    cases = [sweep_run.case(run, name, robot.n, inputs, at, step_s) for name, run in named]
    if isinstance(first, np.ndarray):
        cases = [c._replace(shape=first) for c in cases]
    reported = max(len(c.keep) for c in cases) if trajectories else 0
    if (size := 8 * len(cases) * sets.count * reported) > sweep_file.LARGEST:
        raise InputError(
            f"θ at {reported} stamps of {len(cases) * sets.count:,} elements is {size / 1e9:.1f} GB, and a file holds "
            "2.1 GB; ask for fewer stamps (at), or for outputs alone (trajectories=False, --no-trajectories)"
        )
    ranges = [(float(p.min()), float(p.max())) for p in (np.asarray(c.inputs.pressure_kpa) for c in cases)]
    why = {key: sweep_run.inadmissible(robot, sets.columns, sets.count, key) for key in dict.fromkeys(ranges)}
    reasons = [why[key] for key in ranges]
    if all(all(own) for own in reasons):
        raise InputError(f"{source or 'model'}: no element is admissible; the first: {reasons[0][0]}")

    identity = {
        "ljjax": version("ljjax"),
        "model": {path: float(get(robot, path)) for path in UNITS}
        | {"segments": robot.n, "constant_mass": robot.constant_mass, "lever": getattr(robot.lever, "__qualname__", "")}
        | {"effects": str(jax.tree.map(lambda x: np.asarray(x).tolist(), robot.effects))},
        "runs": [name for name, _ in named],
        "inputs": [_digest(*jax.tree.leaves(c._replace(steps=0)), str(c.inputs.hold)) for c in cases],
        "vary": {path: _digest(x) for path, x in sets.values.items()},
        "how": how,
        "initial": "" if first is None else _digest(*jax.tree.leaves(first)),
        "step_s": step_s,
        "errors": errors,
        "trajectories": trajectories,
    }
    size = batch or sweep_run.batch_size(sets.count, cases, robot.n, errors)
    unfinished, begun = None, {"identity": identity, "created_utc": _now(), "batch": size}
    if out is not None:
        found = _finished(Path(out), identity)
        unfinished = Unfinished(Path(out) / PARTIAL)
        if found is not None:
            unfinished.remove()
            return found
        there = unfinished.plan()
        if there is not None:
            _same(unfinished.folder, there.get("identity", {}), identity)
            begun = there
        else:
            unfinished.begin(begun)
    fixed = first if isinstance(first, State) else None
    options = _Options(fixed, begun["batch"], step_s, errors, trajectories)
    with _shown(progress, sum(not reason for own in reasons for reason in own)) as tell:
        results = _simulate(robot, cases, sets, reasons, options, unfinished, tell)
    variables = describe(named, cases, sets, reasons, results, trajectories)
    attributes = {
        "title": "Parameter sweep of a layer-jamming continuum robot",
        "Conventions": "CF-1.11",
        "source": f"ljjax {version('ljjax')}",
        "history": f"{begun['created_utc']}: {' '.join(map(str, sys.argv)) if sys.argv[0] else 'ljjax.sweep.sweep'}",
        "created_utc": begun["created_utc"],
        "model_file": source,
        "model_sha256": hashlib.sha256(Path(source).read_bytes()).hexdigest() if source else "",
        "model_parameters": json.dumps(identity["model"]),
        "how": how,
        "seed": seed,
        "step_s": step_s,
        "inputs": inputs,
        "sensitive_rad": SENSITIVE_RAD,
        "identity": json.dumps(identity),
    }
    result = Sweep(variables, attributes)
    if out is not None:
        result.save(out)
    if unfinished is not None:
        unfinished.remove()
    return result


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def _named(runs: Any) -> list[tuple[str, Run | Inputs]]:
    if isinstance(runs, Run | Inputs):
        runs = [runs]
    if isinstance(runs, Mapping):
        named = list(runs.items())
    else:
        runs = list(runs)
        ids = [run.run_id if isinstance(run, Run) else f"inputs {i}" for i, run in enumerate(runs, 1)]
        named = [
            (run.path if isinstance(run, Run) and ids.count(name) > 1 else name, run)
            for name, run in zip(ids, runs, strict=True)
        ]
    for name, run in named:
        if not isinstance(run, Run | Inputs):
            raise InputError(f"runs: {name} is a {type(run).__name__}; expected a Run (ljjax.read) or Inputs")
    if not named:
        raise InputError("no run given; expected one Run or Inputs, or more")
    return named


def _check_joints(sets: Plan, n: int) -> None:
    for path in sets.values:
        if path.startswith("initial.q") and not 1 <= int(path[9:]) <= n:
            raise InputError(f"vary: no joint {path!r}; the model has {n} segments: initial.q1 to initial.q{n}")


def _first(initial: Any, n: int, sets: Plan) -> State | np.ndarray | None:
    """The state, or the shape (n,), that was given for the start, if any."""
    if isinstance(initial, State):
        if varied := [path for path in sets.values if path.startswith("initial.")]:
            raise InputError(f"initial is a State and {varied[0]} is varied; give a shape, or vary no shape")
        return initial
    if initial is None:
        return None
    shape = np.asarray(initial, dtype=float)
    if shape.shape not in ((), (n,)) or not np.isfinite(shape).all():
        raise InputError(f"initial: expected a State, an angle, or {n} angles [rad]")
    return np.broadcast_to(shape, (n,))


def _digest(*parts: Any) -> str:
    found = hashlib.sha256()
    for part in parts:
        x = np.asarray(part)
        found.update(f"{x.dtype} {x.shape}".encode() + np.ascontiguousarray(x).tobytes())
    return found.hexdigest()


def _finished(folder: Path, identity: Mapping[str, Any]) -> Sweep | None:
    if not (folder / FILE).exists():
        return None
    found = load(folder)
    _same(folder / FILE, json.loads(found.attributes["identity"]), identity)
    return found


def _same(place: Path, there: Mapping[str, Any], here: Mapping[str, Any]) -> None:
    here = json.loads(json.dumps(here))
    differing = [key for key in here if there.get(key) != here[key]]
    if differing:
        raise InputError(
            f"{place}: is of another sweep (it differs in {', '.join(differing)}); choose another out, or delete it"
        )


class _Options(NamedTuple):
    initial: State | None
    batch: int
    step_s: float
    errors: bool
    trajectories: bool


def _simulate(
    robot: Model,
    cases: Sequence[Case],
    sets: Plan,
    reasons: Sequence[Sequence[str]],
    options: _Options,
    unfinished: Unfinished | None,
    tell: Callable[[int], object],
) -> dict[str, np.ndarray]:
    """Outputs of all elements, each (R, S) and θ (R, S, K): NaN where an element was not simulated."""
    kept = max(len(c.keep) for c in cases)
    found: dict[str, np.ndarray] = {}
    done = 0
    for r, case in enumerate(sweep_run.alike(cases)):
        admissible = np.flatnonzero([not reason for reason in reasons[r]])
        for k in range(0, len(admissible), options.batch):
            chosen = admissible[k : k + options.batch]
            name = f"{r:05d}-{k // options.batch:06d}"
            out = None if unfinished is None else unfinished.get(name)
            if out is None:
                full = np.resize(chosen, options.batch)  # the last batch is filled up with repeats
                columns = {path: x[full] for path, x in sets.columns.items()}
                shape = sweep_run.shapes(columns, case.shape, options.batch)
                out = sweep_run.simulate_batch(
                    robot, case, columns, shape, options.initial, options.step_s, options.errors
                )
                out = {key: x[: len(chosen)] for key, x in out.items() if options.trajectories or key != "theta"}
                if unfinished is not None:
                    unfinished.put(name, out)
            for key, x in out.items():
                tail = (kept,) if key == "theta" else ()
                to = found.setdefault(key, np.full((len(cases), sets.count, *tail), np.nan, x.dtype))
                to[r, chosen] = _filled(x[:, : len(cases[r].keep)], kept) if tail else x
            done += len(chosen)
            tell(done)
    return found


def _filled(theta: np.ndarray, kept: int) -> np.ndarray:
    return np.pad(theta, ((0, 0), (0, kept - theta.shape[1])), constant_values=np.nan)


@contextmanager
def _shown(progress: Any, total: int) -> Iterator[Callable[[int], object]]:
    if callable(progress):
        tell = progress
        yield lambda done: tell(done, total)
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeElapsedColumn, TimeRemainingColumn

    console = Console(stderr=True)
    shown = console.is_terminal if progress is None else progress
    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress("sweep", *columns, console=console, disable=not shown) as bar:
        task = bar.add_task("sweep", total=total)
        yield lambda done: bar.update(task, completed=done)
