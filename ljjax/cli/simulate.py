"""`ljjax simulate`: replay a log's commands through a model."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro

from ljjax.errors import InputError


def command(
    model: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MODEL")],
    log: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="LOG")],
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")],
    inputs: Literal["commands", "measured"] = "commands",
    mapping: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    method: Literal["fast", "reference"] = "fast",
    step_s: float = 0.0025,
) -> None:
    """Replay a log's commands through a model, from the log's initial rest; writes the measured and simulated run.

    The file holds the log's own messages unchanged and /sim/* and /residual/* beside them, at the same stamps.

    Args:
        model: The robot, a model.toml.
        log: The run, an MCAP file.
        out: The MCAP file to write.
        inputs: Drive the model by the log's commands, or by its measured tension and pressure.
        mapping: A mapping file (TOML) for a log that does not follow the contract.
        method: The solver made for this model, or diffrax's adaptive reference (much slower).
        step_s: Step of the fast solver, in s.
    """
    from ljjax.cli import start_jax

    start_jax()
    import numpy as np

    from ljjax import modelfile
    from ljjax.logs import copy_overlay, find, load_mapping, read
    from ljjax.replay import replay

    if not 1e-6 <= step_s <= 0.1:
        raise InputError(f"--step-s {step_s:g}: expected a step between 1e-6 and 0.1 s, such as 0.0025")
    paths = find([log])
    if len(paths) != 1:
        raise InputError(f"{log}: {len(paths)} logs; simulate takes one")
    if out.is_dir() or not out.absolute().parent.is_dir():
        raise InputError(f"--out {out}: expected a file name in a folder that exists, such as run_sim.mcap")
    if out.resolve() == paths[0].resolve():
        raise InputError(f"--out {out}: is the log itself and would be replaced; give another name")
    loaded = modelfile.load(model)
    run = read(paths[0], None if mapping is None else load_mapping(mapping))
    overlay = replay(loaded.model, run, inputs=inputs, method=method, step_s=step_s)
    copy_overlay([run], out, [overlay])
    for name, residual in overlay["/residual"].items():
        if name == "shape":
            error = np.degrees(residual.value)
            mean = error.mean(axis=1)
            line = f"theta error {np.sqrt(np.mean(mean**2)):.4g} deg RMS, largest {np.abs(mean).max():.4g} deg"
            joints = f"; of a joint {np.abs(error).max():.4g} deg" if error.shape[1] > 1 else ""
            print(f"{run.run_id}: {line}{joints}")
    print(f"Written: {out}")
