"""The control study runs, and tells what it is asked to tell; its numbers are small cases' and not looked at here."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from benchmarks.control.cmaes import cmaes
from benchmarks.control.stiffness import reproduced
from benchmarks.control.study import main, parts

FIELDS = {"name", "value", "unit", "goal", "met", "cases", "note", "beside"}
CHEAP = ("stiffness", "locking", "same")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("study")
    main(["--quick", "--out", str(out), *CHEAP])
    return out


def test_parts_leave_their_rows_and_pictures(folder):
    record = json.loads((folder / "study.json").read_text(encoding="utf-8"))
    assert record["schema"] == "ljjax.control_study/1" and record["quick"] is True
    rows = record["rows"]
    assert all(set(row) == FIELDS and math.isfinite(row["value"]) and row["cases"] > 0 for row in rows)
    names = [row["name"] for row in rows]
    expected = ["Table III: p", "Table III in", "closed-loop K_T", "shape locking"]
    expected += ["the law in JAX", "the law exported, C in double", "the law exported, C in float"]
    assert len(names) == len(expected)
    assert all(name.startswith(start) for name, start in zip(names, expected, strict=True))
    assert {p.stem for p in folder.glob("*.png")} == {"stiffness", "locking"}


def test_what_was_asked_of_them_is_met(folder):
    rows = json.loads((folder / "study.json").read_text(encoding="utf-8"))["rows"]
    assert (rows[0]["value"], rows[0]["met"]) == (50, True)
    assert all(row["met"] for row in rows if row["goal"])


def test_the_published_ratios_are_those_of_the_wrong_column():
    assert (reproduced(slip=True), reproduced(slip=False)) == (50, 14)


def test_a_part_that_is_none_is_refused(capsys):
    with pytest.raises(SystemExit):
        main(["everything"])
    assert f"there are {', '.join(parts())}" in capsys.readouterr().err


def test_cma_es_finds_the_bottom_of_a_narrow_bent_valley():
    """Rosenbrock's function in four dimensions, within the box; random points are nowhere near after as many."""

    def loss(u: np.ndarray) -> np.ndarray:
        x = 4 * u - 2
        return np.sum(100 * (x[:, 1:] - x[:, :-1] ** 2) ** 2 + (1 - x[:, :-1]) ** 2, axis=1)

    for seed in range(3):
        source = cmaes(np.full(4, 0.3), 0.2, seed)
        points, best, count = next(source), np.inf, 0
        while best > 1e-6 and count < 4000:
            assert points.min() >= 0 and points.max() <= 1
            losses = loss(points)
            best, count = min(best, float(losses.min())), count + len(points)
            points = source.send(losses)
        assert best <= 1e-6
    assert loss(np.random.default_rng(0).random((4000, 4))).min() > 1e-2
