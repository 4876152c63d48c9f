"""The recovery study: `python -m benchmarks.recovery.study`, or `make recovery`.

Simulated robots with known parameters are identified from noisy logs, beginning from guesses 10 to 30 % off. Prints how
often and how closely the truth is found, and writes OUT/recovery.json. The logs stay in OUT/logs and are used again.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.progress import Progress, track
from rich.table import Table

from benchmarks.recovery import evaluate, logs, plant
from benchmarks.recovery.experiments import PERIOD_S, plan
from benchmarks.recovery.robots import GEOMETRY, Robot, draw
from ljjax.inputs import Inputs
from ljjax.logs import Run, find, read_all
from ljjax.model import TABLES, Model
from ljjax.modelfile import ModelFile
from ljjax.outputs import artefacts
from ljjax.simulation import simulate

Fitted = Mapping[str, Any]
"""A FitResult by robot, or the exception that took its place."""
Fitter = Callable[[Mapping[str, Sequence[Run]], Mapping[str, ModelFile]], Fitted]
CHECKED = 4
"""Robots whose simulation is repeated with half the step."""


def model_of(values: Mapping[str, float]) -> Model:
    """The ljjax model with these parameters."""
    parts: dict[str, Any] = {table: {} for table in TABLES}
    for path, value in values.items():
        table, name = path.split(".")
        parts[table][name] = value
    return Model(**{table: kind(**parts[table]) for table, kind in TABLES.items()})  # pyright: ignore[reportArgumentType]


def side_by_side(runs: Mapping[str, Sequence[Run]], starts: Mapping[str, ModelFile]) -> Fitted:
    """`fit_many`; what kept a robot from a result is that robot's failure."""
    from ljjax.fit import fit_many

    with Progress(console=Console(stderr=True)) as bar:
        tasks: dict[str, Any] = {}

        def tell(stage: str, done: int, count: int) -> None:
            if stage not in tasks:
                tasks[stage] = bar.add_task(stage, total=count)
            bar.update(tasks[stage], completed=done)

        return fit_many(starts, runs, model_from="a wrong guess", progress=tell)


def study(
    count: int, seconds: float, seed: int, out: Path, fitter: Fitter = side_by_side, workers: int | None = None
) -> dict[str, Any]:
    """Make the logs, fit, evaluate; returns what `recovery.json` holds."""
    robots = draw(count, seed)
    bar = Console(stderr=True)
    for done in logs.make(robots, out / "logs", seconds, seed, workers or os.cpu_count() or 1):
        bar.print(f"logs of {done} of {count} robots")
    train = {r.robot_id: read_all(find([str(out / "logs" / r.robot_id / "train")])) for r in robots}
    starts = {
        r.robot_id: ModelFile(model_of(r.start), frozen=r.known, free=tuple(set(GEOMETRY) - set(r.known)))
        for r in robots
    }
    fitted = fitter(train, starts)

    rows, failures, held_out = [], [], []
    for robot in track(robots, "free runs", console=bar):
        result = fitted.get(robot.robot_id, KeyError("no result"))
        try:
            if isinstance(result, BaseException):
                raise result
            new = evaluate.estimates(robot, result.parameters)
            tests = read_all(find([str(out / "logs" / robot.robot_id / "held_out")]))
            errors = (free_run(result.model, tests), free_run(model_of(robot.truth), tests))
        except Exception as error:
            failures.append(evaluate.Failure(robot.robot_id, f"{type(error).__name__}: {error}"))
            continue
        rows += new
        held_out.append(evaluate.HeldOut(robot.robot_id, *errors))
    figures = evaluate.summary(robots, rows, failures, held_out)
    return {**figures, "seconds": seconds, "seed": seed}


