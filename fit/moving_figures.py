"""The pictures of a dynamic fit: runs, loops, residuals, the friction curve, the search, profiles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import jax
import jax.numpy as jnp
import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy import stats

from ljjax.energy import phi
from ljjax.fit.figures import colours
from ljjax.fit.moving import DynamicResult, RunError
from ljjax.fit.problem import Estimate
from ljjax.friction import sliding_torque
from ljjax.model import Model, get, replace
from ljjax.page import ACCENT, INK, MUTED, axes, legend, panels

MEASURED = "#c9d2db"
CLASH = "#c77700"
CLOUD, LONG = 4000, 3000
"""How many residuals are drawn as points (the bands are of all); beyond how many samples rough lines are pixels."""
MOVING_RAD_S = 1e-3
"""Rates below this are rest."""


@dataclass(frozen=True, eq=False)
class Trace:
    """What one run shows, of `estimate`'s motion `index`, with its errors in numbers.

    `t` (N,) stamps [s] from the first; `measured`, `simulated` (N,) θ [deg]; `rate` (N,) of the simulated θ [rad/s];
    `tension` (N, 2) [N] and `vacuum` (N,) [kPa] that drive it.
    """

    estimate: Estimate
    index: int
    said: RunError

    @cached_property
    def _mine(self) -> np.ndarray:
        return self.estimate.windows.sample_run == self.index

    @cached_property
    def _stamps(self) -> np.ndarray:
        return self.estimate.windows.sample_t[self._mine]

    @cached_property
    def t(self) -> np.ndarray:
        return self._stamps - self._stamps[0]

    @cached_property
    def measured(self) -> np.ndarray:
        return np.degrees(self.estimate.windows.y[self._mine].mean(axis=1))

    @cached_property
    def simulated(self) -> np.ndarray:
        return np.degrees(self.estimate.predicted[self._mine].mean(axis=1))

    @property
    def error(self) -> np.ndarray:
        """(N,) measured − simulated [deg]."""
        return self.measured - self.simulated

    @cached_property
    def rate(self) -> np.ndarray:
        return np.gradient(np.radians(self.simulated), self._stamps)

    @cached_property
    def tension(self) -> np.ndarray:
        return self._input(self.estimate.problem.motions[self.index].tendons)

    @cached_property
    def vacuum(self) -> np.ndarray:
        return self._input(self.estimate.problem.motions[self.index].vacuum[:, None])[:, 0]

    def _input(self, value: np.ndarray) -> np.ndarray:
        motion = self.estimate.problem.motions[self.index]
        if motion.hold:
            return value[np.clip(np.searchsorted(motion.input_t, self._stamps, "right") - 1, 0, len(value) - 1)]
        return np.stack([np.interp(self._stamps, motion.input_t, column) for column in value.T], axis=1)


def traces(result: DynamicResult) -> list[Trace]:
    """Every run that moves, those held out last."""
    both = [e for e in (result.estimate, result.held_out) if e is not None]
    places = [(e, i) for e in both for i in range(len(e.problem.motions))]
    return [Trace(e, i, said) for (e, i), said in zip(places, result.run_errors, strict=True)]


def course(trace: Trace, noise_deg: float) -> Figure:
    """One run over time: θ measured and simulated, their difference, and what was commanded."""
    figure, (top, middle, low) = panels((2.3, 1.1, 1.5))
    top.plot(trace.t, trace.measured, color=MEASURED, lw=4.5, label="measured")
    top.plot(trace.t, trace.simulated, color=ACCENT, lw=1.2, label="simulated")
    top.set(ylabel="θ [deg]")
    legend(top, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    middle.axhspan(-2 * noise_deg, 2 * noise_deg, color=MUTED, alpha=0.18, lw=0)
    middle.plot(trace.t, trace.error, color=INK, lw=0.8, rasterized=len(trace.t) > LONG)
    middle.set(ylabel="error\n[deg]")
    for column, (style, name) in enumerate((("-", "$u_1$"), ("--", "$u_2$"))):
        low.plot(trace.t, trace.tension[:, column], color=ACCENT, ls=style, lw=1.2, label=name)
    right = low.twinx()
    right.spines[:].set_visible(False)
    right.grid(False)
    right.plot(trace.t, trace.vacuum, color=CLASH, lw=1.2)
    right.set_ylim(0, 1.15 * max(float(trace.vacuum.max()), 1.0))
    right.set_ylabel("vacuum\n[kPa]", color=CLASH)
    right.tick_params(colors=CLASH)
    low.set(xlabel="time [s]", ylabel="tension\n[N]")
    low.plot([], [], color=CLASH, lw=1.2, label="$u_P$")
    legend(low, loc="lower center", bbox_to_anchor=(0.5, 0.98), ncols=3)
    figure.align_ylabels([top, middle, low])
    return figure


def loop(trace: Trace) -> Figure:
    """θ over net tension u₁ − u₂."""
    figure, ax = axes(height=4.8)
    net = trace.tension[:, 0] - trace.tension[:, 1]
    long = len(trace.t) > LONG
    ax.plot(net, trace.measured, color=MEASURED, lw=4.5, label="measured", rasterized=long)
    ax.plot(net, trace.simulated, color=ACCENT, lw=1.2, label="simulated", rasterized=long)
    ax.set(xlabel="net tension u₁ − u₂ [N]", ylabel="θ [deg]")
    legend(ax, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    return figure


# --- what is left over

Axis = Literal["angle", "rate", "pressure"]
LABELS: dict[Axis, str] = {
    "angle": "mean segment angle θ [deg]",
    "rate": "rate of θ [deg/s]",
    "pressure": "vacuum $u_P$ [kPa]",
}


def residuals(shown: Sequence[Trace], over: Axis, noise_deg: float) -> Figure:
    """Measured − simulated over an axis: the cloud, and by bins the median, 16 … 84 % and 2.5 … 97.5 %."""
    values = {
        "angle": lambda t: t.simulated,
        "rate": lambda t: np.degrees(t.rate),
        "pressure": lambda t: t.vacuum,
    }
    x, y = np.concatenate([values[over](t) for t in shown]), np.concatenate([t.error for t in shown])
    figure, ax = axes()
    some = np.random.default_rng(0).permutation(len(x))[:CLOUD]
    ax.scatter(x[some], y[some], s=2, color=MUTED, alpha=0.25, linewidths=0, rasterized=True)
    centres, cuts = _bins(x, y, even=over != "rate")
    for low, high, alpha in ((0, 4, 0.18), (1, 3, 0.3)):
        ax.fill_between(centres, cuts[:, low], cuts[:, high], color=ACCENT, alpha=alpha, lw=0)
    ax.plot(centres, cuts[:, 2], "o-", color=ACCENT, lw=1.6, ms=3, label="median, 68 % and 95 % of the samples")
    for side in (-2, 2):
        ax.axhline(
            side * noise_deg, color=CLASH, lw=1, ls=":", label="white noise ± 2 sd" if side > 0 else "_nolegend_"
        )
    ax.axhline(0, color=INK, lw=0.8)
    limit = 1.3 * max(float(np.quantile(np.abs(y), 0.995)), 2.2 * noise_deg)
    ax.set(xlabel=LABELS[over], ylabel="measured − simulated [deg]", ylim=(-limit, limit))
    if over == "rate":
        ax.set_xscale("symlog", linthresh=0.1)
        ticks = [tick for size in (0.1, 1, 10, 100) if size < np.abs(x).max() for tick in (-size, size)]
        ax.set_xticks([0, *ticks], [f"{tick:g}".replace("-", "−") for tick in (0, *ticks)])
    legend(figure, loc="outside upper center", ncols=2)
    return figure


def _bins(x: np.ndarray, y: np.ndarray, even: bool, most: int = 20) -> tuple[np.ndarray, np.ndarray]:
    """(b,) middles of bins of x, of like width (`even`) or of like counts, and (b, 5) the 2.5, 16, 50, 84 and 97.5 %
    points of y in each; bins of few samples are left out, and there are so few bins that one of them stays."""
    share = np.linspace(0, 1, min(most, max(len(x) // 20, 1)) + 1)
    edges = np.unique(x.min() + np.ptp(x) * share if even else np.quantile(x, share))
    index = np.searchsorted(edges[1:-1], x, side="right")
    used = [k for k, count in enumerate(np.bincount(index)) if count >= min(20, len(x) // 2)]
    centres = np.array([np.median(x[index == k]) for k in used])
    return centres, np.array([np.quantile(y[index == k], (0.025, 0.16, 0.5, 0.84, 0.975)) for k in used])


# --- friction

CURVE = ("jamming.c4", "jamming.c5", "friction.mu_c", "friction.mu_s", "friction.sigma2", "friction.sigma3")
CURVE += ("friction.v_s",)
"""The parameters of the friction curve."""


def sliding(result: DynamicResult, pressure_kpa: float, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Friction torque φ(u_P)[ρ(v) + σ₂v] [N·m] of steady sliding at rates v (V,) [rad/s], and its standard deviation
    by the parameters' covariance, to first order."""
    names = [name for name in result.names if name in CURVE]
    at, u_p = jnp.asarray(v), jnp.asarray(pressure_kpa)

    def torque(values: jax.Array) -> jax.Array:
        model: Model = replace(result.model, dict(zip(names, values, strict=True)))
        return sliding_torque(model.friction, at, phi(model, u_p))

    own = [result.names.index(name) for name in names]
    values = jnp.asarray([float(get(result.model, name)) for name in names])
    slope = np.asarray(jax.jacfwd(torque)(values)) if names else np.zeros((len(v), 0))
    variance = np.einsum("vk,kl,vl->v", slope, result.covariance[np.ix_(own, own)], slope)
    return np.asarray(torque(values)), np.sqrt(np.maximum(variance, 0.0))


