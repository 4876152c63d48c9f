"""A fit on the terminal: parameters beside published values, how well they explain the data, where the report is."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ljjax.fit.points import UNIT
from ljjax.fit.result import StaticResult
from ljjax.page import number

_PAPER = ("alpha1", "c1", "c2", "c3", "c4", "c5")


def show(result: StaticResult, out: Path, console: Console | None = None) -> None:
    """Print what was found, and what to beware of."""
    console = console or Console(highlight=False)
    if not console.is_terminal:
        console.width = 140
    data = result.as_dict()
    table = Table(title=f"Identified, SI, lever arm {data['lever_arm_m']:g} m (gauge σ₀ = 1)", title_justify="left")
    for heading, justify in (("parameter", "left"), ("value", "right"), ("± 1 sd", "right")):
        table.add_column(heading, justify=justify)  # pyright: ignore[reportArgumentType]
    table.add_column("over pressures", justify="right")
    table.add_column("unit")
    table.add_column("verdict")
    for p in result.parameters.values():
        if p.source != "model":
            colour = "green" if p.settled else "yellow"
            row = (p.name, number(p.value), number(p.sd), number(p.sd_over_pressures), p.unit)
            table.add_row(*row, f"[{colour}]{p.judgement}[/{colour}]")
    console.print(table)

    paper, published = data["paper"], data["paper"].get("published", {})
    if any(name in paper for name in _PAPER):
        table = Table(title="The same in the paper's units (g = 1, degrees)", title_justify="left")
        for heading in ("", "identified", "± 1 sd", "published"):
            table.add_column(heading, justify="left" if not heading else "right")
        table.add_column("unit")
        for name in _PAPER:
            if name in paper:
                unit = paper["units"][name]
                table.add_row(
                    name,
                    number(paper[name], 5),
                    number(paper["sd"][name]),
                    number(published.get(name), 6),
                    unit,
                )
        if "c3_without_alpha1" in paper:
            value, sd = paper["c3_without_alpha1"], paper["sd"]["c3_without_alpha1"]
            table.add_row("c3, no alpha1", number(value, 5), number(sd), number(published.get("c3"), 6), "N/deg")
        if "r_squared" in paper:
            table.add_row("R² of K_T", number(paper["r_squared"], 4), "", number(published.get("r_squared"), 6), "")
        if "rmse_n" in paper:
            table.add_row("RMSE of u", number(paper["rmse_n"], 4), "", number(published.get("rmse_n"), 4), "N")
        console.print(table)

    for kind, stage in result.static.stages.items():
        held = data["held_out"][kind]["rmse_inner"]
        line = f"{kind}: {len(stage.points)} points, error {stage.rmse:.3g} {UNIT[kind]} RMS, R² {stage.r_squared:.4f}"
        console.print(line + (f", at left-out inner pressures {held:.3g} {UNIT[kind]}" if held else ""))
    for warning in result.warnings:
        console.print(f"[yellow]beware:[/yellow] {escape(warning)}", soft_wrap=True)
    console.print(f"Report: {escape(str(Path(out) / 'report.html'))}", soft_wrap=True)
