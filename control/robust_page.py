"""The pictures of a robustness study, and the page that holds them."""

from __future__ import annotations

import math
from html import escape
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from ljjax import page
from ljjax.control.spec import MEASURES
from ljjax.control.telling import SHOWN
from ljjax.law.parts import KINDS
from ljjax.page import ACCENT, GRID, INK, MUTED, number

if TYPE_CHECKING:
    from ljjax.control.robust_result import Robust

MISS = "#c77700"


def page_of(study: Robust, software: str) -> str:
    """The page; it loads nothing from anywhere."""
    from ljjax.control.robust_report import common, worst_lines

    spec, law, worst = study.one.spec, study.one.law, study.worst
    together = study.chances[-1]
    low, high = together.ci95
    loops = study.told.ok.size + study.sobol_told.ok.size
    cards = [
        (f"{100 * together.share:.1f} %", f"of draws meet all requirements ({100 * low:.1f} to {100 * high:.1f} %)"),
        (f"{len(study.xi):,}", f"draws at {len(spec.targets)} targets; {loops:,} closed loops"),
        (str(len(study.failed)), "loops failed"),
        (
            number(worst.cost),
            f"cost of the worst case within {worst.radius:.2g} sd; {number(worst.centre)} at the centre",
        ),
    ]
    named = [
        f"Draw {i} at target {t} failed: its numbers are not finite. It counts as meeting nothing."
        for i, t in study.failed[:20]
    ]
    parts = [page.cards(cards), page.beware(named), "<h2>Requirements</h2>", '<div class="grid">']
    parts += [
        page.figure(_chances(study), "Probabilities", "Of meeting each requirement at every target; 95 % interval.")
    ]
    parts += ["</div>", "<h2>The loops</h2>", '<div class="grid">']
    for t, target in enumerate(spec.targets):
        name = f"{math.degrees(target.theta_rad):.3g}° at {target.stiffness_n_m:.4g} N/m"
        parts += [page.figure(_band(study, t), name, "Median, and bands of 50 and 95 % of the draws; the rest thin.")]
    parts += ["</div>", "<h2>Measures</h2>", '<div class="grid">']
    for name in study.required:
        parts += [page.figure(_histogram(study, name), SHOWN[name][0], "All loops; beyond the limit in orange.")]
    parts += ["</div>", "<h2>What drives it</h2>"]
    parts += [
        "<p>Draws that miss a requirement have in common:</p><ul>",
        *(f"<li>{escape(x)}</li>" for x in common(study)),
        "</ul>",
    ]
    drawn = {k: x for k, x in study.sensitivity.items() if x}
    if drawn:
        used, asked = study.sobol_rows
        said = (
            f"Sobol's indices from {used} of {asked} rows: the share of the variance that a quantity explains, of the "
        )
        parts += [f'<p class="sub">{said}smooth measure at the worst target.</p>', '<div class="grid">']
        for name in drawn:
            label = "cost" if name == "cost" else SHOWN[name][0]
            parts += [page.figure(_indices(study, name), f"Sensitivity: {label}", "Filled: alone. Open: with others.")]
        parts += ["</div>"]
    parts += ["<h2>The worst case nearby</h2>", *(f"<p>{escape(x.strip())}</p>" for x in worst_lines(study))]
    parts += ['<div class="grid">', page.figure(_worst(study), "Worst case", "Against the loop at the centre.")]
    parts += [
        page.figure(_where(study), "Where it lies", "Each quantity from its centre, in its own standard deviations."),
        "</div>",
    ]
    rows = [
        [escape(SHOWN[k][0]), escape(SHOWN[k][1]), *(_value(k, x[k]) for x in (worst.centre_measures, worst.measures))]
        for k in MEASURES
    ]
    parts += [page.table(["measure", "unit", "centre", "worst case"], rows, numeric=(2, 3))]
    parts += ["<h2>What was assumed</h2><ul>", *(f"<li>{escape(x)}</li>" for x in study.assumed), "</ul>"]
    subtitle = f"{KINDS[law.kind]}, at {1 / study.one.period:g} Hz; {software}"
    return page.page(f"Robustness of a law: {law.kind}", subtitle, parts)


def _value(name: str, x: float) -> str:
    return "never" if not math.isfinite(x) else number(SHOWN[name][2](x))


def _chances(study: Robust) -> Figure:
    rows = study.chances[::-1]
    figure, ax = page.axes(5.6, 0.9 + 0.36 * len(rows))
    for i, c in enumerate(rows):
        low, high = c.ci95
        ax.barh(i, c.share, color=ACCENT if c.limit is None else MUTED, height=0.6)
        ax.plot([low, high], [i, i], color=INK, lw=2)
    ax.set_yticks(range(len(rows)), ["all together" if c.limit is None else SHOWN[c.name][0] for c in rows])
    ax.set(xlim=(0, 1.02), xlabel="probability")
    return figure


