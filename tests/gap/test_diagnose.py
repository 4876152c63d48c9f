"""A diagnosis end to end, on robots of the recovery study's plant; their effects are made here by hand."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from benchmarks.recovery import logs
from benchmarks.recovery.experiments import PERIOD_S, plan
from benchmarks.recovery.plant import Plant
from benchmarks.recovery.robots import draw
from benchmarks.recovery.study import model_of
from ljjax import modelfile
from ljjax.cli import main
from ljjax.data import OCTROBOT
from ljjax.effects import REGISTRY
from ljjax.errors import InputError
from ljjax.gap import diagnose
from ljjax.gap.result import LAST
from ljjax.gap.run import _smooth
from ljjax.logs import Writer, read
from ljjax.modelfile import ModelFile
from ljjax.replay import replay

ROBOT, SECONDS = 1, 8.0
"""θ is logged; all of the chain is known."""
RUNS = (0, 1, 3, 5, 7)
"""Of `plan`: locks, triangles, a multisine, pressure steps, tension steps."""
NEAR = (
    *("actuator_lag", "actuator_gain", "tendon_friction", "pressure_lag", "pressure_leak", "pressure_bias"),
    *("friction_saturation", "layer_hysteresis", "viscoelastic_creep", "nonuniform_stiffness", "sensor_filter"),
)
"""Candidates: what is planted, what is like it, and one or more of each block. The blind check's robot has all 31."""
FAR = ("--without", *(i for i in REGISTRY if i not in NEAR))


def slow(pressure: np.ndarray, tau: float) -> np.ndarray:
    """The vacuum in a sheath that fills and vents through a narrow line."""
    out, level = np.empty_like(pressure), pressure[0]
    for k, p in enumerate(pressure):
        level += (p - level) * (1 - np.exp(-PERIOD_S / tau))
        out[k] = level
    return out


def record(folder: Path, tau: float = 0.0) -> Path:
    """Logs of the robot, with a sheath that follows its line with the time constant `tau` [s], and its wrong model."""
    robot = draw(ROBOT + 1)[ROBOT]
    experiments = plan(robot, SECONDS, seed=3)
    plant = Plant({path: np.full(len(RUNS), value) for path, value in robot.truth.items()})
    chosen = [experiments[i] for i in RUNS]
    tendons = np.stack([e.tendons for e in chosen], axis=-1)
    pressure = np.stack([slow(e.pressure_kpa, tau) if tau else e.pressure_kpa for e in chosen], axis=-1)
    q = np.moveaxis(plant.run(tendons, pressure, PERIOD_S), -1, 0)
    (folder / "train").mkdir(parents=True)
    for k, experiment in enumerate(chosen):
        with Writer(folder / "train" / f"run_{k:02d}.mcap", logs.metadata(robot, k, experiment.name)) as log:
            logs._moving(log, robot, k, experiment, q[k], np.random.default_rng(k))
    nominal = ModelFile(model_of(robot.start), frozen=robot.known)
    (folder / "nominal.toml").write_text(modelfile.dumps(nominal))
    return folder


def diagnosed(folder: Path, *more: str) -> dict:
    assert (
        main(
            ["gap", str(folder / "train"), "--model", str(folder / "nominal.toml"), "--out", str(folder / "out"), *more]
        )
        == 0
    )
    return json.loads((folder / "out" / "gap.json").read_text())


def contract(data: dict, steady: bool = False) -> None:
    """What contracts.md promises of gap.json; of steady data levels are held out, not runs."""
    assert data["schema"] == "ljjax.gap/1"
    assert data["verdict"] in ("listed_effect", "no_gap", "parameters_only", "unlisted_effect")
    ids = [e["id"] for e in data["effects"]]
    assert {"no_gap", "parameters_only", "unlisted_effect"} < set(ids) and len(ids) == len(set(ids))
    chances = [e["probability"] for e in data["effects"]]
    assert sum(chances) == pytest.approx(1.0) and chances == sorted(chances, reverse=True)
    roles = {role: {i["run_id"] for i in data["inputs"] if i["role"] == role} for role in ("train", "held_out")}
    assert sum(map(len, roles.values())) == len(data["inputs"])
    if steady:
        assert set(data["gap"]["held_out_runs"]) <= roles["train"]
    else:
        unused = {i["run_id"] for i in data["inputs"] if any(i["file"] in w for w in data["warnings"])}
        assert set(data["gap"]["held_out_runs"]) == roles["held_out"] - unused
    assert [w["share"] for w in data["where"]] == sorted((w["share"] for w in data["where"]), reverse=True)
    for effect in data["effects"]:
        for value in effect["parameters"].values():
            assert set(value) == {"value", "sd", "unit"}


