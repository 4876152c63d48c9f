"""From labels and answers to the scoreboard. Knows nothing of how a diagnosis works but what `gap.json` says."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.blind.cases import HISTORY
from benchmarks.blind.causes import BLOCKS, CAUSES, confusable

PLAIN = {"controls": "no_gap", "parameters": "parameters_only"}
LEAST, LEAST_OUTSIDE = 3.0, 5.0
"""Gaps over noise from which cases count."""
BINS = 10

Row = dict[str, Any]


def judge(label: Mapping[str, Any], answer: Mapping[str, Any] | None, errors: Sequence[float] | None) -> Row:
    """One case: what was true, what was said, and what of it was right.

    Args:
        answer: gap.json; None where the command failed, and then nothing is right.
        errors: of base.toml and of model.toml on the unseen runs [rad].
    """
    kind, causes, sensors = label["kind"], list(label["causes"]), label["sensors"]
    alike = [confusable(c, sensors["tension"], sensors["temperature"]) for c in causes]
    open_set = kind in ("unlisted", "without")
    right = {PLAIN[kind]} if kind in PLAIN else {"unlisted_effect"} if open_set else set().union(*alike)
    least = LEAST_OUTSIDE if kind == "unlisted" else LEAST
    reached = not causes or label["gap_over_noise"] >= least
    row: Row = {
        "case": label["case_id"],
        "kind": kind,
        "truth": causes,
        "size": label["size"],
        "forms": label.get("forms", {}),
        "gap_over_noise": label["gap_over_noise"],
        "attained": reached,
        "columns": label["columns"],
        "tension_measured": sensors["tension"],
        "failed": answer is None,
    }
    answer = answer or {}
    ranked = sorted(
        ((str(e["id"]), float(e.get("probability") or 0.0)) for e in answer.get("effects", [])), key=lambda x: -x[1]
    )
    selected = [str(x) for x in answer.get("selected") or []]
    sets = [{str(x) for x in group} for group in answer.get("equivalent") or []]
    where = (answer.get("where") or [{}])[0]
    top = ranked[0] if ranked else (None, 0.0)
    as_one = confusable(top[0], sensors["tension"], sensors["temperature"]) if top[0] else set()
    row |= {
        "verdict": answer.get("verdict"),
        "top": ranked[:3],
        "selected": selected,
        "equivalent": [sorted(x) for x in sets],
        "block": where.get("block"),
        "axis": where.get("axis"),
        "right": sorted(right),
        "top_right": top[0] in right,
        "stated": sum(p for name, p in ranked if name in as_one),
        "brier": _brier(ranked, right),
        "claimed": row["failed"] or answer.get("verdict") == "listed_effect" or bool(selected),
        "unlisted": answer.get("verdict") == "unlisted_effect",
    }
    if causes and not open_set:
        near = [{x for x in ids if any(x in s and s & set(selected) for s in sets)} for ids in alike]
        hits = [bool(ids & set(selected)) or bool(close) for ids, close in zip(alike, near, strict=True)]
        row |= {
            "found": all(hits),
            "exactly": all(hits) and len(selected) == len(causes),
            "block_right": row["block"] in {BLOCKS[x] for x in right},
            "axis_right": row["axis"] in _axes(right, row["forms"]),
        }
    claimed = answer.get("gap") or {}
    row |= {"closed_claimed": claimed.get("closed_fraction"), "ci95": claimed.get("closed_fraction_ci95")}
    row |= {"closed": None, "closed_by_truth": 1.0 if causes else None, "before": None, "after": None}
    if errors is not None and causes and not of_session(causes, row["forms"]):
        floor, (before, after) = label["theta_noise_rad"], errors
        row |= {"before": before, "after": after}
        if before > 1.1 * floor:
            row["closed"] = 1 - (after**2 - floor**2) / (before**2 - floor**2)
    ci = row["ci95"]
    usable = row["closed"] is not None and ci and None not in ci
    row["covered"] = bool(ci[0] <= row["closed"] <= ci[1]) if usable else None
    return row


def scoreboard(rows: Sequence[Row], timing: Mapping[str, Mapping[str, float]]) -> dict[str, Any]:
    """The goals with what was reached; figures of calibration; the confusion matrix; every case. `timing` has
    seconds and their ratio by case; the longest ratio counts."""
    effects = [r for r in rows if r["kind"] in ("effects", "mujoco") and r["attained"]]
    none = [r for r in rows if r["kind"] in PLAIN]
    outside = [r for r in rows if r["kind"] in ("unlisted", "without") and r["attained"]]
    pairs = [r for r in rows if r["kind"] == "pairs" and r["attained"]]
    closing = [r for r in effects if r["closed"] is not None]
    covering = [r for r in effects if r["covered"] is not None]
    single = [r for r in rows if r["kind"] != "pairs" and r["attained"]]
    reliability = calibration(single)
    goals = [
        _share("true cause ranked first", effects, "top_right", 0.90),
        _share("true cause selected or in its equivalence set", effects, "found", 0.97),
        _share("right block", effects, "block_right", 0.97),
        _share("right region axis", effects, "axis_right", 0.90),
        _row("effect claimed where there is none", _mean(none, "claimed"), "≤ 0.03", lambda x: x <= 0.03, len(none)),
        _share("effects outside the library called unlisted_effect", outside, "unlisted", 0.85),
        _share("both of two effects found, nothing else", pairs, "exactly", 0.70),
        _row(
            "gap closed on unseen runs over what the true effect closes (median)",
            float(np.median([r["closed"] for r in closing])) if closing else None,
            "≥ 0.90",
            lambda x: x >= 0.90,
            len(closing),
        ),
        _row(
            "95 % interval of the closed fraction covers the truth",
            _mean(covering, "covered"),
            "0.90 – 0.99",
            lambda x: 0.90 <= x <= 0.99,
            len(covering),
        ),
        _row("expected calibration error", reliability["ece"], "≤ 0.05", lambda x: x <= 0.05, len(single)),
        _row(
            "time of the diagnosis over that of ljjax fit",
            max(took["ratio"] for took in timing.values()) if timing else None,
            "≤ 15",
            lambda x: x <= 15,
            len(timing),
        ),
    ]
    return {
        "schema": "ljjax.blind/1",
        "rows": goals,
        "by_kind": {
            kind: {
                "cases": len(some := [r for r in rows if r["kind"] == kind and r["attained"]]),
                "top_right": _mean(some, "top_right"),
                "failed": sum(r["failed"] for r in some),
            }
            for kind in sorted({r["kind"] for r in rows})
        },
        "by_shape": {
            name: {
                "cases": len(some := [r for r in effects if _shape(r) == name]),
                **{key: _mean(some, key) for key in ("top_right", "found", "block_right", "axis_right")},
            }
            for name in ("first", "further", "last")
        },
        "calibration": reliability,
        "confusion": confusion(rows),
        "not_attained": [
            {k: r[k] for k in ("case", "truth", "size", "gap_over_noise")} for r in rows if not r["attained"]
        ],
        "timing": {case: dict(took) for case, took in timing.items()},
        "cases": list(rows),
    }


def calibration(rows: Sequence[Row]) -> dict[str, Any]:
    """Of the probability of the first answer, what counts as one with it included, as it does where that is right:
    expected calibration error over ten bins, and what chance alone makes of it on so many cases were every probability
    true; Brier score of all probabilities."""
    stated = [r for r in rows if r["top"]]
    if not stated:
        return {"ece": None, "by_chance": None, "brier": None, "bins": []}
    p = np.array([r["stated"] for r in stated])
    right = np.array([r["top_right"] for r in stated], float)
    at = np.minimum((p * BINS).astype(int), BINS - 1)
    bins = [
        {"stated": float(p[at == k].mean()), "right": float(right[at == k].mean()), "cases": int(np.sum(at == k))}
        for k in range(BINS)
        if np.any(at == k)
    ]
    drawn = np.random.default_rng(0).random((2000, len(p))) < p
    ece, *chance = (
        sum(abs((p - outcome)[at == k].sum()) for k in np.unique(at)) / len(p) for outcome in (right, *drawn)
    )
    return {
        "ece": float(ece),
        "by_chance": float(np.mean(chance)),
        "brier": float(np.mean([r["brier"] for r in stated])),
        "bins": bins,
    }


def confusion(rows: Iterable[Row]) -> dict[str, dict[str, int]]:
    """True cause → what was ranked first → how many cases; those of one cause that counts."""
    out: dict[str, dict[str, int]] = {}
    for r in rows:
        if r["kind"] == "pairs" or not r["attained"]:
            continue
        truth = PLAIN.get(r["kind"]) or r["truth"][0] + " (deleted)" * (r["kind"] == "without")
        said = r["top"][0][0] if r["top"] else "failed"
        out.setdefault(truth, {})[said] = out.get(truth, {}).get(said, 0) + 1
    return out


def _shape(row: Row) -> str:
    """Whether a case's cause has the shape that the plant had first, the last one, or one in between."""
    for name, form in row["forms"].items():
        if form:
            return "last" if form == len(CAUSES[name].shapes) - 1 else "further"
    return "first"


