"""A fit on the terminal: parameters, how well they explain the data, what to beware of, where the report is."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ljjax.fit.moving import DynamicResult
from ljjax.fit.moving_report import left_out_deg, noise_deg, rms_deg, verdict
from ljjax.fit.points import UNIT
from ljjax.fit.result import FitResult, Parameter, StaticResult
from ljjax.page import number

_PAPER = ("alpha1", "c1", "c2", "c3", "c4", "c5")
_MAIN = {
    "gravity.alpha1": "α₁",
    "elastic.c3": "c₃",
    "jamming.c4": "c₄",
    "jamming.c5": "c₅",
    "friction.mu_c": "μ_C",
    "friction.sigma2": "σ₂",
}
"""What tells robots apart, in the table of many."""


def show(result: FitResult, out: Path, console: Console | None = None) -> None:
    """Print what was found, and what to beware of."""
    console = _console(console)
    if isinstance(result, StaticResult):
        _static(result, console)
    if isinstance(result, DynamicResult):
        _dynamic(result, console)
    for warning in result.warnings:
        console.print(f"[yellow]beware:[/yellow] {escape(warning)}", soft_wrap=True)
    console.print(f"Report: {escape(str(Path(out) / 'report.html'))}", soft_wrap=True)


def _console(console: Console | None) -> Console:
    console = console or Console(highlight=False)
    if not console.is_terminal:
        console.width = 140
    return console


def _table(title: str, *heads: str, left: tuple[int, ...] = ()) -> Table:
    """A table of numbers; the columns `left` hold words."""
    table = Table(title=title, title_justify="left")
    for i, head in enumerate(heads):
        table.add_column(head, justify="left" if i in left else "right")
    return table


def _static(result: StaticResult, console: Console) -> None:
    data = result.as_dict()
    title = f"Identified, SI, lever arm {data['lever_arm_m']:g} m (gauge σ₀ = 1)"
    table = _table(title, "parameter", "value", "± 1 sd", "over pressures", "unit", "verdict", left=(0, 4, 5))
    for p in result.parameters.values():
        if p.source != "model":
            colour = "green" if p.settled else "yellow"
            row = (p.name, number(p.value), number(p.sd), number(p.sd_over_pressures), p.unit)
            table.add_row(*row, f"[{colour}]{p.judgement}[/{colour}]")
    console.print(table)

    paper, published = data["paper"], data["paper"].get("published", {})
    if any(name in paper for name in _PAPER):
        title = "The same in the paper's units (g = 1, degrees)"
        table = _table(title, "", "identified", "± 1 sd", "published", "unit", left=(0, 4))
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


def _dynamic(result: DynamicResult, console: Console) -> None:
    title = f"Identified, SI, lever arm {float(result.model.chain.lever_arm_m):g} m (gauge σ₀ = 1)"
    table = _table(title, "parameter", "value", "± 1 sd", "unit", "verdict", left=(0, 3, 4))
    for p in result.fitted:
        colour = "green" if p.settled else "yellow"
        table.add_row(p.name, number(p.value, 4), number(p.sd, 2), p.unit, f"[{colour}]{p.judgement}[/{colour}]")
    console.print(table)
    for e in result.run_errors:
        line = f"{escape(e.run_id)}: {_deg(e.rms)}° RMS over {e.samples} samples, largest {_deg(e.largest)}°"
        line += ", not fitted" if e.role == "held_out" else f", {_deg(e.left_out)}° with its own data left out"
        console.print(line + (", [yellow]sensitive[/yellow]" if e.sensitive else ""), soft_wrap=True)
    line = f"all: {number(rms_deg(result))}° RMS, white noise {number(noise_deg(result))}°"
    for said, error in (("left out", left_out_deg(result)), ("not fitted", rms_deg(result, "held_out"))):
        line += f", {said} {number(error)}°" if error is not None else ""
    console.print(line, soft_wrap=True)
    good, why = verdict(result)
    console.print(f"[{'green' if good else 'yellow'}]{escape(why)}[/]", soft_wrap=True)


def _deg(rad: float | None) -> str:
    return number(None if rad is None else float(np.degrees(rad)))


def show_many(results: Mapping[str, FitResult | Exception], out: Path, console: Console | None = None) -> None:
    """Print a row for each robot, or why there is none."""
    console = _console(console)
    failed = {robot: found for robot, found in results.items() if isinstance(found, Exception)}
    heads = ("robot", "RMS°", "not fitted°", "identified", *_MAIN.values(), "beware")
    table = _table(f"{len(results) - len(failed)} of {len(results)} robots identified", *heads, left=(0,))
    for robot, found in results.items():
        if isinstance(found, Exception):
            table.add_row(escape(robot), "[red]failed[/red]")
            continue
        moving = found if isinstance(found, DynamicResult) else None
        errors = [number(rms_deg(moving, role) if moving else None) for role in ("train", "held_out")]
        known = sum(p.verdict == "identifiable" for p in found.fitted)
        values = [_compact(found.parameters[path]) for path in _MAIN]
        count = len(found.warnings)
        table.add_row(escape(robot), *errors, f"{known} of {len(found.fitted)}", *values, str(count) if count else "")
    console.print(table)
    for robot, why in failed.items():
        console.print(f"[red]{escape(robot)}:[/red] {escape(str(why))}", soft_wrap=True)
    console.print(
        "RMS error of θ in free runs, ± 1 sd; in brackets what is not identifiable or not fitted; beware: warnings in "
        "the robot's report.",
        soft_wrap=True,
    )
    console.print(f"Reports: {escape(str(Path(out) / '*' / 'report.html'))}", soft_wrap=True)


def _compact(p: Parameter) -> str:
    value = number(p.value) + (f"±{number(100 * p.sd / abs(p.value), 1)}%" if p.sd and p.value else "")
    return value if p.settled else f"({value})"
