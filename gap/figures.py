"""The pictures of a moving diagnosis: where the gap lies, its causes, runs overlaid."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize, PowerNorm
from matplotlib.figure import Figure

from ljjax import page
from ljjax.gap.result import LAST, Diagnosis, Finding
from ljjax.gap.static_figures import BASE_COLOUR, MEASURED, PALE, plain
from ljjax.gap.story import Course, percent
from ljjax.page import ACCENT, INK, MUTED, axes, legend, panels

NAMES = {"given": "given model", "base": "base refitted", "extended": "with the effects"}
COLOURS = {"given": MUTED, "base": BASE_COLOUR, "extended": ACCENT}
WAYS = {1.0: "away from straight", -1.0: "back to straight", 0.0: "at rest"}
MAP = "magma_r"
LEVELS, CELLS, SLICES = 8, 10, 60
"""Pressures drawn one by one, else in so many bins; bins of the angle; slices of the longest run."""
FEW = 5
"""Fewer samples than this in a cell are not drawn."""
LONG = 3000
"""Beyond so many samples rough lines are pixels."""


def _rows(count: int, width: float, height: float) -> tuple[Figure, list[Axes]]:
    """A figure of panels side by side over one y axis."""
    with matplotlib.rc_context(page._STYLE):
        figure = Figure(figsize=(width, height), layout="constrained")
        return figure, list(figure.subplots(1, count, sharey=True, squeeze=False)[0])


# --- where the gap lies


class Maps:
    """RMS residuals [deg] over pressure × angle, by direction of motion, on one scale for all models.

    `cells[model][way]` (P, A) of `models`, NaN where there are next to no samples.
    """

    def __init__(self, courses: Sequence[Course], models: Sequence[str]):
        pressure, self.angle, way = (
            np.concatenate([getattr(c, name) for c in courses]) for name in ("pressure", "angle", "direction")
        )
        self.angle = np.degrees(self.angle)
        self.ticks, level = _levels(pressure)
        low, high = float(self.angle.min()), float(self.angle.max())
        self.edges = np.linspace(low, max(high, low + 1e-3), CELLS + 1)
        column = np.clip(np.searchsorted(self.edges, self.angle, side="right") - 1, 0, CELLS - 1)
        place = level * CELLS + column
        self.cells: dict[str, dict[float, np.ndarray]] = {}
        for model in models:
            square = np.concatenate([np.mean(c.error(model) ** 2, axis=1) for c in courses])
            self.cells[model] = {}
            for w in WAYS:
                mine = way == w
                count = np.bincount(place[mine], minlength=len(self.ticks) * CELLS)
                total = np.bincount(place[mine], square[mine], minlength=len(self.ticks) * CELLS)
                mean = np.where(count < FEW, np.nan, total / np.maximum(count, 1))
                self.cells[model][w] = np.degrees(np.sqrt(mean)).reshape(len(self.ticks), CELLS)
        every = np.concatenate([x.ravel() for of in self.cells.values() for x in of.values()])
        self.top = float(np.nanmax(every)) if np.any(np.isfinite(every)) else 1.0

    def picture(self, model: str) -> Figure:
        """One model's, a panel for each direction in which there are samples."""
        shown = {w: x for w, x in self.cells[model].items() if np.any(np.isfinite(x))} or {1.0: self.cells[model][1.0]}
        figure, row = _rows(len(shown), 5.6, 2.3 + 0.25 * len(self.ticks))
        norm = Normalize(0, self.top)
        for ax, (way, cells) in zip(row, shown.items(), strict=True):
            rows = np.arange(len(self.ticks) + 1)
            ax.pcolormesh(self.edges, rows, cells, cmap=MAP, norm=norm, edgecolor="face")
            ax.set_title(WAYS[way], fontsize=11, color=INK)
            ax.set_yticks(np.arange(len(self.ticks)) + 0.5, self.ticks)
            ax.grid(False)
            ax.tick_params(labelsize=10)
        row[0].set_ylabel("vacuum $u_P$ [kPa]")
        figure.supxlabel("mean angle of a joint [deg]", fontsize=12, color=INK)
        figure.colorbar(
            ScalarMappable(norm, MAP), ax=row, label="RMS error [deg]", aspect=12, location="top", shrink=0.7
        )
        return figure


