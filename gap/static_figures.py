"""The pictures of a diagnosis of steady data."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ljjax.fit.figures import colours
from ljjax.fit.points import Points
from ljjax.gap.result import LAST, Diagnosis
from ljjax.gap.static_runs import Apart
from ljjax.gap.static_stage import Channel
from ljjax.page import ACCENT, GRID, INK, MUTED, axes, legend

BASE_COLOUR = "#c77700"
MEASURED, PALE = "#c9d2db", "#9fb6c6"
BESIDE = 3.0
"""A step more than this many times the next is cut in the waterfall."""
FALLS = (
    "Each bar begins where the one above it ends. In brackets: change of the squared error beyond the noise. Hatched: "
    "what stays over the noise."
)
"""What a waterfall shows."""


def plain(name: str) -> str:
    """An id as words."""
    return name.replace("_", " ")


def _along(kind: str, theta: np.ndarray, pressure: np.ndarray) -> Points:
    nothing = np.zeros(len(theta))
    none = nothing.astype(int)
    return Points(kind, nothing, nothing + np.nan, pressure, theta, nothing, none, none.astype(bool))


def tension(story: Any, c: Channel) -> Figure:
    """Measured tension over angle, a colour a pressure, with the curves of the base and of the extended model."""
    figure, ax = axes(height=4.6)
    points, levels = c.points, c.points.levels
    pressures = points.level_pressures()
    theta = np.linspace(min(0.0, points.theta.min()), points.theta.max() * 1.03, 40)
    for k, (p, colour) in enumerate(zip(pressures, colours(len(pressures)), strict=True)):
        mine = levels == k
        ax.plot(np.degrees(points.theta[mine]), points.value[mine], "o", ms=3.5, color=colour, label=f"{p:.3g} kPa")
        at = _along("steady", theta, np.full(len(theta), p))
        ax.plot(np.degrees(theta), story.laws.values(story.laws.x0, at), color=colour, lw=1.1, ls="--")
        ax.plot(np.degrees(theta), story.laws.values(story.x, at), color=colour, lw=1.7)
    ax.plot([], [], color=INK, lw=1.1, ls="--", label="base model")
    ax.plot([], [], color=INK, lw=1.7, label="with the effects")
    ax.set(xlabel="mean segment angle θ [deg]", ylabel="net tension u₁ − u₂ [N]")
    legend(figure, loc="outside upper center", ncols=4)
    return figure


def law(story: Any, c: Channel) -> Figure:
    """Over pressure: what is measured (tension at one angle, or tip stiffness), the two models' laws, and what each
    says of a pressure it has not seen."""
    figure, ax = axes(height=4.7)
    points, levels = c.points, c.points.levels
    if c.kind == "steady":
        counts = {a: len(np.unique(levels[np.isclose(points.theta, a)])) for a in np.unique(np.round(points.theta, 9))}
        most = [a for a, n in counts.items() if n == max(counts.values())]
        angle = most[int(0.67 * (len(most) - 1))]
        mine = np.isclose(points.theta, angle)
        ax.set(ylabel=f"tension that holds {np.degrees(angle):.3g}° [N]")
    else:
        angle, mine = float(np.median(points.theta)), np.ones(len(points), bool)
        ax.set(ylabel="tip stiffness $K_T$ [N/m]")
    p = np.linspace(0, points.pressure_kpa.max() * 1.03, 120)
    at = _along(c.kind, np.full(len(p), angle), p)
    seen, sd = points.value[mine], np.nan_to_num(points.sd[mine])
    for x, errors, colour, style, name in (
        (story.laws.x0, c.base, BASE_COLOUR, "--", "base model"),
        (story.x, c.model, ACCENT, "-", "with the effects"),
    ):
        ax.plot(p, story.laws.values(x, at), color=colour, lw=1.7, ls=style, label=name)
        predicted = seen - errors.left_out[mine]
        shift = -0.35 if colour == BASE_COLOUR else 0.35
        label = f"{name}, pressure left out"
        ax.plot(points.pressure_kpa[mine] + shift, predicted, "D", ms=5, mfc="none", mec=colour, label=label)
    ax.errorbar(points.pressure_kpa[mine], seen, sd, fmt="o", ms=4.5, color=INK, lw=1, label="measured ± 1 sd")
    low, high = float(np.min(seen - sd)), float(np.max(seen + sd))
    room = 0.35 * (high - low) + 1e-9
    ax.set(xlabel="vacuum $u_P$ [kPa]", ylim=(low - room, high + room))
    legend(figure, loc="outside upper center", ncols=2, fontsize=9)
    return figure


def left_out(c: Channel) -> Figure:
    """RMS error at each pressure of a fit that has not seen it, without and with the effects."""
    figure, ax = axes()
    levels, pressures = c.points.levels, c.points.level_pressures()
    at = np.arange(len(pressures))
    for shift, errors, colour, name in (
        (-0.2, c.base, BASE_COLOUR, "base model"),
        (0.2, c.model, ACCENT, "with the effects"),
    ):
        rms = [errors.rms(levels == k) for k in at]
        bars = ax.bar(at + shift, rms, 0.38, color=colour, label=name)
        ax.bar_label(bars, [f"{x:.2g}" for x in rms], fontsize=8.5, color=MUTED, padding=1)
    ax.axhline(c.noise, color=INK, lw=1, ls=":", label="measurements' scatter")
    ax.set_xticks(at, [f"{p:.3g}" for p in pressures])
    ax.set(xlabel="vacuum left out [kPa]", ylabel=f"RMS error [{c.unit}]")
    ax.grid(False, axis="x")
    legend(ax)
    return figure


def ranking(result: Diagnosis) -> Figure:
    """Probability of each cause, the likeliest above."""
    first = [f for f in result.effects if f.probability >= 5e-3][:10] or list(result.effects[:5])
    figure, ax = axes(height=1.2 + 0.36 * len(first))
    at = np.arange(len(first))
    colour = [ACCENT if f.id in result.selected else (MUTED if f.id in LAST else PALE) for f in first]
    bars = ax.barh(at, [f.probability for f in first], 0.66, color=colour)
    ax.bar_label(bars, [f"{100 * f.probability:.0f} %" for f in first], padding=3, fontsize=10, color=INK)
    ax.set_yticks(at, [plain(f.id) for f in first])
    ax.invert_yaxis()
    ax.set(xlabel="probability of being the main cause", xlim=(0, 1.12))
    ax.grid(False, axis="y")
    return figure


def where(c: Channel) -> Figure:
    """The base model's error at left-out pressures, over pressure and angle."""
    figure, ax = axes()
    p, e = c.points, c.base.left_out
    limit = float(np.nanmax(np.abs(e))) or 1.0
    drawn = ax.scatter(
        p.pressure_kpa, np.degrees(p.theta), c=e, cmap="RdBu_r", vmin=-limit, vmax=limit, s=70, marker="s",
        edgecolors=GRID, linewidths=0.6,
    )  # fmt: skip
    figure.colorbar(drawn, ax=ax, label=f"measured − base model [{c.unit}]")
    ax.set(xlabel="vacuum left out [kPa]", ylabel="mean segment angle θ [deg]")
    return figure