def test_a_slow_sheath_is_named_and_added(tmp_path, capsys):
    folder = record(tmp_path / "robot", tau=0.35)
    data = diagnosed(folder, *FAR)
    contract(data)
    assert data["verdict"] == "listed_effect"
    assert data["selected"] == ["pressure_lag"]
    assert data["effects"][0]["id"] == "pressure_lag"
    assert data["where"][0]["block"] == "jamming" and data["where"][0]["axis"] == "pressure"
    lag = data["effects"][0]["parameters"]
    assert lag["fill_s"]["value"] == pytest.approx(0.35, rel=0.1)
    gap = data["gap"]
    assert gap["before"] > 2 * gap["noise_floor"] and gap["closed_fraction"] > 0.9
    assert gap["closed_fraction_ci95"][0] <= gap["closed_fraction"] <= gap["closed_fraction_ci95"][1]
    conditions = [f["closed_fraction"] for f in data["left_out"] if f["closed_fraction"] is not None]
    assert len(conditions) >= 2 and min(conditions) > 0.5  # it carries over to runs left out of the fits
    used, free = (data["evidence"][name]["pressure_lag"] for name in ("used", "parameters"))
    assert 2 <= used <= free == len(lag)  # filling and venting are told from nothing
    assert data["evidence"]["unseen"]["pressure_lag"] < 0.1
    assert set(data["evidence"]["left"]) == {e["id"] for e in data["effects"]} - set(LAST)
    assert "Cause: pressure_lag" in capsys.readouterr().out

    # the files say the same: the extended model replays an unseen run better than the refitted base
    held = next(i["file"] for i in data["inputs"] if i["role"] == "held_out")
    errors = {}
    for name in ("base", "model"):
        model = modelfile.load(folder / "out" / f"{name}.toml")
        assert [e.id for e in model.model.effects] == ([] if name == "base" else ["pressure_lag"])
        assert (
            main(["simulate", str(folder / "out" / f"{name}.toml"), held, "--out", str(tmp_path / f"{name}.mcap")]) == 0
        )

        residual = replay(model.model, read(held))["/residual"]["shape"].value
        errors[name] = float(np.sqrt(np.mean(residual**2)))
    assert errors["model"] < 0.6 * errors["base"]
    assert errors["base"] == pytest.approx(gap["before"], rel=0.1)
    assert (folder / "out" / "report.html").stat().st_size > 1000
    assert (folder / "out" / "result.mcap").exists()


def test_a_robot_without_an_effect_only_needs_its_parameters(tmp_path, capsys):
    """One log more, without a vacuum, is left out, and the reader told."""
    folder = record(tmp_path / "robot")
    robot = draw(ROBOT + 1)[ROBOT]
    with Writer(folder / "train" / "run_09.mcap", logs.metadata(robot, 9, "blind")) as log:
        some: Any = Without(log, "pressure", "cmd_pressure")
        wave = np.zeros((round(SECONDS / PERIOD_S), 6))
        logs._moving(some, robot, 9, plan(robot, SECONDS, seed=3)[0], wave, np.random.default_rng(9))
    data = diagnosed(folder, *FAR)
    contract(data)
    (told,) = (w for w in data["warnings"] if "run_09.mcap" in w)
    assert "pressure" in told and "run_09.mcap" in capsys.readouterr().out
    assert data["verdict"] == "parameters_only"
    assert data["selected"] == []
    assert data["gap"]["closed_fraction"] is None and data["gap"]["before"] < 1.1 * data["gap"]["noise_floor"]


class Without:
    """A log's writer that leaves some signals out."""

    def __init__(self, log: Writer, *names: str):
        self.log, self.names = log, names

    def write(self, name: str, *values, **more) -> None:
        if name not in self.names:
            self.log.write(name, *values, **more)


