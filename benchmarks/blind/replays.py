"""`python -m benchmarks.blind.replays OUT LOG… -- MODEL…`: errors of models on runs, by `ljjax simulate`.

One process for all, so that a program is compiled once. Writes OUT, a JSON list: for each model, the root-mean-square
error of θ over all samples of all runs [rad].
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path

import numpy as np

from ljjax.cli import main as ljjax
from ljjax.logs import read


def error(model: str, logs: list[str]) -> float:
    """RMS of θ, measured − simulated from commands, over these runs [rad]. Raises RuntimeError where one fails."""
    square, count = 0.0, 0
    with tempfile.TemporaryDirectory(prefix="ljjax-blind-") as folder:
        for i, log in enumerate(logs):
            out = Path(folder) / f"{i}.mcap"
            if code := ljjax(["simulate", model, log, "--out", str(out)]):
                raise RuntimeError(f"ljjax simulate {model} {log}: exit code {code}")
            theta = read(out, prefix="/residual").signal("shape").value.mean(axis=1)
            square, count = square + float(theta @ theta), count + len(theta)
    return float(np.sqrt(square / count))


def main() -> None:
    out, *rest = sys.argv[1:]
    cut = rest.index("--")
    found = [error(model, rest[:cut]) for model in rest[cut + 1 :]]
    Path(out).write_text(json.dumps(found), encoding="utf-8")


if __name__ == "__main__":
    main()
