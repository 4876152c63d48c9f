"""The pictures of a static fit, and those that every fit has: intervals and correlations."""

from __future__ import annotations

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from ljjax.fit.points import UNIT, Points
from ljjax.fit.result import FitResult, StaticResult
from ljjax.fit.static import Stage, predict, prediction_sd
from ljjax.page import ACCENT, INK, MUTED, axes, legend


def colours(count: int) -> np.ndarray:
    """(count, 4) colours from dark to light."""
    return matplotlib.colormaps["viridis"](np.linspace(0.05, 0.88, max(count, 1)))


def _curve(kind: str, pressure: np.ndarray, theta: np.ndarray) -> Points:
    nothing = np.zeros(len(pressure))
    none = nothing.astype(int)
    return Points(kind, nothing, nothing + np.nan, pressure, theta, nothing, none, none.astype(bool))


def tension(result: StaticResult, stage: Stage) -> Figure:
    """Measured tension with its scatter over angle, and the model's curves, a colour a pressure level."""
    figure, ax = axes()
    points, levels = stage.points, stage.points.levels
    pressures = points.level_pressures()
    theta = np.linspace(min(0.0, points.theta.min()), points.theta.max() * 1.03, 60)
    for k, (p, colour) in enumerate(zip(pressures, colours(len(pressures)), strict=True)):
        mine = levels == k
        sd = np.nan_to_num(points.sd[mine])
        ax.errorbar(np.degrees(points.theta[mine]), points.value[mine], sd, fmt="o", ms=3.5, color=colour, lw=1)
        curve = predict(result.model, _curve("steady", np.full(len(theta), p), theta))
        ax.plot(np.degrees(theta), curve, color=colour, lw=1.6, label=f"{round(p, 1):g} kPa")
    ax.set(xlabel="mean segment angle θ [deg]", ylabel="net tension u₁ − u₂ [N]")
    legend(ax, title="vacuum", ncols=1 if len(pressures) < 7 else 2)
    return figure


def residuals(stage: Stage) -> Figure:
    """Measured minus model over angle, a line a pressure level."""
    figure, ax = axes()
    points, levels = stage.points, stage.points.levels
    pressures = points.level_pressures()
    for k, (p, colour) in enumerate(zip(pressures, colours(len(pressures)), strict=True)):
        mine = np.flatnonzero(levels == k)
        mine = mine[np.argsort(points.theta[mine])]
        ax.plot(
            np.degrees(points.theta[mine]),
            stage.error[mine],
            "o-",
            ms=3.5,
            lw=1.2,
            color=colour,
            label=f"{round(p, 1):g} kPa",
        )
    if band := points.scatter:
        ax.axhspan(-band, band, color=MUTED, alpha=0.13, lw=0, label="stated scatter ± 1 sd")
    ax.axhline(0, color=INK, lw=0.8)
    ax.set(xlabel="mean segment angle θ [deg]", ylabel="measured − model [N]")
    legend(figure, loc="outside upper center", ncols=3)
    return figure


def error_map(stage: Stage) -> Figure:
    """Where the fit is worst: the error over pressure and angle."""
    figure, ax = axes()
    points = stage.points
    limit = float(np.abs(stage.error).max()) or 1.0
    order = np.argsort(np.abs(stage.error))  # the largest on top
    drawn = ax.scatter(
        points.pressure_kpa[order],
        np.degrees(points.theta[order]),
        c=stage.error[order],
        cmap="RdBu_r",
        vmin=-limit,
        vmax=limit,
        s=70,
        marker="s",
        edgecolors="white",
        linewidths=0.6,
    )
    worst = int(np.argmax(np.abs(stage.error)))
    ax.scatter(
        points.pressure_kpa[worst], np.degrees(points.theta[worst]), s=170, marker="s", facecolors="none",
        edgecolors=INK, linewidths=1.4,
    )  # fmt: skip
    figure.colorbar(drawn, ax=ax, label="measured − model [N]")
    ax.set(xlabel="vacuum $u_P$ [kPa]", ylabel="mean segment angle θ [deg]")
    return figure