def rates_seen(shown: Sequence[Trace]) -> tuple[float, float]:
    """Between which rates [rad/s] nearly all sliding of the runs lies: 2.5 … 97.5 %."""
    rate = np.abs(np.concatenate([t.rate for t in shown]))
    sliding = rate[rate > MOVING_RAD_S]
    if not len(sliding):
        return MOVING_RAD_S, 10 * MOVING_RAD_S
    low, high = np.quantile(sliding, (0.025, 0.975))
    return float(low), float(max(high, 1.1 * low))


def friction(result: DynamicResult, shown: Sequence[Trace]) -> Figure:
    """φ(u_P)[ρ(v) + σ₂v] over v at up to three pressures, with ± 2 sd; dotted where no data were."""
    figure, ax = axes()
    low, high = rates_seen(shown)
    v = np.geomspace(low / 3, 2 * high, 160)
    seen = (v >= low) & (v <= high)
    vacuum = np.concatenate([t.vacuum for t in shown])
    pressures = np.unique(np.round(np.quantile(vacuum, (0.0, 0.5, 1.0)), 1))
    least = np.inf
    for p, colour in zip(pressures, colours(len(pressures)), strict=True):
        middle, sd = sliding(result, float(p), v)
        least = min(least, float(middle.min()))
        ax.fill_between(v, middle - 2 * sd, middle + 2 * sd, color=colour, alpha=0.22, lw=0)
        ax.plot(v, middle, color=colour, lw=1.2, ls=":")
        ax.plot(v[seen], middle[seen], color=colour, lw=1.9, label=f"{p:g} kPa")
    ax.set(xscale="log", yscale="log", xlabel="joint rate v [rad/s]", ylabel="friction torque of a joint [N·m]")
    ax.set_ylim(0.3 * least, None)
    for set_formatter in (ax.yaxis.set_major_formatter, ax.yaxis.set_minor_formatter):
        set_formatter(lambda x, _: f"{x:g}" if f"{x:e}"[0] in "125" else "")
    legend(figure, loc="outside upper center", ncols=3, title="vacuum")
    return figure


