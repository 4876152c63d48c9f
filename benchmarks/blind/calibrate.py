"""The weights of `ljjax.gap.judge` from cases whose labels are open: `python -m benchmarks.blind.calibrate FOLDER…`.

Takes the evidence that every answer holds and the right answer from every label, adds them to `calibration.json` here
(robots that have been scored before, each by the diagnosis of its day), and finds the weights under which the right
answers are most probable. What those weights are worth on cases they were not fitted to is told by leaving out a fifth
of the cases at a time.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from scipy.optimize import minimize

from benchmarks.blind import judge as scoring
from ljjax.gap.judge import WEIGHTS, Evidence, Weights, probabilities

KEPT = Path(__file__).with_name("calibration.json")
FOLDS = 5
Row = Mapping[str, Any]


def gathered(folder: Path) -> list[dict[str, Any]]:
    """Evidence and right answers of the answered cases of a study's folder (`out/blind/seed-N`)."""
    out = []
    for answer in sorted(folder.glob("answers/*/gap.json")):
        label = json.loads((folder / "sealed" / answer.parent.name / "label.json").read_text(encoding="utf-8"))["label"]
        said = json.loads(answer.read_text(encoding="utf-8"))
        judged = scoring.judge(label, said, None)
        if judged["attained"] and label["kind"] != "pairs" and said.get("evidence"):
            out.append(
                {"seed": folder.name, "case": label["case_id"], "right": judged["right"], "evidence": said["evidence"]}
            )
    return out


def evidence(row: Row) -> Evidence:
    """Of a case; what a refit leaves of runs that it cannot simulate, null in gap.json, is without bound."""
    said = dict(row["evidence"])
    said["held_out"] = {i: np.inf if x is None else x for i, x in said["held_out"].items()}
    return Evidence(**said)


def likely(rows: Sequence[Row], by: Weights) -> np.ndarray:
    """(N,) probability of the right answer of each case."""
    stated = (probabilities(evidence(r), by) for r in rows)
    return np.array([sum(p.get(i, 0.0) for i in r["right"]) for r, p in zip(rows, stated, strict=True)])


def fitted(rows: Sequence[Row]) -> Weights:
    """The weights under which the right answers are most probable; a single case pulls them little from `WEIGHTS`."""

    def weights(x: np.ndarray) -> Weights:
        sharpness, outside, leaves, ahead, simpler = np.exp(x[:5])
        return Weights(sharpness, outside, leaves, ahead, float(1 / (1 + np.exp(-x[5]))), simpler)

    w, u = WEIGHTS, WEIGHTS.unforeseen
    start = np.log([w.sharpness, w.outside, w.leaves, w.ahead, w.simpler, u / (1 - u)])

    def cost(x: np.ndarray) -> float:
        return float(-np.sum(np.log(np.maximum(likely(rows, weights(x)), 1e-12))) + 0.5 * np.sum((x - start) ** 2))

    return weights(minimize(cost, start, method="Nelder-Mead", options={"maxiter": 400, "xatol": 1e-3}).x)


def told(rows: Sequence[Row], by: Sequence[Weights]) -> dict[str, Any]:
    """Calibration of the first answers where case i is judged by the weights by[i]."""
    ranked = []
    for r, w in zip(rows, by, strict=True):
        p = probabilities(evidence(r), w)
        top = max(p, key=lambda i: p[i])
        ranked.append({"top": [top], "stated": p[top], "top_right": top in r["right"], "brier": 0.0})
    found = scoring.calibration(ranked)
    logs = np.log(np.concatenate([likely([r], w) for r, w in zip(rows, by, strict=True)]))
    first = float(np.mean([r["top_right"] for r in ranked]))
    return {"ece": found["ece"], "first": first, "log": float(logs.mean())}


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.blind.calibrate", description=__doc__)
    parser.add_argument("folders", nargs="*", type=Path, help="answered seeds to add, such as out/blind/seed-7")
    chosen = parser.parse_args()
    kept = json.loads(KEPT.read_text(encoding="utf-8")) if KEPT.exists() else []
    new = [row for folder in chosen.folders for row in gathered(folder)]
    names = {(r["seed"], r["case"]) for r in new}
    rows = [r for r in kept if (r["seed"], r["case"]) not in names] + new
    if not rows:
        parser.error("no answered case; run benchmarks.blind.study first and name its seed's folder")
    if new:
        KEPT.write_text("[\n" + ",\n".join(json.dumps(r) for r in rows) + "\n]\n", encoding="utf-8")
    whole = fitted(rows)
    fold = np.random.default_rng(0).permutation(len(rows)) % FOLDS
    by = [fitted([r for r, f in zip(rows, fold, strict=True) if f != k]) for k in range(FOLDS)]
    say = Console().print
    say(f"{len(rows)} cases")
    for name, w in (("as they are", [WEIGHTS] * len(rows)), ("left out", [by[f] for f in fold])):
        t = told(rows, w)
        say(f"{name}: first right {t['first']:.2f}, calibration error {t['ece']:.3f}, mean log {t['log']:.3f}")
    say(f"fitted to all: {whole}")


if __name__ == "__main__":
    main()
