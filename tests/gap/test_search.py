"""How trials are refitted, weeded and taken further, and what their parameters count for."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from ljjax.effects import REGISTRY
from ljjax.effects.varying import varying
from ljjax.gap import screening
from ljjax.gap.candidates import Trial
from ljjax.gap.search import FIRST, Study, _best, needed, units
from tests.fit.test_dynamic import robot


@pytest.mark.parametrize(
    "off, along, told",
    [
        ([3.0, 3.0], 0.0, [0, 1]),
        ([3.0, 1.0], 0.0, [0]),
        ([1.0, 1.2], -0.99, [1]),  # their sum is known, not which of them it is
        ([1.0, -1.2], -0.99, []),
        ([1.5, 1.6], 0.99, []),  # without the one the other is nothing that counts
    ],
)
def test_parameters_that_stand_for_one_another_count_once(off, along, told):
    covariance = np.array([[1.0, along], [along, 1.0]])
    assert needed(np.array(off), covariance) == told


def test_parameters_that_take_little_do_not_count():
    """Of 3, 5 and 9 standard deviations the first two together cost a χ² of 34."""
    off = np.array([5.0, 9.0, 3.0])
    assert [needed(off, np.eye(3), free) for free in (0.0, 9.5, 33.0, 35.0)] == [[0, 1, 2], [0, 1], [0, 1], [1]]


def test_of_many_trials_those_that_fall_behind_go_no_further():
    trials = [Trial(("contact",), {"effects.contact.k": float(k)}) for k in range(7)]
    asked: list[tuple[list[Any], list[Trial], int]] = []
    own: list[bool] = []

    class Told(Study):
        def _refit(self, begun, trials, steps, iterations, stage, borrowed=None) -> list[Any]:
            asked.append((list(begun), list(trials), iterations))
            own.append(borrowed is None)
            return [SimpleNamespace(trial=t, model=("after", t), total=-t.start["effects.contact.k"]) for t in trials]

        def _begun(self, like, trial):
            return like

    any_: Any = SimpleNamespace(base_jacobian=np.zeros((2, 1, 4)))
    found = Told(any_, ("a",), [REGISTRY["contact"]], (), 0.0, {}).weeded(any_, trials, any_, "few runs")
    first, then, last = asked
    assert first[1] == trials and first[2] + then[2] == FIRST and own == [False, False, True]
    assert then[1] == trials[:3:-1] and last[1] == then[1][:1]
    assert all(a[0] == [("after", t) for t in a[1]] for a in (then, last))  # from where they had come to
    assert [r.trial for r in found] == last[1]


def test_a_further_effect_begins_as_it_stands_though_it_varied_where_the_first_was_found():
    """It was let vary on trial, and did not come to."""
    tilt, gain = cast(Any, REGISTRY["base_tilt"]), REGISTRY["actuator_gain"]
    free: Any = varying(gain)
    like = dataclasses.replace(robot(), effects=(tilt(tilt_rad=0.1), free(difference=0.02, by_load=0.5)))
    any_: Any = None
    study = Study(any_, (), [tilt, gain], (any_, any_), 0.0, {})
    begun = study._begun(like, Trial(("base_tilt", "actuator_gain"), {"effects.actuator_gain.error": 0.05}))
    values = {n: float(getattr(e, n)) for e in begun.effects for n in e.fields() if float(getattr(e, n)) != 0}
    shapes = {n: about["null"] for k in (tilt, gain) for n, about in k.fields().items() if about["null"]}
    assert values == {"tilt_rad": 0.1, "difference": 0.02, "error": 0.05, **shapes}


def test_a_screen_on_top_of_a_refit_is_of_where_that_came_to(monkeypatch):
    """Not of where its search began."""
    tilt, gain = cast(Any, REGISTRY["base_tilt"]), REGISTRY["actuator_gain"]
    key, seen, any_ = "effects.base_tilt.tilt_rad", [], cast(Any, None)
    model = dataclasses.replace(robot(), effects=(tilt(tilt_rad=0.1),))
    refit: Any = SimpleNamespace(ids=("base_tilt",), model=model, trial=Trial(("base_tilt",), {key: 0.4}))
    refit.free_effects = {key: 0.1}
    monkeypatch.setattr(screening, "screen", lambda whole, names, *_: (seen.append((whole, names)) or [], [], {}))
    monkeypatch.setattr(screening, "gather", lambda *_: None)
    study = Study(any_, ("elastic.c1",), [tilt, gain], (), 0.0, {})
    study.screen(refit, lambda kind: [{}])
    ((whole, names),) = seen
    assert names == ["elastic.c1", key]
    assert [float(e.tilt_rad) for e in whole.effects if e.id == "base_tilt"] == [0.1]


def test_a_gap_in_one_joint_of_six_counts_for_what_it_is():
    noise = np.full(6, 1e-3)
    unit, gross = units(np.where(np.arange(6) == 2, 1e-2, 0.9e-3), noise)
    np.testing.assert_allclose(unit, np.sqrt((5 + 100) / 6) * noise)
    assert gross[2] > 3.9e-2 and np.all(gross[[0, 1, 3, 4, 5]] >= 4 * unit[0] - 1e-12)
    alone, _ = units(np.array([1e-2]), noise[:1])
    np.testing.assert_allclose(alone, [1e-2])


def test_of_an_effects_trials_taken_further_the_second_is_from_the_other_side():
    def trial(effect: str, total: float, above: bool) -> Any:
        return SimpleNamespace(ids=(effect,), total=total, sides=(above,))

    same, near, other, far = (
        trial("pressure_bias", *x) for x in ((3.0, False), (3.1, False), (4.0, True), (5.0, True))
    )
    tilt, tilted = trial("base_tilt", 3.5, True), trial("base_tilt", 3.6, True)
    assert _best([far, tilted, tilt, other, near, same], 6) == [same, tilt, tilted, other]  # one side alone: two of it
    assert _best([far, other, near, same, tilt], 2) == [same, tilt]
