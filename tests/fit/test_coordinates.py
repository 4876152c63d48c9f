"""The coordinates a fit moves: a robot at every one of them, and the right derivatives."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from ljjax import effects
from ljjax.data import OCTROBOT
from ljjax.fit.coordinates import Coordinates
from ljjax.fit.dynamic import Search, _Point
from ljjax.fit.problem import Problem, Round
from ljjax.model import Model, get, replace
from ljjax.modelfile import load

MOVED = (
    *("gravity.alpha1", "elastic.c1", "elastic.c2", "elastic.c3", "jamming.c4", "jamming.c5"),
    *("friction.sigma2", "friction.mu_c"),
)


def robot() -> Model:
    """OctRobot-I, its assumed friction such that σ₃ and μ_S > μ_C matter."""
    model = load(OCTROBOT / "nominal.toml").model
    return replace(model, {"friction.sigma3": 1.6, "friction.mu_c": 0.0032, "friction.mu_s": 0.0036})


def test_coordinates_are_admissible_everywhere_and_start_at_the_model():
    model = robot()
    names = (*MOVED, "friction.sigma1", "friction.mu_s", "friction.sigma3", "friction.v_s", "chain.segment_mass_kg")
    c = Coordinates(model, names, 40.0)
    np.testing.assert_allclose(c.physical(c.start), [float(get(model, p)) for p in names], rtol=1e-10)
    rng = np.random.default_rng(0)
    for _ in range(50):
        assert c.admissible(c.start + rng.normal(scale=1.0, size=len(c)))
    x = c.start + 0.1
    numeric = [(c.physical(x + d) - c.physical(x - d)) / 2e-6 for d in 1e-6 * np.eye(len(c))]
    np.testing.assert_allclose(c.jacobian(x), np.array(numeric).T, rtol=1e-6, atol=1e-9)


def test_a_frozen_parameter_stays_although_its_partners_move():
    model = robot()
    c = Coordinates(model, ("elastic.c2", "friction.mu_s"), 40.0)
    moved = c.model(c.start + 0.2)
    for path in ("elastic.c1", "elastic.c3", "friction.mu_c", "friction.sigma2"):
        assert float(get(moved, path)) == float(get(model, path))
    assert float(get(moved, "friction.mu_s")) == pytest.approx(0.0036 * np.exp(0.2))
    assert not c.admissible(np.array([0.05, np.log(0.001)]))  # mu_s below mu_c


def test_the_stribeck_exponent_stays_where_steps_resolve_it():
    """A steeper fall of the friction is a jump, whose solution a step may miss by degrees."""
    assert Coordinates(robot(), MOVED, 40.0).bounds == {}
    assert Coordinates(robot(), ("friction.sigma3",), 40.0).bounds == {"friction.sigma3": (0.0, 4.0)}
    steep = replace(robot(), {"friction.sigma3": 6.0})
    assert Coordinates(steep, ("friction.sigma3",), 40.0).bounds["friction.sigma3"][1] == 6.0


def test_an_effect_at_a_bound_can_go_everywhere_else():
    """What is held at a bound is off it by rounding in most steps, which are as good as any."""
    kind: Any = effects.REGISTRY["load_dependent_friction"]
    names = [f"effects.load_dependent_friction.{n}" for n in ("gain", "of_net", "power", "bent")]
    like = dataclasses.replace(robot(), effects=(kind(gain=0.1, power=2.9),))
    problem = Problem(Coordinates(like, names, 40.0), ())
    c = problem.coordinates
    below = c.within(c.start + np.array([0.1, -1e-17, 0.1, -1.0]))
    np.testing.assert_array_equal(c.physical(below), [0.2, 0.0, 3.0, 0.0])
    assert c.admissible(below)
    slope, low, high = map(np.array, zip(*problem.limits(c.start), strict=True))
    np.testing.assert_array_equal(slope, np.eye(4))
    np.testing.assert_allclose(low, [-0.1, 0.0, np.log(0.2 / 2.9), 0.0])
    np.testing.assert_allclose(high, [19.9, 20.0, np.log(3.0 / 2.9), 1.0])


def test_a_search_goes_on_with_what_is_held_at_its_bounds():
    """Of data that go with an effect's parameters, three of which would have to be beyond where they may be."""
    kind: Any = effects.REGISTRY["load_dependent_friction"]
    names = [f"effects.load_dependent_friction.{n}" for n in ("gain", "of_net", "bent", "joins_s", "parts_s")]
    like = dataclasses.replace(robot(), effects=(kind(),))
    motion: Any = SimpleNamespace(q0_sd=0.01, seen_noise=np.array([1e-3]))
    problem = Problem(Coordinates(like, names, 40.0), (motion,))
    slope = np.random.default_rng(0).normal(size=(200, 5))
    wanted = np.array([2.0, -0.3, -0.2, 3.0, -0.5])
    rows = np.zeros(len(slope), int)
    windows: Any = SimpleNamespace(run=rows[:1], window=rows, sample_run=rows, y=(slope @ wanted)[:, None])

    class Linear(Search):
        def _evaluate(self, x, offset, starts):
            yield from ()
            jacobian = np.concatenate([slope, np.zeros((len(slope), 1))], axis=1)[:, None]
            predicted = (slope @ problem.coordinates.physical(x))[:, None]
            return _Point(x, offset, cast(Any, SimpleNamespace(predicted=predicted, jacobian=jacobian)), [])

    search = Linear(problem, windows, Round(0.01, True, np.inf, 1, 0.1, 1e-12, onward=True))
    with pytest.raises(StopIteration) as end:
        next(search.run(problem.coordinates.start, 100, [], 0))
    free = [0, 3]
    best, *_ = np.linalg.lstsq(slope[:, free], slope @ wanted)
    found = problem.coordinates.physical(end.value.value)
    np.testing.assert_allclose(found[free], best, rtol=1e-2)
    np.testing.assert_allclose(found[[1, 2, 4]], 0.0, atol=1e-15)
