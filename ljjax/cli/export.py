"""`ljjax export`: the control law of a robot as one file for the rig."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import tyro

from ljjax.errors import InputError


def command(
    model: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MODEL")],
    out: Annotated[Path, tyro.conf.arg(metavar="FILE.json")],
    header: Annotated[Path | None, tyro.conf.arg(metavar="FILE.h")] = None,
    law: Literal["passivity", "integral", "observer"] = "integral",
    gain: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE…")] = (),
    rate_hz: float = 200.0,
    theta_max_deg: Annotated[float | None, tyro.conf.arg(metavar="DEG")] = None,
    tension_min_n: float = 0.5,
    tension_max_n: float = 60.0,
    co_contraction_n: float = 2.0,
    tension_slew_n_s: float = 400.0,
    vacuum_max_kpa: float = 40.0,
    vacuum_slew_kpa_s: float = 50.0,
) -> None:
    """Make a control law for a robot and write it as law.json, with what it reaches and vectors to check it by.

    The command to the law is a segment angle and a transverse stiffness of the tip. Prints what it reaches.

    Args:
        model: The robot, a model.toml; effects on elasticity, friction and vacuum enter the law.
        out: The law.json to write.
        header: A C99 header of the same law to write, for a microcontroller.
        law: The published law, the same with integral action, or with a LuGre observer beside it.
        gain: Gains to set, such as gamma=0.5; the others are chosen from the model.
        rate_hz: Rate of the loop, in Hz.
        theta_max_deg: Largest segment angle to command, in degrees; by default as far as the tensions reach.
        tension_min_n: Least tension of a tendon, in N.
        tension_max_n: Largest tension of a tendon, in N.
        co_contraction_n: Mean tension of the two tendons where the net tension allows, in N.
        tension_slew_n_s: How fast a tension may change, in N/s.
        vacuum_max_kpa: Highest vacuum, in kPa below atmosphere.
        vacuum_slew_kpa_s: How fast the vacuum may change, in kPa/s.
    """
    from ljjax.cli import start_jax

    start_jax()
    from ljjax import modelfile
    from ljjax.control import Hardware, design, export
    from ljjax.law.parts import USED

    gains = read_gains(gain)
    theta_max = None if theta_max_deg is None else math.radians(theta_max_deg)
    limits = tension_min_n, tension_max_n, co_contraction_n, tension_slew_n_s, vacuum_max_kpa, vacuum_slew_kpa_s
    loaded = modelfile.load(model)
    made = design(loaded.model, law, gains=gains, hardware=Hardware(*limits, rate_hz, theta_max), where=str(model))
    export(made, out, header_out=header, model_path=model)
    low, high = made.reach["stiffness_n_m"]
    print(
        f"{law} at {rate_hz:g} Hz: "
        + ", ".join(f"{k} {v:.4g}" for k, v in made.law.gains._asdict().items() if k in USED[law])
    )
    print(f"reaches ±{math.degrees(made.law.limits.theta_max_rad):.4g}° a segment and {low:.4g} to {high:.4g} N/m")
    print(f"Written: {out}" + ("" if header is None else f", {header}"))


def read_gains(given: Sequence[str]) -> dict[str, float]:
    """Gains by name, from NAME=VALUE. Raises InputError for anything else."""
    gains: dict[str, float] = {}
    for text in given:
        name, _, value = text.partition("=")
        try:
            gains[name.strip()] = float(value)
        except ValueError:
            raise InputError(f"--gain {text}: expected NAME=VALUE, such as gamma=0.5") from None
    return gains
