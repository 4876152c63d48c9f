"""Stiffness under the published law over γ and vacuum, and the paper's Table III, side by side in one set of units."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

from benchmarks.control.octrobot import LEVER_ARM_M, PER_JOINT, identified, table
from benchmarks.control.rows import Row, Size
from ljjax.stiffness import closed_loop_stiffness, transverse_stiffness

COLUMN_KPA = {0.1: 0.0, 2.0: 10.0, 4.0: 20.0, 6.0: 30.0, 8.0: 40.0}
"""The vacuum at which Table III takes α₂, by γ [N]: that of the column's place, not the row's own."""


def alpha2_paper(u: Any) -> Any:
    """α₂ [N/deg] at vacuums u [kPa] as the paper finds it: least squares on the steady tensions, without α₁."""
    t = table("identification")
    p, theta = t["pressure_kpa"], t["theta_deg"]
    columns = np.stack([p**2 * theta, p * theta, theta], axis=1)
    return np.polyval(np.linalg.lstsq(columns, t["force_mean_n"], rcond=None)[0], u)


def reproduced(slip: bool) -> int:
    """Pairs of Table III that γ/K_T and α₂/K_T give to the last digit, α₂ at the column's vacuum or at the row's."""
    rows, k_t = table("stiffness_ratios"), measured()
    count = 0
    for row in rows:
        place = row["pressure_kpa"], row["theta_star_deg"], row["gamma"]
        alpha2 = alpha2_paper(COLUMN_KPA[row["gamma"]] if slip else row["pressure_kpa"])
        shares = 100 * np.array([row["gamma"], float(alpha2)]) / k_t[place]
        count += bool(np.all(np.abs(shares - [row["r1_percent"], row["r2_percent"]]) <= 0.005 + 1e-9))
    return count


def measured() -> dict[tuple[float, float, float], float]:
    """Published K_T [N/m] by vacuum [kPa], θ* [deg] and γ [N]."""
    rows = table("closed_loop_stiffness")
    return {(r["pressure_kpa"], r["theta_star_deg"], r["gamma"]): float(r["stiffness_n_per_m"]) for r in rows}


def modelled(u: np.ndarray, gamma_n: np.ndarray) -> np.ndarray:
    """(N,) K_T [N/m] of the identified robot under gains γ [N], at z = 0."""
    model = identified()

    def one(u: jax.Array, gamma: jax.Array) -> jax.Array:
        return transverse_stiffness(model, closed_loop_stiffness(model, u, gamma))

    return np.asarray(jax.vmap(one)(jnp.asarray(u), jnp.asarray(LEVER_ARM_M * gamma_n)))


def slopes(k_t: np.ndarray) -> np.ndarray:
    """K_T over γ [N/m per N] at each vacuum and angle; k_t (N,) in the order of the table."""
    rows = table("closed_loop_stiffness")
    places = {(r["pressure_kpa"], r["theta_star_deg"]) for r in rows}
    at = [(rows["pressure_kpa"] == u) & (rows["theta_star_deg"] == a) for u, a in sorted(places)]
    return np.array([np.polyfit(rows["gamma"][i], k_t[i], 1)[0] for i in at])


def stiffness(size: Size, out: Path, say: Callable[[str], None]) -> list[Row]:
    """Table III with its slip and corrected, and K_T over γ and vacuum."""
    rows = table("closed_loop_stiffness")
    theirs, mine = rows["stiffness_n_per_m"], modelled(rows["pressure_kpa"], rows["gamma"])
    off = np.abs(mine / theirs - 1)
    jammed = rows["pressure_kpa"] > 0
    slope = float(np.median(slopes(mine))), float(np.median(slopes(theirs)))
    r1 = 100 * (1 - modelled(rows["pressure_kpa"], 0 * rows["gamma"]) / mine)
    per_joint = alpha2_paper(rows["pressure_kpa"]) * LEVER_ARM_M * 180 / np.pi
    r2 = 100 * per_joint * PER_JOINT / theirs
    draw(rows, mine).savefig(out / "stiffness.png", dpi=110)
    right = reproduced(slip=True)
    both = {"r1_percent": [float(r1.min()), float(r1.max())], "r2_percent": [float(r2.min()), float(r2.max())]}
    return [
        Row(
            "Table III: published pairs of ratios reproduced, with their slip",
            right,
            "pairs",
            "50 of 50",
            right == 50,
            len(rows),
            "γ/K_T and α₂/K_T as published, N and N/deg over N/m, with α₂ at the column's vacuum (0, 10 … 40 kPa for "
            f"γ = 0.1 … 8 N); with the row's own {reproduced(slip=False)} of 50",
        ),
        Row(
            "Table III in consistent units: the share of α₂ in K_T, median",
            float(np.median(r2)),
            "%",
            "",
            None,
            len(rows),
            f"α₂ in N·m/rad at the row's vacuum times {PER_JOINT:.4g} m⁻² over the measured K_T: {r2.min():.1f} to "
            f"{r2.max():.1f} %; γ, as a torque gain of the model: {r1.min():.2f} to {r1.max():.2f} %",
            both,
        ),
        Row(
            "closed-loop K_T over γ and vacuum: median |model ÷ measured − 1|",
            100 * float(np.median(off)),
            "%",
            "",
            None,
            len(rows),
            "K_T = 1/(aᵀK⁻¹a) with φ from the open-loop probe, nothing fitted to these: "
            f"{100 * off[~jammed].max():.0f} % at worst at 0 kPa, {100 * off[jammed].max():.0f} % from 10 kPa on; over "
            f"γ it rises by {slope[0]:.2g} N/m a newton in the model, {slope[1]:.2g} as measured",
            {"slope_model": slope[0], "slope_measured": slope[1]},
        ),
    ]


def draw(rows: np.ndarray, mine: np.ndarray) -> Figure:
    """K_T over γ, a colour a vacuum: measured points, the model's lines."""
    figure = Figure(figsize=(9, 4), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    for ax, angle in zip(axes, (8, 10), strict=True):
        for i, u in enumerate(np.unique(rows["pressure_kpa"])):
            at = (rows["pressure_kpa"] == u) & (rows["theta_star_deg"] == angle)
            ax.plot(rows["gamma"][at], rows["stiffness_n_per_m"][at], "o", color=f"C{i}", label=f"{u:g} kPa")
            ax.plot(rows["gamma"][at], mine[at], "-", color=f"C{i}")
        ax.set(xlabel="γ [N]", title=f"θ* = {angle}°: measured, and the model (lines)")
    axes[0].set_ylabel("K_T [N/m]")
    axes[1].legend(frameon=False, fontsize=8)
    return figure
