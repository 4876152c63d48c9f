"""`ljjax fit`: identify a robot's parameters from logs."""

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
    freeze: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME…")] = (),
    weights: Literal["equal", "published"] = "equal",
    constraints: Literal["none", "paper"] = "none",
    seed: int = 0,
) -> None:
    """Identify a robot's parameters from logs; writes fit.json, model.toml, report.html and result.mcap.

    From steady operating points: gravity and elasticity (alpha1, c1, c2, c3). From probe stiffness: jamming (c4, c5).

    Args:
        logs: MCAP files, folders (searched for *.mcap) or globs, of one robot.
        out: Folder for the results.
        model: A model.toml with geometry, starting values and what is frozen; without it OctRobot-I's geometry.
        mapping: A mapping file (TOML) for logs that do not follow the contract.
        freeze: Parameters not to move, such as gravity.alpha1.
        weights: Every point alike, or by the standard deviations that the logs state.
        constraints: Keep alpha1, c2, c3 >= 0, as the paper does.
        seed: Seed of what is random, for the record.
    """
    import jax

    jax.config.update("jax_enable_x64", True)
    from ljjax import modelfile
    from ljjax.fit import fit
    from ljjax.fit.show import show
    from ljjax.logs import find, load_mapping, read_all

    start = None if model is None else modelfile.load(model)
    if not logs:
        raise InputError(
            "no log given; expected files, folders or globs of *.mcap (before --freeze, which takes several)"
        )
    runs = read_all(find(logs), None if mapping is None else load_mapping(mapping))
    result = fit(start, runs, frozen=freeze, weights=weights, constraints=constraints, seed=seed, model_from=str(model))
    result.save(out)
    show(result, out)
