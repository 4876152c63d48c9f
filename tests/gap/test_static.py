"""Diagnosis at rest: the real robot, and robots whose statics are made here by formulas of their own."""

from __future__ import annotations

import dataclasses
import io
import json
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rich.console import Console

from ljjax.data import OCTROBOT
from ljjax.effects import REGISTRY
from ljjax.errors import InputError
from ljjax.fit.points import Points, collect
from ljjax.gap import diagnose
from ljjax.gap.show import show
from ljjax.gap.static import diagnose_static
from ljjax.gap.static_runs import sort
from ljjax.logs import Run, Signal, read_all
from ljjax.model import replace
from ljjax.modelfile import ModelFile, load
from tests.gap.test_diagnose import contract
from tests.house.readme import blocks, same

P_ATM, ARM, N, HALF = 101_325.0, 0.02, 6, 0.021
TRUTH = {
    "gravity.alpha1": 0.3,
    "elastic.c1": -8e-4,
    "elastic.c2": 0.08,
    "elastic.c3": 1.6,
    "jamming.c4": 10.0,
    "jamming.c5": 3.0,
}
NEAR = (
    *("actuator_gain", "actuator_deadband", "stiffness_saturation", "friction_saturation", "stiffness_hardening"),
    *("rest_curvature", "base_tilt", "contact", "sensor_bias", "sensor_scale"),
)
"""Candidates for the robots made here: what is planted, what is like it, and one or more of each block that shows at
rest. All 31 together take a minute a robot; the real robot has them all."""
FAR = tuple(id for id in REGISTRY if id not in NEAR)


def alpha2(p: np.ndarray) -> np.ndarray:
    return TRUTH["elastic.c1"] * p**2 + TRUTH["elastic.c2"] * p + TRUTH["elastic.c3"]


def signal(t, value, columns, unit, sd=None):
    return Signal(t, np.reshape(value, (len(t), -1)), columns, unit, "", sd)


def robot(more=lambda theta, p: 0.0 * p, pressures=6, noise_n=0.3, seed=0) -> list[Run]:
    """A steady log and a probe's, with tensions of `more` N beside the base model's."""
    rng = np.random.default_rng(seed)
    p, theta = (
        x.ravel() for x in np.meshgrid(np.linspace(0, 40, pressures), np.radians(np.linspace(2, 20, 6)), indexing="ij")
    )
    u = (TRUTH["gravity.alpha1"] * np.sin(N * theta) + alpha2(p) * theta) / ARM + more(theta, p)
    u = u + noise_n * rng.normal(size=u.shape)
    t = np.arange(len(u)) * 1.0
    names = ("tendon_left", "tendon_right")
    steady = {
        "shape": signal(t, theta, ("theta",), "rad"),
        "tendons": signal(
            t, np.stack([np.maximum(u, 0), np.maximum(-u, 0)], 1), names, "N", np.full((len(t), 2), 0.21)
        ),
        "pressure": signal(t, P_ATM - 1e3 * p, ("pressure",), "Pa"),
    }
    q = np.linspace(0, 40, 2 + pressures)
    a = HALF * (2 * np.arange(N, 0, -1) - 1)
    joint = alpha2(q) + TRUTH["jamming.c4"] + TRUTH["jamming.c5"] * np.sqrt(q)
    k = [1 / (a @ np.linalg.solve(TRUTH["gravity.alpha1"] + j * np.eye(N), a)) for j in joint]
    force = 1e-3 * (np.array(k) + 2.0 * rng.normal(size=len(q)))
    t = np.arange(len(q)) * 1.0
    depth = np.full(len(q), 1e-3)
    sd = np.stack([0 * depth, np.full(len(q), 2e-3)], 1)
    probe = {
        "probe": signal(t, np.stack([depth, force], 1), ("position", "force"), "m,N", sd),
        "pressure": signal(t, P_ATM - 1e3 * q, ("pressure",), "Pa"),
    }
    about = {"robot_id": "r", "p_atm_pa": str(P_ATM)}
    return [
        Run("s.mcap", "a" * 64, 10**18, steady, {**about, "run_id": "s", "experiment": "steady tension"}),
        Run("p.mcap", "b" * 64, 10**18, probe, {**about, "run_id": "p", "experiment": "probe stiffness"}),
    ]


def given(**change: float) -> ModelFile:
    nominal = load(OCTROBOT / "nominal.toml")
    values = {**TRUTH, **{k.replace("__", "."): v for k, v in change.items()}}
    return dataclasses.replace(nominal, model=replace(nominal.model, values))


def diagnosed(runs: list[Run], model: ModelFile):
    steady, probe, said = collect(runs)
    return diagnose_static(model, "given.toml", steady, probe, runs, said, without=FAR)


@pytest.fixture(scope="module")
def octrobot():
    """OctRobot-I, its second steady data set too, as the demo has it."""
    names = ("identification", "open_loop_stiffness", "steady_tension")
    return diagnose(None, read_all([OCTROBOT / f"{n}.mcap" for n in names]))


def test_the_real_robots_stiffness_saturates_with_pressure(octrobot):
    assert octrobot.verdict == "listed_effect"
    assert octrobot.selected == ["stiffness_saturation", "friction_saturation"]
    assert octrobot.effects[0].id == "stiffness_saturation"
    assert {octrobot.effects[0].id, octrobot.effects[1].id} == set(octrobot.selected)
    assert octrobot.where[0].axis == "pressure" and octrobot.where[0].block == "jamming"
    assert sum(f.probability for f in octrobot.effects) == pytest.approx(1)


