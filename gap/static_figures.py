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
    colour = [ACCENT if f.id in result.selected else (MUTED if f.id in LAST else "#9fb6c6") for f in first]
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
