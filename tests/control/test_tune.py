"""Tuning: the gradient is right, gains get better, nothing infeasible comes out, what makes no sense is refused."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ljjax import law, modelfile
from ljjax.cli import main
from ljjax.control import Hardware, design
from ljjax.control.loop import Loop
from ljjax.control.measures import Asked, plain, smooth
from ljjax.control.problem import FAILED, Problem, cost
from ljjax.control.refusals import UNIQUE
from ljjax.control.robots import sample
from ljjax.control.spec import MEASURES, Requirement, Spec, Target, default, load
from ljjax.control.surrogate import KEPT, fit
from ljjax.control.tuning import tune
from ljjax.errors import InputError
from ljjax.law.parts import USED
from ljjax.model import get

HARDWARE = Hardware(theta_max_rad=0.25)
UNSURE = {"jamming.c4": 1.0, "friction.mu_s": 4e-4, "elastic.c3": 0.1}


def spec_for(made, seconds=1.5) -> Spec:
    low, high = made.reach["stiffness_n_m"]
    targets = Target(0.12, low + 0.4 * (high - low)), Target(-0.06, low + 0.6 * (high - low))
    return Spec(targets, duration_s=seconds)


@pytest.fixture(scope="module")
def problem(designs, robot):
    """Of the observer, on two robots."""
    made = designs["observer"]
    robots = sample(robot(), UNSURE, 2, vacuum_max_kpa=40.0)
    return Problem(made, robot(), HARDWARE, spec_for(made, 0.8), robots)


@pytest.fixture(scope="module")
def tuned(designs, robot):
    """Of the law with integral action, from weak gains and another start."""
    said = []
    options = {"uncertainty": UNSURE, "samples": 2, "restarts": 2, "iterations": 8}
    spec = spec_for(designs["integral"])
    start = {"integral": 3.0}
    found = tune(
        robot(), "integral", spec, gains=start, hardware=HARDWARE, progress=lambda *x: said.append(x), **options
    )
    assert said == [("tuning", k + 1, 8) for k in range(8)]
    return found


# --- the surrogate


def test_a_surrogate_goes_through_values_and_derivatives_and_foresees_what_lies_between():
    rng = np.random.default_rng(0)

    def truth(u):
        return jnp.stack([jnp.sin(2 * u[0]) + u[1] ** 2, jnp.exp(u[0] * u[1] - u[2])])

    points = rng.random((KEPT - 4, 3))
    values = np.array(jax.vmap(truth)(jnp.asarray(points)))
    slopes = np.array(jax.vmap(jax.jacfwd(truth))(jnp.asarray(points)))
    guess = fit(points, values, slopes)
    for u in points[:3]:
        np.testing.assert_allclose(guess.at(jnp.asarray(u)), truth(u), atol=5e-3)
        np.testing.assert_allclose(jax.jacfwd(guess.at)(jnp.asarray(u)), jax.jacfwd(truth)(jnp.asarray(u)), atol=0.05)
    between = 0.5 * (points[0] + points[1])
    alone = fit(points, values, np.zeros_like(slopes))  # a surrogate that believes wrong slopes does worse
    off, worse = (np.abs(np.asarray(g.at(jnp.asarray(between))) - truth(between)).max() for g in (guess, alone))
    assert off < 1e-2 and off < worse / 3


# --- measures


def decay(rate: float, beyond: float = 0.0, left: float = 0.0, theta: float = 0.1):
    """A loop of 3 s that comes to θ* exponentially, by way of so much more, and rests that far off."""
    t = jnp.arange(600.0) * 0.005
    error = -jnp.exp(-rate * t) + beyond * jnp.exp(-(((t - 1.0) / 0.2) ** 2)) + left
    q = jnp.tile(theta * (1 + error)[:, None], (1, 2))
    zero = jnp.zeros_like(t)
    tension = 5.0 + 3.0 * jnp.sin(40.0 * t)
    loop = Loop(t, q, q, q, zero, tension, 0 * t + 1.0, zero, zero, zero, jnp.asarray(True))
    return loop, Asked(jnp.asarray(theta), jnp.asarray(100.0), jnp.asarray(97.0))


@pytest.mark.parametrize("theta", [0.1, -0.1])
def test_measures_are_what_they_say_and_the_smooth_ones_are_close(theta):
    spec, period = Spec((Target(theta, 100.0),)), jnp.asarray(0.005)
    loop, asked = decay(4.0, theta=theta)
    told = plain(loop, asked, spec, 0.005)
    assert told["settling_s"] == pytest.approx(math.log(50) / 4, abs=0.005)
    assert told["overshoot"] == 0.0
    assert told["tension_n"] == pytest.approx(8.0, abs=0.01)
    assert told["effort_n"] == pytest.approx(math.sqrt((25 + 4.5 + 1) / 2), rel=0.02)
    assert told["slew_n_s"] == pytest.approx(120 / math.sqrt(2) / math.sqrt(2), rel=0.02)
    assert told["stiffness_error"] == pytest.approx(0.03)
    near = dict(zip(MEASURES, np.asarray(smooth(loop, asked, spec, period)), strict=True))
    assert near["settling_s"] == pytest.approx(told["settling_s"], rel=0.02)
    for name in ("tension_n", "effort_n", "slew_n_s", "stiffness_error"):
        assert near[name] == pytest.approx(told[name], rel=0.02), name

    loop, asked = decay(4.0, beyond=0.1, left=0.05, theta=theta)
    told = plain(loop, asked, spec, 0.005)
    near = dict(zip(MEASURES, np.asarray(smooth(loop, asked, spec, period)), strict=True))
    assert told["settling_s"] == math.inf and near["settling_s"] > 2.5
    assert told["steady_error_rad"] == pytest.approx(0.005, rel=0.01)
    assert near["steady_error_rad"] == pytest.approx(0.005, rel=0.01)
    assert told["overshoot"] == pytest.approx(0.1 + 0.05 - math.exp(-4), rel=0.1)
    assert near["overshoot"] == pytest.approx(told["overshoot"], rel=0.02)


def test_the_cost_is_the_mean_and_the_worst_robots_and_steeper_beyond_the_limit():
    require = {"settling_s": Requirement(2.0, 3.0)}
    spec = Spec((Target(0.1, 100.0),), require, cvar_share=0.5, cvar_weight=0.5)
    settling = np.array([[0.2, 1.0, 4.0, 0.4]])  # one target, four robots: costs 0.3, 1.5, 3(2 + 4), 0.6
    measures = np.full((1, 4, len(MEASURES)), 1e9)
    measures[..., 0] = settling
    ok = jnp.ones((1, 4), bool)
    costs = [0.3, 1.5, 18.0, 0.6]
    expected = np.mean(costs) + 0.5 * np.mean([18.0, 1.5])
    assert float(cost(jnp.asarray(measures), ok, spec)) == pytest.approx(expected, rel=1e-3)
    assert float(cost(jnp.asarray(measures), ok.at[0, 0].set(False), spec)) > FAILED / 4


# --- loss and box


def test_the_gradient_is_that_of_differences_and_loops_are_counted(problem):
    x = np.asarray(problem.box.gains(jnp.asarray(problem.box.coordinates(problem.start)) * 0.9 + 0.03))
    before = problem.count.values, problem.count.gradients
    value, slope = problem.value_and_gradient(x[None])
    steps = 1e-5 * x
    losses = problem.losses(np.concatenate([x[None], x + np.diag(steps), x - np.diag(steps)]))
    assert (problem.count.values - before[0], problem.count.gradients - before[1]) == (17 * 4, 4)
    assert value[0] == pytest.approx(losses[0], rel=1e-9)
    difference = (losses[1:9] - losses[9:]) / (2 * steps)
    np.testing.assert_allclose(slope[0] * x, difference * x, rtol=1e-3, atol=1e-4 * np.abs(difference * x).max())


def test_every_point_of_the_box_is_a_law(problem, robot):
    rng = np.random.default_rng(0)
    corners = [np.zeros(8), np.ones(8), *rng.integers(0, 2, (6, 8)), *rng.random((8, 8))]
    for u in corners:
        gains = np.asarray(problem.box.gains(jnp.asarray(u, float)))
        assert problem.box.feasible(gains)
        named = dict(zip(problem.names, map(float, gains), strict=True))
        made = design(robot(), "observer", gains=named, hardware=HARDWARE)  # refuses what is not feasible
        assert 2 * made.law.gains.gamma < UNIQUE * min(made.law.tables.alpha2)
        for target in problem.spec.targets:
            law.refuse_beyond(made.law, law.Command(target.theta_rad, target.stiffness_n_m))
        np.testing.assert_allclose(problem.box.coordinates(gains), u, atol=1e-9)
    np.testing.assert_allclose(problem.box.gains(jnp.asarray(problem.box.coordinates(problem.start))), problem.start)


@pytest.mark.parametrize("name,value", [("gamma", 50.0), ("integral", 1e6), ("damping", -1.0), ("filter_s", math.nan)])
def test_the_loss_of_infeasible_gains_is_infinite(problem, name, value):
    gains = problem.start.copy()
    gains[problem.names.index(name)] = value
    before = problem.count.values
    assert problem.loss(gains) == math.inf and problem.count.values == before


# --- tuning


def test_tuning_makes_the_law_better_on_these_robots_and_on_others(tuned):
    assert tuned.after.loss < 0.5 * tuned.before.loss
    assert tuned.after.unseen < 0.6 * tuned.before.unseen
    assert tuned.after.loss == pytest.approx(tuned.history.min(), rel=1e-9)
    assert tuned.history[0, 0] == pytest.approx(tuned.before.loss, rel=1e-9)
    rest = [np.mean([m["steady_error_rad"] for row in x.measures for m in row]) for x in (tuned.before, tuned.after)]
    assert rest[1] < rest[0] / 2


def test_the_law_is_the_one_measured_and_loops_are_counted(tuned, robot):
    assert {name: getattr(tuned.made.law.gains, name) for name in tuned.after.gains} == tuned.after.gains
    default_law = design(robot(), "integral", hardware=HARDWARE).law
    assert (tuned.before.gains["gamma"], tuned.before.gains["integral"]) == (default_law.gains.gamma, 3.0)
    assert (tuned.search.values, tuned.search.gradients) == (0, 8 * 2 * 2 * 2)
    assert (tuned.count.values, tuned.count.gradients) == (2 * 8, 64)
    loop = tuned.after.loops[0]
    assert float(loop.theta[-1]) == pytest.approx(0.12, abs=2 * tuned.after.measures[0][0]["steady_error_rad"] + 1e-4)


def test_only_the_gains_named_move_and_the_start_is_never_lost(designs, robot):
    spec = replace(spec_for(designs["passivity"], 0.4), require={"effort_n": Requirement(20.0)})
    start = {"gamma": 0.7, "damping": 9.0}
    found = tune(
        robot(), "passivity", spec, gains=start, free=["filter_s"], hardware=HARDWARE, iterations=2, restarts=1
    )
    assert list(found.after.gains) == ["filter_s"] and found.after.unseen is None
    assert (found.made.law.gains.gamma, found.made.law.gains.damping) == (0.7, 9.0)
    assert found.after.loss <= found.before.loss


POSITIVE = (
    *("chain.half_length_m", "chain.radius_m", "chain.segment_mass_kg", "elastic.c1", "elastic.c3", "jamming.c4"),
    *("friction.sigma1", "friction.sigma2", "friction.mu_c", "friction.v_s"),
)


def test_robots_are_drawn_as_uncertain_as_stated_and_are_possible(robot):
    drawn = sample(robot(), {**UNSURE, "friction.mu_s": 1e-3}, 400, seed=3, vacuum_max_kpa=40.0)
    c4 = np.array([float(get(x, "jamming.c4")) for x in drawn])
    assert c4[0] == 12.0 and len(set(c4)) == 400
    assert np.mean(c4) == pytest.approx(12.0, abs=0.15) and np.std(c4) == pytest.approx(1.0, rel=0.1)
    assert all(float(get(x, "friction.mu_s")) >= float(get(x, "friction.mu_c")) for x in drawn)
    assert [float(get(x, "jamming.c4")) for x in sample(robot(), UNSURE, 3, seed=3)] == [
        float(get(x, "jamming.c4")) for x in sample(robot(), UNSURE, 3, seed=3)
    ]
    assert sample(robot(), {}, 5) == sample(robot(), {"jamming.c4": 0.0}, 5) and len(sample(robot(), {}, 5)) == 1
    with pytest.raises(InputError, match="none of 200 robots drawn"):
        sample(robot(), dict.fromkeys(POSITIVE, 50.0), 5, vacuum_max_kpa=40.0)


# --- specifications and the command

GOOD = """
schema = "ljjax.spec/1"
[[targets]]
theta_rad = 0.12
stiffness_n_m = 5000.0
[loop]
duration_s = 0.5
noise_rad = 2e-4
[robots]
cvar_weight = 0.25
[require.settling_s]
limit = 0.4
[require.steady_error_rad]
limit = 5e-4
weight = 2.0
"""


def test_a_specification_is_read(tmp_path):
    path = tmp_path / "spec.toml"
    path.write_text(GOOD)
    spec = load(path)
    assert spec.targets == (Target(0.12, 5000.0),)
    assert spec.require == {"settling_s": Requirement(0.4, 1.0), "steady_error_rad": Requirement(5e-4, 2.0)}
    assert (spec.duration_s, spec.noise_rad, spec.cvar_weight, spec.band) == (0.5, 2e-4, 0.25, 0.02)


def test_the_default_specification_is_within_reach(designs):
    for made in designs.values():
        for target in default(made.law).targets:
            law.refuse_beyond(made.law, law.Command(target.theta_rad, target.stiffness_n_m))


BAD = [
    ("ljjax.spec/1", "ljjax.spec/9", 'expected schema = "ljjax.spec/1"'),
    ("theta_rad = 0.12", "theta = 0.12", "unknown key targets[0].theta; expected theta_rad, stiffness_n_m"),
    ("stiffness_n_m = 5000.0", "", "missing key targets[0].stiffness_n_m"),
    ("stiffness_n_m = 5000.0", "stiffness_n_m = 6e9", "targets[0]: stiffness = 6e+09 N/m is out of reach"),
    ("theta_rad = 0.12", "theta_rad = 0.0", "give an angle of at least 0.001 rad"),
    ("theta_rad = 0.12", "theta_rad = 1.12", "targets[0]: theta = 1.12 rad"),
    ("duration_s = 0.5", "duration_s = 0", "loop.duration_s = 0: must be between 0.1 and 600 s"),
    ("duration_s = 0.5", "duration_s = 0.5\nrest_share = 0.01", "loop.rest_share = 0.01 of 0.5 s is less than two"),
    ("noise_rad = 2e-4", 'noise_rad = "low"', "loop.noise_rad is 'low'; expected a finite number"),
    ("cvar_weight = 0.25", "cvar_weight = 2", "robots.cvar_weight = 2: must be between 0 and 1"),
    ("require.settling_s", "require.rise_s", "unknown key require.rise_s; expected settling_s"),
    ("limit = 0.4", "limit = 0.0", "require.settling_s.limit = 0: must be > 0"),
    ("weight = 2.0", "weight = -1", "require.steady_error_rad.weight = -1: must be ≥ 0"),
    ("[[targets]]", "[[targets", "not TOML"),
]


@pytest.fixture
def model_file(robot, tmp_path):
    path = tmp_path / "model.toml"
    path.write_text(modelfile.dumps(modelfile.ModelFile(robot(), uncertainty={"jamming.c4": 0.5})), encoding="utf-8")
    return path


@pytest.mark.parametrize("old,new,said", BAD, ids=[said for _, _, said in BAD])
def test_a_bad_specification_is_refused_in_a_line_and_nothing_written(model_file, tmp_path, capsys, old, new, said):
    path, out = tmp_path / "spec.toml", tmp_path / "out"
    assert old in GOOD
    path.write_text(GOOD.replace(old, new))
    assert main(["tune", str(model_file), "--spec", str(path), "--theta-max-deg", "14", "--out", str(out)]) == 2
    error = capsys.readouterr().err
    assert said in error and "spec.toml" in error and error.count("\n") == 1
    assert not out.exists()


@pytest.mark.parametrize(
    "more,said",
    [
        (["--spec", "nowhere.toml"], "nowhere.toml: no such file"),
        (["--samples", "0"], "--samples 0: expected"),
        (["--free", "integral", "--law", "passivity"], "'integral' is no gain that passivity uses"),
        (["--gain", "gamma=99"], "choose gamma <"),
        (["--vacuum-max-kpa", "90"], "give α₂ = -"),
    ],
)
def test_bad_usage_is_refused_in_a_line(model_file, tmp_path, capsys, more, said):
    assert main(["tune", str(model_file), "--out", str(tmp_path / "out"), *more]) == 2
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_the_command_writes_everything_and_prints_before_and_after(model_file, tmp_path, capsys):
    path, out = tmp_path / "spec.toml", tmp_path / "out"
    path.write_text(GOOD)
    few = ["--samples", "2", "--restarts", "1", "--iterations", "2", "--theta-max-deg", "14"]
    assert main(["tune", str(model_file), "--spec", str(path), "--out", str(out), *few]) == 0
    assert {p.name for p in out.iterdir()} == {"law.json", "tune.json", "report.html"}
    said = json.loads((out / "tune.json").read_text(encoding="utf-8"))
    given = law.load(out / "law.json")
    assert said["after"]["gains"] == {name: getattr(given.gains, name) for name in USED["integral"]}
    assert said["after"]["loss"] <= said["before"]["loss"]
    assert said["spec"]["targets"] == [{"theta_rad": 0.12, "stiffness_n_m": 5000.0}]
    assert said["loops"]["search"] == {"values": 0, "gradients": 4}
    assert len(said["provenance"]["model_sha256"]) == 64 and np.shape(said["history"]) == (2, 1)
    printed = capsys.readouterr()
    assert "settling time" in printed.out and "before, median" in printed.out and printed.err == ""
    page = (out / "report.html").read_text(encoding="utf-8")
    assert page.count("<figure>") == 3 and "http" not in page.replace("http://www.w3.org", "")