def _levels(pressure: np.ndarray) -> tuple[list[str], np.ndarray]:
    """Names of the levels of a pressure (N,) [kPa], few ones as they are, else bins; and each sample's level."""
    rounded = np.round(pressure)
    known, level, count = np.unique(rounded, return_inverse=True, return_counts=True)
    if len(known) <= LEVELS or count[np.argsort(-count)][:LEVELS].sum() == len(pressure):
        return [f"{x:g}" for x in known], level
    edges = np.unique(np.round(np.linspace(pressure.min(), pressure.max(), LEVELS + 1)))
    level = np.clip(np.searchsorted(edges, pressure, side="right") - 1, 0, len(edges) - 2)
    return [f"{a:g}–{b:g}" for a, b in zip(edges[:-1], edges[1:], strict=True)], level


def timelines(courses: Sequence[Course], model: str, before: str, shares: Sequence[float]) -> Figure:
    """When in each run a model errs: squared error per second, in shares [%/s] of all that the model `before` leaves;
    beside each run its share of what this one leaves."""
    longest = max(float(c.t[-1]) for c in courses)
    edges = np.linspace(0, longest, SLICES + 1)
    whole = sum(float(np.sum(c.error(before) ** 2)) for c in courses) or 1.0
    figure, ax = axes(height=1.6 + 0.32 * len(courses))
    lines = {m: [_sliced(c, m, edges) * 100 / whole for c in courses] for m in {model, before}}
    top = float(np.nanmax([np.nanmax(x) for x in lines[before]])) or 1.0
    norm = PowerNorm(0.5, 0, top)
    for row, line in enumerate(lines[model]):
        ax.pcolormesh(edges, [row - 0.4, row + 0.4], line[None], cmap=MAP, norm=norm, edgecolor="face")
        ax.text(1.015, row, f"{100 * shares[row]:.1f} %", transform=ax.get_yaxis_transform(), va="center", fontsize=9.5)
    names = [_short(c.run_id) + (" ◂" if c.held_out else "") for c in courses]
    ax.set_yticks(np.arange(len(courses)), names, fontsize=9.5)
    ax.set(xlabel="time in the run [s]", xlim=(0, longest), ylim=(len(courses) - 0.5, -0.5))
    ax.grid(False)
    figure.colorbar(
        ScalarMappable(norm, MAP),
        ax=ax,
        label=f"share of the squared error, {NAMES[before]} [%/s]",
        location="top",
        aspect=25,
    )
    return figure


def _sliced(c: Course, model: str, edges: np.ndarray) -> np.ndarray:
    """(S,) squared error per second in each slice; NaN beyond the run's end."""
    square = np.sum(c.error(model) ** 2, axis=1)
    index = np.clip(np.searchsorted(edges, c.t, side="right") - 1, 0, len(edges) - 2)
    out = np.bincount(index, square, len(edges) - 1) / np.diff(edges)
    out[edges[:-1] > c.t[-1]] = np.nan
    return out


def _short(name: str, most: int = 16) -> str:
    return name if len(name) <= most else "…" + name[1 - most :]


def joints(courses: Sequence[Course], models: Sequence[str]) -> Figure:
    """RMS error of every joint, from the base to the tip."""
    figure, ax = axes(height=3.4)
    count = courses[0].measured.shape[1]
    width = 0.8 / len(models)
    for k, model in enumerate(models):
        square = np.concatenate([c.error(model) ** 2 for c in courses])
        at = np.arange(count) + 1 + (k - (len(models) - 1) / 2) * width
        ax.bar(at, np.degrees(np.sqrt(square.mean(axis=0))), 0.92 * width, color=COLOURS[model], label=NAMES[model])
    noise = np.degrees(np.sqrt(np.mean([c.noise**2 for c in courses], axis=0)))
    ax.plot(np.arange(count) + 1, noise, "_", ms=18, color=INK, label="white noise")
    ax.set_xticks(np.arange(count) + 1)
    ax.set(xlabel="joint, from the base to the tip", ylabel="RMS error [deg]")
    ax.grid(False, axis="x")
    legend(figure, loc="outside upper center", ncols=3)
    return figure


# --- causes