def closing(c: Channel) -> Figure:
    """The RMS error at pressures left out (of tension the inner ones), from the given model over the base refitted to
    each effect found on these points, down to their scatter."""
    keep = c.inner if c.kind == "steady" else np.ones(len(c.points), bool)
    level = [float(np.sqrt(np.mean(c.given[keep] ** 2))), c.base.rms(keep)]
    inside = np.unique(c.points.levels[keep])
    by = np.bincount(c.points.levels)[inside]
    for r in c.rounds[1 : len(c.added)]:  # squares of the levels left out, in units of the scatter's
        level.append(c.noise * float(np.sqrt(np.average(r.none.left_out[inside], weights=by))))
    if c.added:
        level.append(c.model.rms(keep))
    names = ["given model", "base refitted", *(f"+ {plain(e)}" for e in c.added)]
    where = "pressures left out" if keep.all() else "inner pressures left out"
    return waterfall(names, level, c.noise, f" {c.unit}", f"RMS error at {where}")


def leftover(c: Channel) -> Figure:
    """What the extended model leaves over angle, a colour a pressure, with the line through each."""
    figure, ax = axes(height=4.3)
    points, levels, error = c.points, c.points.levels, c.model.error
    pressures = points.level_pressures()
    for k, (p, colour) in enumerate(zip(pressures, colours(len(pressures)), strict=True)):
        mine = levels == k
        theta = points.theta[mine]
        ax.plot(np.degrees(theta), error[mine], "o", ms=3.5, color=colour, label=f"{p:.3g} kPa")
        if len(theta) > 2 and np.ptp(theta) > 0:
            line = np.polynomial.Polynomial.fit(theta, error[mine], 1)
            ends = np.array([min(0.0, theta.min()), theta.max()])
            ax.plot(np.degrees(ends), line(ends), color=colour, lw=1.4)
    ax.axhspan(-c.noise, c.noise, color=MUTED, alpha=0.13, lw=0, label="scatter ± 1 sd")
    ax.axhline(0, color=INK, lw=0.8)
    ax.set(xlabel="mean segment angle θ [deg]", ylabel="measured − extended model [N]")
    legend(figure, loc="outside upper center", ncols=3)
    return figure


