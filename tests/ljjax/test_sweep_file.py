"""Sweeps on disk and from the command line: killed ones go on; one file that explains itself."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from scipy.io import netcdf_file

from ljjax import sweep_run
from ljjax.cli import main
from ljjax.errors import InputError
from ljjax.model import Model, replace
from ljjax.modelfile import ModelFile, dumps
from ljjax.sweep import load
from ljjax.sweep_result import OUTPUTS
from tests.ljjax.sweeps import C5, MU, STEP, VARY, assert_same, bend, swept
from tests.ljjax.sweeps import grid as grid
from tests.ljjax.sweeps import model as model

# --- the file


@pytest.fixture(scope="module")
def place(model: Model, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a model file and a sweep of it."""
    folder = tmp_path_factory.mktemp("sweep")
    (folder / "model.toml").write_text(dumps(ModelFile(model)))
    swept(folder / "model.toml", {"pull": bend()}, out=folder / "done")  # type: ignore[arg-type]
    return folder


def test_the_file_opens_with_scipy_and_says_what_it_holds(place, grid):
    assert {p.name for p in (place / "done").iterdir()} == {"sweep.nc", "report.html"}
    with netcdf_file(place / "done" / "sweep.nc", mmap=False) as file:
        assert file.version_byte == 2
        assert file.dimensions["friction.mu_s"] == 3 and file.dimensions["run"] == 1
        v = file.variables
        assert v["friction.mu_s"].units == b"1" and v["jamming.c5"].units == b"N m/kPa^0.5"
        assert v["theta"].units == b"rad" and v["time"].units == b"s"
        assert v["theta"].dimensions == ("run", "friction.mu_s", "jamming.c5", "time")
        np.testing.assert_array_equal(v["friction.mu_s"][:], MU)
        np.testing.assert_array_equal(v["theta"][:], grid["theta"])
        assert v["run"][:].tobytes() == b"pull"
        assert v["status"].flag_meanings == b"ok sensitive inadmissible failed"
        np.testing.assert_array_equal(v["status"].flag_values, [0, 1, 2, 3])
        assert all(hasattr(v[name], "units") and hasattr(v[name], "long_name") for name in OUTPUTS if name in v)
        about = file._attributes
        assert about["source"].startswith(b"ljjax ") and about["model_file"] == str(place / "model.toml").encode()
        assert len(about["model_sha256"]) == 64 and about["step_s"] == STEP
        assert json.loads(about["model_parameters"])["friction.mu_c"] == 0.025
        assert "rms_error" not in v  # nothing was measured


def test_what_is_loaded_is_what_was_found(place, grid, tmp_path):
    found = load(place / "done")
    np.testing.assert_array_equal(found["theta_final"], grid["theta_final"])
    assert found["reason"].tolist() == grid["reason"].tolist()
    found.save(tmp_path / "copy")
    assert_same(load(tmp_path / "copy" / "sweep.nc"), found)


def test_reasons_in_many_letters_survive_the_file(model, tmp_path):
    found = swept(model, vary={"friction.mu_s": [0.01, 0.03], "jamming.c5": [0.5]}, out=tmp_path)
    assert (
        load(tmp_path)["reason"][0, 0, 0]
        == found["reason"][0, 0, 0]
        == ("friction.mu_s = 0.01: must be ≥ friction.mu_c = 0.025")
    )


@pytest.mark.parametrize("content", [b"", b"no netcdf", b"CDF\x02\x00\x00"])
def test_a_file_that_is_no_sweep_is_refused(tmp_path, content):
    (tmp_path / "sweep.nc").write_bytes(content)
    with pytest.raises(InputError, match="sweep.nc: "):
        load(tmp_path)


# --- again


SLOW = """
import sys, time
import jax
jax.config.update("jax_enable_x64", True)
sys.path.insert(0, sys.argv[1])
from tests.ljjax.conftest import make_robot
from tests.ljjax.test_sweep_file import LONG, swept
swept(make_robot(1), vary=LONG, out=sys.argv[2], progress=lambda done, total: time.sleep(0.5))
"""
LONG = {"friction.mu_s": np.linspace(0.02, 0.06, 9), "jamming.c5": C5}


def test_a_killed_sweep_goes_on_where_it_was(model, tmp_path, monkeypatch):
    """Killed by the system after two batches of four; a torn batch is done again; the file is that of a quiet run."""
    out, kept = tmp_path / "killed", tmp_path / "killed" / "sweep.partial"
    child = subprocess.Popen([sys.executable, "-c", SLOW, str(Path(__file__).parents[2]), str(out)])
    try:
        for _ in range(1200):
            if len(list(kept.glob("*.npz"))) >= 2:
                break
            assert child.poll() is None, "the child ended by itself"
            time.sleep(0.05)
    finally:
        child.kill()
    assert child.wait() == -9
    done = sorted(kept.glob("*.npz"))
    assert 2 <= len(done) < 4 and not (out / "sweep.nc").exists()
    done[0].write_bytes(done[0].read_bytes()[:200])
    with pytest.raises(InputError, match=r"sweep.partial: is of another sweep \(it differs in vary\)"):
        swept(model, out=out)

    simulated = []
    batch = sweep_run.simulate_batch
    monkeypatch.setattr(sweep_run, "simulate_batch", lambda *args: simulated.append(1) or batch(*args))
    resumed = swept(model, vary=LONG, out=out, batch=3)  # the batch of the first call holds
    assert len(simulated) == 4 - len(done) + 1
    assert {p.name for p in out.iterdir()} == {"sweep.nc", "report.html"}
    quiet = swept(model, vary=LONG, out=tmp_path / "quiet")
    assert_same(load(out), load(tmp_path / "quiet"), but=("created_utc", "history"))
    assert_same(resumed, quiet, but=("created_utc", "history"))


