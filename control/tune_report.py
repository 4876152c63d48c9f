"""A tuned law told: on the terminal, as tune.json, as report.html."""

from __future__ import annotations

import json
import math
import os
from dataclasses import asdict
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from rich.markup import escape as plainly
from rich.table import Table

from ljjax import page
from ljjax.control.files import provenance, texts
from ljjax.control.spec import MEASURES
from ljjax.control.telling import SHOWN, finite
from ljjax.control.tuning import Side, Tuned
from ljjax.law.parts import KINDS, UNITS
from ljjax.outputs import artefacts
from ljjax.page import ACCENT, INK, MUTED, number

PathLike = str | os.PathLike[str]
SCHEMA = "ljjax.tune/1"


def save(tuned: Tuned, out: PathLike, *, model_path: PathLike | None = None, keep: tuple[PathLike, ...] = ()) -> None:
    """Write law.json, tune.json and report.html into a folder: all or none.

    Args:
        model_path: the model's file, for the provenance; it and those of `keep` are never replaced.

    Raises:
        InputError: a folder that cannot be written, or in which an input would be replaced.
    """
    law, _ = texts(tuned.made, model_path)
    text = json.dumps(as_dict(tuned, model_path), ensure_ascii=False, indent=1, allow_nan=False) + "\n"
    with artefacts(out, keep=[*keep, *([] if model_path is None else [model_path])]) as folder:
        (folder / "law.json").write_text(law, encoding="utf-8")
        (folder / "tune.json").write_text(text, encoding="utf-8")
        (folder / "report.html").write_text(report(tuned), encoding="utf-8")


def summary(side: Side, name: str) -> tuple[float, float]:
    """Median and largest of a measure over the loops on the robots tuned on; a loop that failed is infinitely bad."""
    values = np.array([m[name] for row in side.measures for m in row])
    values = np.where(np.isnan(values), np.inf, values)
    return float(np.median(values)), float(np.max(values))


def met(tuned: Tuned, side: Side, name: str | None = None, unseen: bool = False) -> float:
    """The share of loops that are within the limit of a measure, or of every measure that counts (None)."""
    rows = side.unseen_measures if unseen else side.measures
    limits = {k: r.limit for k, r in tuned.spec.require.items() if r.weight > 0 and name in (None, k)}
    good = [all(m[k] <= limit for k, limit in limits.items()) for row in rows for m in row]
    return float(np.mean(good))


def as_dict(tuned: Tuned, model_path: PathLike | None = None) -> dict[str, Any]:
    """The content of tune.json (schema ljjax.tune/1); infinities and NaN are null."""

    def side(x: Side) -> dict[str, Any]:
        return {
            "gains": x.gains,
            "loss": x.loss,
            "loss_unseen": x.unseen,
            "measures": x.measures,
            "measures_unseen": x.unseen_measures,
            "met": met(tuned, x),
            "met_unseen": met(tuned, x, unseen=True) if x.unseen_measures else None,
        }

    return finite(
        {
            "schema": SCHEMA,
            "provenance": provenance(model_path),
            "options": tuned.options,
            "spec": tuned.spec.as_dict(),
            "units": {name: UNITS[f"gains.{name}"] for name in tuned.after.gains}
            | {name: unit for name, (unit, _, _) in MEASURES.items()},
            "before": side(tuned.before),
            "after": side(tuned.after),
            "best": {"iteration": tuned.best[0], "restart": tuned.best[1]},
            "loops": {"search": asdict(tuned.search), "all": asdict(tuned.count)},
            "history": tuned.history.tolist(),
            "coordinates": tuned.coordinates.tolist(),
        }
    )


def _value(name: str, x: float) -> str:
    return "never" if name == "settling_s" and not math.isfinite(x) else number(SHOWN[name][2](x))