def _band(study: Robust, t: int) -> Figure:
    figure, ax = page.axes()
    target, at = study.one.spec.targets[t], study.one.stamps
    wanted = math.degrees(target.theta_rad)
    band = abs(wanted) * study.one.spec.band
    ax.axhspan(wanted - band, wanted + band, color=MUTED, alpha=0.2, lw=0)
    theta = np.degrees(study.told.theta[:, t][study.told.ok[:, t]].astype(float))
    if len(theta):
        for share, alpha in ((0.95, 0.25), (0.5, 0.45)):
            low, high = np.quantile(theta, [0.5 - share / 2, 0.5 + share / 2], axis=0)
            ax.fill_between(at, low, high, color=ACCENT, alpha=alpha, lw=0)
        ax.plot(at, theta[:: max(1, len(theta) // 20)].T, color=INK, lw=0.4, alpha=0.5)
        ax.plot(at, np.median(theta, axis=0), color=ACCENT, lw=1.8)
    ax.set(xlabel="t [s]", ylabel="θ [deg]")
    return figure


def _histogram(study: Robust, name: str) -> Figure:
    figure, ax = page.axes(5.6, 3.0)
    label, unit, scale = SHOWN[name]
    values = study.told.plain[..., list(MEASURES).index(name)][study.told.ok]
    never = int(np.sum(~np.isfinite(values)))
    values = np.array([scale(float(x)) for x in values[np.isfinite(values)]])
    limit = scale(study.required[name])
    if len(values):
        _, _, bars = ax.hist(values, bins=30, color=ACCENT)
        for bar in bars:  # type: ignore[union-attr]
            if bar.get_x() + bar.get_width() / 2 > limit:
                bar.set_facecolor(MISS)
        if limit < 3 * max(values.max(), 1e-12):
            ax.axvline(limit, color=INK, lw=1.2)
    ax.set(xlabel=f"{label} [{unit}]" + (f"; {never} never" if never else ""), ylabel="loops")
    return figure


def _indices(study: Robust, name: str) -> Figure:
    rows = sorted(study.sensitivity[name].items(), key=lambda row: row[1].total)
    figure, ax = page.axes(5.6, 0.9 + 0.36 * len(rows))
    for i, (_, x) in enumerate(rows):
        ax.plot(x.total_ci95, [i + 0.15] * 2, color=MUTED, lw=1.4)
        ax.plot(x.total, i + 0.15, "o", color=MUTED, mfc="white")
        ax.plot(x.first_ci95, [i - 0.15] * 2, color=ACCENT, lw=1.4)
        ax.plot(x.first, i - 0.15, "o", color=ACCENT)
    ax.axvline(0, color=GRID, lw=1)
    ax.set_yticks(range(len(rows)), [_short(k) for k, _ in rows])
    ax.set(xlabel="share of the variance", xlim=(-0.25, 1.25))
    return figure


def _short(name: str) -> str:
    return name if len(name) < 34 else name[:31] + "…"


def _worst(study: Robust) -> Figure:
    figure, (above, below) = page.panels((2.6, 1.9))
    worst = study.worst
    above.axhline(math.degrees(study.one.spec.targets[worst.target].theta_rad), color=INK, lw=0.8)
    for loop, colour, name in ((worst.centre_loop, MUTED, "centre"), (worst.loop, MISS, "worst case")):
        above.plot(loop.t, np.degrees(loop.q.mean(axis=1)), color=colour, lw=1.6, label=name)
        below.plot(loop.t, loop.left, color=colour, lw=1.2)
        below.plot(loop.t, loop.right, color=colour, lw=1.2, ls="--")
    above.set(ylabel="θ [deg]")
    below.set(ylabel="tension [N]", xlabel="t [s]")
    page.legend(above, loc="best")
    return figure


def _where(study: Robust) -> Figure:
    rows = sorted(study.one.given.away(study.worst.xi).items(), key=lambda row: abs(row[1]))[-16:]
    figure, ax = page.axes(5.6, 0.9 + 0.3 * len(rows))
    ax.barh(range(len(rows)), [x for _, x in rows], color=MISS, height=0.6)
    ax.set_yticks(range(len(rows)), [_short(k) for k, _ in rows])
    ax.axvline(0, color=INK, lw=0.8)
    ax.set(xlabel="sd from the centre")
    return figure
