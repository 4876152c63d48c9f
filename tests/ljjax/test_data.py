"""The logs in the box are the published tables, row for row."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

from ljjax.data import OCTROBOT
from ljjax.data.make_octrobot_logs import LOGS, make
from ljjax.logs import read
from ljjax.logs.info import missing_for

USE = {"identification": "steady fit", "steady_tension": "steady fit", "open_loop_stiffness": "stiffness fit"}


def table(name: str) -> np.ndarray:
    return np.genfromtxt(OCTROBOT / f"{name}.csv", delimiter=",", names=True)


def test_the_script_makes_the_bundled_bytes(tmp_path: Path):
    made = make(tmp_path)
    assert {p.stem for p in made} == set(LOGS) == {p.stem for p in OCTROBOT.glob("*.mcap")} == set(USE)
    for path in made:
        assert path.read_bytes() == (OCTROBOT / path.name).read_bytes(), path.name


@pytest.mark.parametrize("name", USE)
def test_every_row_is_a_sample_with_its_value_and_deviation(name: str):
    rows, run = table(name), read(OCTROBOT / f"{name}.mcap")
    seconds = np.arange(len(rows))
    np.testing.assert_allclose(run.vacuum_kpa("pressure").value[:, 0], rows["pressure_kpa"], atol=1e-9)
    if name == "open_loop_stiffness":
        probe = run.signals["probe"]
        assert probe.sd is not None and set(probe.sd[:, 0]) == {0.0}
        depth, force = probe.column("position"), probe.column("force")
        np.testing.assert_allclose(force / depth, rows["stiffness_mean_n_per_m"], rtol=1e-12)
        np.testing.assert_allclose(probe.sd[:, 1] / depth, rows["stiffness_sd_n_per_m"], rtol=1e-12)
        measured = [probe, run.signals["shape"], run.signals["pressure"]]
    else:
        tendons, shape = run.signals["tendons"], run.signals["shape"]
        assert tendons.sd is not None and shape.columns == ("theta",)
        np.testing.assert_array_equal(tendons.value[:, 0] - tendons.value[:, 1], rows["force_mean_n"])
        np.testing.assert_array_equal(np.hypot(*tendons.sd.T), rows["force_sd_n"])
        np.testing.assert_allclose(np.degrees(shape.value[:, 0]), rows["theta_deg"], rtol=1e-12)
        measured = [tendons, shape, run.signals["pressure"]]
    for signal in measured:
        np.testing.assert_array_equal(signal.t, seconds)


@pytest.mark.parametrize("name", USE)
def test_the_logs_are_whole_say_their_source_and_meet_the_contract_for_their_use(name: str):
    run = read(OCTROBOT / f"{name}.mcap")
    assert run.damage is None and run.notes == ()
    assert (run.run_id, run.robot_id) == (name, "OctRobot-I")
    assert run.metadata["contract_version"] == "1" and run.metadata["end_reason"] == "completed"
    assert run.metadata["table"] == f"{name}.csv" and "Fan, Yi" in run.metadata["source"]
    assert run.metadata["table_sha256"] == hashlib.sha256((OCTROBOT / f"{name}.csv").read_bytes()).hexdigest()
    assert missing_for(run)[USE[name]] == []


def test_the_two_tension_experiments_overlap_and_disagree():
    """Why they are not to be pooled: same angles and pressures, up to 1.8 times the tension."""
    first = {(r["theta_deg"], r["pressure_kpa"]): r["force_mean_n"] for r in table("identification")}
    ratio = [
        r["force_mean_n"] / first[r["theta_deg"], r["pressure_kpa"]]
        for r in table("steady_tension")
        if (r["theta_deg"], r["pressure_kpa"]) in first
    ]
    assert len(ratio) == 10 and max(ratio) == pytest.approx(1.8, abs=0.05)
