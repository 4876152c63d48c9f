"""What a graphics card is worth to each command: the same command on the processor and on the card, compiling included.

`python -m benchmarks.devices` on a machine with a card and JAX for it; every command in a process of its own that keeps
no programs.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import jax
from rich.console import Console
from rich.table import Table

from benchmarks.fit_speed import data
from ljjax import modelfile
from ljjax.data import OCTROBOT

LIMIT_S = 150.0
"""When a side is given up; the ratio is then a bound."""
MANY = ("--vary", "friction.mu_s=0.003:0.008:64", "--vary", "jamming.c5=2:5:64", "--no-errors")


def commands(folder: Path) -> dict[str, list[str]]:
    """Commands by name, on logs and models that are written to the folder."""
    _, runs, start = data(folder)
    model, octrobot, law = folder / "model.toml", str(OCTROBOT / "nominal.toml"), folder / "law.json"
    model.write_text(modelfile.dumps(start), encoding="utf-8")
    logs = [str(r.path) for r in runs]
    return {
        "simulate a run": ["simulate", str(model), logs[0], "--out", str(folder / "replayed.mcap")],
        "fit of 8 runs": ["fit", *logs, "--model", str(model)],
        "tune": ["tune", octrobot, "--iterations", "5"],
        "export": ["export", octrobot, "--out", str(law)],
        "robust, 200 draws": ["robust", str(law), "--model", octrobot, "--samples", "200", "--sobol", "0"],
        "robust, 5,000 draws": ["robust", str(law), "--model", octrobot, "--samples", "5000", "--sobol", "0"],
        "sweep of 4,096": ["sweep", octrobot, *MANY],
    }


def seconds(command: list[str], where: str, out: Path) -> float:
    """How long a command took there; infinite where it was given up. Raises RuntimeError where it failed."""
    if "--out" not in command:
        command = [*command, "--out", str(out)]
    start, given = time.perf_counter(), {**os.environ, "JAX_PLATFORMS": where, "LJJAX_CACHE": ""}
    try:
        done = subprocess.run(
            [sys.executable, "-m", "ljjax", *command], env=given, capture_output=True, text=True, timeout=LIMIT_S
        )
    except subprocess.TimeoutExpired:
        return float("inf")
    if done.returncode:
        raise RuntimeError(f"ljjax {command[0]} on {where}: {done.stderr.strip().splitlines()[-1]}")
    return time.perf_counter() - start


def main() -> None:
    """Print the ratios."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.devices", description=__doc__)
    parser.add_argument("--only", nargs="*", default=[], help="names of commands, such as 'tune'")
    only = parser.parse_args().only
    card = jax.default_backend()
    if card == "cpu":
        raise SystemExit("JAX has no graphics card here")
    card = {"gpu": "cuda"}.get(card, card)
    jax.config.update("jax_enable_x64", True)
    table = Table("command", "time on the card ÷ on the processor")
    with tempfile.TemporaryDirectory() as folder, jax.default_device(jax.devices("cpu")[0]):
        for name, command in commands(Path(folder)).items():
            if only and name not in (*only, "export"):
                continue
            here, there = (seconds(command, side, Path(folder, f"{name}-{side}")) for side in ("cpu", card))
            more = ">" if there == float("inf") else "<" if here == float("inf") else ""
            table.add_row(name, f"{more}{min(there, LIMIT_S) / min(here, LIMIT_S):.2g}")
            print(name, f"{here:.0f} {there:.0f} s", flush=True)
    print(f"{jax.devices()[0].device_kind}; {os.cpu_count()} cores")
    Console(width=100).print(table)


if __name__ == "__main__":
    main()
