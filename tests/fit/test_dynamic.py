"""Identification from moving logs: on runs simulated by the package, small so that they compile and run quickly."""

from __future__ import annotations

import csv
import dataclasses
import hashlib
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from ljjax.cli import main
from ljjax.errors import InputError
from ljjax.fit import fit, fit_many
from ljjax.fit.dynamic import Search
from ljjax.fit.folds import conditions, left_out
from ljjax.fit.moving import DynamicResult, profile_interval
from ljjax.fit.pooling import pool
from ljjax.fit.problem import ROUNDS
from ljjax.fit.run import prepared
from ljjax.fit.shooting import together
from ljjax.inputs import Inputs
from ljjax.logs import Run, Signal, Writer
from ljjax.model import Chain, Elastic, Friction, Gravity, Jamming, Model, get, replace
from ljjax.modelfile import ModelFile, dumps
from ljjax.simulation import rest, simulate
from ljjax.stiffness import probe_stiffness

P_ATM = 101_325.0
NOISE = np.radians(0.02)
KNOWN = ("chain.segment_mass_kg", "friction.sigma1", "friction.sigma3", "friction.v_s", "friction.mu_s")
"""What three short runs cannot show well; held, so that the tests stay small."""


def robot(n: int = 2) -> Model:
    """A robot whose every identified parameter matters in a few seconds."""
    x = jnp_
    return Model(
        Chain(x(0.021), x(0.025), x(0.02), x(0.05), segments=n),
        Gravity(x(0.4)),
        Elastic(x(-6e-4), x(0.05), x(1.5)),
        Jamming(x(8.0), x(3.8)),
        Friction(x(0.004), x(0.0125), x(1.6), x(0.0032), x(0.0036), x(0.045)),
    )


