"""The command line: what it does, and how it refuses: exit 2, one line with file, place and mend, nothing written."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from ljjax.cli import COMMANDS, _parse, main
from ljjax.data import OCTROBOT
from ljjax.errors import InputError
from ljjax.logs import Writer, read
from ljjax.logs.contract import JOINT_STATE, SCHEMAS
from ljjax.model import Model
from ljjax.modelfile import ModelFile, dumps

T0 = 1_772_530_837_000_000_000
IDENTIFICATION = str(OCTROBOT / "identification.mcap")


def meta(run_id: str, experiment: str = "bend", robot: str = "octrobot-1") -> dict[str, str]:
    return {
        "run_id": run_id, "robot_id": robot, "experiment": experiment, "p_atm_pa": "101325",
        "start_utc": "2026-03-03T09:40:37Z",
    }  # fmt: skip


def steady(path: Path, pressures=(0, 10, 20, 30), robot: str = "octrobot-1", noise: float = 0.1) -> None:
    """Steady points at five angles of each pressure, with some noise."""
    rng = np.random.default_rng(0)
    with Writer(path, meta(path.stem, "steady", robot)) as log:
        t = T0
        for kpa in pressures:
            for degrees in (2, 6, 10, 14, 18):
                theta, t = math.radians(degrees), t + 1_000_000_000
                u = (0.3 * math.sin(6 * theta) + (1.5 + 0.06 * kpa - 1e-3 * kpa**2) * theta) / 0.02
                log.write("pressure", t, [101_325 - 1e3 * kpa])
                log.write("shape", t, [theta])
                log.write("tendons", t, [u + 2 + noise * rng.normal(), 2.0])


def probe(path: Path, pressures=(0, 10, 20, 30)) -> None:
    with Writer(path, meta(path.stem, "probe")) as log:
        for i, kpa in enumerate(pressures):
            log.write("pressure", T0 + i * 10**9, [101_325 - 1e3 * kpa])
            log.write("probe", T0 + i * 10**9, [1e-3, 0.1 + 0.03 * math.sqrt(kpa) + 1e-4 * (-1) ** i])


def moving(path: Path) -> None:
    """A tenth of a second of commands and shape, θ only."""
    with Writer(path, meta(path.stem)) as log:
        for i in range(11):
            t = T0 + i * 10_000_000
            if i in (0, 3, 6):
                log.write("cmd_tendons", t, [2.0 + i, 2.0])
                log.write("cmd_pressure", t, [101_325 - 1e3 * i])
            log.write("shape", t, [0.05])


def no_signal(path: Path) -> None:
    with Writer(path, meta(path.stem)) as log:
        log.write_diagnostics(T0, [(0, "loop", "", {})])


def not_a_number(path: Path) -> None:
    """A NaN, by another writer than ours, which refuses it."""
    from mcap_ros2.writer import Writer as Ros2Writer

    with path.open("wb") as stream:
        writer = Ros2Writer(stream)
        schema = writer.register_msgdef(JOINT_STATE, SCHEMAS[JOINT_STATE])
        for i, x in enumerate((0.1, math.nan, 0.3)):
            stamp = SimpleNamespace(sec=T0 // 10**9 + i, nanosec=0)
            m = {"header": {"stamp": vars(stamp), "frame_id": ""}, "name": ["theta"], "position": [x], "velocity": [],
                 "effort": []}  # fmt: skip
            writer.write_message("/real/shape", schema, m, T0 + i * 10**9, T0 + i * 10**9, i)
        writer._writer.add_metadata("ljjax.run", {"contract_version": "1", **meta("nan")})
        writer.finish()


MAPPING = """
schema = "ljjax.mapping/1"
[signals.theta]
topic = "/angle"
path = "deg"
{unit}
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory, robot: Callable[..., Model]) -> Path:
    """A folder with logs good and bad, and model files."""
    folder = tmp_path_factory.mktemp("cli")
    for name, make in {
        "steady": steady, "probe": probe, "moving": moving, "no_signal": no_signal, "nan": not_a_number,
        "one": lambda p: steady(p, (20,)), "two": lambda p: steady(p, (0, 40)),
        "other": lambda p: steady(p, robot="octrobot-2"), "probe_one": lambda p: probe(p, (5,)),
    }.items():  # fmt: skip
        make(folder / f"{name}.mcap")
    (folder / "text.mcap").write_text("no log")
    (folder / "blank.mcap").write_bytes(b"")
    (folder / "cut.mcap").write_bytes((folder / "moving.mcap").read_bytes()[:200])
    (folder / "empty").mkdir()
    (folder / "file").write_text("mine")
    good = dumps(ModelFile(robot(2)))
    (folder / "model.toml").write_text(good)
    (folder / "no_toml.toml").write_text("[chain")
    (folder / "short.toml").write_text(good.replace("mu_s", "mu_t"))
    (folder / "negative.toml").write_text(good.replace("segment_mass_kg = 0.06", "segment_mass_kg = -1.0"))
    (folder / "soft.toml").write_text(good.replace("c2 = 0.04", "c2 = -0.5"))
    (folder / "whole.toml").write_text(MAPPING.format(unit='unit = "deg"'))
    (folder / "no_unit.toml").write_text(MAPPING.format(unit=""))
    return folder