def test_a_finished_sweep_is_read_and_another_refused(model, place, monkeypatch):
    monkeypatch.setattr(sweep_run, "simulate_batch", None)
    before = (place / "done" / "sweep.nc").read_bytes()
    again = swept(place / "model.toml", {"pull": bend()}, out=place / "done")  # type: ignore[arg-type]
    assert again.counts == load(place / "done").counts
    for differs, change in {
        "vary": {"vary": {**VARY, "jamming.c5": [0.5, 0.8]}},
        "inputs": {"runs": {"pull": bend(tension=11.0)}},
        "step_s": {"step_s": 0.02},
        "model": {"model": replace(model, {"friction.v_s": 0.05})},
    }.items():
        given = {"model": model, "runs": {"pull": bend()}, "out": place / "done", **change}
        with pytest.raises(InputError, match=rf"sweep.nc: is of another sweep \(it differs in {differs}\)"):
            swept(**given)
    assert (place / "done" / "sweep.nc").read_bytes() == before


# --- the command

SAID = {
    "no such model": ("none.toml --vary jamming.c5=1,2", ["none.toml: no such file"]),
    "no such log": ("model.toml none.mcap --vary jamming.c5=1,2", ["none.mcap: no such file"]),
    "nothing to vary": ("model.toml", ["nothing to sweep over", "--vary"]),
    "a path that is none": ("model.toml --vary jamming.c9=1,2", ["no parameter 'jamming.c9'"]),
    "no values": ("model.toml --vary jamming.c5", ["--vary jamming.c5: expected PATH=LOW:HIGH:COUNT"]),
    "no count": ("model.toml --vary jamming.c5=1:2", ["--vary jamming.c5=1:2: expected PATH=LOW:HIGH:COUNT"]),
    "a count for samples": ("model.toml --samples 4 --vary jamming.c5=1:2:3", ["expected PATH=LOW:HIGH or"]),
    "twice": ("model.toml --vary jamming.c5=1 --vary jamming.c5=2", ["jamming.c5 is varied already"]),
    "two ways": ("model.toml --vary jamming.c5=1 --list sets.csv", ["--list sets.csv with --vary"]),
    "a list of text": ("model.toml --list text.csv", ["text.csv, line 3: jamming.c5 is 'much'"]),
    "no such list": ("model.toml --list none.csv", ["none.csv: cannot be read"]),
    "how": ("model.toml --vary jamming.c5=1,2 --how all", ["--how", "grid", "zip"]),
    "an impossible step": ("model.toml --vary jamming.c5=1,2 --step-s 1", ["step_s is 1"]),
    "an empty batch": ("model.toml --vary jamming.c5=1,2 --batch 0", ["--batch 0"]),
}  # fmt: skip


@pytest.mark.parametrize("case", SAID)
def test_bad_usage_is_said_in_one_line(place, monkeypatch, capsys, case):
    monkeypatch.chdir(place)
    (place / "text.csv").write_text("friction.mu_s,jamming.c5\n0.03,1\n0.03,much\n")
    words, said = SAID[case]
    assert main(["sweep", *words.split(), "--out", "new"]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and err.startswith("ljjax: ")
    assert all(part in err for part in said), err
    assert not (place / "new").exists()


def test_the_command_writes_what_the_function_finds(place, model, tmp_path, capsys):
    """Without a log: the standard manoeuvre, whose shape stays locked while the vacuum holds."""
    sets = tmp_path / "sets.csv"
    sets.write_text("friction.mu_s,jamming.c5\n0.06,0.5\n0.01,0.5\n0.06,20\n")
    words = [
        "sweep",
        place / "model.toml",
        "--list",
        sets,
        "--step-s",
        "0.02",
        "--no-errors",
        "--out",
        tmp_path / "out",
    ]
    assert main([str(w) for w in words]) == 0
    out, err = capsys.readouterr()
    assert err == "" and out.startswith("3 elements (1 × 3 parameter sets): 2 ok, 1 inadmissible\n")
    found = load(tmp_path / "out")
    assert "error_estimate" not in found.variables
    held = found["theta"][0][:, np.searchsorted(found["time"], 3.75)]
    assert held[2] > 2 * held[0] and np.isnan(held[1])
    report = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "must be ≥ friction.mu_c" in report and report.count("<img") >= 5 and "http" not in report.split("<main>")[1]