def weak(folder: Path, bend: float, tension: float, *missing: str, columns: int = 1) -> list[str]:
    """Three runs that bend to so many radians a joint under so many newtons, some signals left out, θ logged or each
    of 6 joints; and a model."""
    robot = replace(draw(ROBOT + 1)[ROBOT], columns=columns)
    folder.mkdir()
    wave = np.sin(np.linspace(0, 12, round(SECONDS / PERIOD_S)))
    for k, experiment in enumerate(plan(robot, SECONDS, seed=3)[:3]):
        tendons = tension * np.stack([np.maximum(wave, 0), np.maximum(-wave, 0)], axis=1)
        still = replace(experiment, tendons=tendons, pressure_kpa=np.full(len(wave), 10.0 * k))
        with Writer(folder / f"run_{k:02d}.mcap", logs.metadata(robot, k, experiment.name)) as log:
            q = np.repeat(bend * wave[:, None], 6, axis=1)
            some: Any = Without(log, *missing)
            logs._moving(some, robot, k, still, q, np.random.default_rng(k))
    (folder / "nominal.toml").write_text(modelfile.dumps(ModelFile(model_of(robot.start), frozen=robot.known)))
    return [str(folder), "--model", str(folder / "nominal.toml"), "--out", str(folder / "out")]


@pytest.mark.parametrize(
    "bend, tension, missing, said",
    [
        (0.0, 0.0, (), "no excitation: neither the tensions nor the shape move"),
        (0.0, 1.0, (), "no excitation: the shape moves by"),
        (0.0012, 1.0, (), "cannot tell from these data: the shape moves by"),
        (0.1, 1.0, ("pressure", "cmd_pressure"), "no signal cmd_pressure or pressure; it has"),
        (0.1, 1.0, ("shape",), "it has cmd_tendons, tendons, cmd_pressure, pressure\n"),
    ],
)
def test_runs_that_cannot_tell_are_refused_with_the_reason(tmp_path, capsys, bend, tension, missing, said):
    args = weak(tmp_path / "robot", bend, tension, *missing)
    assert main(["gap", *args]) == 2
    error = capsys.readouterr().err
    assert said in error and "Traceback" not in error
    assert not (tmp_path / "robot" / "out").exists()


def test_a_model_of_another_robot_is_refused(tmp_path, capsys):
    """Rather than its runs left out one by one, and what rests in them diagnosed as if it were all."""
    args = weak(tmp_path / "robot", 0.1, 1.0, columns=6)
    given = tmp_path / "robot" / "nominal.toml"
    given.write_text(given.read_text().replace("segments = 6", "segments = 4"))
    assert main(["gap", *args]) == 2
    assert "6 joint angles for a model of 4 segments; give a model" in capsys.readouterr().err
    assert not (tmp_path / "robot" / "out").exists()


def test_bad_input_is_refused_by_name(tmp_path, capsys):
    folder = record(tmp_path / "robot")
    run, other = (str(folder / "train" / f"run_{k:02d}.mcap") for k in (1, 2))
    given = ["--model", str(folder / "nominal.toml"), "--out", str(tmp_path / "out")]
    for args, said in (
        ([run, *given], "cannot tell from 1 moving run: a diagnosis needs three or more"),
        ([run, other, *given], "cannot tell from 2 moving runs: a diagnosis needs three or more"),
        ([run, *given, "--held-out", other], "1 moving run beside those of --held-out: a diagnosis fits two or more"),
        ([run, *given, "--without", "gremlins"], "--without gremlins: no such effect"),
        ([str(folder / "train"), *given, "--without", *REGISTRY], "--without leaves no effect to try"),
        ([run, *given, "--effects", str(tmp_path / "own.py")], "own.py: no such file"),
    ):
        assert main(["gap", *args]) == 2
        assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


OWN = '''
import jax
from ljjax.effect import Effect, parameter
from ljjax.effects.shapes import lagged

class NarrowHose(Effect):
    """The vacuum comes through a narrow hose."""
    id, block, axes = "narrow_hose", "jamming", ("pressure", "time")
    slow_s: jax.Array = parameter("s", 0.0, 0.0, 2.0, 0.1)

    def start(self, now):
        return (now.vacuum,)

    def evacuate(self, memory, vacuum, now):
        mean, end = lagged(vacuum, memory[0], self.slow_s, now.h)
        return mean, (end,)
'''