def of_session(causes: Collection[str], forms: Mapping[str, int]) -> bool:
    """Whether what a run does hangs on the session's earlier ones, so that one replayed by itself does not show it."""
    shapes = (CAUSES[x].shapes[form] for x, form in forms.items() if x in causes)
    return bool(set(causes) & set(HISTORY)) or any("run" in shape.axes for shape in shapes)


def _axes(right: set[str], forms: Mapping[str, int]) -> set[str]:
    """That are right for these causes, and for the shapes that were planted."""
    usual = {axis for x in right for axis in CAUSES[x].axes}
    return usual.union(*(CAUSES[x].shapes[form].axes for x, form in forms.items()))


def _brier(ranked: Sequence[tuple[str, float]], right: set[str]) -> float:
    """Σ (p − truth)² over classes, the right ones taken as one."""
    together = sum(p for name, p in ranked if name in right)
    return (1 - together) ** 2 + sum(p**2 for name, p in ranked if name not in right)


def _mean(rows: Sequence[Row], key: str) -> float | None:
    return float(np.mean([bool(r[key]) for r in rows])) if rows else None


def _share(name: str, rows: Sequence[Row], key: str, goal: float) -> Row:
    return _row(name, _mean(rows, key), f"≥ {goal:.2f}", lambda x: x >= goal, len(rows))


def _row(name: str, value: float | None, goal: str, met: Callable[[float], bool], cases: int) -> Row:
    """`met` None where there is nothing to judge."""
    return {"name": name, "value": value, "goal": goal, "met": None if value is None else met(value), "cases": cases}
