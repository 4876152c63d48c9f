"""The robustness study: probabilities and indices are right, it survives failures and kills, its worst case replays."""

from __future__ import annotations

import json
import math
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from statistics import NormalDist

import jax.numpy as jnp
import numpy as np
import pytest

from ljjax import law, modelfile, replay, sweep_file
from ljjax.cli import main
from ljjax.control import Hardware, design, export, fitted, robust, robust_report
from ljjax.control import uncertain as uncertain_module
from ljjax.control.chance import design as saltelli
from ljjax.control.chance import differences, sobol, wilson
from ljjax.control.robust_inputs import uncertain
from ljjax.control.robust_loop import OneLoop
from ljjax.control.robust_result import Robust
from ljjax.control.robust_run import Kept, simulate
from ljjax.control.spec import Spec, Target, load
from ljjax.control.statics import felt
from ljjax.control.uncertain import Input, draw, inputs, possible
from ljjax.control.vary import Vary
from ljjax.control.worst import climb, usual_radius
from ljjax.errors import InputError
from ljjax.logs import read, read_attachment
from ljjax.model import get
from ljjax.model import replace as put

SD = {"jamming.c4": 1.0, "friction.mu_s": 4e-4}
SPEC = """
schema = "ljjax.spec/1"
[[targets]]
theta_rad = 0.12
stiffness_n_m = {}
[[targets]]
theta_rad = -0.06
stiffness_n_m = {}
[loop]
duration_s = 0.4
noise_rad = 2e-4
[vary]
compute_ticks = [0.5, 1.5]
shape_rad = 0.003
[vary.effects.sensor_bias]
offset_rad = [0.0, 0.005]
[require.stiffness_error]
limit = 0.03
[require.settling_s]
limit = 0.3
"""
FEW = ["--samples", "40", "--sobol", "8", "--steps", "4", "--seed", "3"]


@pytest.fixture(scope="module")
def place(tmp_path_factory, robot):
    """A folder with a law, a model and a specification."""
    folder = tmp_path_factory.mktemp("robust")
    made = design(robot(), "integral", gains={"damping": 50.0}, hardware=Hardware(theta_max_rad=0.25))
    export(made, folder / "law.json")
    low, high = made.reach["stiffness_n_m"]
    (folder / "spec.toml").write_text(SPEC.format(low + 0.05 * (high - low), low + 0.2 * (high - low)))
    (folder / "model.toml").write_text(modelfile.dumps(modelfile.ModelFile(robot(), uncertainty=SD)), encoding="utf-8")
    return folder


def command(place, out, *more):
    files = [str(place / "law.json"), "--model", str(place / "model.toml"), "--spec", str(place / "spec.toml")]
    return ["robust", *files, "--out", str(out), *(more or FEW)]


@pytest.fixture(scope="module")
def study(place) -> Robust:
    """What the command found, in `place/out`; its compiled loops serve the other tests."""
    found = []

    def save(study, *args, **kwargs):
        found.append(study)
        robust_report_save(study, *args, **kwargs)

    robust_report_save = robust_report.save
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(robust_report, "save", save)
        assert main(command(place, place / "out")) == 0
    return found[0]


# --- the study


def test_the_command_writes_everything(place, study):
    out = place / "out"
    assert {p.name for p in out.iterdir()} == set(robust_report.NAMES)
    said = json.loads((out / "robust.json").read_text(encoding="utf-8"))
    assert said["schema"] == "ljjax.robust/1" and len(said["provenance"]["law_sha256"]) == 64
    assert set(said["requirements"]) == {"stiffness_error", "settling_s", "all"}
    assert said["failed"]["count"] == 0 and said["options"]["seed"] == 3
    assert {"noise course", "initial shape", "jamming.c4"} <= set(said["sensitivity"]["indices"]["cost"])
    kept, about = sweep_file.read(out / "samples.nc")
    np.testing.assert_array_equal(kept["jamming.c4"].data, study.columns["jamming.c4"])
    assert kept["settling_s"].dims == ("sample", "target") and about["seed"] == 3
    page = (out / "report.html").read_text(encoding="utf-8")
    assert page.count("<figure>") == 10 and "http" not in page.replace("http://www.w3.org", "")