def free_run(model: Model, runs: Sequence[Run]) -> float:
    """RMS of measured − simulated θ [rad] over runs, simulated from straight rest by their commands alone."""
    square, count = 0.0, 0
    for run in runs:
        shape = run.signal("shape")
        # On the full grid, so that all runs have one shape and the solver is compiled once.
        t = np.arange(round(shape.t[-1] / PERIOD_S) + 1) * PERIOD_S
        u, p = run.signal("cmd_tendons").held_at(t + 1e-6), run.vacuum_kpa("cmd_pressure").held_at(t + 1e-6)[:, 0]
        motion = simulate(model, Inputs(jnp.asarray(t), jnp.asarray(u), jnp.asarray(p)), at=shape.t)
        error = shape.value.mean(axis=1) - np.asarray(motion.theta)
        square, count = square + float(error @ error), count + len(error)
    return float(np.sqrt(square / count))


def halved(robots: Sequence[Robot], seconds: float, seed: int) -> dict[str, float]:
    """How far half the step moves the simulated angles [degrees], of the first robots' runs."""
    plans = [plan(robot, seconds, seed) for robot in robots]
    coarse, fine = (np.degrees(np.concatenate(logs.simulate(robots, plans, plant.STEP_S / k))) for k in (1, 2))
    theta = np.sqrt(np.mean((coarse - fine).mean(axis=2) ** 2, axis=1))
    return {
        "step_s": plant.STEP_S,
        "median_rms_theta_deg": float(np.median(theta)),
        "worst_rms_theta_deg": float(theta.max()),
        "noise_theta_deg": float(np.degrees(logs.THETA_SD_RAD)),
    }


def show(found: Mapping[str, Any], console: Console) -> None:
    """The study on a terminal."""
    table = Table("goal", "asked", "found", "", title=f"Recovery of {found['robots']} simulated robots")
    goals = found["goals"]
    low, high = goals["within_2_sd"]["goal"]
    asked = {
        "within_2_sd": ("estimates within 2 sd", f"{100 * low:.0f} to {100 * high:.0f} %", 100),
        "median_error": ("median error, identifiable", f"≤ {100 * evaluate.MEDIAN_ERROR:.0f} %", 100),
        "free_run_ratio": ("held-out free-run error ÷ truth's", f"≤ {evaluate.RATIO} for every robot", 1),
    }
    for name, (words, goal, scale) in asked.items():
        text = _number(goals[name]["found"], scale)
        if name == "free_run_ratio" and goals[name]["worst"] is not None:
            within = 100 * goals[name]["robots_within"]
            text += f" (median), {goals[name]['worst']:.3f} (worst); {within:.0f} % of robots within"
        table.add_row(words, goal, text, "[green]met[/]" if goals[name]["met"] else "[red]missed[/]")
    console.print(table)
    figures = {"within_2_sd": 100, "median_error": 100, "median_sd": 100, "spread_of_z": 1, "mean_z": 1}
    for title in ("parameters", "kinds"):
        table = Table(
            title, "estimates", "identifiable", *(k.replace("_", " ") + " %" * (s > 1) for k, s in figures.items())
        )
        for name, d in [*found[title].items(), ("all", found["overall"])]:
            counts = (str(d["estimates"]), str(d["identifiable"]))
            table.add_row(name, *counts, *(_number(d.get(k), s) for k, s in figures.items()))
        console.print(table)
    for failure in found["failures"]:
        console.print(
            f"failed: {failure['robot_id']}: {failure['why']}", markup=False, no_wrap=True, overflow="ellipsis"
        )
    p = found["plant"]
    console.print(
        f"Simulator: half the step moves θ by {p['median_rms_theta_deg']:.1e}° RMS in the median run, "
        f"{p['worst_rms_theta_deg']:.1e}° in the worst; noise {p['noise_theta_deg']:.4f}°"
    )


def _number(x: float | None, scale: float) -> str:
    return "–" if x is None else f"{scale * x:.3g}"


def main() -> None:
    import jax

    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", type=int, default=40)
    parser.add_argument("--seconds", type=float, default=14.0, help="length of a run")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("out/recovery"))
    given = parser.parse_args()
    found = study(given.robots, given.seconds, given.seed, given.out)
    found["plant"] = halved(draw(CHECKED, given.seed), given.seconds, given.seed)
    with artefacts(given.out) as folder:
        (folder / "recovery.json").write_text(json.dumps(found, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    show(found, Console(width=None if sys.stdout.isatty() else 140))


if __name__ == "__main__":
    main()