def _rows(tuned: Tuned) -> list[tuple[list[str], bool]]:
    """A row a measure that counts: name, unit, limit, before and after (median, worst), share met after; all met."""
    out = []
    for name, need in tuned.spec.require.items():
        if need.weight <= 0:
            continue
        cells = [SHOWN[name][0], SHOWN[name][1], _value(name, need.limit)]
        for side in (tuned.before, tuned.after):
            cells += [_value(name, x) for x in summary(side, name)]
        share = met(tuned, tuned.after, name)
        out.append(([*cells, f"{100 * met(tuned, tuned.before, name):.0f} → {100 * share:.0f} %"], share == 1.0))
    return out


def _counted(tuned: Tuned) -> str:
    search = tuned.search
    beside = tuned.count.gradients + tuned.count.values - search.gradients - search.values
    return f"{search.gradients} loops simulated with derivatives by the search, {beside} to compare"


def _robots(tuned: Tuned) -> int:
    return len(tuned.after.measures[0])


def verdict(tuned: Tuned) -> tuple[bool, str]:
    """Whether the specification is met, in a sentence."""
    unseen = bool(tuned.after.unseen_measures)
    share, was = met(tuned, tuned.after, unseen=unseen), met(tuned, tuned.before, unseen=unseen)
    where = "loops on robots it was not tuned on" if unseen else "loops"
    return (
        share == 1.0,
        f"All requirements together are met in {100 * share:.0f} % of {where} (before: {100 * was:.0f} %).",
    )


def show(tuned: Tuned, out: PathLike, console: Console | None = None) -> None:
    """Print before and after, and where the files are."""
    console = console or Console(highlight=False)
    if not console.is_terminal:
        console.width = 140
    law = tuned.made.law
    targets, robots = len(tuned.spec.targets), _robots(tuned)
    title = f"{law.kind} at {1 / law.period_s:g} Hz: {targets} targets on {robots} robot{'s' if robots > 1 else ''}"
    table = Table(title=title, title_justify="left")
    heads = ("measure", "unit", "limit", "before, median", "worst", "after, median", "worst", "within the limit")
    for i, head in enumerate(heads):
        table.add_column(head, justify="left" if i < 2 else "right")
    for cells, good in _rows(tuned):
        table.add_row(*cells[:-1], f"[{'green' if good else 'yellow'}]{cells[-1]}[/]")
    console.print(table)
    gains = Table(title="Gains", title_justify="left")
    for i, head in enumerate(("gain", "unit", "before", "after")):
        gains.add_column(head, justify="left" if i < 2 else "right")
    for name, x in tuned.after.gains.items():
        gains.add_row(name, UNITS[f"gains.{name}"], number(tuned.before.gains[name], 4), number(x, 4))
    console.print(gains)
    line = f"loss {number(tuned.before.loss, 4)} → {number(tuned.after.loss, 4)}"
    if tuned.after.unseen is not None:
        line += f"; on robots it was not tuned on {number(tuned.before.unseen, 4)} → {number(tuned.after.unseen, 4)}"
    console.print(f"{line}; {_counted(tuned)}", soft_wrap=True)
    good, said = verdict(tuned)
    console.print(f"[{'green' if good else 'yellow'}]{plainly(said)}[/]", soft_wrap=True)
    names = ", ".join(str(Path(out) / name) for name in ("law.json", "tune.json", "report.html"))
    console.print(f"Written: {plainly(names)}", soft_wrap=True)


# --- the report