def test_the_probability_is_the_known_one(study, robot):
    """Of the stiffness error, which c₄ alone decides, K_T rising with it: two quantiles of a normal distribution."""
    target = study.one.spec.targets[0]
    vacuum = jnp.asarray(vacuum_for(study))
    gamma = study.one.law.gains.gamma

    def error(c4: float) -> float:
        own = put(robot(), {"jamming.c4": c4})
        return float(felt(own, jnp.asarray(2.0), vacuum, gamma)) / target.stiffness_n_m - 1

    def where(limit: float) -> float:
        low, high = 1.0, 40.0
        for _ in range(40):
            low, high = (low, (low + high) / 2) if error((low + high) / 2) > limit else ((low + high) / 2, high)
        return low

    normal = NormalDist(float(get(robot(), "jamming.c4")), SD["jamming.c4"])
    probability = normal.cdf(where(0.03)) - normal.cdf(where(-0.03))
    met = study.good[:, 0, 6]
    np.testing.assert_array_equal(met, [abs(error(x)) <= 0.03 for x in study.columns["jamming.c4"]])
    low, high = wilson(int(met.sum()), len(met))
    assert 0.1 < probability < 0.9 and low < probability < high


def vacuum_for(study) -> float:
    """That which the law commands for the first target [kPa]."""
    table, limits = np.asarray(study.one.law.tables.root), study.one.law.limits
    k = np.linspace(float(limits.stiffness_min_n_m), float(limits.stiffness_max_n_m), len(table))
    w = np.interp(study.one.spec.targets[0].stiffness_n_m, k, table)
    return float(w * w)


def test_a_draw_alone_is_the_draw_among_many(study):
    one = study.one
    i, t = 7, 1
    target = one.spec.targets[t]
    case = (study.xi[i], np.uint32(study.courses[i]), target.theta_rad, target.stiffness_n_m)
    loop, _, plain, cost = one.alone(*map(jnp.asarray, case))
    np.testing.assert_allclose(plain, study.told.plain[i, t], rtol=1e-9)
    assert float(cost) == pytest.approx(float(study.told.price[i, t]), rel=1e-9)
    assert float(loop.q[0].sum()) == pytest.approx(study.columns["shape.q1"][i] + study.columns["shape.q2"][i])


def test_the_worst_case_is_no_better_than_any_sample_nearby(study):
    worst = study.worst
    inside = np.linalg.norm(study.xi, axis=1) <= worst.radius
    assert worst.cost >= study.told.price[inside].max() * (1 - 1e-9) and worst.away <= worst.radius * (1 + 1e-9)
    assert worst.cost > worst.begun  # it went uphill
    assert bool(possible(study.one.model, study.one.given, worst.xi[None], 40.0)[0])


def test_the_worst_case_replays(place, study):
    """From its two files alone, through the solver that knows nothing of the loop; a biased sensor included."""
    out, worst = place / "out", study.worst
    robot, run = modelfile.load(out / "worst.toml").model, read(out / "worst.mcap")
    assert float(get(robot, "effects.sensor_bias.offset_rad")) == worst.values["effects.sensor_bias.offset_rad"] != 0
    again = replay.replay(robot, run)["/sim"]["shape"].value
    np.testing.assert_allclose(again, run.signal("shape").value, atol=1e-8)
    bias = worst.values["effects.sensor_bias.offset_rad"]
    np.testing.assert_allclose(again, worst.loop.q + bias, atol=1e-8)
    assert read_attachment(out / "worst.mcap", "law.json") == (place / "law.json").read_bytes()
    assert json.loads((out / "robust.json").read_text())["worst"]["replay_error_rad"] < 1e-8


