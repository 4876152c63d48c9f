"""`ljjax robust`: thousands of closed loops on robots and scenarios as they may turn out to be."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Literal

import tyro

from ljjax.errors import InputError


def command(
    law: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="LAW")],
    model: Annotated[Path, tyro.conf.arg(metavar="MODEL.toml")],
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    spec: Annotated[Path | None, tyro.conf.arg(metavar="FILE.toml")] = None,
    fit: Annotated[Path | None, tyro.conf.arg(metavar="FIT")] = None,
    effects: Annotated[tuple[str, ...], tyro.conf.arg(metavar="ID…")] = (),
    samples: int = 2000,
    sobol: int = 128,
    steps: int = 20,
    radius: Annotated[float | None, tyro.conf.arg(metavar="SD")] = None,
    seed: int = 0,
    batch: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    precision: Literal["float64", "float32"] = "float64",
) -> None:
    """Study how robust a law is; writes robust.json, samples.nc, report.html, worst.mcap and worst.toml.

    Draws robots from the model's standard deviations and scenarios from the specification, and simulates each at every
    target: the probability of meeting each requirement, what drives the result, the worst case nearby as a run that
    `ljjax simulate` replays. Interrupted or killed, the same command goes on where it was.

    Args:
        law: The law, a law.json.
        model: The robot, a model.toml; its effects are simulated.
        out: Folder for the results.
        spec: What is wanted and what varies (TOML, docs/control.md); without it three targets within reach.
        fit: A fit.json or its folder, for standard deviations and correlations; otherwise the model's [uncertainty].
        effects: Effects to add, each with its prior (its typical size), such as tip_payload.
        samples: How many robots and scenarios to draw.
        sobol: Rows of the sensitivity study: rows × (quantities + 2) further draws; 0 for none.
        steps: Steps of the ascent to the worst case.
        radius: How far from the centre to look for the worst case, in standard deviations; without it as far as 95 of
            100 draws lie.
        seed: Seed of everything drawn.
        batch: Loops at a time; chosen from the free memory without it.
        precision: Of the samples; float32 is for accelerators.
    """
    from ljjax.cli import progress, start_jax

    start_jax(large=True)
    from ljjax import law as laws
    from ljjax import modelfile
    from ljjax.control import fitted
    from ljjax.control.robust_report import refuse_inputs, save, show
    from ljjax.control.robustness import robust
    from ljjax.control.spec import load

    for name, value, least in (("samples", samples, 2), ("sobol", sobol, 0), ("steps", steps, 0), ("seed", seed, 0)):
        if value < least:
            raise InputError(f"--{name} {value}: expected a whole number from {least} on")
    if batch is not None and batch < 1:
        raise InputError(f"--batch {batch}: expected a number of loops ≥ 1")
    if radius is not None and not 0 < radius < 100:
        raise InputError(f"--radius {radius:g}: expected standard deviations between 0 and 100")
    keep = tuple(x for x in (spec, fit) if x is not None and x.is_file())
    refuse_inputs(out, [law, model, *keep])
    given, loaded = laws.load(law), modelfile.load(model)
    wanted = None if spec is None else load(spec)
    errors = fitted.Fitted({}, {}) if fit is None else fitted.read(fit)
    try:
        with progress() as tell:
            study = robust(
                given,
                loaded.model,
                wanted,
                uncertainty={**loaded.uncertainty, **errors.sd},
                correlation=errors.correlation,
                priors=loaded.priors,
                effects=effects,
                samples=samples,
                sobol_rows=sobol,
                steps=steps,
                radius=radius,
                seed=seed,
                batch=batch,
                precision=precision,
                out=out,
                progress=tell,
                where=str(model),
                law_where=str(law),
                spec_where=str(spec or "specification"),
            )
    except KeyboardInterrupt:
        print(f"ljjax: interrupted; what is done is kept in {out}: the same command goes on", file=sys.stderr)
        raise SystemExit(130) from None
    save(study, out, law_path=law, model_path=model, keep=keep)
    show(study, out)