REFUSED: dict[str, tuple[str, list[str]]] = {
    "no such log": ("fit none.mcap --out new", ["none.mcap: no such file"]),
    "no such glob": ("fit none*.mcap --out new", ["none*.mcap: matches no log"]),
    "an empty folder": ("fit empty --out new", ["empty: has no *.mcap in it"]),
    "not MCAP": ("fit text.mcap --out new", ["text.mcap: ", "not an MCAP"]),
    "an empty file": ("fit blank.mcap --out new", ["blank.mcap: "]),
    "cut before the first sample": ("fit cut.mcap --out new", ["cut.mcap: no usable signal before byte"]),
    "no usable signal": ("fit no_signal.mcap --out new", ["no_signal.mcap: no usable signal", "/real/rig/diagnostics"]),
    "NaN": ("fit nan.mcap --out new", ["nan.mcap: /real/shape: sample 1 (stamp ", "theta is nan"]),
    "nothing at rest": ("fit moving.mcap --out new", ["moving.mcap: nothing at rest"]),
    "one good log of two": ("fit steady.mcap text.mcap --out new", ["text.mcap: ", "not an MCAP"]),
    "a mapping without a unit": (
        "fit steady.mcap --mapping no_unit.toml --out new", ["no_unit.toml, line 3: [signals.theta] unit: is missing"],
    ),
    "no such mapping": ("fit steady.mcap --mapping none.toml --out new", ["none.toml: no such file; give a mapping"]),
    "a mapping of nothing": ("fit steady.mcap --mapping whole.toml --out new", ["steady.mcap: none of the topics"]),
    "one pressure": ("fit one.mcap --out new", ["elastic.c1, elastic.c2 cannot be found", "20 kPa", "--freeze"]),
    "two pressures": ("fit two.mcap --out new", ["elastic.c1 cannot be found", "0, 40 kPa", "--freeze elastic.c1"]),
    "probe at one pressure": ("fit probe_one.mcap --out new", ["jamming.c5 cannot be found", "--freeze jamming.c5"]),
    "an unknown path to freeze": ("fit steady.mcap --out new --freeze elastic.c9", ["elastic.c9: no such parameter"]),
    "all frozen": ("fit probe.mcap --out new --freeze jamming.c4 jamming.c5", ["every parameter", "frozen"]),
    "weights that are not there": ("fit steady.mcap --out new --weights published", ["--weights published: 20 of 20"]),
    "weights unknown": ("fit steady.mcap --out new --weights best", ["--weights", "equal", "published"]),
    "no such model": ("fit steady.mcap --model none.toml --out new", ["none.toml: no such file"]),
    "a model that is no TOML": ("fit steady.mcap --model no_toml.toml --out new", ["no_toml.toml: not TOML"]),
    "a wrong key": ("fit steady.mcap --model short.toml --out new", ["short.toml: unknown key friction.mu_t"]),
    "an impossible mass": ("fit steady.mcap --model negative.toml --out new", ["negative.toml: chain.segment_mass_kg"]),
    "a folder as a model": ("fit steady.mcap --model empty --out new", ["empty: cannot be read"]),
    "held out: a stranger": ("fit steady.mcap --held-out other.mcap --out new", ["--held-out: logs of octrobot-2"]),
    "--out a file": ("fit steady.mcap --out file", ["file: is a file"]),
    "--out under a file": ("fit steady.mcap --out file/new", ["file/new: cannot be written"]),
    "no --out": ("fit steady.mcap", ["--out"]),
    "no log": ("fit --out new", ["no log given"]),
    "--freeze before the log": ("fit --freeze elastic.c1 steady.mcap --out new", ["no log given", "before options"]),
    "an unknown option": ("fit steady.mcap --out new --quick", ["--quick"]),
    "a seed that is no number": ("fit steady.mcap --out new --seed x", ["--seed"]),
    "an unknown command": ("identify steady.mcap", ["no command 'identify'", "fit"]),
    "simulate: no model": ("simulate none.toml moving.mcap --out new.mcap", ["none.toml: no such file"]),
    "simulate: no log": ("simulate model.toml none.mcap --out new.mcap", ["none.mcap: no such file"]),
    "simulate: several logs": ("simulate model.toml . --out new.mcap", ["simulate takes one"]),
    "simulate: no commands": ("simulate model.toml steady.mcap --out new.mcap", ["steady.mcap: no signal cmd_tendons"]),
    "simulate: α₂ ≤ 0 at the log's pressure": (
        "simulate soft.toml moving.mcap --out new.mcap", ["moving.mcap: elastic.c1, c2, c3 give α₂ = "],
    ),
    "simulate: onto the log": ("simulate model.toml moving.mcap --out moving.mcap", ["moving.mcap: is the log itself"]),
    "simulate: into nowhere": ("simulate model.toml moving.mcap --out new/new.mcap", ["new/new.mcap: expected"]),
    "simulate: onto a folder": ("simulate model.toml moving.mcap --out empty", ["empty: expected a file name"]),
    "simulate: unknown inputs": ("simulate model.toml moving.mcap --out new.mcap --inputs real", ["--inputs"]),
    "simulate: no step": ("simulate model.toml moving.mcap --out new.mcap --step-s nan", ["--step-s nan: expected"]),
    "simulate: nothing": ("simulate", ["MODEL", "LOG", "--out"]),
    "info: no log": ("info", ["no log given"]),
    "info: not MCAP": ("info text.mcap", ["text.mcap: ", "not an MCAP"]),
}  # fmt: skip


