"""The tip's pose beside the shape: a second angle, which no effect of the shape's sensor touches."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from ljjax.effects import REGISTRY
from ljjax.fit.coordinates import Coordinates
from ljjax.fit.dynamic import Search
from ljjax.fit.problem import Problem
from ljjax.fit.run import prepared
from ljjax.fit.shooting import together
from ljjax.fit.windows import Motion, cut, with_tips
from ljjax.gap.candidates import universal
from ljjax.gap.search import QUICK
from ljjax.logs import Signal
from ljjax.model import replace
from tests.fit.test_dynamic import guess, logged, robot

NAMES = ("elastic.c3", "effects.sensor_scale.error", "effects.sensor_delay.delay_seconds")


@pytest.fixture(scope="module")
def motions():
    case = prepared(
        guess(robot()), "nominal.toml", [logged(robot(), s, theta=True) for s in (1, 2)], (), (), "commands"
    )
    assert not isinstance(case, list)
    return case.problem.motions


def posed(m: Motion, angle: np.ndarray, every: int = 1) -> Motion:
    """A run in which the tip is logged, turned by `angle` (T,) [rad]."""
    value = np.zeros((len(angle), 7))
    value[:, 4], value[:, 6] = np.sin(angle / 2), np.cos(angle / 2)
    names = ("x", "y", "z", "qx", "qy", "qz", "qw")
    tip = Signal(m.t[::every], value[::every], names, "m", "/real/tip/pose", None)
    return dataclasses.replace(m, run=dataclasses.replace(m.run, signals={**m.run.signals, "tip": tip}))


def test_the_tips_turn_counts_where_all_runs_have_it(motions):
    noise = 1e-3 * np.random.default_rng(0).standard_normal(len(motions[0].t))
    turned = [posed(m, len(m.q0) * (1.1 * m.y[:, 0] + noise[: len(m.t)])) for m in motions]
    both = with_tips(turned)
    for m in both:
        assert m.seen.shape == (len(m.t), 2) and m.seen_noise.shape == (2,)
        np.testing.assert_array_equal(m.seen[:, :1], m.y)
        assert np.std(m.seen[:, 1] - 1.1 * m.y[:, 0]) == pytest.approx(1e-3, rel=0.1)
        assert m.seen_noise[1] == pytest.approx(np.hypot(1e-3, 1.1 * m.noise[0]), rel=0.2)
    opposite = [dataclasses.replace(m.run.signals["tip"], value=-m.run.signals["tip"].value) for m in turned]
    same = [
        dataclasses.replace(m, run=dataclasses.replace(m.run, signals={**m.run.signals, "tip": tip}))
        for m, tip in zip(turned, opposite, strict=True)
    ]
    for m, other in zip(both, with_tips(same), strict=True):  # −q is the same orientation as q
        np.testing.assert_allclose(other.seen, m.seen, atol=1e-12)
    some = with_tips([turned[0], motions[1]])  # one without
    still = with_tips([turned[0], posed(motions[1], 0.0 * motions[1].t)])  # an orientation that nobody fills in
    rare = with_tips([turned[0], posed(motions[1], motions[1].y[:, 0], every=60)])
    assert all(m.tip is None and m.seen is m.y for found in (some, still, rare) for m in found)


def test_what_the_shapes_sensor_does_does_not_touch_the_tip(motions):
    """A scale and a delay show in the shape alone, and so do derivatives by them."""
    with_both = with_tips([posed(m, len(m.q0) * m.y[:, 0]) for m in motions])
    model = universal(guess(robot()).model, [REGISTRY["sensor_scale"], REGISTRY["sensor_delay"]])
    model = replace(model, {NAMES[1]: 0.1, NAMES[2]: 0.02})
    problem = Problem(Coordinates(model, NAMES, 20.0), with_both)
    windows = cut(with_both, QUICK.step_s)
    search = Search(problem, windows, QUICK)
    assert together([search.look(problem.coordinates.start)]) == [None] and search.point is not None
    predicted, slopes = search.point.answer.predicted, search.point.answer.jacobian
    assert windows.logged == (False, True) and predicted.shape[1] == 2 and np.isfinite(predicted).all()
    assert windows.shape(predicted).shape[1] == 1
    for run in (0, 1):
        mine = windows.sample_run == run
        t, (shape, tip) = windows.sample_t[mine], predicted[mine].T
        late = t > t[0] + 0.05
        np.testing.assert_allclose(shape[late], 1.1 * np.interp(t - 0.02, t, tip)[late], atol=3e-4)
    moving = windows.sample_t > 0.5  # where a run starts is told from the shape, by the scale
    shown, hidden = (np.abs(slopes[moving, column, 1:3]).max(axis=0) for column in (0, 1))
    assert np.all(shown > 1e-3) and np.all(hidden < 0.01 * shown) and np.abs(slopes[moving, 1, 0]).max() > 1e-3


def test_a_shape_smoothed_afterwards_shows_what_is_to_come(motions):
    """The mean from 60 ms before to 60 ms after, but for what a filter leaves of a moving average; a run's own end
    stands for what came after it."""
    with_both = with_tips([posed(m, len(m.q0) * m.y[:, 0]) for m in motions])
    tau, name = 0.02, "effects.sensor_filter.undone"
    model = replace(
        universal(guess(robot()).model, [REGISTRY["sensor_filter"]]),
        {"effects.sensor_filter.tau_s": tau, "effects.sensor_filter.later": 1.0, name: 0.9},
    )
    problem = Problem(Coordinates(model, (name,), 20.0), with_both)
    windows, at, shown = cut(with_both, QUICK.step_s), problem.coordinates.start, []
    for x in (at, at + 0.001):
        search = Search(problem, windows, QUICK)
        assert together([search.look(x)]) == [None] and search.point is not None
        shown.append(search.point.answer)
    predicted, slope = shown[0].predicted, shown[0].jacobian[:, 0, 0]
    for run in (0, 1):
        mine = windows.sample_run == run
        t, (shape, tip) = windows.sample_t[mine], predicted[mine].T
        inside = (t > t[0] + 0.5) & (t < t[-1] - 0.2)
        mean = np.mean([np.interp(t - 0.3 * tau + s, t, tip) for s in np.linspace(-3 * tau, 3 * tau, 61)], axis=0)
        off, lag = (shape - mean)[inside], (np.interp(t - 3 * tau, t, tip) - tip)[inside]
        assert np.sqrt(np.mean(off**2)) < 0.05 * np.sqrt(np.mean(lag**2))
    differed = (shown[1].predicted - predicted)[:, 0] / 0.001
    assert np.sqrt(np.mean((slope - differed) ** 2)) < 0.2 * np.sqrt(np.mean(differed**2))
