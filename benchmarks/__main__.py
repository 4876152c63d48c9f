"""`python -m benchmarks`: every benchmark in one run, one table, and `out/bench/bench.json`."""

from __future__ import annotations

import argparse
import json
import os
import platform
import time
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import jax
from rich import print as show
from rich.console import Console
from rich.table import Table

PACKAGES = ("jax", "diffrax", "numpy", "scipy", "scikit-sundae", "casadi", "mujoco", "ljjax")


def main() -> None:
    """Run the benchmarks asked for, all by default."""
    jax.config.update("jax_enable_x64", True)
    from benchmarks import fit_speed, free_runs, jacobian, simulation

    parts = {
        "equal-accuracy": simulation.equal_accuracy,
        "against-c": simulation.against_c,
        "jacobian": jacobian.cost,
        "free-runs": free_runs.natively,
        "fit": fit_speed.whole_fit,
    }
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("part", nargs="*", default=list(parts), help=f"of {', '.join(parts)}")
    parser.add_argument("--out", type=Path, default=Path("out/bench"))
    chosen = parser.parse_args()
    if unknown := set(chosen.part) - set(parts):
        parser.error(f"no benchmark {', '.join(sorted(unknown))}; there are {', '.join(parts)}")

    rows = []
    for name in chosen.part:
        start = time.time()
        show(f"{name} …")
        rows += parts[name](show)
        show(f"  {time.time() - start:.0f} s")

    table = Table("benchmark", "value", "goal", "met", "beside it", show_lines=True)
    for row in rows:
        beside = "\n".join(f"{name}: {x:.3g}" for name, x in row.peers.items())
        met = "" if row.met is None else "yes" if row.met else "NO"
        table.add_row(f"{row.name}\n[dim]{row.note}[/]", f"{row.value:.3g} {row.unit}", row.goal, met, beside)
    Console(width=140).print(table)
    chosen.out.mkdir(parents=True, exist_ok=True)
    record = {"rows": [row._asdict() for row in rows], "provenance": provenance()}
    (chosen.out / "bench.json").write_text(json.dumps(record, indent=2, ensure_ascii=False) + "\n")
    show(f"wrote {chosen.out / 'bench.json'}")


def provenance() -> dict:
    """Versions, processor, date."""
    versions = {}
    for name in PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = None
    return {
        "versions": versions,
        "python": platform.python_version(),
        "machine": platform.machine(),
        "cpus": os.cpu_count(),
        "date_utc": datetime.now(UTC).isoformat(timespec="seconds"),
    }


if __name__ == "__main__":
    main()