def ranking(shown: Sequence[Finding], result: Diagnosis) -> Figure:
    """Probability of each cause, the likeliest above."""
    figure, ax = axes(height=1.2 + 0.36 * len(shown))
    at = np.arange(len(shown))
    colour = [ACCENT if f.id in result.selected else (MUTED if f.id in LAST else PALE) for f in shown]
    bars = ax.barh(at, [100 * f.probability for f in shown], 0.66, color=colour)
    ax.bar_label(bars, [percent(f.probability) for f in shown], padding=3, fontsize=10, color=INK)
    ax.set_yticks(at, [plain(f.id) for f in shown])
    ax.invert_yaxis()
    ax.set(xlabel="probability of being the main cause [%]", xlim=(0, 122), xticks=range(0, 101, 20))
    ax.grid(False, axis="y")
    return figure


def closing(shown: Sequence[Finding], result: Diagnosis, refitted: Mapping[str, Any]) -> Figure:
    """Share of the fitted runs' gap that each candidate closes by itself."""
    figure, ax = axes(height=1.2 + 0.36 * len(shown))
    at = np.arange(len(shown))
    share = np.array([100 * min(max(f.closed_fraction or 0.0, 0.0), 1.0) for f in shown])
    colour = [ACCENT if f.id in result.selected else PALE for f in shown]
    hollow = ["white" if f.id not in refitted else c for f, c in zip(shown, colour, strict=True)]
    bars = ax.barh(at, share, 0.66, color=hollow, edgecolor=colour, lw=1.2)
    words = [f"{x:z.0f} %" if f.id in refitted else f"≤ {x:z.0f} %" for f, x in zip(shown, share, strict=True)]
    ax.bar_label(bars, words, padding=3, fontsize=10, color=INK)
    ax.set_yticks(at, [plain(f.id) for f in shown])
    ax.invert_yaxis()
    ax.set(xlabel="share of the gap closed [%]", xlim=(0, 116), xticks=range(0, 101, 20))
    ax.grid(False, axis="y")
    return figure


def likeness(ids: Sequence[str], matrix: np.ndarray) -> Figure:
    """How alike the traces of candidates are."""
    count = len(ids)
    figure, ax = axes(height=1.6 + 0.42 * count)
    ax.imshow(matrix, cmap="Blues", vmin=0, vmax=1.25, aspect="auto")
    for i in range(count):
        for j in range(count):
            ink = "white" if matrix[i, j] > 0.85 else INK
            ax.text(j, i, f"{matrix[i, j]:.2f}", ha="center", va="center", fontsize=9.5, color=ink)
    names = [plain(i) for i in ids]
    ax.set_xticks(range(count), names, rotation=38, ha="right", rotation_mode="anchor", fontsize=10)
    ax.set_yticks(range(count), names, fontsize=10)
    ax.grid(False)
    ax.tick_params(length=0)
    ax.spines[:].set_visible(False)
    return figure


# --- runs


def overlay(c: Course, models: Sequence[str]) -> Figure:
    """A run over time: the joint in which the base errs most, measured and predicted, and the models' errors."""
    figure, (top, low) = panels((2.5, 1.5))
    measured, many = np.degrees(c.measured[:, c.worst]), len(c.t) > LONG
    top.plot(c.t, measured, color=MEASURED, lw=4.5, label="measured")
    noise = 2 * float(np.degrees(c.noise[c.worst]))
    low.axhspan(-noise, noise, color=MUTED, alpha=0.18, lw=0)
    low.axhline(0, color=INK, lw=0.6)
    for model in models:
        error = np.degrees(c.error(model)[:, c.worst])
        style = "--" if model == "given" else "-"
        line = {"color": COLOURS[model], "lw": 1.2, "ls": style, "rasterized": many}
        top.plot(c.t, measured - error, label=NAMES[model], **line)
        low.plot(c.t, error, **{**line, "lw": 0.9})
    top.set(ylabel="angle [deg]" if c.measured.shape[1] == 1 else f"joint {c.worst + 1} [deg]")
    drawn = [np.degrees(c.error(m)[:, c.worst]) for m in models if m != "given"] or [np.zeros(1)]
    limit = 1.15 * max(2.2 * noise, *(float(np.abs(x).max()) for x in drawn))
    low.set(xlabel="time [s]", ylabel="measured −\nmodel [deg]", ylim=(-limit, limit))
    figure.align_ylabels([top, low])
    legend(top, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4, columnspacing=1.2, handlelength=1.5)
    return figure
