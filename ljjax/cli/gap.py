"""`ljjax gap`: diagnose the sim-to-real gap."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro

from ljjax.errors import InputError


def command(
    logs: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="LOG…")],
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    model: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    mapping: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    held_out: Annotated[tuple[str, ...], tyro.conf.arg(metavar="LOG…")] = (),
    effects: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="FILE…")] = (),
    without: Annotated[tuple[str, ...], tyro.conf.arg(metavar="ID…")] = (),
    inputs: Literal["commands", "measured"] = "commands",
    seed: int = 0,
) -> None:
    """Find where a model and its robot disagree, which unmodelled effect causes it, and how far the gap closes with it.

    Writes gap.json, model.toml (base refitted, effects added), base.toml (base refitted), report.html,
    result.mcap and foxglove.json (its layout).
    The base parameters are refitted with every candidate; the gap is measured on runs that no fit has seen.

    Args:
        logs: MCAP files of one robot, folders (searched for *.mcap) or globs.
        out: Folder for the results.
        model: The robot's model.toml; without it OctRobot-I's.
        mapping: A mapping file (TOML) for logs that do not follow the contract.
        held_out: Logs on which the gap is measured; a quarter of the logs by default.
        effects: Python files that define effects of your own.
        without: Effects that are not on trial.
        inputs: Drive the model by the logs' commands, or by their measured tension and pressure.
        seed: Seed of what is random.
    """
    from ljjax.cli import progress, start_jax

    start_jax()
    from ljjax import effects as library
    from ljjax import modelfile
    from ljjax.gap import diagnose
    from ljjax.gap.show import show
    from ljjax.logs import find, load_mapping, read_all

    for file in effects:
        library.load(file)
    start = None if model is None else modelfile.load(model)
    if not logs:
        raise InputError("no log given; expected files, folders or globs of *.mcap (before options that take several)")
    how = None if mapping is None else load_mapping(mapping)
    runs = read_all(find(logs), how)
    tests = read_all(find(held_out), how) if held_out else []
    with progress() as tell:
        found = diagnose(
            start, runs, held_out=tests, without=without, inputs=inputs, seed=seed, model_from=str(model), progress=tell
        )
    found.save(out)
    show(found, out)
