"""Which effects are let vary, and how they begin."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from ljjax.effects import REGISTRY
from ljjax.effects.varying import HALFWAY, WAYS, varies, varying
from ljjax.gap.candidates import Trial
from ljjax.gap.screening import Column, Screen
from ljjax.gap.search import Study
from ljjax.gap.variation import Variation, anchored


@pytest.mark.parametrize(
    ("alone", "varied", "vary"),
    [
        ({"base_tilt": 0.3, "contact": 0.35, "sensor_bias": 0.95}, {"base_tilt": 0.02, "contact": 0.3}, {"base_tilt"}),
        ({"base_tilt": 0.3, "contact": 0.8}, {"base_tilt": 0.29}, set()),  # that helps none
        ({"base_tilt": 0.01, "contact": 0.02}, {}, set()),  # little is left to be told
        ({"base_tilt": 0.00390625, "contact": 0.02}, {}, set()),  # nothing is
        ({"actuator_delay": 0.3}, {}, set()),  # it cannot
        (
            {"actuator_ripple": 0.05, "base_tilt": 0.3},
            {"actuator_ripple": 0.05},
            set(),
        ),  # often a stand-in: ends nothing
    ],
)
def test_leaders_that_leave_much_may_vary(alone, varied, vary):
    def refitted(effect: str, left: float) -> Any:
        return SimpleNamespace(ids=(effect,), total=100 + 900 * left, free_effects={})

    asked: list[str] = []

    class Told(Study):
        def varied(self, refits, stage):
            asked.extend(r.ids[0] for r in refits)
            return [refitted(i, varied[i]) for i in asked]

    any_: Any = None
    study = Told(any_, (), list(REGISTRY.values()), (any_, any_), 0.0, {"slip": 9.0})
    variation: Any = Variation(study, any_, any_, lambda refit: (refit.total - 100) / 900, 900.0)
    others: list[set[str]] = []
    variation._left_out = lambda refit: refit.total
    variation._others = lambda single, kinds, pilots, stage: others.append(set(kinds))
    variation._by_run = lambda single, within: others.append({"by run"})
    single = {i: refitted(i, x) for i, x in alone.items()}
    variation.let(single)
    assert set(asked) == set(varied)
    sudden = {"pressure_bias", "pressure_leak", "rest_curvature", "base_tilt", "tip_payload", "contact", "sensor_bias"}
    sudden |= {"actuator_delay", "sensor_delay", "sensor_scale", "actuator_gain"}
    able = {i for i, k in REGISTRY.items() if varies(k)}
    least = min(map(variation.left, single.values()))
    by_run: list[Any] = [{"by run"}] if least > 0.005 else []
    cause = min(variation.left(r) for i, r in single.items() if i != "actuator_ripple")
    assert others == ([sudden, able - set(varied)] if cause > 0.12 else []) + by_run
    assert {i for i, r in single.items() if variation.left(r) < alone[i]} == vary
    free = {k.id for k in study.kinds if "by_load" in k.fields()}
    assert free == vary


@pytest.mark.parametrize(
    ("varied", "unseen", "vary"),
    [(0.02, 0.03, {"friction_asymmetry", "pressure_lag"}), (0.02, 0.3, set()), (0.09, 0.03, set())],
)
def test_two_effects_vary_where_they_then_leave_less_of_what_is_left_out_too(varied, unseen, vary):
    def refitted(ids: tuple[str, ...], left: float, unseen: float) -> Any:
        return SimpleNamespace(ids=ids, total=left, unseen=unseen)

    pair = "friction_asymmetry", "pressure_lag"
    found = [refitted(pair, 0.1, 0.2), refitted(pair, 0.12, 0.1), refitted(("contact", "base_tilt"), 0.5, 0.5)]
    asked: list[Any] = []

    class Told(Study):
        def varied(self, refits, stage):
            asked.extend(refits)
            assert {k.id for k in self.kinds if "by_load" in k.fields()} == {*pair}
            return [refitted(r.ids, varied, unseen) for r in refits]

    any_: Any = None
    study = Told(any_, (), list(REGISTRY.values()), (any_, any_), 0.0, {"slip": 9.0})
    variation: Any = Variation(study, any_, any_, lambda refit: refit.total, 1.0)
    variation._left_out = lambda refit: refit.unseen
    kept = variation.of_several(found)
    assert asked == [found[0]], "the best of each pair, of those that come near the best"
    assert [r.ids for r in kept] == [pair] * bool(vary)
    assert {k.id for k in study.kinds if "by_load" in k.fields()} == vary
    assert variation.of_several([]) == []


def test_what_does_nothing_as_it_stands_may_vary_too():
    """Of the effects not let vary yet those that promise most in any way; what then leaves notably less stays."""
    kinds = [REGISTRY[i] for i in ("viscous_damping", "contact", "base_tilt", "sensor_bias")]
    usual = {(k.id, 0): {"power": 1.8} if k.id == "viscous_damping" else {} for k in kinds}
    any_, none = cast(Any, None), np.zeros((2, 2, 1))
    columns = [Column(k.id, 0, "", 0, 0, 1) for k in kinds]
    before = Screen(columns, usual, none, none, none, dict.fromkeys(usual, 1.0), {}, {}, {}, none)
    forms: dict[tuple[str, int], dict[str, float]] = {}
    begun: list[Trial] = []

    def refitted(trial: Trial, left: float) -> Any:
        return SimpleNamespace(trial=trial, ids=trial.ids, total=100 + 900 * left, free_effects=dict(trial.start))

    class Told(Study):
        def screen(self, from_, forms_of=None):
            assert forms_of is not None
            forms.update({(k.id, n): f for k in self.kinds for n, f in enumerate(forms_of(k))})
            gains = {k: 9.0 if k[0] == "viscous_damping" and "by_bend" in f else 1.0 for k, f in forms.items()}
            columns = [Column(*key, "", 0, 0, 1) for key in forms]
            steps = {k: {"damping": 0.1} if k[0] == "viscous_damping" else {} for k in forms}
            return Screen(columns, forms, none, none, none, gains, gains, steps, {k: np.zeros(0) for k in forms}, none)

        def refit(self, like, trials, screen, steps=None, stage="", finish=1, sure=0, within=np.inf):
            begun.extend(trials)
            return [refitted(t, 0.05 if t.ids == ("viscous_damping",) else 0.9) for t in trials]

        def varied(self, refits, stage):
            return list(refits)

    study, base = Told(any_, (), kinds, (any_, any_), 0.0, {}), cast(Any, SimpleNamespace(model=None))
    variation = Variation(study, base, before, lambda refit: (refit.total - 100) / 900, 900.0)
    single = {i: refitted(Trial((i,)), 0.94) for i in ("viscous_damping", "contact", "base_tilt")}
    free = {k.id: varying(k) for k in kinds if k.id != "base_tilt"}
    by_bend = [{"by_load": 8.0}, {"by_bend": 8.0}]
    variation._others(single, free, lambda kind: by_bend[kind.id == "sensor_bias" :], "others that vary")
    assert {k[0] for k, f in forms.items() if "by_bend" in f} == {"viscous_damping", "contact", "sensor_bias"}
    bent = next(t for t in begun if t.ids == ("viscous_damping",)).start
    own = {p.split(".")[2]: x for p, x in bent.items()}
    assert own == {**dict.fromkeys(WAYS, 0.0), **HALFWAY, "by_bend": 8.0, "power": 1.8, "damping": 0.1}
    assert variation.left(single["viscous_damping"]) == 0.05 and variation.left(single["contact"]) == 0.94
    assert [k.id for k in study.kinds if "by_bend" in k.fields()] == ["viscous_damping"]


def test_where_no_candidate_may_vary_so_none_is_asked():
    """A damping alone on trial can neither begin at a moment nor be another in each run; a study that cannot screen."""
    any_: Any = SimpleNamespace(worn=np.zeros(2))
    study = Study(any_, (), [REGISTRY["viscous_damping"]], (any_, any_), 0.0, {"slip": 9.0})
    variation: Any = Variation(study, any_, any_, lambda refit: 0.5, 900.0)
    single: dict[str, Any] = {}
    variation._others(single, variation._sudden(), lambda kind: [{}], "effects that begin at once")
    variation._by_run(single, np.inf)
    assert single == {}


def test_what_is_there_in_no_run_has_no_run_to_be_the_largest_in():
    none = anchored(REGISTRY["sensor_bias"], {"effects.sensor_bias.offset_rad": 0.02}, np.zeros(2))
    in_runs = {f"effects.sensor_bias.in_run{k}": -1.0 for k in (1, 2)}
    assert none == {"effects.sensor_bias.offset_rad": 0.02, **in_runs}
