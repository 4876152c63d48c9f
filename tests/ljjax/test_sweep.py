"""Sweeps: the right elements, each as if simulated alone; bad ones named."""

from __future__ import annotations

import os
import subprocess
import sys

import jax.numpy as jnp
import numpy as np
import pytest

import ljjax
from ljjax import sweep_run
from ljjax.dynamics import State
from ljjax.errors import InputError
from ljjax.inputs import Inputs
from ljjax.model import replace
from ljjax.simulation import SENSITIVE_RAD, rest, simulate
from ljjax.sweep import sweep
from ljjax.sweep_plan import parse, plan, read_columns
from ljjax.sweep_report import explained
from ljjax.sweep_result import STATUS
from tests.ljjax.sweeps import C5, MU, STEP, VARY, bend, logged, standing, swept
from tests.ljjax.sweeps import grid as grid
from tests.ljjax.sweeps import model as model

# --- which elements


def test_a_grid_is_every_value_with_every_other():
    sets = plan({"friction.mu_s": [3, 1, 2, 2], "jamming.c5": [5, 4]})
    assert sets.dims == ("friction.mu_s", "jamming.c5") and sets.shape == (3, 2)
    pairs = list(zip(sets.columns["friction.mu_s"], sets.columns["jamming.c5"], strict=True))
    assert pairs == [(1, 4), (1, 5), (2, 4), (2, 5), (3, 4), (3, 5)]


def test_columns_stay_side_by_side():
    sets = plan({"friction.mu_s": [3, 1, 2], "jamming.c5": [5, 4, 4]}, "zip")
    assert sets.shape == (3,) and sets.columns["friction.mu_s"].tolist() == [3, 1, 2]
    assert sets.columns["jamming.c5"].tolist() == [5, 4, 4]


def test_samples_meet_every_slice_of_every_range_once():
    ranges = {"friction.mu_s": (0.003, 0.008), "jamming.c5": (0.01, 100.0, "log")}
    sets = plan(ranges, "samples", 40, seed=3)
    even = (sets.columns["friction.mu_s"] - 0.003) / 0.005, (np.log10(sets.columns["jamming.c5"]) + 2) / 4
    for x in even:
        assert sorted(np.floor(40 * x)) == list(range(40))
    assert abs(np.corrcoef(*even)[0, 1]) < 0.5
    again, other = plan(ranges, "samples", 40, seed=3), plan(ranges, "samples", 40, seed=4)
    np.testing.assert_array_equal(sets.columns["jamming.c5"], again.columns["jamming.c5"])
    assert not np.array_equal(sets.columns["jamming.c5"], other.columns["jamming.c5"])


def test_what_the_command_line_says_is_what_is_meant(tmp_path):
    assert parse("friction.mu_s=0.003:0.008:3", "grid")[0] == "friction.mu_s"
    np.testing.assert_allclose(parse("friction.mu_s=0.003:0.008:3", "grid")[1], [0.003, 0.0055, 0.008])
    np.testing.assert_allclose(parse("jamming.c5=1:100:3:log", "grid")[1], [1, 10, 100])
    assert parse("jamming.c5=3,4,5", "zip") == ("jamming.c5", [3.0, 4.0, 5.0])
    assert parse("jamming.c5=3:5:log", "samples") == ("jamming.c5", (3.0, 5.0, "log"))
    (tmp_path / "sets.csv").write_text("friction.mu_s, jamming.c5\n0.03,1\n\n0.04,2\n")
    columns = read_columns(tmp_path / "sets.csv")
    assert {path: x.tolist() for path, x in columns.items()} == {"friction.mu_s": [0.03, 0.04], "jamming.c5": [1, 2]}


# --- what they give