# --- the search


def _passes(result: DynamicResult) -> tuple[np.ndarray, list[int]]:
    """(E,) passes over the data, over all rounds, up to each entry of the history; and the entries that open rounds."""
    history = result.estimate.history
    opens = [i for i, h in enumerate(history) if i == 0 or h[0] != history[i - 1][0]]
    before, total = 0, []
    for i, h in enumerate(history):
        if i in opens and i:
            before += history[i - 1][1]
        total.append(before + h[1])
    return np.array(total), opens


def _rounds(ax: Axes, passes: np.ndarray, opens: Sequence[int]) -> None:
    for k, i in enumerate(opens):
        ax.axvline(passes[i], color=MUTED, lw=1, ls="--")
        ax.text(passes[i], 1.01, f"{k + 1}", transform=ax.get_xaxis_transform(), ha="center", fontsize=10, color=MUTED)


def descent(result: DynamicResult) -> Figure:
    """RMS error over passes over the data."""
    figure, ax = axes()
    passes, opens = _passes(result)
    rms = np.degrees([h[2] for h in result.estimate.history])
    ends = [*opens[1:], len(passes)]
    for first, last in zip(opens, ends, strict=True):
        ax.plot(passes[first:last], rms[first:last], "o-", color=ACCENT, ms=4, lw=1.5)
    _rounds(ax, passes, opens)
    ax.set(xlabel="passes over the data", ylabel="RMS error [deg]", yscale="log")
    return figure


