"""`ljjax tune`: a control law's gains, tuned through the simulated closed loop."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

import tyro

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
    iterations: int = 30,
    seed: int = 0,
    rate_hz: float = 200.0,
    theta_max_deg: Annotated[float | None, tyro.conf.arg(metavar="DEG")] = None,
    tension_min_n: float = 0.5,
    tension_max_n: float = 60.0,
    co_contraction_n: float = 2.0,
    tension_slew_n_s: float = 400.0,
    vacuum_max_kpa: float = 40.0,
    vacuum_slew_kpa_s: float = 50.0,
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
        rate_hz: Rate of the loop, in Hz.
        theta_max_deg: Largest segment angle to command, in degrees; by default as far as the tensions reach.
        tension_min_n: Least tension of a tendon, in N.
        tension_max_n: Largest tension of a tendon, in N.
        co_contraction_n: Mean tension of the two tendons where the net tension allows, in N.
        tension_slew_n_s: How fast a tension may change, in N/s.
        vacuum_max_kpa: Highest vacuum, in kPa below atmosphere.
        vacuum_slew_kpa_s: How fast the vacuum may change, in kPa/s.
    """
    from ljjax.cli import progress, start_jax
    from ljjax.cli.export import read_gains

    start_jax()
    from ljjax import modelfile
    from ljjax.control import Hardware, tune
    from ljjax.control.spec import load
    from ljjax.control.tune_report import save, show

    for name, value, least in (("samples", samples, 1), ("restarts", restarts, 1), ("iterations", iterations, 1)):
        if value < least:
            raise InputError(f"--{name} {value}: expected a whole number from {least} on")
    if seed < 0:
        raise InputError(f"--seed {seed}: expected a whole number from 0 on")
    theta_max = None if theta_max_deg is None else math.radians(theta_max_deg)
    limits = tension_min_n, tension_max_n, co_contraction_n, tension_slew_n_s, vacuum_max_kpa, vacuum_slew_kpa_s
    loaded = modelfile.load(model)
    wanted = None if spec is None else load(spec)
    with progress() as tell:
        tuned = tune(
            loaded.model,
            law,
            wanted,
            gains=read_gains(gain),
            free=free or None,
            hardware=Hardware(*limits, rate_hz, theta_max),
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