def snapshot(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() if p.is_file() else b"" for p in folder.rglob("*")}


@pytest.mark.parametrize("case", REFUSED)
def test_bad_input(place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], case: str):
    monkeypatch.chdir(place)
    args, words = REFUSED[case]
    before = snapshot(place)
    assert main(args.split()) == 2
    said = capsys.readouterr()
    assert said.out == "" and said.err.startswith("ljjax: ") and said.err.endswith("\n")
    assert len(said.err.splitlines()) == 1 and "Traceback" not in said.err
    for word in words:
        assert word in said.err
    assert snapshot(place) == before


@pytest.mark.parametrize("case", ["no such log", "an unknown command", "no --out"])
def test_bad_input_as_a_user_meets_it(place: Path, case: str):
    args, words = REFUSED[case]
    done = subprocess.run([sys.executable, "-m", "ljjax", *args.split()], capture_output=True, text=True, cwd=place)
    assert (done.returncode, done.stdout, len(done.stderr.splitlines())) == (2, "", 1)
    assert all(word in done.stderr for word in words)


def test_a_good_fit_as_a_user_meets_it(place: Path):
    """On the second of two runs the folder is there already; nothing on stderr."""
    args = [sys.executable, "-m", "ljjax", "fit", "steady.mcap", "probe.mcap", "--out", "out [1]/fit"]
    done = subprocess.run(args, capture_output=True, text=True, cwd=place)
    assert (done.returncode, done.stderr) == (0, "")
    assert "gravity.alpha1" in done.stdout and "Report: out [1]/fit/report.html" in done.stdout
    names = {"fit.json", "model.toml", "report.html", "result.mcap"}
    assert {p.name for p in (place / "out [1]" / "fit").iterdir()} == names


def test_a_terminal_that_knows_no_greek(place: Path, tmp_path: Path):
    args = [sys.executable, "-m", "ljjax", "info", "steady.mcap"]
    done = subprocess.run(args, capture_output=True, cwd=place, env={**os.environ, "PYTHONIOENCODING": "ascii"})
    assert (done.returncode, done.stderr) == (0, b"") and b"octrobot-1" in done.stdout