def test_derivatives_by_what_is_drawn_are_those_of_differences(study):
    one = study.one
    x = np.repeat(study.xi[:1], 4, axis=0)  # as many as climb side by side
    rest = (np.repeat(study.courses[:1], 4), np.full(4, 0.12), np.full(4, one.spec.targets[0].stiffness_n_m))
    value, slope = one.slopes(x, *rest)
    h = 1e-5
    for i in range(x.shape[1]):
        ends = []
        for sign in (1, -1):
            moved = x[0].copy()
            moved[i] += sign * h
            ends.append(float(one.alone(jnp.asarray(moved), *(jnp.asarray(y[0]) for y in rest))[3]))
        assert float(slope[0, i]) == pytest.approx((ends[0] - ends[1]) / (2 * h), rel=2e-3, abs=2e-5), i


# --- failures and kills


def test_a_loop_that_fails_is_named_and_leaves_the_others_alone(study):
    size = len(study.told.ok) + len(study.sobol_told.ok)
    size = -(-size // -(-size // 512)) if size > 512 else size
    xi = study.xi.copy()
    xi[5] = np.nan
    told, _ = simulate(study.one, xi, study.courses, size, None, lambda *_: None)
    others = np.arange(len(xi)) != 5
    for a, b in zip(told, study.told, strict=True):
        np.testing.assert_array_equal(a[others], b[others])
    broken = replace(study, told=told, xi=xi)
    assert broken.failed == [(5, 0), (5, 1)] and not broken.good[5].all(axis=1).any()
    assert broken.chances[-1].met <= study.chances[-1].met and broken.chances[-1].draws == 40
    said = robust_report.as_dict(broken, {}, 0.0)
    assert said["failed"]["count"] == 2 and said["failed"]["loops"][0]["sample"] == 5
    assert "Draw 5 at target 0 failed" in robust_report.page_of(broken, "")
    worst = climb(study.one, xi, study.courses, np.where(told.ok, told.price, np.nan), 3.0, 0, 40.0)
    assert math.isfinite(worst.cost)


def test_a_killed_study_goes_on_and_finds_the_same(study, tmp_path):
    size, identity = len(study.told.ok) + len(study.sobol_told.ok), {"study": 1}
    xi, courses = (np.concatenate([x, x]) for x in (study.xi, study.courses))
    xi, courses = np.resize(xi, (2 * size, xi.shape[1])), np.resize(courses, 2 * size)

    def killed(done, count):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate(study.one, xi, courses, size, Kept(tmp_path, identity, size), killed)
    (tmp_path / "robust.partial" / "000001.npz").write_bytes(b"cut")
    assert Kept(tmp_path, identity, 7).batch == size  # that of the study, however much memory is free now
    told, fresh = simulate(study.one, xi, courses, size, Kept(tmp_path, identity, size), lambda *_: None)
    assert fresh == told.ok.size / 2
    whole, _ = simulate(study.one, xi, courses, size, None, lambda *_: None)
    for a, b in zip(told, whole, strict=True):
        np.testing.assert_array_equal(a, b)
    with pytest.raises(InputError, match="robust.partial: is of another study .it differs in study."):
        Kept(tmp_path, {"study": 2}, size)


def test_another_study_into_the_same_folder_is_refused(place, study, capsys):
    before = {p: p.read_bytes() for p in (place / "out").iterdir()}
    assert main(command(place, place / "out", "--samples", "41")) == 2
    error = capsys.readouterr().err
    assert "samples.nc: is of another study (it differs in" in error and error.count("\n") == 1
    assert {p: p.read_bytes() for p in (place / "out").iterdir()} == before


# --- what is drawn


def test_correlated_quantities_have_the_correlation_and_are_one_group():
    entries = [Input(k, "1", "normal", m, s) for k, m, s in (("a", 1.0, 0.5), ("b", -2.0, 2.0), ("c", 0.0, 1.0))]
    given = inputs(entries, {("b", "a"): 0.8, ("c", "a"): 0.05}, {})
    assert given.groups == {"a + b": (0, 1), "c": (2,)}
    x = given.columns(np.random.default_rng(0).standard_normal((20_000, 3)))
    found = np.corrcoef(np.stack([x["a"], x["b"], x["c"]]))
    assert found[0, 1] == pytest.approx(0.8, abs=0.01) and abs(found[0, 2]) < 0.03
    assert (x["b"].mean(), x["b"].std()) == pytest.approx((-2.0, 2.0), abs=0.05)
    with pytest.raises(InputError, match="those of no distribution"):
        inputs(entries, {("b", "a"): 0.9, ("c", "a"): 0.9, ("c", "b"): -0.9}, {})


def test_quantities_keep_within_their_bounds():
    given = inputs([Input("u", "s", "uniform", 2.0, 3.0), Input("m", "kg", "normal", 0.0, 1.0, 0.0, 5.0)], {}, {})
    x = given.columns(np.random.default_rng(0).standard_normal((20_000, 2)))
    assert x["u"].min() >= 2 and x["u"].max() <= 3 and np.mean(x["u"]) == pytest.approx(2.5, abs=0.01)
    assert x["m"].min() >= 0 and np.mean(x["m"]) == pytest.approx(math.sqrt(2 / math.pi), abs=0.02)  # half a normal


def test_impossible_robots_are_drawn_anew(robot, monkeypatch):
    model, given = uncertain(robot(), Vary(), (), {"friction.mu_s": 1e-3}, {}, {})
    xi, redrawn = draw(model, given, 200, np.random.default_rng(0), 40.0)
    assert redrawn > 20 and given.columns(xi)["friction.mu_s"].min() >= 0.0025
    monkeypatch.setattr(uncertain_module, "TRIES", 2)
    model, given = uncertain(robot(), Vary(), (), {"jamming.c4": 1e9}, {}, {})
    with pytest.raises(InputError, match="lower the standard deviations"):
        draw(model, given, 64, np.random.default_rng(0), 40.0)


def test_effects_have_their_priors_and_pushes_their_time(robot):
    vary = Vary(
        push_n=(0.5, 0.5),
        push_at_s=(0.1, 0.1),
        push_for_s=(0.05, 0.05),
        effects={"effects.base_tilt.tilt_rad": (0.1, 0.2)},
    )
    weight = "effects.gravity_distribution.link_weight_n"
    model, given = uncertain(robot(), vary, ["gravity_distribution"], {}, {}, {weight: (0.2, 0.1)})
    assert [e.id for e in model.effects] == ["base_tilt", "gravity_distribution"]
    own = {x.name: (x.a, x.b) for x in given.entries}
    assert own["effects.base_tilt.tilt_rad"] == (0.1, 0.2) and own[weight] == (0.2, 0.1)
    assert "effects.gravity_distribution.mode1" in own and {"effects.gravity_distribution"} <= set(given.groups)
    vary = replace(
        vary, noise_rad=(3e-4, 3e-4), compute_ticks=(2.0, 2.0), effects={"effects.base_tilt.tilt_rad": (0.1, 0.0)}
    )
    model, given = uncertain(model, vary, [], {}, {}, {})
    assert not given.entries and float(get(model, "effects.base_tilt.tilt_rad")) == 0.1
    made = design(robot(), "integral", hardware=Hardware(theta_max_rad=0.25))
    one = OneLoop(made.law, model, Spec((Target(0.1, 5000.0),), duration_s=0.4), vary, given, float)
    plan = one.scenario({}, model, jnp.asarray(1, jnp.uint32), jnp.asarray(0.1), jnp.asarray(5000.0))
    pushed = np.flatnonzero((np.abs(plan.torque) > 1e-9).any(axis=1)) * one.period
    assert (pushed.min(), pushed.max()) == pytest.approx((0.1, 0.145))
    assert float(jnp.std(plan.noise)) == pytest.approx(2 * 3e-4, rel=0.3)
    assert float(plan.compute_s) == pytest.approx(2 * one.period) and float(plan.sensor_s) == 0


def test_a_fit_gives_standard_deviations_and_correlations(tmp_path):
    data = {
        "schema": "ljjax.fit/1",
        "parameters": {"jamming.c4": {"sd": 0.5}, "elastic.c1": {"sd": None}, "jamming.c5": {"sd": 0.1}},
        "correlation": {"names": ["jamming.c4", "jamming.c5"], "matrix": [[1.0, -0.9], [-0.9, None]]},
    }
    (tmp_path / "fit.json").write_text(json.dumps(data))
    found = fitted.read(tmp_path)
    assert found.sd == {"jamming.c4": 0.5, "jamming.c5": 0.1}
    assert found.correlation == {("jamming.c5", "jamming.c4"): -0.9}
    for content, said in (("[", "not JSON"), ("{}", "is no fit of one robot")):
        (tmp_path / "fit.json").write_text(content)
        with pytest.raises(InputError, match=said):
            fitted.read(tmp_path)


# --- statistics


@pytest.mark.parametrize(
    "met,count,low,high", [(0, 10, 0.0, 0.27753), (10, 10, 0.72247, 1.0), (5, 20, 0.11186, 0.46870)]
)
def test_wilsons_interval(met, count, low, high):
    assert wilson(met, count) == pytest.approx((low, high), abs=2e-5)


def test_sobols_indices_of_ishigamis_function():
    """Against the closed form, a = 7, b = 0.1, on uniform angles."""
    groups = {"x1": (0,), "x2": (1,), "x3": (2,)}
    xi = saltelli(np.random.default_rng(1), 4000, groups, 3)
    cdf = np.vectorize(lambda y: 0.5 * (1 + math.erf(y / math.sqrt(2))))
    x = math.pi * (2 * cdf(xi) - 1)
    y = np.sin(x[..., 0]) + 7 * np.sin(x[..., 1]) ** 2 + 0.1 * x[..., 2] ** 4 * np.sin(x[..., 0])
    found = sobol(y, tuple(groups), np.random.default_rng(2), 200)
    for name, first, total in (("x1", 0.3139, 0.5576), ("x2", 0.4424, 0.4424), ("x3", 0.0, 0.2437)):
        index = found[name]
        assert index.first == pytest.approx(first, abs=0.05) and index.total == pytest.approx(total, abs=0.05)
        assert index.first_ci95[0] < first < index.first_ci95[1] and index.total_ci95[0] < total < index.total_ci95[1]


def test_sobols_indices_of_a_sum_in_groups_and_with_rows_lost():
    groups = {"ab": (0, 1), "c": (2,)}
    xi = saltelli(np.random.default_rng(1), 4000, groups, 3, lambda x: x[:, 0] < 4.0)
    assert xi[..., 0].max() < 4
    y = xi[..., 0] + xi[..., 1] + math.sqrt(2) * xi[..., 2]
    y[3, ::10] = np.nan
    found = sobol(y, tuple(groups), np.random.default_rng(2), 100)
    for index in found.values():
        assert (index.first, index.total) == pytest.approx((0.5, 0.5), abs=0.05)
    assert sobol(np.ones((4, 20)), tuple(groups), np.random.default_rng(2)) == {}


def test_what_failures_have_in_common_is_found_and_nothing_else():
    rng = np.random.default_rng(0)
    columns = {name: rng.standard_normal(2000) for name in ("high", "far", "neither")}
    failing = (columns["high"] > 1.0) | (np.abs(columns["far"]) > 2.0)
    found = {d.name: d for d in differences(columns, failing)}
    assert set(found) == {"high", "far"} and not found["high"].away and found["far"].away
    assert found["high"].size > 1 and found["high"].failing > 0.5 > found["high"].passing
    assert differences(columns, np.zeros(2000, bool)) == []


@pytest.mark.parametrize("d", [1, 5, 20])
def test_the_usual_radius_holds_95_of_100_draws(d):
    length = np.linalg.norm(np.random.default_rng(0).standard_normal((40_000, d)), axis=1)
    assert np.mean(length <= usual_radius(d)) == pytest.approx(0.95, abs=0.005)


def test_a_batch_is_laid_out_over_all_devices():
    code = """
import jax, jax.numpy as jnp, numpy as np
from ljjax import batch
found = batch.over(lambda x, y: {"sum": jnp.sin(x) + y})(np.arange(7.0, dtype="f4"), np.ones(7, "f4"))
np.testing.assert_allclose(found["sum"], np.sin(np.arange(7)) + 1, rtol=1e-6)
print(jax.device_count(), found["sum"].shape)
"""
    env = {**os.environ, "XLA_FLAGS": "--xla_force_host_platform_device_count=3"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=env)
    assert done.stdout.strip() == "3 (7,)", done.stderr


# --- refusals


BAD = [
    ("compute_ticks = [0.5, 1.5]", "compute_ticks = [1.5, 0.5]", "vary.compute_ticks is [1.5, 0.5]: must be between"),
    ("compute_ticks = [0.5, 1.5]", "delay_s = 1", "unknown key vary.delay_s; expected noise_rad"),
    ("compute_ticks = [0.5, 1.5]", "push_at_s = 0.1", "vary.push_at_s without a push; give vary.push_n"),
    (
        "compute_ticks = [0.5, 1.5]",
        "push_n = 1\npush_at_s = 3",
        "spec.toml: vary.push_at_s is up to 3 s, the loop ends at 0.4 s",
    ),
    ("shape_rad = 0.003", "shape_rad = -1", "vary.shape_rad = -1: must be between 0 and 0.5 rad"),
    ("shape_rad = 0.003", "effects.wind.force = [0, 1]", "vary.effects.wind: no such effect"),
    ("shape_rad = 0.003", "effects.base_tilt.tilt_rad = [9, 1]", "vary.effects.base_tilt.tilt_rad is [9, 1]"),
    ("theta_rad = 0.12", "theta_rad = 1.2", "targets[0]: theta = 1.2 rad"),
]


@pytest.mark.parametrize("old,new,said", BAD, ids=[said for _, _, said in BAD])
def test_a_bad_specification_is_refused_in_a_line_and_nothing_written(place, tmp_path, capsys, old, new, said):
    for name in ("law.json", "model.toml"):
        shutil.copy(place / name, tmp_path / name)
    text = (place / "spec.toml").read_text()
    assert old in text
    (tmp_path / "spec.toml").write_text(text.replace(old, new, 1))
    assert main(command(tmp_path, tmp_path / "new")) == 2
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1 and not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    "more,said",
    [
        (["--samples", "1"], "--samples 1: expected a whole number from 2 on"),
        (["--batch", "0"], "--batch 0: expected"),
        (["--radius", "-1"], "--radius -1: expected"),
        (["--effects", "wind"], "effects: no effect 'wind'"),
        (["--fit", "none"], "none: no such file"),
        (["--precision", "float16"], "--precision"),
    ],
)
def test_bad_usage_is_refused_in_a_line(place, tmp_path, capsys, more, said):
    assert main(command(place, tmp_path / "new", *more)) == 2
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1 and not (tmp_path / "new").exists()


def test_an_input_is_never_replaced_and_nothing_uncertain_is_said(place, tmp_path, capsys, robot):
    shutil.copy(place / "model.toml", tmp_path / "worst.toml")
    args = ["robust", str(place / "law.json"), "--model", str(tmp_path / "worst.toml"), "--out", str(tmp_path)]
    assert main(args) == 2
    assert "worst.toml: is an input and would be replaced" in capsys.readouterr().err
    (tmp_path / "sure.toml").write_text(modelfile.dumps(modelfile.ModelFile(robot())), encoding="utf-8")
    (tmp_path / "spec.toml").write_text((place / "spec.toml").read_text().split("[vary]")[0] + "[vary]\n")
    args = ["robust", str(place / "law.json"), "--model", str(tmp_path / "sure.toml"), "--out", str(tmp_path / "new")]
    assert main([*args, "--spec", str(tmp_path / "spec.toml")]) == 2
    assert "nothing is uncertain" in capsys.readouterr().err and not (tmp_path / "new").exists()
    with pytest.raises(InputError, match="the law|is for 2 segments"):
        robust(law.load(place / "law.json"), robot(3), load(place / "spec.toml"))
