"""The page of a sweep: outputs over what was varied, and the motions themselves."""

from __future__ import annotations

from html import escape
from typing import Literal

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure

from ljjax import page
from ljjax.page import ACCENT, INK, axes, legend, number
from ljjax.sweep_result import OUTPUTS, STATUS, Sweep

RUNS, CURVES, PAIRS = 4, 60, 6
"""How many runs, curves of one run and parameters are drawn at most."""
LABELS = {
    "theta_final": ("final angle θ [deg]", np.degrees),
    "theta_max": ("largest angle θ [deg]", np.degrees),
    "theta_min": ("smallest angle θ [deg]", np.degrees),
    "rms_error": ("RMS error of θ [deg]", np.degrees),
    "loop_area": ("loop area [N·rad]", np.asarray),
    "error_estimate": ("error estimate [rad]", np.asarray),
}
SHADE, CLASH = "viridis", "#c77700"


def report(sweep: Sweep) -> str:
    """The whole page as HTML."""
    counts, status = sweep.counts, sweep["status"]
    cards = [(f"{status.size:,}", "elements"), *((f"{counts[name]:,}", name) for name in STATUS)]
    facts = [
        f"model {sweep.attributes['model_file']}" if sweep.attributes["model_file"] else "",
        f"{status.shape[0]} runs" if status.shape[0] > 1 else f"run {sweep['run'][0]}",
        f"{sweep.how} of {', '.join(sweep.parameters)}" if sweep.parameters else "",
        sweep.attributes["source"],
    ]
    parts = [page.cards(cards), page.beware(_beware(sweep))]
    parts += ['<h2>Outputs</h2><div class="grid">', *_outputs(sweep), "</div>"]
    if "theta" in sweep.variables:
        parts += ['<h2>Motions</h2><div class="grid">', *_motions(sweep), "</div>"]
    parts += ["<h2>Ranges</h2>", _ranges(sweep)]
    return page.page("Parameter sweep", " · ".join(f for f in facts if f), parts)


def _beware(sweep: Sweep) -> list[str]:
    said = {
        "sensitive": "their motion depends on the solver's step (stick-slip); they are drawn as open points, and one "
        "of them is one of many motions that the model allows",
        "inadmissible": "they were not simulated",
        "failed": "the solver lost them",
    }
    lines = []
    for k, name in enumerate(STATUS[1:], 1):
        found = sweep["reason"][sweep["status"] == k]
        if len(found):
            lines.append(f"{len(found):,} elements are {name}: {said[name]}. For example: {found[0]}.")
    return lines


def _label(sweep: Sweep, path: str) -> str:
    units = sweep.variables[path].attributes["units"]
    return path if units == "1" else f"{path} [{units}]"


def _log(x: np.ndarray) -> bool:
    """Whether values are spread evenly in their ratios rather than in their differences."""
    x = np.unique(x)
    return len(x) > 3 and x[0] > 0 and x[-1] / x[0] > 20 and bool(np.median(x) < 0.35 * (x[0] + x[-1]))


def _scale(ax: Axes, axis: Literal["x", "y"], values: np.ndarray) -> None:
    if _log(values):
        ax.set(**{f"{axis}scale": "log"})
    else:
        ax.locator_params(axis=axis, nbins=5)


def _shown(sweep: Sweep) -> list[str]:
    return [name for name in OUTPUTS if name in sweep.variables and np.isfinite(sweep[name]).any()]


def _outputs(sweep: Sweep) -> list[str]:
    if not sweep.parameters:
        return [page.figure(_over_runs(sweep, name), LABELS[name][0], "One bar a run.") for name in _shown(sweep)]
    if len(sweep.parameters) == 1:
        (path,) = sweep.parameters
        note = "Open points: sensitive. Marks at the foot: not simulated."
        return [page.figure(_curves(sweep, name, path), LABELS[name][0], note) for name in _shown(sweep)]
    out: list[str] = []
    main, share = _influences(sweep)
    order = list(share)
    if len(order) > 2:
        out.append(
            page.figure(
                _influence(share, order),
                f"Influence on {LABELS[main][0].split(' [')[0]}",
                "Share of the variance over the parameter sets that one parameter explains alone; what is missing to "
                "1 is due to several together.",
            )
        )
        out += [
            page.figure(
                _scatter(sweep, main, path),
                f"Over {path}",
                "A point a parameter set; the line joins medians of slices.",
            )
            for path in order[:PAIRS]
        ]
    x, y = order[0], order[1]
    runs = "" if len(sweep["run"]) == 1 else " Medians over the runs."
    rest = " Medians over the other parameters." if len(order) > 2 and sweep.how == "grid" else ""
    blank = "Blank" if sweep.how == "grid" else "Crosses"
    note = f"{x} and {y}. {blank}: not simulated, or lost.{runs}{rest}"
    return out + [page.figure(_map(sweep, name, x, y), LABELS[name][0], note) for name in _shown(sweep)]


