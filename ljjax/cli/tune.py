"""`ljjax tune`: a control law's gains, tuned through the simulated closed loop."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro

from ljjax.cli.limits import DEFAULTS, Flags
from ljjax.errors import InputError


def command(
    model: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MODEL")],
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    law: Literal["passivity", "integral", "observer"] = "integral",
    spec: Annotated[Path | None, tyro.conf.arg(metavar="FILE.toml")] = None,
    gain: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE…")] = (),
    free: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME…")] = (),
    samples: int = 8,
    restarts: int = 2,
    iterations: int = 20,
    seed: int = 0,
    limits: Flags = DEFAULTS,
) -> None:
    """Tune a control law's gains to a specification; writes law.json, tune.json and report.html.

    Simulates the closed loop with sampling, delay, noise, saturation, friction and the model's effects, and follows its
    derivatives by the gains. Where model.toml states standard deviations, the law is tuned on robots drawn within them
    and checked on others.

    Args:
        model: The robot, a model.toml; all its effects are simulated, the law knows those that `export` counts.
        out: Folder for the results.
        law: The published law, the same with integral action, or with a LuGre observer beside it.
        spec: What is wanted (TOML, docs/control.md): targets, limits, weights; without it three targets within reach.
        gain: Gains to start from, such as gamma=0.5; the others are chosen from the model.
        free: Gains to tune; by default all that the law uses.
        samples: How many robots to tune on, where the model is uncertain.
        restarts: How many starting points to try, side by side.
        iterations: Steps of the descent, from every starting point.
        seed: Seed of robots, noise and starting points.
    """
    from ljjax.cli import progress, start_jax
    from ljjax.cli.export import read_gains

    start_jax()
    from ljjax import modelfile
    from ljjax.control import tune
    from ljjax.control.spec import load
    from ljjax.control.tune_report import save, show

    for name, value, least in (("samples", samples, 1), ("restarts", restarts, 1), ("iterations", iterations, 1)):
        if value < least:
            raise InputError(f"--{name} {value}: expected a whole number from {least} on")
    if seed < 0:
        raise InputError(f"--seed {seed}: expected a whole number from 0 on")
    loaded = modelfile.load(model)
    wanted = None if spec is None else load(spec)
    with progress() as tell:
        tuned = tune(
            loaded.model,
            law,
            wanted,
            gains=read_gains(gain, law),
            free=free or None,
            hardware=limits.hardware(),
            uncertainty=loaded.uncertainty,
            samples=samples,
            seed=seed,
            restarts=restarts,
            iterations=iterations,
            progress=tell,
            where=str(model),
            spec_where=str(spec or "specification"),
        )
    save(tuned, out, model_path=model, keep=() if spec is None else (spec,))
    show(tuned, out)
