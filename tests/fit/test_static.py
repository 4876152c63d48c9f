"""Parameters from synthetic statics, made by formulas of their own: values, errors, constraints, refusals."""

from __future__ import annotations

import numpy as np
import pytest

from ljjax.errors import InputError
from ljjax.fit.static import PARAMETERS, fit_static, predict, prediction_sd
from ljjax.model import get, replace

NAMES = (*PARAMETERS["steady"], *PARAMETERS["probe"])
LEVER_M = 0.02


def estimates(fit) -> np.ndarray:
    return np.array([float(get(fit.model, name)) for name in NAMES])


def columns(points, n: int) -> np.ndarray:
    """u = X [α₁, c₁, c₂, c₃]."""
    p, th = points.pressure_kpa, points.theta
    return np.stack([np.sin(n * th), p**2 * th, p * th, th], axis=1) / LEVER_M


def regression(x: np.ndarray, y: np.ndarray, w: np.ndarray | float = 1.0):
    """Weighted linear regression: estimates and their covariance."""
    w = np.broadcast_to(w, y.shape)
    a, b = x * w[:, None], y * w
    found = np.linalg.lstsq(a, b, rcond=None)[0]
    error = b - a @ found
    return found, error @ error / (len(y) - x.shape[1]) * np.linalg.inv(a.T @ a)


CASES = {
    "six segments": {"n": 6},
    "one segment": {"n": 1},
    "three segments": {"n": 3},
    "no gravity": {"alpha1": 0.0},
    "pulled up by gravity": {"alpha1": -0.3},
    "no quadratic": {"c1": 0.0},
    "friction that ignores pressure": {"c5": 0.0},
}
ROOT = 2e-5
"""The model rounds √u_P off below 1 Pa or so, so that its slope stays finite: relative to K_T at 5 kPa."""