def test_each_element_is_the_simulation_of_its_parameters(model, grid):
    assert grid["theta"].shape == (1, 3, 2, 501) and grid["time"].shape == (501,)
    for i, mu in enumerate(MU):
        for k, c5 in enumerate(C5):
            own = replace(model, {"friction.mu_s": mu, "jamming.c5": c5})
            motion = simulate(own, bend(), at=grid["time"], step_s=STEP)
            theta = np.asarray(motion.theta)
            np.testing.assert_allclose(grid["theta"][0, i, k], theta, atol=1e-9)
            np.testing.assert_allclose(grid["theta_final"][0, i, k], theta[-1], atol=1e-9)
            np.testing.assert_allclose(grid["theta_max"][0, i, k], theta.max(), atol=1e-9)
            np.testing.assert_allclose(grid["theta_min"][0, i, k], theta.min(), atol=1e-9)
    assert len(np.unique(grid["theta_final"])) == 6
    assert grid["theta_max"].min() > 0.05


def test_errors_are_estimated_and_sensitive_elements_flagged(model):
    """The same as `simulate(…, errors=True)` finds; a jump of 30 N in steps of 10 ms is too fast for them."""
    quiet = bend()
    jump = Inputs(quiet.t, 2.5 * quiet.tendons, quiet.pressure_kpa, quiet.torque, hold=True)
    vary = {path: x[:1] for path, x in VARY.items()}
    for inputs, status in ((jump, "sensitive"), (standing(), "ok")):
        found = swept(model, inputs, vary, errors=True)
        own = replace(model, {"friction.mu_s": MU[0], "jamming.c5": C5[0]})
        motion = simulate(own, inputs, at=found["time"], step_s=STEP, errors=True)
        assert motion.error is not None
        np.testing.assert_allclose(found["error_estimate"].item(), motion.error, rtol=1e-3, atol=1e-9)
        np.testing.assert_allclose(found["theta"].ravel(), motion.theta, atol=1e-5)
        assert found.counts[status] == 1 and (motion.error > SENSITIVE_RAD) == (status == "sensitive")
        assert ("halving the step moves an angle by 0.01" in found["reason"].item()) == (status == "sensitive")


def test_the_loop_area_is_that_of_tension_over_angle(grid):
    pull = np.interp(grid["time"], bend().t, bend().tendons[:, 0])
    expected = np.trapezoid(pull, grid["theta"], axis=-1)
    np.testing.assert_allclose(grid["loop_area"], expected, rtol=1e-4)
    assert expected.min() > 0.05


def test_runs_of_different_length_are_compared_with_what_was_measured(model):
    """Runs a tenth apart share one padded shape; RMS goes over all samples, though θ is kept at fewer."""
    runs = [logged(bend(0.6), 0.02, 1201), logged(bend(0.56), 0.03, 31)]
    found = swept(model, runs, {"friction.mu_s": [0.05], "jamming.c5": [0.7]})
    assert list(found["run"]) == ["run-1201", "run-31"]
    own = replace(model, {"friction.mu_s": 0.05})
    for r, run in enumerate(runs):
        motion = simulate(own, run, step_s=STEP)
        theta, measured = np.asarray(motion.theta), run.signals["shape"].value[:, 0]
        error = np.sqrt(np.mean((theta - measured) ** 2))
        np.testing.assert_allclose(found["rms_error"][r].item(), error, rtol=1e-4)
        kept = np.isfinite(found["time"][r])
        assert kept.sum() == (401, 31)[r]
        every = np.searchsorted(run.signals["shape"].t, found["time"][r, kept])
        np.testing.assert_allclose(found["theta"][r, 0, 0, kept], theta[every], atol=1e-5)  # Newton stops there
        assert np.isnan(found["theta"][r, 0, 0, ~kept]).all()
        np.testing.assert_allclose(found["theta_measured"][r, kept], measured[every])


