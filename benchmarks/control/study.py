"""What the control room claims, measured: `python -m benchmarks.control.study`, or `make control-study`.

The published experiments side by side with the simulated ones, accuracy over sampled robots, tuning against searches
without derivatives, speed against C, the exported law against the law. Prints one table; writes OUT/study.json and a
picture for each part that has one.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import jax
from rich.console import Console
from rich.table import Table

from benchmarks.control.rows import QUICK, Row, Size

SCHEMA = "ljjax.control_study/1"
Part = Callable[[Size, Path, Callable[[str], None]], list[Row]]


def parts() -> dict[str, Part]:
    """The study's parts by name."""
    from benchmarks.control import accuracy, locking, regulation, search, speed, stiffness

    return {
        "regulation": regulation.regulation,
        "stiffness": stiffness.stiffness,
        "locking": locking.locking,
        "accuracy": accuracy.accuracy,
        "tuning": search.tuning,
        "speed": speed.speed,
        "same": speed.same,
    }


def study(names: list[str], size: Size, out: Path, say: Callable[[str], None]) -> list[Row]:
    """Run these parts and write `study.json`; the rows."""
    out.mkdir(parents=True, exist_ok=True)
    rows = []
    for name in names:
        say(f"{name} …")
        start = time.time()
        rows += parts()[name](size, out, say)
        say(f"  {time.time() - start:.0f} s")
    record = {"schema": SCHEMA, "quick": size == QUICK, "size": size._asdict(), "rows": [r._asdict() for r in rows]}
    text = json.dumps(record, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    (out / "study.json").write_text(text, encoding="utf-8")
    return rows


def show(rows: list[Row], console: Console) -> None:
    """The table."""
    table = Table("what", "value", "goal", "met", "cases", show_lines=True)
    for row in rows:
        met = "" if row.met is None else "yes" if row.met else "NO"
        table.add_row(
            f"{row.name}\n[dim]{row.note}[/]",
            f"{row.value:.3g} {row.unit}".removesuffix(" 1"),
            row.goal,
            met,
            f"{row.cases:,}",
        )
    console.print(table)


def main(arguments: list[str] | None = None) -> None:
    """Run the parts asked for, all by default."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.control.study", description=__doc__)
    parser.add_argument("part", nargs="*", help=f"of {', '.join(parts())}; all by default")
    parser.add_argument("--out", type=Path, default=Path("out/control"))
    parser.add_argument("--quick", action="store_true", help="two segments and few cases, to see that it runs")
    chosen = parser.parse_args(arguments)
    if unknown := set(chosen.part) - set(parts()):
        parser.error(f"no part {', '.join(sorted(unknown))}; there are {', '.join(parts())}")
    console = Console(width=140, highlight=False)
    rows = study(chosen.part or list(parts()), QUICK if chosen.quick else Size(), chosen.out, console.print)
    show(rows, console)
    console.print(f"wrote {chosen.out / 'study.json'}")


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main()
