"""What the judgement makes of evidence, without a robot."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ljjax.effects import REGISTRY
from ljjax.gap import judge
from ljjax.gap.judge import Evidence
from ljjax.gap.selection import Found, pairs


def evidence(left: dict[str, float], *, excess: float = 5.0, chance: float = 1e-9, sizes: dict[str, int] | None = None):
    return Evidence(excess, left, sizes or dict.fromkeys(left, 1), 1e-4, chance, as_given=False)


def test_a_gap_that_no_candidate_explains_is_not_called_none():
    """Whatever the base leaves beyond the noise is something, even where no effect gains more than chance."""
    for excess, answer in ((5.0, "unlisted_effect"), (0.05, "parameters_only"), (-0.02, "parameters_only")):
        p = judge.probabilities(evidence({"contact": 0.99, "base_tilt": 0.98}, excess=excess, chance=1.0))
        assert abs(sum(p.values()) - 1) < 1e-9
        assert judge.verdict(p, ["base_tilt"]) == answer
        assert p[answer] > 0.85
        assert p["no_gap"] > 0 or answer == "unlisted_effect"  # nothing possible is given no chance at all


@pytest.mark.parametrize(("left", "effect"), [(0.92, False), (0.2, True)])
def test_where_the_noise_itself_is_in_doubt_what_a_candidate_takes_away_must_matter(left, effect):
    """A gap of a twentieth of the noise's variance may be the noise, however seldom chance takes a tenth of it away."""
    p = judge.probabilities(evidence({"pressure_leak": left}, excess=0.055, chance=1.8e-4))
    assert bool(p["parameters_only"] < 0.1) is effect


def test_of_effects_that_leave_as_much_the_simpler_one_is_ahead():
    p = judge.probabilities(evidence({"plain": 0.02, "rich": 0.02}, sizes={"plain": 1, "rich": 3}))
    assert p["plain"] > p["rich"] > 0.2
    p = judge.probabilities(evidence({"plain": 0.06, "rich": 0.02}, sizes={"plain": 1, "rich": 3}))
    assert p["rich"] > 0.9


def test_what_is_free_but_not_used_is_not_held_against_an_effect():
    rich = evidence({"plain": 0.03, "rich": 0.02}, sizes={"plain": 1, "rich": 9})
    assert judge.probabilities(rich)["plain"] > judge.probabilities(rich)["rich"]
    plain = judge.probabilities(dataclasses.replace(rich, used={"plain": 1, "rich": 2}))
    assert plain["rich"] > plain["plain"]


def test_what_carries_over_to_runs_that_no_fit_saw_is_likely_a_cause():
    """However ill a first-order step foretells each condition left out."""
    astray = dataclasses.replace(evidence({"contact": 0.15, "base_tilt": 0.6}), unseen={"contact": 0.65})
    carried = dataclasses.replace(astray, held_out={"contact": 0.08})
    assert judge.probabilities(carried)["contact"] > judge.probabilities(astray)["contact"] + 0.1


def test_an_effect_that_makes_left_out_conditions_worse_is_not_excused_by_unseen_runs():
    alike = dataclasses.replace(
        evidence({"contact": 0.2, "base_tilt": 0.6}), unseen={"contact": 0.2}, held_out={"contact": 0.2}
    )
    worse = dataclasses.replace(alike, unseen={"contact": 1.3})
    assert judge.probabilities(worse)["contact"] < judge.probabilities(alike)["contact"] - 0.2


def test_parameters_in_use_by_all_that_leave_little_do_not_speak_for_something_unknown():
    found = evidence({"contact": 0.18, "base_tilt": 0.9})
    few, many, more = (judge.probabilities(dataclasses.replace(found, used={"contact": n})) for n in (1, 8, 24))
    assert many["contact"] == pytest.approx(few["contact"], abs=1e-3)
    assert 1 - more["contact"] > 2 * (1 - many["contact"])  # unless they are more than a stand-in for anything has


def test_a_stand_in_that_leaves_far_less_speaks_for_an_effect_outside_the_library():
    """One that leaves a little less does not: it has many terms."""
    for left, answer in ((0.01, "unlisted_effect"), (0.1, "listed_effect"), (0.6, "listed_effect")):
        decoy = dataclasses.replace(evidence({"contact": 0.12, "base_tilt": 0.9}), flexible={"friction": left})
        assert judge.verdict(judge.probabilities(decoy), ["contact"]) == answer
    loud = dataclasses.replace(evidence({"contact": 0.06}, sizes={"contact": 3}), flexible={"body": 0.02})
    quiet = dataclasses.replace(loud, unit=3.4e-3)  # where chance alone takes that much for so many terms
    assert judge.verdict(judge.probabilities(loud), ["contact"]) == "unlisted_effect"
    assert judge.verdict(judge.probabilities(quiet), ["contact"]) == "listed_effect"