def test_initial_shapes(model, robot):
    vary = {"initial.theta": [0.0, 0.1], **{path: x[:1] for path, x in VARY.items()}}
    found = swept(model, vary=vary)
    own = replace(model, {"friction.mu_s": MU[0], "jamming.c5": C5[0]})
    for i, angle in enumerate(vary["initial.theta"]):
        motion = simulate(own, bend(), at=found["time"], initial=rest(own, bend(), angle), step_s=STEP)
        np.testing.assert_allclose(found["theta"][0, i, 0, 0], motion.theta, atol=1e-9)
        assert found["theta"][0, i, 0, 0, 0] == pytest.approx(angle)
    given = swept(model, vary={path: x[:1] for path, x in VARY.items()}, initial=0.1)
    np.testing.assert_array_equal(given["theta"][0, 0, 0], found["theta"][0, 1, 0, 0])
    columns = {"initial.q2": np.array([0.5]), "initial.theta": np.array([0.1])}
    np.testing.assert_array_equal(sweep_run.shapes(columns, np.zeros(3), 1), [[0.1, 0.5, 0.1]])


# --- bad elements


def test_bad_elements_are_named_and_harm_no_other(model, grid):
    """μ_S < μ_C, a NaN, and a start from which the solver is lost, among good ones."""
    columns = {
        "friction.mu_s": [0.03, 0.01, 0.045, np.nan, 0.06, 0.06],
        "jamming.c5": [0.5, 0.5, 0.9, 0.5, 0.5, 0.5],
        "initial.theta": [0.0, 0.0, 0.0, 0.0, 0.0, 1e308],
    }
    found = swept(model, vary=columns, how="zip")
    assert [STATUS[s] for s in found["status"][0, [1, 3, 5]]] == ["inadmissible", "inadmissible", "failed"]
    assert found["reason"][0, 1] == "friction.mu_s = 0.01: must be ≥ friction.mu_c = 0.025"
    assert found["reason"][0, 3] == "friction.mu_s = nan: must be a finite number"
    assert "not finite from t = " in found["reason"][0, 5]
    assert np.isnan(found["theta_final"][0, [1, 3, 5]]).all() and np.isnan(found["theta"][0, 1]).all()
    for element, place in ((0, (0, 0)), (2, (1, 1)), (4, (2, 0))):
        np.testing.assert_array_equal(found["theta"][0, element], grid["theta"][0, *place])
    assert "2 inadmissible, 1 failed" in str(found)


def test_elements_impossible_in_the_runs_own_pressures(model):
    columns = {"elastic.c2": np.array([0.04, -0.09]), "initial.q1": np.array([0.0, np.nan])}
    assert sweep_run.inadmissible(model, {"elastic.c2": columns["elastic.c2"]}, 2, (0.0, 1.0)) == ["", ""]
    good, soft = sweep_run.inadmissible(model, {"elastic.c2": columns["elastic.c2"]}, 2, (5.0, 20.0))
    assert good == "" and "α₂ = " in soft and "at 20 kPa" in soft
    assert sweep_run.inadmissible(model, columns, 2, (0.0, 1.0))[1] == "initial.q1 = nan: must be a finite number"


