"""Windows cut of runs: every sample once, where they start, and what is noise in them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from ljjax.errors import InputError
from ljjax.fit.covariance import bandwidth
from ljjax.fit.windows import STEPS, check_columns, cut, motion, white_noise
from ljjax.logs import Run, Signal

P_ATM = 101_325.0


def pulled(run_of, seconds: float = 3.0) -> Run:
    """Two joints that swing out from rest, with 0.02° of noise, on steps of the vacuum."""
    rng = np.random.default_rng(0)
    t = np.arange(round(seconds / 0.01) + 1) * 0.01
    wave = np.clip((t - 0.1) / 0.3, 0, 1) * np.sin(2 * np.pi * 0.9 * t)
    tendons = 9.0 * np.stack([np.maximum(wave, 0), np.maximum(-wave, 0)], axis=1)
    vacuum = 10.0 * np.minimum((4 * t / seconds).astype(int), 3)
    shape = np.stack([0.1 * wave, 0.08 * wave], axis=1) + np.radians(0.02) * rng.normal(size=(len(t), 2))
    return run_of(cmd_tendons=(t, tendons), cmd_pressure=(t, P_ATM - 1e3 * vacuum), shape=(t, shape))


def test_windows_hold_every_sample_once_and_cover_their_run(run_of):
    w = cut([motion(pulled(run_of, seconds), 2) for seconds in (3.0, 2.5)], 0.005)
    assert len(w.y) == 301 + 251
    t = w.t[w.window, w.step] + w.weight * w.h
    np.testing.assert_allclose(t, w.sample_t, atol=1e-9)
    assert list(np.flatnonzero(w.opens)) == [0, 3]
    np.testing.assert_allclose(w.left.shape, (6, STEPS))
    some = w.some(4)
    np.testing.assert_allclose(some.t[some.window, some.step] + some.weight * some.h, some.sample_t, atol=1e-9)


def test_noise_and_its_colour_are_measured():
    rng = np.random.default_rng(0)
    trend = np.sin(np.linspace(0, 20, 5000))[:, None]
    assert white_noise(trend + 0.01 * rng.normal(size=(5000, 1)))[0] == pytest.approx(0.01, rel=0.1)
    fast = 0.05 * np.sin(np.linspace(0, 300, 5000))[:, None]
    rounded = 0.01 * np.round((fast + 0.0195 * rng.normal(size=(5000, 1))) / 0.01)
    assert white_noise(rounded)[0] == pytest.approx(np.hypot(0.0195, 0.01 / np.sqrt(12)), rel=0.03)
    white = rng.normal(size=5000)
    assert bandwidth(white) <= 4
    slow = np.zeros(5000)
    for i in range(1, 5000):
        slow[i] = 0.95 * slow[i - 1] + white[i]
    assert bandwidth(slow) > 50


def shown(run: Run, change) -> Run:
    """The run with its shape as `change` makes it of its stamps and angles."""
    s = run.signals["shape"]
    t, value = change(s.t, s.value)
    return dataclasses.replace(run, signals={**run.signals, "shape": dataclasses.replace(s, t=t, value=value)})


def test_angles_so_coarse_that_most_samples_are_alike_have_the_noise_of_their_rounding(run_of):
    step = np.radians(0.5)
    coarse = motion(shown(pulled(run_of), lambda t, y: (t, step * np.round(y / step))), 2)
    assert np.all(coarse.noise >= 0.99 * step / np.sqrt(12))
    still = motion(shown(pulled(run_of), lambda t, y: (t, np.stack([y[:, 0], 0 * t], axis=1))), 2)
    assert still.noise[1] == still.noise[0] > 0  # a joint that never moves


def test_of_samples_with_one_stamp_the_last_counts(run_of):
    run = pulled(run_of)
    twice = shown(run, lambda t, y: (np.insert(t, 100, t[100]), np.insert(y, 100, 9.9, axis=0)))
    once, again = motion(run, 2), motion(twice, 2)
    assert np.all(np.diff(again.t) > 0)
    np.testing.assert_array_equal(again.y, once.y)


def test_runs_of_joints_and_runs_of_their_mean_are_not_taken_together(run_of):
    run = pulled(run_of)
    mean = shown(run, lambda t, y: (t, y.mean(axis=1, keepdims=True)))
    with pytest.raises(InputError, match=r"logs 2 joint angles, .* their mean alone: give runs of one kind"):
        check_columns([motion(run, 2), motion(mean, 2)])


def test_a_run_that_begins_in_motion_starts_with_its_rate(run_of):
    whole = pulled(run_of)
    angle = whole.signals["shape"].value
    rate = (angle[6:] - angle[:-6]) / 0.06
    fastest = int(np.argmax(np.abs(rate.mean(axis=1))))  # around its middle the rate hardly changes
    late = dataclasses.replace(whole, signals={k: _from(s, 0.01 * fastest) for k, s in whole.signals.items()})
    np.testing.assert_allclose(motion(late, 2).v0, rate[fastest], rtol=0.1)
    assert not motion(whole, 2).v0.any()


def _from(s: Signal, t0: float) -> Signal:
    keep = s.t >= t0 - 1e-9
    return dataclasses.replace(s, t=s.t[keep], value=s.value[keep])
