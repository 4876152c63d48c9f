"""What a delay that is another one for every frame accounts for of what a refit leaves."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from ljjax.gap.scatter import NO_SCATTER, scatter

NOISE, DELAY_S = 1e-3, 0.04
T, RUNS = np.arange(0, 15, 0.01), 4


def _shape(t, run, joint):
    """Angles of the run's joint at times t [rad]."""
    hz = 0.2 + 0.1 * run
    return 0.1 * (1 + 0.3 * joint) * np.sin(2 * np.pi * hz * t) + 0.02 * np.sin(2 * np.pi * 2.3 * hz * t + joint)


def _refit(errors, joints: int, latency: float | None = DELAY_S, tip: bool = False):
    """A refit of runs that leaves `errors` of run and joint beside the noise, by one effect of such a latency; the tip,
    if it is logged, is stamped as it was seen."""
    rng = np.random.default_rng(3)
    predicted = np.concatenate([np.stack([_shape(T, r, j) for j in range(joints)], axis=1) for r in range(RUNS)])
    error = np.concatenate([np.stack([errors(r, j) for j in range(joints)], axis=1) for r in range(RUNS)])
    if tip:
        predicted = np.column_stack([predicted, predicted.sum(axis=1)])
        error = np.column_stack([error, np.zeros(len(error))])
    windows = SimpleNamespace(sample_t=np.tile(T, RUNS), sample_run=np.repeat(np.arange(RUNS), len(T)))
    windows.shape = lambda x: x[:, :joints]
    error += NOISE * rng.standard_normal(error.shape)
    estimate = SimpleNamespace(error=error, predicted=predicted, windows=windows)
    return SimpleNamespace(effects=[SimpleNamespace(latency_s=lambda: latency)], estimate=estimate)


def _scatter(refit, **asked):
    columns = refit.estimate.error.shape[1]
    return scatter(refit.estimate, refit.effects, np.full(columns, 2 * NOISE), np.full(columns, NOISE), **asked)


def _late(run, sd, spell_s):
    """A delay [s] of such a standard deviation, another one after each spell."""
    rng = np.random.default_rng([run, 7])
    return sd * rng.standard_normal(int(T[-1] / spell_s) + 1)[(T / spell_s).astype(int)]


def _stamped(run, joint, late):
    return _shape(T - late, run, joint) - _shape(T, run, joint)


@pytest.mark.parametrize("joints", [1, 6])
@pytest.mark.parametrize("spell_s", [0.01, 0.5])
def test_a_delay_drawn_for_every_frame_or_spell_is_told_by_its_size_and_accounts_for_what_is_left(joints, spell_s):
    found = _scatter(_refit(lambda r, j: _stamped(r, j, _late(r, 0.015, spell_s)), joints))
    assert found.sd_s == pytest.approx(0.015, rel=0.2)
    assert found.left < 0.35, found


def test_a_tip_that_is_not_late_does_not_hide_it():
    found = _scatter(_refit(lambda r, j: _stamped(r, j, _late(r, 0.015, 0.01)), 1, tip=True))
    assert found.sd_s == pytest.approx(0.015, rel=0.1)
    assert found.left < 0.2


def test_runs_are_asked_by_themselves_and_so_far_as_others_allow():
    refit = _refit(lambda r, j: _stamped(r, j, _late(r, 0.015, 0.01)) * (r < 2), 6)
    first = np.arange(RUNS) < 2
    assert _scatter(refit, runs=first).left < 0.2
    assert _scatter(refit, runs=~first).left > 0.8
    less = _scatter(refit, runs=first, most_s=0.005)
    assert less.sd_s == pytest.approx(0.005) and less.left > 0.8


def _rate(run, joint):
    return np.gradient(_shape(T, run, joint), T)


OTHERS = {
    "a vibration": lambda r, j: 0.01 * np.sin(2 * np.pi * 3.1 * T + r),
    "a curve": lambda r, j: 3 * _shape(T, r, j) ** 3,
    "frames lost for a second now and then": lambda r, j: _stamped(r, j, np.where(T % 5 < 1, T % 5, 0.0)),
    "a rate's": lambda r, j: 0.03 * np.tanh(20 * _rate(r, j)),
    "another delay one way than the other": lambda r, j: 0.015 * np.abs(_rate(r, j)),
    "a longer delay": lambda r, j: 0.015 * _rate(r, j),
    "another delay in each run": lambda r, j: 0.015 * (-1) ** r * _rate(r, j),
    "a delay that goes with the bend's sense": lambda r, j: 0.015 * np.sign(_shape(T, r, 0)) * _rate(r, j),
    "one joint's": lambda r, j: _stamped(r, j, _late(r, 0.02, 0.01)) * (j == 2),
}


@pytest.mark.parametrize("what", OTHERS)
def test_what_is_no_scattered_delay_is_left(what):
    for joints in (1, 6):
        assert _scatter(_refit(OTHERS[what], joints)).left > 0.5, joints


@pytest.mark.parametrize("latency", [None, 0.0])
def test_without_a_delay_nothing_scatters(latency):
    """However much the errors look like it: a scatter is at most a share of the delay."""
    refit = _refit(lambda r, j: _stamped(r, j, _late(r, 0.015, 0.01)), 6, latency)
    assert _scatter(refit) == NO_SCATTER