def test_where_all_are_bad_nothing_is_done(model, tmp_path):
    with pytest.raises(InputError, match="no element is admissible; the first: friction.mu_s = 0.01: must be ≥"):
        swept(model, vary={"friction.mu_s": [0.01]}, out=tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_progress_counts_the_elements(model):
    seen = []
    swept(model, progress=lambda done, total: seen.append((done, total)))
    assert seen == [(4, 6), (6, 6)]


def test_a_batch_fits_the_memory(model, monkeypatch):
    case = sweep_run.case(bend(), "inputs", 6, "commands", None, 1e-4)
    for free, most in ((2.0**40, 1024), (1e9, 40), (1.0, 1)):
        monkeypatch.setattr(sweep_run, "free_bytes", lambda free=free: free)
        size = sweep_run.batch_size(5000, [case], 6, True)
        assert 1 <= size <= most
        monkeypatch.undo()
    monkeypatch.setattr(sweep_run, "free_bytes", lambda: 2.0**40)
    assert sweep_run.batch_size(1100, [case], 6, True) == 550  # two equal batches, not 1024 and a rest


# --- refused in one line

REFUSED = {
    "no such parameter": ({"vary": {"friction.mu": [1]}}, "no parameter 'friction.mu'; expected initial.theta"),
    "columns of two lengths": ({"how": "zip"}, "friction.mu_s: 3, jamming.c5: 2"),
    "no range": ({"how": "samples", "samples": 4}, "friction.mu_s is .*expected a range"),
    "no count": ({"how": "samples"}, "samples is None; expected how many"),
    "text": ({"vary": {"jamming.c5": "many"}}, "jamming.c5 is 'many'; expected numbers"),
    "no values": ({"vary": {"jamming.c5": []}}, "jamming.c5 has shape"),
    "a joint too far": ({"vary": {"initial.q2": [0.1]}}, "no joint 'initial.q2'; the model has 1 segments"),
    "no run": ({"runs": []}, "no run given"),
    "no step": ({"step_s": 0.0}, "step_s is 0"),
    "stamps back": ({"at": [0.2, 0.1]}, "expected a row of stamps"),
    "too many": ({"vary": {path: np.arange(4000.0) for path in VARY}}, "16,000,000 parameter sets"),
    "too large a file": ({"vary": {"jamming.c5": np.arange(1e6)}}, "4.0 GB.*trajectories=False"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_no_use(model, case):
    change, said = REFUSED[case]
    with pytest.raises(InputError, match=said):
        swept(**{"model": model, **change})


def test_a_state_and_a_shape_at_once_are_refused(model):
    with pytest.raises(InputError, match="initial is a State and initial.theta is varied"):
        swept(model, vary={"initial.theta": [0.1]}, initial=State(*(jnp.zeros(1),) * 3))


# --- pictures


def test_influence_is_the_share_of_variance_that_one_parameter_explains():
    rng = np.random.default_rng(0)
    a, b, noise = rng.random((3, 4000))
    y = 3 * a + b
    assert explained(a, y) == pytest.approx(0.9, abs=0.03)
    assert explained(b, y) == pytest.approx(0.1, abs=0.03)
    assert explained(noise, y) < 0.01
    assert explained(np.sign(a - 0.5), np.where(a > 0.5, 1.0, 0.0)) == pytest.approx(1.0)
    assert explained(a, np.full(4000, np.nan)) == 0.0


@pytest.mark.parametrize(("how", "count"), [("grid", 1), ("samples", 2), ("grid", 3)])
def test_reports_of_any_number_of_parameters(model, how, count, monkeypatch):
    """Drawn from made-up outputs: every parameter is named, nothing warns."""
    paths = ("friction.mu_s", "jamming.c5", "elastic.c3")[:count]
    ranges = {"friction.mu_s": (0.02, 0.06), "jamming.c5": (0.1, 10.0), "elastic.c3": (0.5, 1.0)}
    vary = {path: ranges[path] if how == "samples" else np.linspace(*ranges[path], 4) for path in paths}

    def made_up(model, case, columns, shape, *rest):
        y = sum(columns.values())
        names = ("theta_final", "theta_max", "theta_min", "loop_area", "error_estimate")
        own = {name: y * 1e-3 for name in names} | {"rms_error": y * np.nan, "lost_at": y * np.nan}
        return {"theta": np.outer(y, np.linspace(0, 1, len(case.keep))), **own}

    monkeypatch.setattr(sweep_run, "simulate_batch", made_up)
    found = swept(model, vary=vary, how=how, samples=30 if how == "samples" else None)
    assert found.counts["inadmissible"] > 0
    page = found.report()
    assert all(f"<code>{path}</code>" in page for path in paths)
    assert page.count("<img") == {1: 5, 2: 5, 3: 9}[count] + 2


def test_it_is_found_without_being_loaded():
    code = "import sys, ljjax, ljjax.cli; print('jax' in sys.modules); print(ljjax.sweep.sweep.__name__)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=dict(os.environ))
    assert done.stdout.split() == ["False", "sweep"], done.stderr
    assert ljjax.sweep.sweep is sweep
