"""`ljjax sweep`: simulate a robot over ranges of its parameters."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Literal

import tyro

from ljjax.errors import InputError


def command(
    model: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MODEL")],
    logs: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[LOG…]")],
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    vary: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="PATH=VALUES")] = (),
    list: Annotated[Path | None, tyro.conf.arg(metavar="FILE.csv")] = None,
    how: Literal["grid", "zip", "samples"] = "grid",
    samples: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    seed: int = 0,
    inputs: Literal["commands", "measured"] = "commands",
    mapping: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    step_s: float = 0.0025,
    batch: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    errors: bool = True,
    trajectories: bool = True,
) -> None:
    """Simulate every log with every parameter set; writes sweep.nc (NetCDF) and report.html.

    Without a log, a standard manoeuvre: bend, draw a vacuum, let go, vent, pull back. Interrupted or killed, the same
    command goes on where it was.

    Args:
        model: The robot, a model.toml.
        logs: MCAP files, folders (searched for *.mcap) or globs; none for the standard manoeuvre.
        out: Folder for the results.
        vary: What to vary, as often as needed: friction.mu_s=0.003:0.008:50 (low:high:count, with :log in even ratios),
            jamming.c5=3,4,5, or for samples a range low:high. Also initial.theta, in rad.
        list: A CSV file of parameter sets: paths in the first line, then a set a line. Instead of --vary.
        how: Every value with every other, the first of each, the second of each, …, or samples of ranges.
        samples: How many samples (with --how samples, which it implies).
        seed: Seed of the samples.
        inputs: Drive the model by the logs' commands, or by their measured tension and pressure.
        mapping: A mapping file (TOML) for logs that do not follow the contract.
        step_s: Step of the solver, in s.
        batch: Elements at a time; chosen from the free memory without it.
        errors: Estimate each element's error by halving the step, at three times the cost.
        trajectories: Keep the angle over time, not only outputs such as its final value.
    """
    from ljjax.cli import start_jax

    start_jax(large=True)
    from ljjax.logs import find, load_mapping, read_all
    from ljjax.sweep import sweep
    from ljjax.sweep_plan import parse, read_columns
    from ljjax.sweep_run import standard_manoeuvre

    if list is not None and (vary or how == "samples" or samples is not None):
        raise InputError(f"--list {list} with --vary or samples; give the parameter sets in one way")
    if samples is not None and how == "grid":
        how = "samples"
    if list is not None:
        how, sets = "zip", read_columns(list)
    else:
        sets = {}
        for text in vary:
            path, values = parse(text, how)
            if path in sets:
                raise InputError(f"--vary {text}: {path} is varied already; give all its values at once")
            sets[path] = values
    if not sets and not logs:
        raise InputError("nothing to sweep over; give --vary PATH=LOW:HIGH:COUNT, --list FILE.csv, or logs")
    if batch is not None and batch < 1:
        raise InputError(f"--batch {batch}: expected a number of elements ≥ 1")
    runs = read_all(find(logs), None if mapping is None else load_mapping(mapping)) if logs else standard_manoeuvre()
    try:
        result = sweep(
            model,
            runs,
            sets,
            how=how,
            samples=samples,
            seed=seed,
            inputs=inputs,
            step_s=step_s,
            errors=errors,
            trajectories=trajectories,
            batch=batch,
            out=out,
        )
    except KeyboardInterrupt:
        print(f"ljjax: interrupted; what is done is kept in {out}: the same command goes on", file=sys.stderr)
        raise SystemExit(130) from None
    print(result)
    print(f"Written: {out / 'sweep.nc'}, {out / 'report.html'}")