def _influences(sweep: Sweep) -> tuple[str, dict[str, float]]:
    """The output that matters most, and what share of its variance each parameter explains, the largest first."""
    main = "rms_error" if "rms_error" in _shown(sweep) else "theta_final"
    share = {path: explained(sweep.column(path).ravel(), _middle(sweep, main)) for path in sweep.parameters}
    return main, dict(sorted(share.items(), key=lambda item: -item[1]))


def _over_runs(sweep: Sweep, name: str) -> Figure:
    figure, ax = axes()
    label, convert = LABELS[name]
    value = convert(sweep[name])
    ax.barh(range(len(value)), value, color=ACCENT)
    ax.set_yticks(range(len(value)), [_short(run) for run in sweep["run"]], fontsize=9 if len(value) < 20 else 5)
    ax.invert_yaxis()
    ax.set(xlabel=label)
    return figure


def _short(name: str) -> str:
    return name if len(name) < 28 else "…" + name[-27:]


def _curves(sweep: Sweep, name: str, path: str) -> Figure:
    figure, ax = axes()
    label, convert = LABELS[name]
    x, value, status = sweep[path], convert(sweep[name]), sweep["status"]
    order, runs = np.argsort(x), range(min(len(sweep["run"]), 8))
    small = 4.5 if len(x) <= 60 else 2.5
    for r in runs:
        colour = ACCENT if len(runs) == 1 else matplotlib.colormaps[SHADE](r / len(runs))
        ax.plot(x[order], value[r, order], "-", color=colour, lw=1.5, label=_short(sweep["run"][r]))
        for k, face in ((0, colour), (1, "white")):
            at = status[r] == k
            ax.plot(x[at], value[r, at], "o", ms=small, color=colour, mfc=face)
        lost = x[status[r] > 1]
        ax.plot(lost, np.zeros(len(lost)), "x", ms=5, color=CLASH, transform=ax.get_xaxis_transform(), clip_on=False)
    _scale(ax, "x", x)
    if name == "error_estimate" and np.all(value[np.isfinite(value)] > 0):
        ax.set_yscale("log")
        ax.axhline(float(sweep.attributes["sensitive_rad"]), color=CLASH, lw=1, ls=":")
    ax.set(xlabel=_label(sweep, path), ylabel=label)
    if len(runs) > 1:
        legend(ax, title="run")
    return figure


def _middle(sweep: Sweep, name: str) -> np.ndarray:
    """(S,) the output of each parameter set, the median over the runs; NaN where there is none."""
    value = sweep[name].reshape(len(sweep["run"]), -1)
    return median(value, 0)


def median(x: np.ndarray, axis: int | tuple[int, ...]) -> np.ndarray:
    """Median of what is finite, NaN where nothing is."""
    return np.ma.median(np.ma.masked_invalid(x), axis=axis).filled(np.nan) if x.size else x


def explained(x: np.ndarray, y: np.ndarray) -> float:
    """Share of the variance of y (S,) that slices of x (S,) explain, less what chance explains; 0 … 1."""
    known = np.isfinite(y)
    x, y = x[known], y[known]
    if len(y) < 4 or np.ptp(y) == 0:
        return 0.0
    part = slices(x)
    used = np.unique(part)
    if len(used) >= len(y):
        return 0.0
    within = sum(np.sum((y[part == k] - y[part == k].mean()) ** 2) for k in used) / (len(y) - len(used))
    return float(np.clip(1 - within / y.var(ddof=1), 0, 1))


def slices(x: np.ndarray, most: int = 8) -> np.ndarray:
    """(S,) the slice each value is in: one a value where there are few values, else of equal counts."""
    values, index = np.unique(x, return_inverse=True)
    if len(values) <= most:
        return index
    return np.searchsorted(np.quantile(x, np.linspace(0, 1, most + 1)[1:-1]), x, side="right")


def _influence(share: dict[str, float], order: list[str]) -> Figure:
    figure, ax = axes(height=1.2 + 0.36 * max(len(order), 3))
    ax.barh(range(len(order)), [share[path] for path in order], color=ACCENT)
    ax.set_yticks(range(len(order)), order)
    ax.invert_yaxis()
    ax.set(xlabel="share of the variance", xlim=(0, 1))
    ax.grid(False, axis="y")
    return figure


