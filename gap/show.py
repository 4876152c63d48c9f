"""A diagnosis on the terminal."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from ljjax.gap.result import LAST, Diagnosis
from ljjax.page import estimate, number

SHOWN, LEAST = 6, 0.005
"""How many candidates are shown at most, and from which probability."""
WORDS = {
    "listed_effect": "an effect the model lacks",
    "no_gap": "no gap: the given model explains these runs to their noise",
    "parameters_only": "no effect is missing: refitting the model's own parameters closes the gap",
    "unlisted_effect": "something real that no listed effect explains",
}


def show(found: Diagnosis, out: Path, console: Console | None = None) -> None:
    """Print what was found, and where the rest is."""
    console = console or Console()
    for line in found.warnings:
        console.print(f"[yellow]beware:[/] {line}", highlight=False, soft_wrap=True)
    words = WORDS[found.verdict]
    if found.verdict == "listed_effect":
        words = " and ".join(found.selected)
    named = {found.verdict, *found.selected, *(i for group in found.equivalent for i in group)}
    sure = sum(f.probability for f in found.effects if f.id in named)
    console.print(f"Cause: [bold]{words}[/] (probability {sure:.2f})", highlight=False, soft_wrap=True)
    gap = found.gap
    factor, unit = (float(np.degrees(1.0)), "°") if gap.unit == "rad" else (1.0, f" {gap.unit}")
    numbers = [f"{number(factor * x)}{unit}" for x in (gap.before, gap.after, gap.noise_floor)]
    closed = "" if gap.closed_fraction is None else f"; {100 * gap.closed_fraction:z.0f} % of the gap closed"
    if gap.closed_fraction is not None and gap.closed_fraction_ci95 is not None and found.selected:
        low, high = gap.closed_fraction_ci95
        closed += f" (95 %: {100 * low:z.0f} to {100 * high:z.0f} %)"
    where = "on runs not fitted" if found.evidence is not None else "at pressures left out"
    console.print(
        f"Error {where}: {numbers[0]} → {numbers[1]}, noise {numbers[2]}{closed}",
        highlight=False,
        soft_wrap=True,
    )
    table = Table(box=None, padding=(0, 2, 0, 0))
    for name in ("candidate", "probability", "closes", "parameters"):
        table.add_column(name, justify="right" if name in ("probability", "closes") else "left")
    for f in [f for f in found.effects[:SHOWN] if f.probability >= LEAST]:
        values = ", ".join(f"{n} {estimate(p['value'], p['sd'])} {p['unit']}" for n, p in f.parameters.items())
        closes = "" if f.closed_fraction is None or f.id in LAST else f"{100 * f.closed_fraction:z.0f} %"
        table.add_row(f.id, f"{f.probability:.2f}", closes, values)
    console.print(table)
    for group in found.equivalent:
        console.print(f"These data cannot tell apart: {', '.join(group)}", highlight=False, soft_wrap=True)
    if found.next_experiment:
        console.print(f"Next experiment: {found.next_experiment['why']}", highlight=False, soft_wrap=True)
    console.print(f"Report: {out / 'report.html'}", highlight=False, soft_wrap=True)