def logged(model: Model, seed: int, seconds: float = 3.0, robot_id: str = "r1", theta: bool = False) -> Run:
    """A run of `robot`: a multisine of net tension on steps of the vacuum, from rest, with white noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds / 0.01) + 1) * 0.01
    level = 10.0 * rng.permutation(4)[np.minimum((4 * t / seconds).astype(int), 3)]
    hz = np.array([0.4, 0.9, 2.1, 4.0])
    wave = np.sum(np.sin(2 * np.pi * (hz * t[:, None] + rng.uniform(size=4))) / np.sqrt(hz), axis=1)
    net = 9.0 * wave * np.clip((t - 0.1) / 0.3, 0, 1)
    u = np.stack([np.maximum(net, 0), np.maximum(-net, 0)], axis=1)
    out = simulate(model, Inputs(jnp_(t), jnp_(u), jnp_(level)), at=t, step_s=0.00125)
    y = np.asarray(out.state.q) + NOISE * rng.normal(size=(len(t), model.n))
    if theta:
        y = y.mean(axis=1, keepdims=True)
    names = ("theta",) if theta else tuple(f"q{i + 1}" for i in range(model.n))
    tendons = ("tendon_left", "tendon_right")
    signals = {
        "cmd_tendons": Signal(t, u, tendons, "N", "/real/cmd/tendons"),
        "cmd_pressure": Signal(t, P_ATM - 1e3 * level[:, None], ("pressure",), "Pa", "/real/cmd/pressure"),
        "shape": Signal(t, y, names, "rad", "/real/shape"),
    }
    name = f"{robot_id}-{seed}"
    metadata = {"run_id": name, "robot_id": robot_id, "experiment": "multisine", "p_atm_pa": str(P_ATM)}
    return Run(f"{name}.mcap", hashlib.sha256(name.encode()).hexdigest(), 0, signals, metadata)


def jnp_(x) -> jnp.ndarray:
    return jnp.asarray(x, float)


def guess(model: Model) -> ModelFile:
    """The robot, a quarter off in all that is fitted."""
    off = {p: float(get(model, p)) * f for p, f in zip(MOVED, (1.25, 0.8, 1.3, 0.75, 1.25, 0.8, 0.8, 1.1), strict=True)}
    return ModelFile(replace(model, off), frozen=KNOWN)


MOVED = (
    *("gravity.alpha1", "elastic.c1", "elastic.c2", "elastic.c3", "jamming.c4", "jamming.c5"),
    *("friction.sigma2", "friction.mu_c"),
)


@pytest.fixture(scope="module")
def found() -> DynamicResult:
    """Three runs fitted, a fourth held out, though it is among those given to fit."""
    model = robot()
    runs = [logged(model, s) for s in (0, 1, 2, 7)]
    result = fit(guess(model), runs, held_out=runs[3:], profile=["jamming.c4"])
    assert isinstance(result, DynamicResult)
    return result


def test_the_truth_is_found_within_the_stated_deviations(found):
    z = [(p.value - float(get(robot(), p.name))) / (p.sd or 0.0) for p in found.fitted]
    assert tuple(p.name for p in found.fitted) == MOVED
    assert np.sum(np.square(z)) < stats.chi2.ppf(0.999, len(z))
    assert np.sum(np.square(z)) > stats.chi2.ppf(0.001, len(z))  # the deviations are not padded either
    assert all(p.verdict == "identifiable" for p in found.fitted)


def test_what_is_left_over_is_the_noise(found):
    np.testing.assert_allclose(found.estimate.sigma, NOISE, rtol=0.1)
    assert not found.warnings
    assert 0.8 < found.colour < 1.3
    roles = [e.role for e in found.run_errors]
    assert roles == ["train"] * 3 + ["held_out"]
    for e in found.run_errors:
        assert e.rms == pytest.approx(NOISE / np.sqrt(2), rel=0.15)
        assert not e.sensitive
    assert all(e.left_out and e.left_out >= e.rms for e in found.run_errors[:3])


def test_predictions_are_the_free_runs_of_the_simulator(found):
    """Windows that meet are one run: what `simulate` gives from the fitted start."""
    e = found.estimate
    m = e.problem.motions[1]
    inputs = Inputs(jnp_(m.input_t), jnp_(m.tendons), jnp_(m.vacuum))
    start = rest(e.model, inputs, jnp_(m.q0 + e.offset[1]))
    alone = simulate(e.model, inputs, at=m.t, initial=start, step_s=e.windows.h)
    np.testing.assert_allclose(e.predicted[e.windows.sample_run == 1], alone.state.q, atol=2e-6)


def test_sensitivities_are_those_of_the_simulator(found):
    """Against central differences of whole free runs."""
    e = found.estimate
    m, c = e.problem.motions[0], e.problem.coordinates
    inputs = Inputs(jnp_(m.input_t), jnp_(m.tendons), jnp_(m.vacuum))

    def path(x):
        model = c.model(x)
        out = simulate(model, inputs, at=m.t, initial=rest(model, inputs, jnp_(m.q0 + e.offset[0])), step_s=e.windows.h)
        return np.asarray(out.state.q)

    search = Search(e.problem, e.windows, ROUNDS[-1])
    search.start_offset = e.offset
    together([search.look(e.x)])
    assert search.point is not None
    raw = search.point.answer.jacobian[e.windows.sample_run == 0]
    for i in (0, 3, 4, 7):
        d = np.zeros(len(c))
        d[i] = 1e-5
        central = (path(e.x + d) - path(e.x - d)) / 2e-5
        assert np.linalg.norm(raw[..., i] - central) < 0.01 * np.linalg.norm(central), c.names[i]


def test_leaving_a_run_out_to_first_order_is_a_fit_without_it(found):
    model, e = robot(), found.estimate
    without = fit(guess(model), [logged(model, s) for s in (0, 1)], held_out=[logged(model, 2)])
    assert isinstance(without, DynamicResult) and without.held_out is not None
    late = np.flatnonzero(e.windows.sample_run == 2)[
        150:
    ]  # where the start, which a held-out run takes as it is, fades
    foretold, refitted, whole = left_out(e, np.arange(3))[late], without.held_out.error[150:], e.error[late]
    assert np.std(foretold - refitted) < 0.3 * np.std(whole - refitted)


def line(short: float, low: float) -> tuple[np.ndarray, Any]:
    """Two runs that pull the slope of a line to −0.1 and 0.1, not less than `low`: where a search ended at 0, or so far
    `short` of it."""
    x = np.linspace(-1.0, 1.0, 50)
    error, slope = np.concatenate([(short - 0.1) * x, (short + 0.1) * x])[:, None], np.tile(x, 2)
    e: Any = SimpleNamespace(
        problem=SimpleNamespace(
            coordinates=SimpleNamespace(spread=np.ones(1)), limits=lambda _: [(np.ones(1), low + short, 1.0 + short)]
        ),
        windows=SimpleNamespace(sample_run=np.repeat([0, 1], 50)),
        x=np.full(1, -short), sigma=np.full(1, 1e-3), weight=np.ones_like(error), jacobian=slope[:, None, None],
        error=error, white=np.array([[1e-6 / np.sum(slope**2)]]), pull=1e6 * slope @ error,
    )  # fmt: skip
    return x, e


@pytest.mark.parametrize(("low", "follows"), [(-1.0, 1.0), (-0.03, 0.3), (0.0, 0.0)])
def test_a_parameter_on_its_bound_stays_there_where_a_run_is_left_out(low, follows):
    """Without the second it would fall to −0.1, if it may, and what rests on its bound does not leave it."""
    x, e = line(0.0, low)
    first, second = np.split(left_out(e, np.arange(2))[:, 0], 2)
    np.testing.assert_allclose(first, -(0.1 + 0.1 * (low < 0)) * x, atol=1e-3)
    np.testing.assert_allclose(second, (0.1 + 0.1 * follows) * x, atol=1e-3)


def test_what_is_held_stays_where_a_run_is_left_out():
    _, e = line(0.0, -1.0)
    np.testing.assert_allclose(left_out(e, np.arange(2), [0]), e.error, atol=1e-5)


def test_what_is_left_of_a_left_out_run_does_not_hang_on_where_the_search_stopped():
    ended, short = (left_out(line(by, -1.0)[1], np.arange(2)) for by in (0.0, 0.07))
    np.testing.assert_allclose(short, ended, atol=1e-3)


def test_conditions_are_pressures_where_runs_keep_to_one():
    def at(*kpa: float) -> Any:
        return SimpleNamespace(vacuum=np.array(kpa))

    by, fold = conditions([at(20, 20.5), at(0, 0), at(40, 41), at(0.5, 0)])
    assert by == "pressure" and fold.tolist() == [1, 0, 2, 0]
    for runs in ([at(0, 0), at(20, 20)], [at(0, 10), at(20, 20), at(40, 40)]):
        by, fold = conditions(runs)
        assert by == "run" and fold.tolist() == list(range(len(runs)))


def test_a_profile_agrees_with_the_deviation(found):
    values, chi2 = found.profiles["jamming.c4"]
    p = found.parameters["jamming.c4"]
    low, high = profile_interval(values, chi2)
    assert low is not None and high is not None and p.sd is not None and low < p.value < high
    assert (high - low) / (2 * 1.96 * p.sd) == pytest.approx(1.0, abs=0.2)


def test_robots_are_fitted_side_by_side_and_a_bad_one_loses_no_other(found):
    other = replace(robot(), {"elastic.c3": 1.9, "friction.mu_c": 0.003})
    still = logged(robot(), 5)
    calm = dict(still.signals) | {"shape": dataclasses.replace(still.signals["shape"], value=np.zeros((301, 2)))}
    quiet = dataclasses.replace(still, signals={**calm, "cmd_tendons": _zero(still.signals["cmd_tendons"])})
    robots = {
        "one": [logged(robot(), s) for s in range(3)],
        "two": [logged(other, s, robot_id="two") for s in range(3)],
        "still": [quiet],
    }
    both = fit_many(guess(robot()), robots)
    assert isinstance(both["still"], InputError) and "no excitation" in str(both["still"])
    one, two = both["one"], both["two"]
    assert isinstance(one, DynamicResult) and isinstance(two, DynamicResult)
    for p in MOVED:
        assert one.parameters[p].value == pytest.approx(found.parameters[p].value, rel=1e-3)
    for p in ("elastic.c3", "friction.mu_c"):
        mine = two.parameters[p]
        assert mine.sd is not None and abs(mine.value - float(get(other, p))) < 4 * mine.sd


def _zero(s: Signal) -> Signal:
    return dataclasses.replace(s, value=np.zeros_like(s.value))


def test_a_folder_of_three_logs_delivers_and_says_what_was_left_out(found):
    """One cut short, one without excitation, one good."""
    cut_short = dataclasses.replace(
        (whole := logged(robot(), 1)),
        signals={k: _first(s, 180) for k, s in whole.signals.items()},
    )
    still = logged(robot(), 2)
    still = dataclasses.replace(
        still,
        signals={
            **still.signals,
            "cmd_tendons": _zero(still.signals["cmd_tendons"]),
            "shape": dataclasses.replace(
                still.signals["shape"], value=NOISE * np.random.default_rng(0).normal(size=(301, 2))
            ),
        },
    )
    result = fit(guess(robot()), [cut_short, still, logged(robot(), 0)])
    assert isinstance(result, DynamicResult)
    assert [r.run_id for r in result.run_errors] == ["r1-0", "r1-1"]  # by their start
    assert any("r1-2.mcap: no excitation" in w for w in result.warnings)
    assert result.parameters["elastic.c3"].value == pytest.approx(1.5, rel=0.02)


def _first(s: Signal, count: int) -> Signal:
    return dataclasses.replace(s, t=s.t[:count], value=s.value[:count])


def test_priors_and_bounds_of_the_file_hold():
    model = robot()
    runs = [logged(model, s) for s in range(3)]
    start = guess(model)
    sure = fit(dataclasses.replace(start, priors={"gravity.alpha1": (0.6, 1e-4)}), runs)
    assert sure.parameters["gravity.alpha1"].value == pytest.approx(0.6, abs=5e-4)
    bounded = fit(dataclasses.replace(start, bounds={"elastic.c3": (0.5, 1.3)}), runs)
    assert bounded.parameters["elastic.c3"].verdict == "at bound"
    assert bounded.parameters["elastic.c3"].value == pytest.approx(1.3)
    assert any("elastic.c3 is at its bound" in w for w in bounded.warnings)
    again = float(get(bounded.model, "elastic.c3"))  # as a file holds it, from which one may go on
    assert 0.5 <= again <= 1.3 + 1e-8
    reached = dataclasses.replace(start, model=bounded.model, bounds={"elastic.c3": (0.5, 1.3)})
    assert prepared(reached, "again", runs, (), start.frozen, "commands")
    with pytest.raises(InputError, match=r"fit.bounds.elastic.c3 = \[2, 3\] does not hold the starting value"):
        fit(dataclasses.replace(start, bounds={"elastic.c3": (2.0, 3.0)}), runs)


@pytest.mark.parametrize("bound, reached", [(-0.1, -0.1), (-2.0, -0.25), (0.0, 0.0)])
def test_a_step_goes_no_further_than_its_bound_or_its_reach(bound, reached):
    stands: Any = SimpleNamespace(problem=SimpleNamespace(coordinates=SimpleNamespace(spread=np.ones(2))))
    a, g = np.array([[1.1, 0.1], [0.1, 1.1]]), np.array([0.05, -5.0])
    step = Search._step(stands, a, g, 0.0, [(np.array([0.0, 1.0]), bound, np.inf)])
    assert step[1] == pytest.approx(reached)
    assert step[0] == pytest.approx((g[0] - a[0, 1] * reached) / a[0, 0])  # the other makes the best of it


def test_pooling_draws_what_a_robot_hardly_shows_to_the_others(found):
    """Four robots alike in all; one of them knows c4 badly."""
    results = {}
    rng = np.random.default_rng(0)
    for i in range(6):
        e = found.estimate
        covariance = e.covariance.copy()
        if i == 0:
            k = e.problem.coordinates.names.index("jamming.c4")
            covariance[k, k] += 0.3**2
        x = e.x + rng.multivariate_normal(np.zeros(len(e.x)), covariance)
        results[f"r{i}"] = dataclasses.replace(
            found, estimate=dataclasses.replace(e, x=x, covariance=covariance, model=e.problem.coordinates.model(x))
        )
    pooled = pool(results)
    assert pooled is not None
    k = pooled.names.index("jamming.c4")
    alone = results["r0"].parameters["jamming.c4"]
    assert abs(pooled.value["r0"][k] - 8.0) < 0.3 * abs(alone.value - 8.0)
    assert pooled.sd["r0"][k] < 0.3 * (alone.sd or 0.0)
    well = results["r1"].parameters["jamming.c4"]
    assert abs(pooled.value["r1"][k] - well.value) < 2 * (well.sd or 0.0)


def test_statics_join_the_motion(tmp_path: Path):
    """A probe tells the scale of torques, so that the lever arm is found; without it, it stays."""
    model = robot()
    pressures = np.array([0.0, 10.0, 20.0, 30.0])
    force = np.array([float(probe_stiffness(model, jnp_(p))) for p in pressures]) * 1e-3
    t = np.arange(4.0)
    probe = Run(
        "probe.mcap",
        "p",
        0,
        {
            "probe": Signal(t, np.stack([np.full(4, 1e-3), force], 1), ("position", "force"), "m,N", "/real/probe"),
            "pressure": Signal(t, P_ATM - 1e3 * pressures[:, None], ("pressure",), "Pa", "/real/pressure"),
        },
        {"run_id": "probe", "robot_id": "r1", "experiment": "probe stiffness", "p_atm_pa": str(P_ATM)},
    )
    wrong = replace(model, {"chain.lever_arm_m": 0.024})
    runs = [logged(model, s) for s in range(3)]
    result = fit(ModelFile(wrong, frozen=KNOWN), [*runs, probe])
    assert result.parameters["chain.lever_arm_m"].value == pytest.approx(0.02, rel=0.01)
    assert result.parameters["elastic.c3"].value == pytest.approx(1.5, rel=0.02)


@pytest.mark.parametrize("options", [{"method": "adam"}, {"restarts": 3}], ids=["adam", "restarts"])
def test_other_ways_lead_to_the_same_robot(found, options):
    result = fit(guess(robot()), [logged(robot(), s) for s in range(3)], seed=1, **options)
    assert isinstance(result, DynamicResult)
    for p in found.fitted:
        assert p.sd is not None
        assert abs(result.parameters[p.name].value - p.value) < 0.3 * p.sd
    if "restarts" in options:
        assert len(result.restarts) == 3


def write(run: Run, path: Path) -> None:
    """The run as an MCAP log of the contract."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with Writer(path, {**run.metadata, "start_utc": "2026-01-01T00:00:00Z"}) as log:
        for name in ("cmd_tendons", "cmd_pressure", "shape"):
            s = run.signals[name]
            for t, value in zip(s.t, s.value, strict=True):
                log.write(name, 1_767_225_600 * 10**9 + round(t * 1e9), value)