def test_the_real_robots_gap_closes_at_pressures_left_out(octrobot):
    gap = octrobot.gap
    assert gap.channel == "tension" and gap.before == pytest.approx(2.34, abs=5e-3)
    assert gap.after <= 0.7
    (probe,) = (c for c in octrobot.story.channels if c.kind == "probe")
    assert 27 < probe.base.rms() < 29 and probe.model.rms() <= 6.0
    assert gap.closed_fraction_ci95[0] <= gap.closed_fraction <= gap.closed_fraction_ci95[1]


def test_what_stays_unexplained_is_said(octrobot):
    said = "\n".join(octrobot.warnings)
    assert "intercepts of tension over angle are not explained" in said and "they fall with pressure" in said
    assert "steady_tension is not fitted and not averaged in" in said and "1.80" in said
    assert list(octrobot.roles) == ["train", "train", "held_out"]
    (steady,) = (c for c in octrobot.story.channels if c.kind == "steady")
    assert set(steady.points.run) == {0}


def test_the_demo_prints_the_diagnosis_shown(octrobot):
    """In the README."""
    screen = io.StringIO()
    show(octrobot, Path("out/demo/gap"), Console(file=screen, highlight=False))
    same(screen.getvalue().splitlines(), blocks("text")[1].splitlines())


def test_it_saves_whole(octrobot, tmp_path):
    octrobot.save(tmp_path)
    data = json.loads((tmp_path / "gap.json").read_text(encoding="utf-8"))
    contract(data, steady=True)
    assert data["selected"] == list(octrobot.selected)
    effects = {e.id for e in load(tmp_path / "model.toml").model.effects}
    assert effects == set(octrobot.selected) and not load(tmp_path / "base.toml").model.effects
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "What stays unexplained" in page and "stiffness saturation" in page
    assert "From error to scatter, tension at rest" in page and "From error to scatter, tip stiffness" in page
    shown = json.loads((tmp_path / "foxglove.json").read_text(encoding="utf-8"))["configById"].values()
    topics = {path["value"].split(".")[0] for panel in shown for path in panel["paths"]}
    with (tmp_path / "result.mcap").open("rb") as log:
        summary = make_reader(log).get_summary()
    assert summary is not None
    written = {c.topic for c in summary.channels.values() if c.topic.startswith(("/sim/", "/residual/"))}
    assert written == {t for t in topics if t.startswith(("/sim/", "/residual/"))} and len(written) == 4


def test_a_bent_rest_shape_is_named_and_what_is_like_it_comes_next():
    found = diagnosed(robot(lambda theta, p: -alpha2(p) * 0.03 / ARM), given())
    assert found.verdict == "listed_effect" and found.selected[0] == "rest_curvature"
    assert found.effects[0].parameters["angle_rad"]["value"] == pytest.approx(0.03, abs=5e-3)
    assert found.effects[1].id == "sensor_bias"
    assert found.next_experiment is not None and found.next_experiment["expected_separation"] > 0


def test_no_effect_is_claimed_where_there_is_none():
    """The given model is the true one."""
    found = diagnosed(robot(), given())
    assert found.verdict == "no_gap" and found.effects[0].id == "no_gap" and found.selected == []
    assert found.where == []


def test_what_no_effect_explains_at_rest_is_called_unlisted():
    """Levels that read too high and too low by turns, as no law over pressure does."""
    found = diagnosed(robot(lambda theta, p: 3.0 * np.cos(np.pi * p / 8)), given())
    assert found.verdict == "unlisted_effect" and found.effects[0].id == "unlisted_effect" and found.selected == []
    assert found.where[0].axis == "pressure" and found.where[0].block == "jamming"


def test_a_wrong_gain_is_taken_up_by_the_parameters():
    """Exactly confused with the base parameters at rest, so never claimed."""
    u = lambda theta, p: (TRUTH["gravity.alpha1"] * np.sin(N * theta) + alpha2(p) * theta) / ARM  # noqa: E731
    found = diagnosed(robot(lambda theta, p: -0.2 * u(theta, p)), given())
    assert found.verdict == "parameters_only" and found.effects[0].id == "parameters_only" and found.selected == []


def part(run: Run, name: str, keep: np.ndarray, scale: float = 1.0) -> Run:
    """A log of some of a steady log's points, its tensions times `scale`."""
    signals = {
        n: signal(s.t[keep], s.value[keep] * (scale if n == "tendons" else 1.0), s.columns, s.unit)
        for n, s in run.signals.items()
    }
    return dataclasses.replace(run, path=f"{name}.mcap", sha256=name * 64, signals=signals)


def test_logs_of_one_pressure_each_are_one_set_but_for_one_that_disagrees():
    whole = robot(pressures=4)[0]
    level = np.repeat(np.arange(4), 6)
    runs = [part(whole, str(k), level == k) for k in range(4)]
    runs.append(part(whole, "5", level == 1, 1.8))
    steady, _, _ = collect(runs)
    kept, (apart,) = sort(steady, runs)
    assert set(kept.run) == {0, 1, 2, 3} and len(kept.level_pressures()) == 4
    assert apart.name == runs[4].run_id and "1.80" in apart.words


def test_too_few_pressures_are_refused_with_the_reason():
    runs = robot(pressures=3)[:1]
    with pytest.raises(InputError, match="at 3 pressures .* add steady points at 4 pressures or more"):
        diagnosed(runs, given())
    with pytest.raises(InputError, match="no steady points"):
        none = Points.none
        diagnose_static(given(), "given.toml", none("steady"), none("probe"), [], [])