def apart(logs: Sequence[Apart]) -> Figure:
    """How many times more another log reads than the fitted one."""
    figure, ax = axes()
    for log, colour in zip(logs, colours(len(logs)), strict=True):
        ratio = log.points.value / log.expected
        known = np.isfinite(ratio)
        for angle in np.unique(np.round(log.points.theta[known], 9)):
            mine = known & np.isclose(log.points.theta, angle)
            _line(ax, log.points.pressure_kpa[mine], ratio[mine], colour, f"{log.name}, {np.degrees(angle):.3g}°")
    ax.axhline(1, color=INK, lw=1, ls=":", label="the fitted log")
    ax.set(xlabel="vacuum $u_P$ [kPa]", ylabel="tension, as a multiple of the fitted log's", ylim=(0, None))
    legend(ax, loc="lower right")
    return figure


def _line(ax: Axes, x: np.ndarray, y: np.ndarray, colour: Any, label: str) -> None:
    order = np.argsort(x)
    ax.plot(x[order], y[order], "o-", ms=4.5, lw=1.4, color=colour, label=label)
    ax.annotate(
        label.split(", ")[-1], (x[order][-1], y[order][-1]), xytext=(4, 4), textcoords="offset points", fontsize=9
    )


def waterfall(names: Sequence[str], level: Sequence[float], floor: float, unit: str, axis: str) -> Figure:
    """The error at each named step, the fall from the one before it, and what is left over the noise `floor`, all in
    `unit`; `axis` says what error."""
    later = float(max(level[1:])) if len(level) > 1 else float(level[0])
    edge = BESIDE * later if level[0] > BESIDE * later else 1.22 * float(max(level))
    figure, ax = axes(height=1.4 + 0.48 * (len(level) + 2))
    ax.barh(0, min(level[0], edge), 0.6, color=PALE)
    _cut(ax, level[0], edge, unit)
    for k in range(1, len(level)):
        better = level[k] <= level[k - 1]
        a, b = sorted((min(level[k - 1], edge), min(level[k], edge)))
        colour = (BASE_COLOUR if k == 1 else ACCENT) if better else "#b3364a"
        ax.barh(k, b - a, 0.6, left=a, color=colour)
        gone = level[k] ** 2 - level[k - 1] ** 2
        before = level[k - 1] ** 2 - floor**2
        share = f" ({100 * gone / before:+.0f} %)".replace("-", "−") if before > 0 else ""
        ax.text(b + 0.012 * edge, k, f"→ {level[k]:.3g}{unit}{share}", va="center", fontsize=9.5)
    last = len(level)
    a, b = floor, max(min(level[-1], edge), floor)
    ax.barh(last, b - a, 0.6, left=a, color="white", edgecolor=MUTED, hatch="///", lw=0.8)
    ax.text(b + 0.012 * edge, last, f"{max(level[-1] - floor, 0.0):.2g}{unit}", va="center", fontsize=9.5)
    ax.barh(last + 1, floor, 0.6, color=MEASURED)
    ax.text(floor + 0.012 * edge, last + 1, f"{floor:.3g}{unit}", va="center", fontsize=9.5)
    for k in range(last + 1):  # each bar begins where the one before it ends
        x = min(level[k], edge) if k < last else floor
        ax.plot([x, x], [k - 0.3, k + 1.3], color=INK, lw=0.8, ls=":")
    ax.set_yticks(range(last + 2), [*names, "not explained", "noise floor"])
    ax.invert_yaxis()
    ax.set(xlabel=f"{axis} [{'deg' if unit == '°' else unit.strip()}]", xlim=(0, edge * 1.02))
    ax.grid(False, axis="y")
    return figure


def _cut(ax: Axes, value: float, edge: float, unit: str) -> None:
    """The number of the first bar, marked where the bar goes on beyond the picture."""
    if value <= edge:
        ax.text(value + 0.012 * edge, 0, f"{value:.3g}{unit}", va="center", fontsize=9.5)
    else:
        where = {"va": "center", "ha": "right", "fontsize": 10, "fontweight": "bold", "color": INK}
        ax.text(0.98 * edge, 0, f"{value:.3g}{unit}  »", **where)