def test_the_share_left_parts_listed_from_unlisted():
    p = [judge.probabilities(evidence({"contact": x}))["unlisted_effect"] for x in (0.02, 0.1, 0.3, 0.6)]
    assert p == sorted(p)
    assert p[0] < judge.WEIGHTS.unforeseen and p[-1] > 0.85


def test_what_is_far_ahead_of_all_others_is_a_cause_in_another_form_not_a_stand_in():
    """Of what nobody knows, several effects can each mimic a part."""
    alone, among = (judge.probabilities(evidence({"contact": 0.3, "base_tilt": x})) for x in (0.95, 0.4))
    assert alone["contact"] > 0.8 and among["unlisted_effect"] > among["contact"]
    varied = dataclasses.replace(evidence({"contact": 0.3, "base_tilt": 0.95}), steady={"contact": 0.4})
    assert judge.probabilities(varied)["contact"] < 0.5 < alone["contact"]  # which may not vary as it does
    both = judge.probabilities(evidence({"actuator_delay": 0.2, "actuator_lag": 0.22, "base_tilt": 0.95}))
    assert both["actuator_delay"] + both["actuator_lag"] > 0.8  # none of the two holds the other back: they do the same
    partial = judge.probabilities(evidence({"contact": 0.2, "tip_payload": 0.22, "base_tilt": 0.95}))
    assert partial["unlisted_effect"] > 0.8
    for mimic in judge.MIMICS:  # which is ahead of all others where it does what is outside the library
        ahead = judge.probabilities(evidence({mimic: 0.3, "base_tilt": 0.95}))
        assert ahead["unlisted_effect"] > ahead[mimic]


def test_what_does_not_carry_over_to_a_condition_left_out_is_likely_a_stand_in():
    """Of a cause's form a wrong one may be fitted to every condition, yet not foretell one: a form that does either as
    well is none; what a first-order step far astray says counts no more than the base's own error."""
    carried, astray, far = (
        judge.probabilities(dataclasses.replace(evidence({"contact": 0.12, "base_tilt": 0.4}), unseen={"contact": x}))
        for x in (0.1, 0.8, 9.0)
    )
    alone = judge.probabilities(evidence({"contact": 0.12, "base_tilt": 0.4}))
    assert carried == pytest.approx(alone)
    assert alone["contact"] > 0.9 and astray["unlisted_effect"] > astray["contact"] > far["contact"] > 0.1
    left = evidence({"contact": 0.01, "tip_payload": 0.03})
    better = dataclasses.replace(left, unseen={"contact": 0.5, "tip_payload": 0.04})
    assert judge.probabilities(left)["contact"] > 0.9 and judge.probabilities(better)["tip_payload"] > 0.9


def test_what_leaves_half_of_runs_that_no_fit_saw_is_likely_a_stand_in():
    """However well it and its folds fit; a tenth of the gap says little, two runs being few."""
    found = dataclasses.replace(evidence({"contact": 0.03, "base_tilt": 0.1}), unseen={"contact": 0.04})
    usual, half, double = (
        judge.probabilities(dataclasses.replace(found, held_out={"contact": x, "base_tilt": x}))
        for x in (0.1, 0.5, 2.0)
    )
    assert usual["contact"] > 0.8
    assert half["unlisted_effect"] > 0.55 and double["unlisted_effect"] > 0.85
    near = dataclasses.replace(found, left={"contact": 0.03, "base_tilt": 0.05})
    better = dataclasses.replace(near, held_out={"contact": 0.5, "base_tilt": 0.05})
    assert judge.probabilities(better)["base_tilt"] > 0.85
    assert judge.probabilities(near)["contact"] > 2 * judge.probabilities(near)["base_tilt"]


def test_a_cause_is_named_where_it_is_more_probable_than_what_nobody_knows():
    """What else might be it and could be told from it does not speak for it; what cannot be told from it does."""
    p = {"no_gap": 0.0, "parameters_only": 0.0, "unlisted_effect": 0.4, "contact": 0.35, "sensor_scale": 0.25}
    assert judge.verdict(p, ["contact"]) == "unlisted_effect"
    assert judge.verdict(p, ["contact", "sensor_scale"]) == "listed_effect"


def test_where_the_noise_is_thought_too_large_candidates_are_told_by_what_they_leave_of_each_other():
    exact, near = (judge.probabilities(evidence({"contact": x, "base_tilt": x + 0.002})) for x in (0.0, -0.002))
    assert near["contact"] == pytest.approx(exact["contact"]) and near["contact"] > 2 * near["base_tilt"]


