"""What a log holds, and what it is good for, on one screen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ljjax.errors import InputError
from ljjax.logs import contract
from ljjax.logs.run import Run, Signal

if TYPE_CHECKING:
    from rich.console import Console

# use → what it needs: any one signal of each group
USES: dict[str, tuple[tuple[str, ...], ...]] = {
    "replay (ljjax simulate)": (("cmd_tendons",), ("cmd_pressure",), ("shape",)),
    "steady fit": (("tendons", "cmd_tendons"), ("pressure", "cmd_pressure"), ("shape",)),
    "stiffness fit": (("probe",), ("pressure", "cmd_pressure")),
}


def missing_for(run: Run) -> dict[str, list[str]]:
    """For each use, what the run lacks; an empty list where it has all."""
    lacks_p_atm = []
    try:
        _ = run.p_atm_pa
    except InputError:
        lacks_p_atm = ["p_atm_pa"]
    found = {}
    for use, groups in USES.items():
        lacking = [" or ".join(group) for group in groups if not any(name in run.signals for name in group)]
        found[use] = lacking + lacks_p_atm
    return found


@dataclass(frozen=True)
class Rhythm:
    """How regularly a signal comes: rate [Hz] by the median period, longest gap [s], gaps over three such periods."""

    rate: float
    longest: float
    gaps: int


def rhythm(t: np.ndarray) -> Rhythm | None:
    """None for fewer than two samples."""
    steps = np.diff(t)
    if not len(steps):
        return None
    period = float(np.median(steps))
    rate = 1 / period if period > 0 else float("nan")
    return Rhythm(rate, float(steps.max()), int((steps > 3 * period).sum()))


def show(run: Run, console: Console, other_topics: dict[str, int] | None = None) -> None:
    """Print one run: metadata, signals, clocks, damage and what the log is good for."""
    from rich.panel import Panel
    from rich.text import Text

    head = Text(f"{run.path}\nsha256 {run.sha256}")
    for key in contract.RUN_KEYS:
        if key in run.metadata:
            head.append(f"\n{key:17}", style="bold").append(run.metadata[key] or "–")
    for key in sorted(set(run.metadata) - set(contract.RUN_KEYS)):
        head.append(f"\n{key:17}", style="dim").append(run.metadata[key])
    console.print(Panel(head, title=Text(run.run_id), title_align="left"))
    console.print(_signal_table(run))
    if other_topics:
        console.print(Text("also in the file: " + ", ".join(f"{t} ({n})" for t, n in sorted(other_topics.items()))))
    if run.damage:
        console.print(Text(f"DAMAGED at {run.damage.where}: {run.damage.why}", style="bold red"))
    for note in run.notes:
        console.print(Text(f"note: {note}", style="yellow"))
    for use, lacking in missing_for(run).items():
        if lacking:
            answer = Text("✗ lacks " + ", ".join(lacking), style="red")
        else:
            answer = Text("✗ values in doubt, see the notes", "red") if run.doubts else Text("✓", "green")
        console.print(Text(f"{use:25}").append(answer))


def _signal_table(run: Run):
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in ("signal", "topic"):
        table.add_column(name, overflow="fold")
    for name in (
        "samples",
        "rate Hz",
        "longest gap s",
        "gaps",
        "unit",
        "range",
        "sd",
        "log − header ms",
        "publish − header ms",
    ):
        table.add_column(name, justify="right", overflow="fold")
    for name, s in run.signals.items():
        beat = rhythm(s.t)
        table.add_row(
            *(Text(cell) for cell in (
                f"{name}[{len(s.columns)}]",
                s.topic,
                str(len(s)),
                f"{beat.rate:.4g}" if beat else "–",
                f"{beat.longest:.4g}" if beat else "–",
                str(beat.gaps) if beat else "–",
                ",".join(dict.fromkeys(s.unit.split(","))),
                _range(s),
                "–" if s.sd is None or np.isnan(s.sd).all() else f"{np.nanmedian(s.sd):.3g}",
                _offset(s, s.log_t),
                _offset(s, s.publish_t),
            ))
        )  # fmt: skip
    return table


def _range(s: Signal) -> str:
    columns = range(s.value.shape[1]) if len(set(s.unit.split(","))) > 1 else [slice(None)]
    parts = [s.value[:, c] for c in columns][:3]
    return "; ".join(f"{p.min():.5g} … {p.max():.5g}" for p in parts)


def _offset(s: Signal, other: np.ndarray | None) -> str:
    """Median and half the 5–95 % spread of another clock against the one that counts [ms]."""
    if other is None:
        return "–"
    gap = np.rint((other - s.t) * 1e9) / 1e6
    low, high = np.percentile(gap, [5, 95])
    return f"{np.median(gap):.4g} ± {(high - low) / 2:.3g}"