def report(tuned: Tuned) -> str:
    """The page; it loads nothing from anywhere."""
    law, spec = tuned.made.law, tuned.spec
    good, said = verdict(tuned)
    robots = _robots(tuned)
    settle = [summary(side, "settling_s")[0] for side in (tuned.before, tuned.after)]
    rest = [summary(side, "steady_error_rad")[0] for side in (tuned.before, tuned.after)]

    def change(pair: list[float], name: str, unit: str) -> str:
        return " → ".join(_value(name, x) for x in pair) + unit

    parts = [
        page.cards(
            [
                (f"{number(tuned.before.loss)} → {number(tuned.after.loss)}", "loss"),
                (change(settle, "settling_s", " s"), "settling time, median"),
                (change(rest, "steady_error_rad", "°"), "steady error, median"),
                (f"{tuned.search.gradients + tuned.search.values}", "closed loops simulated by the search"),
            ]
        ),
        f'<p><b class="{"good" if good else "bad"}">{escape(said)}</b></p>',
        "<h2>The loops, before and after</h2>",
        f'<p class="sub">The model itself, {spec.duration_s:g} s, noise and delays included.</p>',
        '<div class="grid">',
    ]
    for i, target in enumerate(spec.targets):
        name = f"{math.degrees(target.theta_rad):.3g}° at {target.stiffness_n_m:.4g} N/m"
        parts += [
            page.figure(_course(tuned, i), name, "Above: angle, band of settling shaded. Below: the two tensions.")
        ]
    parts += ["</div>", "<h2>Measures</h2>"]
    heads = ["measure", "unit", "limit", "before, median", "worst", "after, median", "worst", "within the limit"]
    rows = [[escape(c) for c in cells] for cells, _ in _rows(tuned)]
    parts += [page.table(heads, rows, numeric=range(2, 8))]
    parts += ["<h2>Gains</h2>"]
    gains = [
        [escape(name), escape(UNITS[f"gains.{name}"]), number(tuned.before.gains[name], 4), number(x, 4)]
        for name, x in tuned.after.gains.items()
    ]
    parts += [page.table(["gain", "unit", "before", "after"], gains, numeric=(2, 3)), "<h2>The search</h2>"]
    parts += [f'<p class="sub">{escape(_counted(tuned))}.</p><div class="grid">']
    parts += [
        page.figure(_descent(tuned), "Descent", "A line a restart; the dot is the law taken."),
        page.figure(
            _spread(tuned), "All loops", "Every target on every robot tuned on: settling time and steady error."
        ),
        "</div>",
    ]
    subtitle = f"{KINDS[law.kind]}, at {1 / law.period_s:g} Hz, tuned on {robots} robot{'s' if robots > 1 else ''}; "
    return page.page(f"Tuned law: {law.kind}", subtitle + provenance(None)["software"], parts)


def _course(tuned: Tuned, i: int) -> Figure:
    figure, (above, below) = page.panels((2.6, 1.9))
    target = tuned.spec.targets[i]
    wanted = math.degrees(target.theta_rad)
    band = abs(wanted) * tuned.spec.band
    above.axhspan(wanted - band, wanted + band, color=MUTED, alpha=0.2, lw=0)
    above.axhline(wanted, color=INK, lw=0.8)
    for side, colour, name in ((tuned.before, MUTED, "before"), (tuned.after, ACCENT, "after")):
        loop = side.loops[i]
        t = np.asarray(loop.t)
        above.plot(t, np.degrees(np.asarray(loop.theta)), color=colour, lw=1.6, label=name)
        below.plot(t, np.asarray(loop.left), color=colour, lw=1.2)
        below.plot(t, np.asarray(loop.right), color=colour, lw=1.2, ls="--")
    above.set(ylabel="θ [deg]")
    below.set(ylabel="tension [N]", xlabel="t [s]")
    page.legend(above, loc="best")
    return figure


def _descent(tuned: Tuned) -> Figure:
    figure, ax = page.axes()
    for r, losses in enumerate(tuned.history.T):
        ax.plot(losses, color=ACCENT if r == tuned.best[1] else MUTED, lw=1.6 if r == tuned.best[1] else 1.0)
    ax.plot(tuned.best[0], tuned.history[tuned.best], "o", color=ACCENT)
    ax.set(xlabel="iteration", ylabel="loss", yscale="log")
    return figure


def _spread(tuned: Tuned) -> Figure:
    figure, ax = page.axes()
    most = tuned.spec.duration_s
    for side, colour, name in ((tuned.before, MUTED, "before"), (tuned.after, ACCENT, "after")):
        loops = [m for row in side.measures for m in row if math.isfinite(m["steady_error_rad"])]
        x = [min(m["settling_s"], most) for m in loops]
        ax.plot(x, [math.degrees(m["steady_error_rad"]) for m in loops], "o", ms=4, color=colour, alpha=0.7, label=name)
    ax.set(xlabel=f"settling time [s], never at {most:g}", ylabel="steady error [deg]", yscale="log")
    page.legend(ax, loc="best")
    return figure
