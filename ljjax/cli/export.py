"""`ljjax export`: the control law of a robot as one file for the rig."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import tyro

from ljjax.cli.limits import DEFAULTS, Flags
from ljjax.errors import InputError
from ljjax.law.parts import Kind


def command(
    model: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MODEL")],
    out: Annotated[Path, tyro.conf.arg(metavar="FILE.json")],
    header: Annotated[Path | None, tyro.conf.arg(metavar="FILE.h")] = None,
    law: Literal["passivity", "integral", "observer"] = "integral",
    gain: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE…")] = (),
    limits: Flags = DEFAULTS,
) -> None:
    """Make a control law for a robot and write it as law.json, with what it reaches and vectors to check it by.

    The command to the law is a segment angle and a transverse stiffness of the tip. Prints what it reaches.

    Args:
        model: The robot, a model.toml; effects on elasticity, friction and vacuum enter the law.
        out: The law.json to write.
        header: A C99 header of the same law to write, for a microcontroller.
        law: The published law, the same with integral action, or with a LuGre observer beside it.
        gain: Gains to set, such as gamma=0.5; the others are chosen from the model.
    """
    from ljjax.cli import start_jax

    start_jax()
    from ljjax import modelfile
    from ljjax.control import design, export
    from ljjax.law.parts import USED

    gains = read_gains(gain, law)
    loaded = modelfile.load(model)
    made = design(loaded.model, law, gains=gains, hardware=limits.hardware(), where=str(model))
    export(made, out, header_out=header, model_path=model)
    low, high = made.reach["stiffness_n_m"]
    print(
        f"{law} at {limits.rate_hz:g} Hz: "
        + ", ".join(f"{k} {v:.4g}" for k, v in made.law.gains._asdict().items() if k in USED[law])
    )
    print(f"reaches ±{math.degrees(made.law.limits.theta_max_rad):.4g}° a segment and {low:.4g} to {high:.4g} N/m")
    if made.reach["effects_not_counted"]:
        names = ", ".join(made.reach["effects_not_counted"])
        print(f"the law does not count what changes neither α₂ nor φ of the robot at rest: {names}")
    print(f"Written: {out}" + ("" if header is None else f", {header}"))


def read_gains(given: Sequence[str], law: Kind) -> dict[str, float]:
    """Gains by name, from NAME=VALUE.

    Raises:
        InputError: anything else; a gain given twice, or one that the law does not use.
    """
    from ljjax.law.parts import USED

    gains: dict[str, float] = {}
    for text in given:
        name, _, value = (part.strip() for part in text.partition("="))
        try:
            number = float(value)
        except ValueError:
            raise InputError(f"--gain {text}: expected NAME=VALUE, such as gamma=0.5") from None
        if name not in USED[law]:
            raise InputError(f"--gain {text}: {law} uses no such gain; its gains are {', '.join(USED[law])}")
        if name in gains:
            raise InputError(f"--gain {text}: {name} is given twice; give it once")
        gains[name] = number
    return gains
