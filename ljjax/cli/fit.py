"""`ljjax fit`: identify robots' parameters from logs."""

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
    freeze: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME…")] = (),
    inputs: Literal["commands", "measured"] = "commands",
    method: Literal["lm", "adam"] = "lm",
    restarts: int = 1,
    profile: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME…")] = (),
    pool: bool = False,
    weights: Literal["equal", "published"] = "equal",
    constraints: Literal["none", "paper"] = "none",
    seed: int = 0,
) -> None:
    """Identify a robot's parameters from logs; writes fit.json, model.toml, report.html and result.mcap.

    From moving logs: everything, friction included; steady points and probe presses join them. From those alone:
    gravity, elasticity and jamming (alpha1, c1 to c5). Logs of several robots give a folder for each, and robots.csv.

    Args:
        logs: MCAP files, folders (searched for *.mcap) or globs.
        out: Folder for the results.
        model: A model.toml with geometry, starting values, what is frozen, bounds and priors; without it OctRobot-I's.
        mapping: A mapping file (TOML) for logs that do not follow the contract.
        held_out: Logs that are not fitted but predicted, to see how good the model is.
        freeze: Parameters not to move, such as gravity.alpha1.
        inputs: Drive the model by the logs' commands, or by their measured tension and pressure.
        method: Levenberg-Marquardt, or stochastic descent before it (for very many logs).
        restarts: How many starting points to try, side by side.
        profile: Parameters whose profile likelihood is wanted, such as friction.v_s.
        pool: Let robots of one make share what each alone shows poorly (robots.csv has both).
        weights: (steady logs) Every point alike, or by the standard deviations that the logs state.
        constraints: (steady logs) Keep alpha1, c2, c3 >= 0, as the paper does.
        seed: Seed of what is random.
    """
    from ljjax.cli import progress, start_jax

    start_jax()
    from ljjax import modelfile
    from ljjax.fit import fit_many
    from ljjax.fit.many import by_robot, save_many
    from ljjax.fit.moving import DynamicResult
    from ljjax.fit.pooling import pool as pooling
    from ljjax.fit.show import show, show_many
    from ljjax.logs import find, load_mapping, read_all

    start = None if model is None else modelfile.load(model)
    if not logs:
        raise InputError("no log given; expected files, folders or globs of *.mcap (before options that take several)")
    if restarts < 1:
        raise InputError(f"--restarts {restarts}: expected a number from 1 on")
    how = None if mapping is None else load_mapping(mapping)
    robots = by_robot(read_all(find(logs), how))
    tests = by_robot(read_all(find(held_out), how)) if held_out else {}
    if strange := set(tests) - set(robots):
        raise InputError(f"--held-out: logs of {', '.join(sorted(strange))}, a robot that has no logs to fit")
    with progress() as tell:
        results = fit_many(
            start,
            robots,
            held_out=tests,
            frozen=freeze,
            inputs=inputs,
            method=method,
            restarts=restarts,
            profile=profile,
            weights=weights,
            constraints=constraints,
            seed=seed,
            model_from=str(model),
            progress=tell,
        )
    if len(results) == 1:
        (result,) = results.values()
        if isinstance(result, Exception):
            raise result
        result.save(out)
        show(result, out)
        return
    if all(isinstance(r, Exception) for r in results.values()):
        raise InputError("no robot could be fitted: " + "; ".join(f"{k}: {r}" for k, r in results.items()))
    moving = {k: r for k, r in results.items() if isinstance(r, DynamicResult)}
    save_many(results, out, pooling(moving) if pool else None)
    show_many(results, out)