def test_a_users_own_effect_is_diagnosed_and_used_from_the_model_file(tmp_path):
    folder = record(tmp_path / "robot", tau=0.35)
    (tmp_path / "own.py").write_text(OWN)
    try:
        data = diagnosed(folder, "--effects", str(tmp_path / "own.py"), "--without", *REGISTRY)
        contract(data)
        assert data["selected"] == ["narrow_hose"] and data["gap"]["closed_fraction"] > 0.9
        assert data["effects"][0]["parameters"]["slow_s"]["value"] == pytest.approx(0.35, rel=0.1)
        REGISTRY.pop("narrow_hose")
        log, out = str(folder / "train" / "run_03.mcap"), tmp_path / "sim.mcap"
        assert main(["simulate", str(folder / "out" / "model.toml"), log, "--out", str(out)]) == 0 and out.exists()
    finally:
        REGISTRY.pop("narrow_hose", None)


BROKEN = '''
import jax.numpy as jnp
from ljjax.effect import Effect, parameter

class Root(Effect):
    """A push as the root of its parameter, which has no derivative where it is 0."""
    id, block, axes = "root_push", "structure", ("angle",)
    size = parameter("N²m²", 0.0, 0.0, 1.0, 0.1)
    __annotations__ = {"size": object}

    def load(self, memory, load, now):
        return tuple(x + jnp.sqrt(self.size) for x in load)
'''


def test_an_effect_without_a_derivative_where_it_vanishes_is_refused_by_its_name(tmp_path, capsys):
    folder = record(tmp_path / "robot", tau=0.35)
    (tmp_path / "own.py").write_text(BROKEN)
    try:
        args = ["--model", str(folder / "nominal.toml"), "--effects", str(tmp_path / "own.py"), "--without", *REGISTRY]
        assert main(["gap", str(folder / "train"), *args, "--out", str(tmp_path / "out")]) == 2
        assert "root_push: its derivative where it vanishes is not a finite number" in capsys.readouterr().err
        nominal = modelfile.load(folder / "nominal.toml").model
        assert [_smooth(REGISTRY[i], nominal) for i in ("root_push", "actuator_lag", "sensor_filter")] == [
            False,
            True,
            True,
        ]
    finally:
        REGISTRY.pop("root_push", None)
    assert not (tmp_path / "out").exists()


def test_what_is_kept_unseen_is_fitted_nowhere_and_presses_beside_motion_set_no_parameter_free(tmp_path, monkeypatch):
    """A log among those to fit and those of --held-out; a probe's log in the same folder."""
    monkeypatch.setattr("ljjax.gap.run.Inquiry", lambda setting: setting)
    monkeypatch.setattr("ljjax.gap.run.answer", lambda setting: setting)
    folder = record(tmp_path / "robot")
    runs = [read(p) for p in sorted((folder / "train").glob("*.mcap"))]
    model = replace(modelfile.load(folder / "nominal.toml"), frozen=())
    alone: Any = diagnose(model, runs, held_out=[read(runs[1].path)] * 2)
    assert [m.run.path for m in alone.test] == [runs[1].path] and len(alone.train) == len(runs) - 1
    press = read(OCTROBOT / "open_loop_stiffness.mcap")
    press = replace(press, metadata={**press.metadata, "robot_id": runs[0].robot_id})
    beside: Any = diagnose(model, [*runs, press])
    assert beside.study.names == diagnose(model, runs).study.names  # type: ignore[attr-defined]
    assert "chain.lever_arm_m" not in beside.study.names
    assert any(line.startswith(f"left out: {press.path}: steady points and presses") for line in beside.said)
    with pytest.raises(InputError, match="--held-out: no run to fit moves"):
        diagnose(model, [press], held_out=runs)


def test_single_precision_is_refused_with_the_mend():
    with jax.enable_x64(False), pytest.raises(InputError, match="jax_enable_x64"):
        diagnose(None, [])
