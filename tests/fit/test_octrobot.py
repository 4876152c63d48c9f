"""The published figures of OctRobot-I come out of its published measurements (model section 9)."""

from __future__ import annotations

import numpy as np
import pytest

from ljjax.data import OCTROBOT
from ljjax.fit import fit
from ljjax.logs import read_all

PAPER = {
    ("c5",): (29.1067, 5e-4),
    ("c4",): (110.9848, 5e-4),
    ("r_squared",): (0.9216, 1e-4),
    ("alpha1",): (1.0227, 5e-5),
    ("c1",): (-0.001483, 5e-7),
    ("c2",): (0.08906, 5e-6),
    ("c3",): (1.6242, 5e-5),
    ("c3_without_alpha1",): (1.7056, 5e-5),
    ("rmse_n",): (1.364, 5e-4),
    ("rmse_without_alpha1_n",): (1.367, 5e-4),
    ("sd", "alpha1"): (1.72, 5e-3),
    ("left_out", "steady_inner_n"): (2.34, 5e-3),
    ("left_out", "probe_n_per_m"): (28.6, 5e-2),
    ("published", "rmse_n"): (1.51, 5e-3),
    ("published", "c4"): (110.9847, 0),
    ("published", "c5"): (29.1067, 0),
    ("published", "r_squared"): (0.9216, 0),
    ("published", "alpha1"): (1.0227, 0),
    ("published", "c3"): (1.7056, 0),
    ("published", "largest_residual", "theta_deg"): (13, 1e-9),
    ("published", "largest_residual", "pressure_kpa"): (0, 1e-9),
}


@pytest.mark.parametrize("key", PAPER, ids=".".join)
def test_published_figure(octrobot, key):
    found = octrobot.json["paper"]
    for part in key:
        found = found[part]
    value, tolerance = PAPER[key]
    assert found == pytest.approx(value, abs=tolerance, rel=0)


def test_the_published_sets_largest_residual(octrobot):
    assert abs(octrobot.json["paper"]["published"]["largest_residual"]["n"]) == pytest.approx(3.31, abs=5e-3)


def test_alpha1_is_not_identifiable_and_the_rest_is(octrobot):
    verdicts = {k: p["verdict"] for k, p in octrobot.json["parameters"].items() if p["source"] != "model"}
    assert verdicts == {
        "gravity.alpha1": "not identifiable",
        "elastic.c1": "identifiable",
        "elastic.c2": "identifiable",
        "elastic.c3": "identifiable",
        "jamming.c4": "identifiable",
        "jamming.c5": "identifiable",
    }
    low, high = octrobot.json["parameters"]["gravity.alpha1"]["ci95"]
    assert low < 0 < high


def test_si_is_the_papers_with_the_stated_lever_arm(octrobot):
    """u [N] over θ [deg] with g = 1, against u·r [N·m] over θ [rad]: a factor r for α₁, r·180/π for c₁, c₂, c₃."""
    paper, si, r = octrobot.json["paper"], octrobot.json["parameters"], octrobot.json["lever_arm_m"]
    assert r == 0.02
    for name, factor in (("gravity.alpha1", r), *((f"elastic.c{i}", r * 180 / np.pi) for i in (1, 2, 3))):
        short = name.split(".")[1]
        assert si[name]["value"] == pytest.approx(factor * paper[short], rel=1e-9)
        assert si[name]["sd"] == pytest.approx(factor * paper["sd"][short], rel=1e-9)


def test_left_out_pressures_are_worse_than_fitted_ones(octrobot):
    """10–30 kPa left out, one at a time, in SI as in the paper's units; the stiffness law too fails where unseen."""
    held = octrobot.json["held_out"]
    assert held["steady"]["pressure_kpa"] == pytest.approx([0, 10, 20, 30, 40])
    assert held["steady"]["rmse_inner"] == pytest.approx(2.34, abs=5e-3)
    assert held["probe"]["pressure_kpa"] == pytest.approx(range(0, 41, 5))
    for kind in ("steady", "probe"):
        assert held[kind]["rmse_all"] > octrobot.json["residuals"][kind]["rmse"]


def test_it_warns_that_the_law_over_pressure_does_not_fit(octrobot):
    assert any("do not extrapolate" in w and "elastic.c1" in w for w in octrobot.json["warnings"])


def test_pooling_the_second_experiment_warns_that_runs_disagree():
    """It reads up to 1.8 times higher at the same angles and pressures: not to be pooled."""
    pooled = fit(None, read_all([OCTROBOT / "identification.mcap", OCTROBOT / "steady_tension.mcap"]))
    (warning,) = (w for w in pooled.warnings if "runs disagree" in w)
    assert "steady_tension lie" in warning and "those of identification" in warning
    alone = fit(None, read_all([OCTROBOT / "identification.mcap"]))
    assert not any("disagree" in w for w in alone.warnings)