def test_the_main_job(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "new" / "fit"
    assert main(["fit", IDENTIFICATION, str(OCTROBOT / "open_loop_stiffness.mcap"), "--out", str(out)]) == 0
    said = capsys.readouterr()
    assert said.err == ""
    for shown in ("110.985", "29.1067", "1.7056", "not identifiable", "beware", str(out / "report.html")):
        assert shown in said.out
    paper = json.loads((out / "fit.json").read_text())["paper"]
    assert paper["c5"] == pytest.approx(29.1067, abs=5e-4)


def test_options_reach_the_fit(place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """The result of one fit starts the next; what is frozen there or here does not move."""
    one, two = tmp_path / "one", tmp_path / "two"
    options = ["--weights", "published", "--constraints", "paper", "--seed", "7"]
    assert main(["fit", IDENTIFICATION, "--out", str(one), *options, "--freeze", "gravity.alpha1"]) == 0
    first = json.loads((one / "fit.json").read_text())
    assert first["options"] == {
        "frozen": ["gravity.alpha1"], "weights": "published", "constraints": "paper", "seed": 7,
    }  # fmt: skip
    assert first["parameters"]["gravity.alpha1"]["verdict"] == "frozen"
    model = str(one / "model.toml")
    assert main(["fit", str(place / "probe.mcap"), "--model", model, "--out", str(two)]) == 0
    second = json.loads((two / "fit.json").read_text())
    assert second["start"] == model
    for name in ("gravity.alpha1", "elastic.c1", "elastic.c2", "elastic.c3"):
        assert second["parameters"][name]["value"] == first["parameters"][name]["value"]
    capsys.readouterr()


def test_a_folder_with_logs_and_results_is_fitted_again(place: Path, tmp_path: Path):
    logs = tmp_path / "logs"
    logs.mkdir()
    for name in ("steady.mcap", "probe.mcap"):
        (logs / name).write_bytes((place / name).read_bytes())
    assert main(["fit", str(logs), "--out", str(logs)]) == 0
    first = (logs / "fit.json").read_bytes()
    assert main(["fit", str(logs), "--out", str(logs)]) == 0
    assert (logs / "fit.json").read_bytes() == first
    assert len(json.loads(first)["inputs"]) == 2


def test_simulate(place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "sim.mcap"
    assert main(["simulate", str(place / "model.toml"), str(place / "moving.mcap"), "--out", str(out)]) == 0
    said = capsys.readouterr()
    assert said.err == "" and "deg RMS" in said.out and f"Written: {out}" in said.out
    real, sim, residual = (read(out, prefix=prefix).signals["shape"] for prefix in ("/real", "/sim", "/residual"))
    np.testing.assert_array_equal(sim.t, real.t)
    np.testing.assert_allclose(real.value - sim.value, residual.value, atol=1e-15)
    theta = np.degrees(residual.value.mean(axis=1))
    assert f"theta error {np.sqrt(np.mean(theta**2)):.4g} deg RMS, largest {np.abs(theta).max():.4g} deg" in said.out
    assert sim.columns == ("theta",) and abs(sim.value[0, 0] - 0.05) < 1e-3 < abs(sim.value[-1, 0] - 0.05)
    assert list(tmp_path.iterdir()) == [out]


def test_an_option_of_several_values_given_again_loses_none():
    bound = _parse("gap", ["run.mcap", "--without", "contact", "--out", "o", "--without=base_tilt", "tip_payload"])
    assert bound is not None
    heard = dict(zip(("logs", "out"), bound.args, strict=False)) | bound.keywords
    assert heard["without"] == ("contact", "base_tilt", "tip_payload") and heard["logs"] == ("run.mcap",)
    with pytest.raises(InputError, match="--seed is given twice"):
        _parse("gap", ["run.mcap", "--out", "o", "--seed", "1", "--seed", "2"])


def test_info(place: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["info", str(place / "steady.mcap"), str(place / "moving.mcap")]) == 0
    said = capsys.readouterr()
    assert said.err == "" and "octrobot-1" in said.out and "/real/cmd/tendons" in said.out


@pytest.mark.parametrize("args", [[], ["-h"], ["--help"], *([name, "--help"] for name in COMMANDS)], ids=" ".join)
def test_help(args: list[str], capsys: pytest.CaptureFixture[str]):
    assert main(args) == 0
    said = capsys.readouterr()
    assert said.err == "" and "Traceback" not in said.out
    own = {"fit": ["--held-out"], "gap": ["--without"], "simulate": ["--inputs"], "sweep": ["--vary"], "info": ["LOG"]}
    rig = [
        "--rate-hz FLOAT",
        "--theta-max-deg DEG",
        "--tension-max-n FLOAT",
        "How fast the vacuum may change, in kPa/s",
    ]
    own |= {"export": ["--law", "--gain", *rig], "tune": ["--spec", "--samples", *rig], "robust": ["--fit", "--sobol"]}
    own["rig"] = ["run", "experiment", "check", "emulate"]
    for word in COMMANDS if len(args) < 2 else own[args[0]]:
        assert word in said.out


def test_version(capsys: pytest.CaptureFixture[str]):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("ljjax 0.")


def test_a_fault_of_ours_is_not_dressed_as_the_users(place: Path, monkeypatch: pytest.MonkeyPatch):
    """Exit 2 is for bad input alone: an unforeseen error reaches Python, which exits with 1."""

    def broken(*_args, **_kwargs):
        raise ZeroDivisionError("ours")

    monkeypatch.setattr("ljjax.fit.fit_many", broken, raising=False)
    with pytest.raises(ZeroDivisionError):
        main(["fit", str(place / "steady.mcap"), "--out", str(place / "new")])
    assert not (place / "new").exists()


@pytest.mark.parametrize(("large", "asked", "found"), [("", "", "cpu"), ("large=True", "", "any"), ("", "tpu", "tpu")])
def test_a_command_takes_a_graphics_card_where_it_pays_or_is_asked_for(large, asked, found):
    code = f"import jax; from ljjax.cli import start_jax; start_jax({large}); print(jax.config.jax_platforms or 'any')"
    env = {**os.environ, "JAX_PLATFORMS": asked, "LJJAX_CACHE": ""}
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == found