def test_the_interval_is_of_runs_that_no_fit_has_seen():
    """Six fitted runs down to the noise, and two unseen ones that keep a tenth of the gap."""
    before, floor = np.full(8, 17.0), np.ones(8)
    after = np.r_[np.full(6, 1.0), 2.5, 2.7]
    low, high = judge.interval(before, after, floor, 2, np.random.default_rng(0)) or (1.0, 1.0)
    assert low < 1 - 1.6 / 16 < high < 0.95
    low, high = judge.interval(before, np.ones(8), floor, 2, np.random.default_rng(0)) or (1.0, 1.0)
    assert low < 1.0 < high  # the floor itself is not known exactly


def test_the_interval_of_few_runs_covers_what_many_would_show():
    rng, share, hits = np.random.default_rng(1), 0.05, []
    for _ in range(200):
        floor = np.ones(4)
        before = floor + 20 * rng.lognormal(0.0, 0.3, 4)
        after = floor + (before - floor) * share * rng.lognormal(0.0, 0.5, 4)
        low, high = judge.interval(before, after, floor, 1, rng, draws=500) or (1.0, 0.0)
        hits.append(low <= 1 - share * np.exp(0.5**2 / 2) <= high)
    assert 0.83 < np.mean(hits) < 1.0  # 0.7 without Student's t


def test_of_several_effects_each_exchange_is_known_by_what_went_and_what_came():
    def refit(*ids: str) -> Any:
        return SimpleNamespace(ids=ids)

    best = refit("filter", "payload")
    others = [
        ("filter", "tilt"),
        ("payload", "tilt"),
        ("filter", "payload"),
        ("lag", "tilt"),
        ("filter", "lag", "tilt"),
    ]
    found = Found({}, {tuple(sorted(ids)): refit(*ids) for ids in others}, best)
    said = {(out, new) for out, new, _ in found.exchanged}
    assert said == {("payload", "tilt"), ("filter", "tilt")}


def test_of_two_effects_one_begins_as_it_was_alone_the_other_cautiously():
    def alone(path: str, value: float) -> Any:
        return SimpleNamespace(ids=(path.split(".")[1],), free_effects={path: value})

    lag, gain, scale = "effects.actuator_lag.tau_s", "effects.actuator_gain.error", "effects.sensor_scale.error"
    leaders = [alone(lag, 0.1), alone(gain, -0.2), alone(scale, 0.4)]
    begun = [dict(trial.start) for trial in pairs(leaders, list(REGISTRY.values()))]
    assert len(begun) == 5
    for one, other, x, y in ((lag, gain, 0.1, -0.2), (gain, lag, -0.2, 0.1), (scale, lag, 0.4, 0.1)):
        assert any(set(b) == {one, other} and b[one] == x and 0 < b[other] / y < 0.5 for b in begun)


def test_what_data_cannot_tell_apart_leaves_as_little_or_has_a_tenth_of_the_odds():
    left = {"contact": 0.02, "tip_payload": 0.04, "base_tilt": 0.06, "sensor_scale": 0.5}
    odds = {"contact": 0.6, "tip_payload": 0.25, "base_tilt": 0.05, "sensor_scale": 1e-3}
    assert judge.equivalents(left, "contact", 1e-5) == ["contact"]
    assert judge.equivalents(left, "contact", 1e-5, odds) == ["contact", "tip_payload"]
    assert judge.equivalents(left, "tip_payload", 1e-5, odds) == ["tip_payload", "contact", "base_tilt"]
    assert judge.equivalents({**left, "base_tilt": 0.025}, "contact", 1e-5) == ["contact", "base_tilt"]


def test_a_further_effect_of_little_of_the_gap_must_leave_nearly_nothing():
    worth = judge.pairs_worth
    assert worth(0.3, 0.1, 1e-4) and not worth(0.3, 0.15, 1e-4)  # most of what is left
    assert worth(0.1, 0.02, 1e-4) and not worth(0.1, 0.04, 1e-4)
    assert not worth(0.04, 0.0, 1e-4) and not worth(0.1, 0.02, 1e-2)  # too little to matter, or to tell from chance


def test_a_listed_cause_may_have_a_form_that_nobody_has_thought_of():
    """However little the best effect explains, what is outside the library is not certain; the others share the rest
    alike, beside what each has."""
    p = judge.probabilities(evidence({"tip_payload": 0.95, "contact": 0.97, "base_tilt": 0.99}))
    assert max(p, key=lambda i: p[i]) == "unlisted_effect" and p["unlisted_effect"] < 1 - 0.9 * judge.STRANGE
    assert min(p[i] for i in ("tip_payload", "contact", "base_tilt")) > 0.3 * judge.STRANGE