def approach(result: DynamicResult) -> Figure:
    """Every parameter's distance from its final value, in standard deviations, over passes."""
    figure, ax = axes(height=5.0)
    passes, opens = _passes(result)
    c = result.estimate.problem.coordinates
    values = np.array([c.physical(h[4]) for h in result.estimate.history])
    away = (values - c.physical(result.estimate.x)) / np.sqrt(np.diag(result.covariance))
    for k, (column, name) in enumerate(zip(away.T, c.names, strict=True)):
        colour = matplotlib.colormaps["tab20"](k % 20)
        ax.plot(passes, column, "o-", ms=2.5, lw=1.4, color=colour, label=name.split(".")[-1])
    ax.axhspan(-1, 1, color=MUTED, alpha=0.13, lw=0)
    ax.set_yscale("symlog", linthresh=1)
    _rounds(ax, passes, opens)
    ax.set(xlabel="passes over the data", ylabel="estimate − final [sd]")
    legend(figure, loc="outside lower center", ncols=4, fontsize=9)
    return figure


def profile(result: DynamicResult, name: str, interval: Sequence[float | None]) -> Figure:
    """χ² above its least along one parameter, the others fitted anew, beside the parabola of its standard deviation."""
    figure, ax = axes()
    values, above = result.profiles[name]
    known = np.isfinite(above)
    p = result.parameters[name]
    fine = np.linspace(values.min(), values.max(), 200)
    if p.sd:
        ax.plot(fine, ((fine - p.value) / p.sd) ** 2, color=MUTED, ls="--", lw=1.2, label="were it a parabola")
    ax.plot(values[known], above[known], "o-", color=ACCENT, lw=1.8, ms=4, label="profile")
    ax.axhline(float(stats.chi2.ppf(0.95, 1)), color=CLASH, lw=1, ls=":", label="95 %")
    for edge in interval:
        if edge is not None:
            ax.axvline(edge, color=CLASH, lw=1)
    ax.axvline(p.value, color=INK, lw=0.8)
    ax.set(xlabel=f"{name} [{p.unit}]", ylabel="χ² above its least")
    ax.set_ylim(-0.3, min(float(np.nanmax(above)) * 1.05 + 1, 16))
    legend(figure, loc="outside upper center", ncols=3)
    return figure
