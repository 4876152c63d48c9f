"""What steady data cannot part, how small an effect they could show, and which measurements would part the leaders."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ljjax.fit.points import Points
from ljjax.gap.static_cells import Cells
from ljjax.gap.static_search import Candidate, Round
from ljjax.gap.static_stage import Channel
from ljjax.gap.statics import Laws

ABSORBED = 1e-3
"""Share of an effect's trace beyond what base parameters take up, below which nothing of it can be seen."""


def trace(cells: Cells) -> tuple[np.ndarray, np.ndarray]:
    """Per cell, the norm of a unit of its own first size beyond what the others take up, and its whole norm, in units
    of the noise."""
    own, rest = cells.x[:, :, cells.sizes[0]], np.delete(cells.x, cells.sizes, axis=2)
    size = np.maximum(np.linalg.norm(rest, axis=1), 1e-300)
    u, s, _ = np.linalg.svd(rest / size[:, None], full_matrices=False)
    u = u * (s > 1e-6)[:, None]
    left = own - np.einsum("cnk,ck->cn", u, np.einsum("cnk,cn->ck", u, own))
    return np.linalg.norm(left, axis=1), np.linalg.norm(own, axis=1)


def absorbed(found: Round) -> list[str]:
    """Effects that change what is measured, but only as base parameters do."""
    out = []
    for effect, cells in found.cells.items():
        if effect:
            beyond, whole = trace(cells)
            if np.all(beyond <= ABSORBED * np.maximum(whole, 1e-12)):
                out.append(effect)
    return out


def detectable(laws: Laws, channel: Channel) -> dict[str, dict[str, Any]]:
    """Effect → parameter, value, unit: the size whose gain passes what chance alone gives in these data."""
    data, last = channel.data, channel.rounds[-1]
    n = data.tested.independent
    misfit = float(last.none.fit[-1])
    out = {}
    for effect, cells in last.cells.items():
        if not effect:
            continue
        penalty = 0.5 * len(cells.own) * np.log(sum(b.independent for b in data.blocks))
        needed = len(data.y) * (1 + misfit) * np.expm1(2 * (max(last.threshold, 0.0) + penalty) / n)
        beyond, whole = trace(cells)
        name = cells.own[0]
        about = laws.about[name]
        if np.all(beyond <= ABSORBED * np.maximum(whole, 1e-12)):
            continue
        value = float(np.sqrt(needed) / np.median(beyond[beyond > 0]))
        if value <= max(abs(about["low"]), abs(about["high"])):
            out[effect] = {"parameter": name.split(".")[-1], "value": value, "unit": about["unit"]}
    return out


def designs(channels: Sequence[Channel]) -> list[tuple[str, Points, float]]:
    """Measurements one could add: in words, their points, and the scatter to expect."""
    out = []
    for channel in channels:
        p, pressures = channel.points, channel.points.level_pressures()
        gaps = 0.5 * (pressures[1:] + pressures[:-1])
        beyond = pressures[-1] + np.diff(pressures)[-1] * np.array([1.0, 2.0])
        angles = np.unique(np.round(p.theta, 6))
        if channel.kind == "steady":
            most = float(np.abs(angles).max())
            spread = f"angles of {np.degrees(angles.min()):.2g} to {np.degrees(angles.max()):.3g}°"
            for pressure in [*gaps, *beyond]:
                words = f"hold {spread} at {pressure:.3g} kPa and log the tension at rest"
                out.append((words, _points("steady", angles, np.full(len(angles), pressure)), channel.noise))
            for factor in (1.3, 1.6):
                words = f"hold {np.degrees(factor * most):.3g}° at the same pressures and log the tension at rest"
                out.append((words, _points("steady", np.full(len(pressures), factor * most), pressures), channel.noise))
            less = "hold the same angles to the other side at the same pressures and log the tension at rest"
            theta, vacuum = np.repeat(-angles, len(pressures)), np.tile(pressures, len(angles))
            out.append((less, _points("steady", theta, vacuum), channel.noise))
        else:
            for pressure in [*gaps, *beyond]:
                words = f"probe the straight tip at {pressure:.3g} kPa"
                out.append((words, _points("probe", np.zeros(1), np.array([pressure])), channel.noise))
            steady = next((c for c in channels if c.kind == "steady"), None)
            if steady is not None:
                top = float(np.abs(steady.points.theta).max())
                words = f"probe the tip bent to {np.degrees(top):.3g}° at the same pressures"
                out.append((words, _points("probe", np.full(len(pressures), top), pressures), channel.noise))
    return out


def _points(kind: str, theta: np.ndarray, pressure: np.ndarray) -> Points:
    nothing = np.zeros(len(theta))
    none = nothing.astype(int)
    return Points(kind, nothing, nothing + np.nan, pressure, theta, nothing, none, none.astype(bool))


def plan(points: Points) -> list[dict[str, Any]]:
    """The measurements as the runs of a rig's plan (`ljjax rig experiment` takes them from gap.json)."""
    angles = [round(float(a), 3) for a in np.unique(np.round(np.degrees(points.theta), 3))]
    vacuums = [round(float(p), 3) for p in np.unique(np.round(points.pressure_kpa, 3))]
    if points.kind == "steady":
        return [{"protocol": "hold_angles", "angles_deg": angles, "vacuums_kpa": vacuums}]
    return [{"protocol": "probe_press", "angle_deg": angle, "vacuums_kpa": vacuums} for angle in angles]


def next_experiment(laws: Laws, channels: Sequence[Channel]) -> dict[str, Any] | None:
    """The measurement on which the two leading explanations differ most, in units of the scatter."""
    pairs: list[tuple[float, Candidate, Candidate]] = []
    for channel in channels:
        for number, found in enumerate(channel.rounds[: max(1, len(channel.added))]):
            ranked = sorted(
                (c for c in [*found.found.values(), found.none] if np.isfinite(c.score)), key=lambda c: -c.score
            )
            if number < len(channel.added):  # what was taken in this round leads it
                first = found.found[channel.added[number]]
                ranked = [first, *(c for c in ranked if c.effect != first.effect)]
            if len(ranked) > 1:
                pairs.append((ranked[0].score - ranked[1].score, ranked[0], ranked[1]))
    if not pairs:
        return None
    lead, first, second = min(pairs, key=lambda p: p[0])
    best, words, chosen = 0.0, "", None
    for text, points, noise in designs(channels):
        with np.errstate(all="ignore"):
            difference = (laws.values(first.x, points) - laws.values(second.x, points)) / noise
        size = float(np.sqrt(np.mean(difference**2)))
        if np.isfinite(size) and size > best:
            best, words, chosen = size, text, points
    if chosen is None:
        return None
    names = [c.effect or "no_gap" for c in (first, second)]
    shown = [n if n != "no_gap" else "the base model" for n in names]
    odds = f"{np.exp(min(lead, 50)):.2g} times" if lead > 0 else "no"
    return {
        "protocol": words,
        "separates": names,
        "expected_separation": best,
        "why": (
            f"{words}: there {shown[0]} and {shown[1]} differ by {best:.2g} times the measurements' scatter (RMS); so "
            f"far the first is {odds} more likely"
        ),
        "plan": plan(chosen),
    }


__all__ = ["absorbed", "detectable", "next_experiment"]
