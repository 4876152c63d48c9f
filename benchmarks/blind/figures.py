"""The scoreboard's two pictures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np


def confusion(found: Mapping[str, Any], path: Path) -> None:
    """True causes down, answers across; shares of the row's cases."""
    table: Mapping[str, Mapping[str, int]] = found["confusion"]
    rows = list(table)
    columns = [r for r in rows if any(r in table[k] for k in rows)]
    columns += sorted({said for r in rows for said in table[r]} - set(columns))
    share = np.array([[table[r].get(c, 0) / sum(table[r].values()) for c in columns] for r in rows])
    figure, ax = plt.subplots(figsize=(2 + 0.24 * len(columns), 2 + 0.24 * len(rows)), layout="constrained")
    ax.imshow(share, cmap="Blues", vmin=0, vmax=1, aspect="auto")
    for i, r in enumerate(rows):
        for j, c in enumerate(columns):
            if n := table[r].get(c, 0):
                ax.text(j, i, str(n), ha="center", va="center", fontsize=7, color="white" if share[i, j] > 0.6 else "k")
    ax.set_xticks(range(len(columns)), columns, rotation=90, fontsize=7)
    ax.set_yticks(range(len(rows)), rows, fontsize=7)
    ax.set_xlabel("ranked first")
    ax.set_ylabel("planted")
    figure.savefig(path, dpi=130)
    plt.close(figure)


def reliability(found: Mapping[str, Any], path: Path) -> None:
    """How often the first-ranked answer is right against the probability stated for it."""
    bins = found["calibration"]["bins"]
    figure, ax = plt.subplots(figsize=(4.5, 4.5), layout="constrained")
    ax.plot([0, 1], [0, 1], color="0.7", lw=1)
    for b in bins:
        sd = np.sqrt(max(b["right"] * (1 - b["right"]), 0.25 / b["cases"]) / b["cases"])
        ax.errorbar(b["stated"], b["right"], yerr=sd, fmt="o", color="C0", ms=5)
        ax.annotate(f"{b['cases']}", (b["stated"], b["right"]), xytext=(5, -10), textcoords="offset points", fontsize=8)
    ece, brier = found["calibration"]["ece"], found["calibration"]["brier"]
    if ece is not None:
        ax.set_title(f"calibration error {ece:.3f}, Brier score {brier:.3f}", fontsize=10)
    ax.set(xlim=(0, 1.02), ylim=(0, 1.05), xlabel="probability stated", ylabel="share right")
    figure.savefig(path, dpi=130)
    plt.close(figure)