def test_the_command_fits_robots_in_folders_and_leaves_out_what_is_broken(found, tmp_path, monkeypatch, capsys):
    """Two robots; one log of the first is cut off in the middle, another holds nothing; a third robot has only that."""
    monkeypatch.setenv("LJJAX_CACHE", "")
    other = replace(robot(), {"elastic.c3": 1.9})
    for s in range(3):
        write(logged(robot(), s), tmp_path / "logs" / "one" / f"{s}.mcap")
        write(logged(other, s, robot_id="r2"), tmp_path / "logs" / "two" / f"{s}.mcap")
    whole = (tmp_path / "logs" / "one" / "2.mcap").read_bytes()
    (tmp_path / "logs" / "one" / "2.mcap").write_bytes(whole[: int(0.7 * len(whole))])
    still = logged(robot(), 4, robot_id="r3")
    calm = {k: _zero(s) if k != "cmd_pressure" else s for k, s in still.signals.items()}
    write(dataclasses.replace(still, signals=calm), tmp_path / "logs" / "three" / "0.mcap")
    (tmp_path / "model.toml").write_text(dumps(guess(robot())))
    out = tmp_path / "out"
    assert main(["fit", str(tmp_path / "logs"), "--model", str(tmp_path / "model.toml"), "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "no excitation" in said
    one, two = (json.loads((out / r / "fit.json").read_text()) for r in ("r1", "r2"))
    assert one["parameters"]["elastic.c3"]["value"] == pytest.approx(1.5, rel=0.02)
    assert two["parameters"]["elastic.c3"]["value"] == pytest.approx(1.9, rel=0.02)
    assert [bool(i["partial"]) for i in one["inputs"]] == [False, False, True]
    rows = list(csv.DictReader((out / "robots.csv").read_text(encoding="utf-8").splitlines()))
    assert {r["robot"] for r in rows} == {"r1", "r2", "r3"}
    assert len([r for r in rows if r["robot"] == "r2"]) == len(MOVED)
    assert ["no excitation" in r["problem"] for r in rows if r["robot"] == "r3"] == [True]
    assert not (out / "r3").exists()
    for name in ("model.toml", "report.html", "result.mcap"):
        assert (out / "r1" / name).stat().st_size > 0


def test_what_runs_inherit_from_those_before_them_is_theirs_in_a_fit_too():
    """Of logs in any order: the later run is worn and warm already; its number is that of the log given."""
    runs = [dataclasses.replace(logged(robot(), s), t0_ns=(10 - s) * 10**11) for s in range(2)]
    case: Any = prepared(guess(robot()), "m", runs, (), (), "commands")
    first, second = case.problem.motions
    assert [m.run for m in (first, second)] == [runs[1], runs[0]] and case.moving == [1, 0]
    assert first.worn[0] == 0.0 and second.worn[0] == first.worn[-1] > 0.1
    assert second.warm[0] > 0 and first.warm[0] == 0.0
