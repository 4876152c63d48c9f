"""Many robots' fits as one table: robots.csv, and a folder for each."""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ljjax.errors import InputError
from ljjax.fit.moving import DynamicResult
from ljjax.fit.pooling import Pooled
from ljjax.fit.result import FitResult
from ljjax.logs import Run
from ljjax.outputs import artefacts


def by_robot(runs: list[Run]) -> dict[str, list[Run]]:
    """Runs by their robot's id; those that state none by the folder they lie in."""
    out: dict[str, list[Run]] = {}
    for run in runs:
        out.setdefault(run.robot_id or Path(run.path).resolve().parent.name, []).append(run)
    return out


def folder_of(robot: str) -> str:
    """A folder's name for a robot's id."""
    return re.sub(r"[^\w.-]+", "_", robot).strip("._") or "robot"


def save_many(
    results: Mapping[str, FitResult | Exception], out: str | os.PathLike[str], pooled: Pooled | None = None
) -> None:
    """Write each robot's artefacts into OUT/ROBOT, and OUT/robots.csv: a row a robot and a parameter.

    Raises InputError where `out` cannot be written, or where two robots would share a folder.
    """
    names = [folder_of(robot) for robot in results]
    if len(set(names)) < len(names):
        raise InputError(f"--out {out}: two robots' ids give the same folder name; give the robots other ids")
    for robot, result in results.items():
        if not isinstance(result, Exception):
            result.save(Path(out) / folder_of(robot))
    with artefacts(out, keep=[]) as folder, (folder / "robots.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(
            ["robot", "parameter", "value", "sd", "unit", "verdict", "pooled_value", "pooled_sd", "rms_rad", "problem"]
        )
        for robot, result in results.items():
            if isinstance(result, Exception):
                table.writerow([robot, *[""] * 8, str(result)])
                continue
            rms = ""
            if isinstance(result, DynamicResult):
                mine = [e for e in result.run_errors if e.role == "train"]
                rms = float(np.sqrt(np.average([e.rms**2 for e in mine], weights=[e.samples for e in mine])))
            for p in result.fitted:
                drawn: list[float | str] = ["", ""]
                if pooled is not None and robot in pooled.value:
                    i = pooled.names.index(p.name)
                    drawn = [float(pooled.value[robot][i]), float(pooled.sd[robot][i])]
                sd = "" if p.sd is None else p.sd
                table.writerow([robot, p.name, p.value, sd, p.unit, p.verdict, *drawn, rms, ""])