@pytest.mark.parametrize("case", CASES)
def test_noise_free_points_give_the_parameters(truth, measured, case):
    robot = truth(seed=len(case), **CASES[case])
    steady, probe = measured(robot, seed=None)
    known = robot.model(**robot_values(robot))
    np.testing.assert_allclose(predict(known, steady), steady.value, rtol=1e-12)
    np.testing.assert_allclose(predict(known, probe), probe.value, rtol=ROOT)
    fit = fit_static(robot.model(), steady, probe)
    np.testing.assert_allclose(estimates(fit)[:4], robot.values[:4], rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(estimates(fit)[4:], robot.values[4:], rtol=1e-4, atol=1e-4)
    assert fit.names == NAMES and not fit.warnings


def robot_values(robot) -> dict[str, float]:
    return dict(zip(("alpha1", "c1", "c2", "c3", "c4", "c5"), robot.values, strict=True))


def test_estimates_lie_within_their_stated_errors(truth, measured):
    """60 repetitions with steady points so noisy that their error dominates c₄'s and c₅'s: z-scores are standard, and
    the second stage's errors, and their correlation with the first's, are those that carry the first stage's."""
    robot = truth(seed=1)
    fits = [fit_static(robot.model(), *measured(robot, seed, 3.0, 0.2)) for seed in range(100, 160)]
    found = np.array([estimates(fit) for fit in fits])
    sd = np.array([[fit.sd(name) for name in NAMES] for fit in fits])
    z = (found - robot.values) / sd
    assert np.all((np.mean(z**2, axis=0) > 0.55) & (np.mean(z**2, axis=0) < 1.6)), np.mean(z**2, axis=0)
    assert np.all(np.abs(z.mean(axis=0)) < 0.5)
    np.testing.assert_allclose(np.std(found, axis=0, ddof=1), sd.mean(axis=0), rtol=0.3)

    probes = [fit.stages["probe"].solution for fit in fits]
    own = np.array([np.sqrt(s.variance * np.diag(s.unit_covariance())) for s in probes]).mean(axis=0)
    assert np.all(own < 0.5 * sd[:, 4:].mean(axis=0)), "the first stage's error must matter for this test"
    stated = np.mean([fit.covariance / np.outer(s, s) for fit, s in zip(fits, sd, strict=True)], axis=0)
    np.testing.assert_allclose(stated, np.corrcoef(found.T), atol=0.3)
    np.testing.assert_allclose(fits[0].covariance, fits[0].covariance.T, rtol=1e-9, atol=1e-16)


@pytest.mark.parametrize("weights", ["equal", "published"])
def test_the_first_stages_error_moves_the_second_as_a_refit_does(truth, measured, points, weights):
    """C₂₁ = D C₁₁ with D = ∂(c₄, c₅)/∂(α₁, c₁, c₂, c₃), found by refitting the probe points to a model moved a little
    (to 1 %: the covariance leaves the curvature out)."""
    robot = truth(seed=9)
    steady, probe = measured(robot)
    probe = points("probe", probe.value, probe.pressure_kpa, 0.0, np.linspace(0.5, 4, len(probe)))
    fit, none = fit_static(robot.model(), steady, probe, weights=weights), steady.take(np.empty(0, int))

    def refit(first: np.ndarray) -> np.ndarray:
        moved = replace(fit.model, dict(zip(NAMES[:4], first, strict=True)))
        return estimates(fit_static(moved, none, probe, weights=weights))[4:]

    at = estimates(fit)[:4]
    steps = np.diag(1e-2 * np.sqrt(np.diag(fit.covariance)[:4]))
    d = np.stack([(refit(at + h) - refit(at - h)) / (2 * h.sum()) for h in steps], axis=1)
    first = fit.covariance[:4, :4]
    np.testing.assert_allclose(fit.covariance[4:, :4], d @ first, rtol=1e-2, atol=1e-9)
    own = fit.stages["probe"].solution
    total = own.variance * own.unit_covariance() + d @ first @ d.T
    np.testing.assert_allclose(fit.covariance[4:, 4:], total, rtol=1e-2)


@pytest.mark.parametrize("weights", ["equal", "published"])
def test_steady_points_are_linear_regression(truth, measured, points, weights):
    robot = truth(seed=2)
    clean, _ = measured(robot, seed=None)
    rng = np.random.default_rng(5)
    sd = rng.uniform(0.1, 2.0, len(clean))
    steady = points("steady", clean.value + sd * rng.normal(size=len(sd)), clean.pressure_kpa, clean.theta, sd)
    fit = fit_static(robot.model(), steady, steady.take(np.empty(0, int)), weights=weights)
    x, covariance = regression(columns(steady, 6), steady.value, 1.0 if weights == "equal" else 1 / sd)
    np.testing.assert_allclose(estimates(fit)[:4], x, rtol=1e-8)
    np.testing.assert_allclose(fit.covariance, covariance, rtol=1e-7, atol=1e-18)
    row = columns(steady, 6)
    np.testing.assert_allclose(prediction_sd(fit, steady), np.sqrt(np.sum(row @ covariance * row, axis=1)), rtol=1e-7)
    assert estimates(fit)[4:].tolist() == [10.0, 1.0]  # without a probe, the model's own


def test_held_out_errors_are_those_of_a_refit(truth, measured):
    robot = truth(seed=3)
    steady, probe = measured(robot, seed=4)
    fit = fit_static(robot.model(), steady, probe)
    x, found, expected = columns(steady, 6), [], np.empty(len(steady))
    for pressure in np.unique(steady.pressure_kpa):
        out = steady.pressure_kpa == pressure
        found.append(regression(x[~out], steady.value[~out])[0])
        expected[out] = steady.value[out] - x[out] @ found[-1]
    stage = fit.stages["steady"]
    np.testing.assert_allclose(stage.held_out, expected, rtol=1e-6, atol=1e-8)
    jackknife = np.sqrt(4 / 5 * np.sum((np.array(found) - np.mean(found, axis=0)) ** 2, axis=0))
    np.testing.assert_allclose(stage.jackknife_sd, jackknife, rtol=1e-6)
    probe_out = fit.stages["probe"].held_out
    refit = fit_static(robot.model(), steady, probe.take(probe.pressure_kpa != 20.0))
    left = probe.take(probe.pressure_kpa == 20.0)
    np.testing.assert_allclose(probe_out[4], (left.value - np.asarray(predict(refit.model, left)))[0], rtol=1e-6)


FROZEN = {
    "gravity off": (("gravity.alpha1",), {"alpha1": 0.0}),
    "gravity known": (("gravity.alpha1",), {"alpha1": 0.25}),
    "straight line over pressure": (("elastic.c1",), {"c1": 0.0}),
    "two at once, and one not fitted here": (("elastic.c1", "elastic.c2", "friction.mu_s"), {"c1": -1e-3, "c2": 0.08}),
}


@pytest.mark.parametrize("case", FROZEN)
def test_frozen_parameters_stay_and_the_rest_is_refitted_around_them(truth, measured, case):
    frozen, values = FROZEN[case]
    robot = truth(seed=4)
    steady, probe = measured(robot)
    fit = fit_static(robot.model(**values), steady, probe, frozen=frozen)
    free = [i for i, name in enumerate(NAMES[:4]) if name not in frozen]
    held = [i for i in range(4) if i not in free]
    at = np.array([values.get(name.split(".")[1], 0.0) for name in NAMES[:4]])
    x = columns(steady, 6)
    expected, covariance = regression(x[:, free], steady.value - x[:, held] @ at[held])
    np.testing.assert_allclose((estimates(fit)[free] - expected) / np.sqrt(np.diag(covariance)), 0, atol=1e-6)
    np.testing.assert_array_equal(estimates(fit)[held], at[held])
    assert fit.names == tuple(name for name in NAMES if name not in frozen)
    np.testing.assert_allclose(fit.covariance[: len(free), : len(free)], covariance, rtol=1e-7, atol=1e-18)


def test_paper_constraints_hold_gravity_at_zero_and_say_so(truth, measured):
    robot = truth(seed=5, alpha1=-0.1)
    steady, probe = measured(robot)
    free = fit_static(robot.model(), steady, probe)
    assert estimates(free)[0] < -0.05 and not free.warnings
    held = fit_static(robot.model(), steady, probe, constraints="paper")
    assert estimates(held)[0] == 0.0
    assert [w for w in held.warnings if "gravity.alpha1" in w and "bound" in w]
    off = fit_static(robot.model(alpha1=0.0), steady, probe, frozen=["gravity.alpha1"])
    np.testing.assert_allclose(estimates(held), estimates(off), rtol=1e-7)
    assert np.isnan(held.sd("gravity.alpha1"))
    np.testing.assert_allclose([held.sd(n) for n in NAMES[1:]], [off.sd(n) for n in NAMES[1:]], rtol=1e-6)


def test_paper_constraints_change_nothing_where_they_do_not_bind(truth, measured):
    robot = truth(seed=6)
    steady, probe = measured(robot)
    free, held = (fit_static(robot.model(), steady, probe, constraints=c) for c in ("none", "paper"))
    np.testing.assert_allclose(estimates(held), estimates(free), rtol=1e-7)
    assert not held.warnings


def test_without_steady_points_stiffness_rests_on_the_given_model(truth, measured):
    robot = truth(seed=7)
    steady, probe = measured(robot, seed=None)
    known = {k: v for k, v in robot_values(robot).items() if k not in ("c4", "c5")}
    fit = fit_static(robot.model(**known), steady.take(np.empty(0, int)), probe)
    np.testing.assert_allclose(estimates(fit), robot.values, rtol=1e-4)
    assert any("no steady points" in w for w in fit.warnings)


def only(points, **conditions):
    keep = np.ones(len(points), bool)
    for name, allowed in conditions.items():
        keep &= np.isin(np.round(getattr(points, name), 6), np.round(allowed, 6))
    return points.take(keep)


ANGLE = np.radians(np.linspace(2, 20, 12))
REFUSED = {
    "one pressure": (dict(pressure_kpa=[20.0]), {}, {}, ["elastic.c1, elastic.c2", "1 pressure (20 kPa)"]),
    "two pressures": (dict(pressure_kpa=[0.0, 40.0]), {}, {}, ["elastic.c1 cannot", "2 pressures (0, 40 kPa)"]),
    "one angle": (dict(theta=ANGLE[5:6]), {}, {}, ["gravity.alpha1, elastic.c3", "angles"]),
    "probe at one pressure": ({}, dict(pressure_kpa=[10.0]), {}, ["probe", "jamming.c5", "--freeze"]),
    "too few points": ({}, dict(pressure_kpa=[10.0, 20.0]), {}, ["2 probe points for 2 parameters"]),
    "all frozen": ({}, {}, dict(frozen=NAMES[4:]), ["every parameter", "probe"]),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_points_that_cannot_fix_a_parameter_are_refused_by_name(truth, measured, case):
    steady_only, probe_only, options, words = REFUSED[case]
    steady, probe = measured(truth())
    with pytest.raises(InputError) as caught:
        fit_static(truth().model(), only(steady, **steady_only), only(probe, **probe_only), **options)
    for word in words:
        assert word in str(caught.value)


def test_the_mend_that_a_refusal_names_works(truth, measured):
    robot = truth(seed=8)
    steady, probe = measured(robot)
    for pressures, frozen in (([20.0], ["elastic.c1", "elastic.c2"]), ([0.0, 40.0], ["elastic.c1"])):
        fit_static(robot.model(), only(steady, pressure_kpa=pressures), probe, frozen=frozen)


def test_weights_need_a_stated_error_for_every_point(truth, measured):
    steady, probe = measured(truth())
    steady.sd[3] = np.nan
    probe.sd[2] = 0.0
    with pytest.raises(InputError, match="1 of 60 steady points"):
        fit_static(truth().model(), steady, probe, weights="published")
    with pytest.raises(InputError, match="1 of 9 probe points"):
        fit_static(truth().model(), steady.take(np.empty(0, int)), probe, weights="published")