def probe(result: StaticResult, stage: Stage) -> Figure:
    """Measured tip stiffness over pressure and the model's curve with its 95 % band."""
    figure, ax = axes()
    points = stage.points
    p = np.linspace(0, points.pressure_kpa.max() * 1.03, 200)
    curve = _curve("probe", p, np.zeros(len(p)))
    middle, sd = np.asarray(predict(result.model, curve)), prediction_sd(result.static, curve)
    if np.all(np.isfinite(sd)):
        ax.fill_between(
            p, middle - 1.96 * sd, middle + 1.96 * sd, color=ACCENT, alpha=0.15, lw=0, label="95 % of the curve"
        )
    ax.plot(p, middle, color=ACCENT, lw=1.8, label="model")
    ax.errorbar(
        points.pressure_kpa,
        points.value,
        np.nan_to_num(points.sd),
        fmt="o",
        ms=4.5,
        color=INK,
        lw=1,
        label="measured ± 1 sd",
    )
    ax.set(xlabel="vacuum $u_P$ [kPa]", ylabel="tip stiffness $K_T$ [N/m]", ylim=(0, None))
    legend(ax, loc="lower right")
    return figure


def left_out(stage: Stage) -> Figure:
    """RMS error at each pressure level: of the fit, and of a fit that has not seen that level."""
    figure, ax = axes()
    levels, pressures = stage.points.levels, stage.points.level_pressures()
    at = np.arange(len(pressures))

    def rms(errors):
        return [np.sqrt(np.mean(errors[levels == k] ** 2)) for k in at]

    ax.bar(at - 0.2, rms(stage.error), 0.38, color=MUTED, alpha=0.6, label="fit on all")
    ax.bar(at + 0.2, rms(stage.held_out), 0.38, color=ACCENT, label="this pressure left out")
    ax.set_xticks(at, [f"{round(p, 1):g}" for p in pressures])
    ax.set(xlabel="vacuum $u_P$ [kPa]", ylabel=f"RMS error [{UNIT[stage.points.kind]}]")
    ax.grid(False, axis="x")
    legend(ax)
    return figure


def intervals(result: FitResult) -> Figure:
    """Every fitted parameter's 95 % interval relative to its value, and its range over left-out pressures."""
    fitted = [p for p in result.parameters.values() if p.sd]
    figure, ax = axes(height=0.9 + (0.48 if len(fitted) < 8 else 0.32) * max(len(fitted), 3))
    for i, p in enumerate(fitted):
        good = p.settled
        size = abs(p.value)
        if p.sd_over_pressures:
            ax.plot(
                np.array([-2, 2]) * p.sd_over_pressures / size * 100,
                [i, i],
                color=MUTED,
                lw=5,
                alpha=0.3,
                solid_capstyle="butt",
            )
        low, high = p.ci95 or (p.value, p.value)
        ax.plot(
            [100 * (low - p.value) / size, 100 * (high - p.value) / size],
            [i, i],
            color="#1b7f4b" if good else "#c77700",
            lw=2.4,
        )
        ax.plot(0, i, "o", color=INK, ms=4.5)
    ax.axvline(0, color=INK, lw=0.8)
    for edge in (-100, 100):
        ax.axvline(edge, color="#c77700", lw=1, ls=":")
    close = bool(fitted) and np.median([(p.sd or 0.0) / abs(p.value) for p in fitted]) < 0.02
    ticks = np.array([-100, -10, -1, 0, 1, 10, 100] if close else [-100, -10, 0, 10, 100])
    ax.set_xscale("symlog", linthresh=1 if close else 10)
    ax.set_xticks(ticks, [f"{tick}".replace("-", "−") for tick in ticks])
    ax.set_yticks(range(len(fitted)), [p.name for p in fitted])
    ax.invert_yaxis()
    ax.set(xlabel="deviation [% of the estimate]")
    ax.grid(False, axis="y")
    return figure


def correlation(result: FitResult) -> Figure:
    """Correlation matrix of the fitted parameters; in a large one only what is far from 0 is written out."""
    names, matrix = result.correlation
    large = len(names) > 8
    figure, ax = axes(height=5.2 if large else 4.3)
    ax.imshow(matrix, cmap="RdBu_r", vmin=-1, vmax=1)
    short = [name.split(".")[-1] for name in names]
    ax.set_xticks(range(len(short)), short, rotation=90 if large else 0)
    ax.set_yticks(range(len(short)), short)
    ax.grid(False)
    for i in range(len(short)):
        for j in range(len(short)):
            r = matrix[i, j]
            if np.isfinite(r) and (not large or (i != j and abs(r) > 0.3)):
                text = f"{round(r, 2) + 0.0:.2f}"
                ax.text(
                    j,
                    i,
                    text.replace("0.", ".", 1) if large else text,
                    ha="center",
                    va="center",
                    fontsize=7.5 if large else 9,
                    color="white" if abs(r) > 0.6 else INK,
                )
    return figure