def _scatter(sweep: Sweep, name: str, path: str) -> Figure:
    figure, ax = axes()
    label, convert = LABELS[name]
    x, y = sweep.column(path).ravel(), convert(_middle(sweep, name))
    known = np.isfinite(y)
    shaken = np.any(sweep["status"] == 1, axis=0).ravel()
    for at, face in ((known & ~shaken, ACCENT), (known & shaken, "none")):
        ax.scatter(x[at], y[at], s=10, facecolors=face, edgecolors=ACCENT, linewidths=0.6, alpha=0.5, rasterized=True)
    part = slices(x)
    middle = [(np.median(x[own]), np.median(y[own])) for k in np.unique(part) if (own := (part == k) & known).any()]
    ax.plot(*zip(*middle, strict=True), "-", color=INK, lw=1.6)
    _scale(ax, "x", x)
    ax.set(xlabel=_label(sweep, path), ylabel=label)
    return figure


def _map(sweep: Sweep, name: str, x: str, y: str) -> Figure:
    figure, ax = axes()
    label, convert = LABELS[name]
    if sweep.how == "grid":
        dims = sweep.variables[name].dims
        others = tuple(k for k, dim in enumerate(dims) if dim not in (x, y))
        value = convert(median(sweep[name], others))
        value = value if dims.index(x) > dims.index(y) else value.T
        drawn = ax.pcolormesh(sweep[x], sweep[y], value, cmap=SHADE, shading="nearest", rasterized=True)
        ax.grid(False)
    else:
        value = convert(_middle(sweep, name))
        known = np.isfinite(value)
        ax.plot(sweep[x][~known], sweep[y][~known], "x", ms=5, color=CLASH)
        drawn = ax.scatter(sweep[x][known], sweep[y][known], c=value[known], s=22, cmap=SHADE, rasterized=True)
    _scale(ax, "x", sweep[x])
    _scale(ax, "y", sweep[y])
    figure.colorbar(drawn, ax=ax, label=label)
    ax.set(xlabel=_label(sweep, x), ylabel=_label(sweep, y))
    return figure


def _motions(sweep: Sweep) -> list[str]:
    figures = []
    path = next(iter(_influences(sweep)[1]), None)
    status = sweep["status"].reshape(len(sweep["run"]), -1)
    for r in range(min(len(sweep["run"]), RUNS)):
        name = str(sweep["run"][r])
        time = sweep["time"] if sweep["time"].ndim == 1 else sweep["time"][r]
        good = np.flatnonzero(status[r] < 2)
        if not len(good):
            continue
        drawn = good[np.unique(np.linspace(0, len(good) - 1, min(CURVES, len(good))).astype(int))]
        theta = np.degrees(sweep["theta"][r].reshape(-1, len(time)))
        figure, ax = axes()
        _family(figure, ax, sweep, path, time, theta, drawn)
        caption = f"Mean segment angle over time, {len(drawn)} of {len(good)} parameter sets"
        caption += f", coloured by {path}." if path else "."
        if "theta_measured" in sweep.variables and np.isfinite(measured := sweep["theta_measured"][r]).any():
            ax.plot(time, np.degrees(measured), color=INK, lw=1.4, ls="--")
            caption += " Dashed: measured."
        ax.set(xlabel="time [s]", ylabel="mean segment angle θ [deg]")
        figures.append(page.figure(figure, name, caption))
        if len(good) > 1:
            figure, ax = axes()
            _family(figure, ax, sweep, path, time, theta - median(theta[good], 0), drawn)
            ax.set(xlabel="time [s]", ylabel="θ − median of all sets [deg]")
            figures.append(page.figure(figure, f"{name}, differences", "The same motions, less their median."))
    return figures


def _family(figure: Figure, ax: Axes, sweep: Sweep, path: str | None, time, theta, chosen) -> None:
    if path is None:
        ax.plot(time, theta[chosen].T, color=ACCENT, lw=1.5)
        return
    value = sweep.column(path).ravel()[chosen]
    if not len(value):
        return
    norm = LogNorm() if _log(sweep[path]) else Normalize()
    norm.autoscale(value)
    shade = ScalarMappable(norm, SHADE)
    for k, colour in zip(chosen, shade.to_rgba(value), strict=True):
        ax.plot(time, theta[k], color=colour, lw=1, alpha=0.8)
    figure.colorbar(shade, ax=ax, label=_label(sweep, path))


def _ranges(sweep: Sweep) -> str:
    rows = []
    for name in (*sweep.parameters, *_shown(sweep)):
        variable = sweep.variables[name]
        x = variable.data[np.isfinite(variable.data)]
        digits = [number(float(v), 4) for v in (x.min(), np.median(x), x.max())]
        about = variable.attributes
        rows.append([f"<code>{escape(name)}</code>", *digits, escape(about["units"]), escape(about["long_name"])])
    return page.table(["", "lowest", "median", "highest", "unit", "what it is"], rows, numeric=(1, 2, 3))
