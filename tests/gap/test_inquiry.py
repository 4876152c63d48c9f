"""What runs that are left out say of an effect."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ljjax.effects.sensing import SensorDelay
from ljjax.effects.structure import BaseTilt, Contact
from ljjax.effects.varying import by_run, varying
from ljjax.fit.run import prepared
from ljjax.fit.session import in_order
from ljjax.gap.answer import _left_over
from ljjax.gap.candidates import Trial
from ljjax.gap.data import span
from ljjax.gap.inquiry import Inquiry, began, fell_behind, unfixed
from ljjax.gap.judge import Evidence
from ljjax.gap.scatter import NO_SCATTER
from ljjax.gap.search import Study
from ljjax.gap.selection import Found, Selection
from ljjax.gap.stand_ins import QUICK, STAND_INS
from ljjax.gap.variation import Variation
from tests.fit.test_dynamic import guess, logged, robot


def inquiry(*effects: Any, kinds: Any = (Contact, BaseTilt), seen: Any = lambda run, seed: run) -> Inquiry:
    """Into three runs of a robot with an effect in each, as they are `seen`, what is asked of it left out."""
    start = guess(robot())
    given = [seen(logged(dataclasses.replace(robot(), effects=(e,)), s), s) for s, e in enumerate(effects)]
    case = prepared(start, "nominal.toml", given, (), start.frozen, "commands")
    assert not isinstance(case, list)
    runs, c = in_order(case.problem.motions), case.problem.coordinates
    study = Study(start.model, c.names, kinds, runs, c.pressure, span(runs), start.bounds, start.priors)
    asked: Any = Inquiry.__new__(Inquiry)
    asked.setting, asked.base = SimpleNamespace(study=study, train=runs, test=()), study.base()
    asked.selection = object.__new__(Selection)
    asked.selection.study = study
    asked.selection.floor = float(study.floor(runs).sum())
    asked.selection.excess = asked.base.total - asked.selection.floor
    asked.measured = SimpleNamespace(joined=lambda share, _: share)
    return asked


@pytest.fixture(scope="module")
def touched() -> tuple[Inquiry, float]:
    """A robot that meets an obstacle in one of the runs, and the angle of that."""
    bends = sorted(float(logged(robot(), s).signals["shape"].value.mean(axis=1).max()) for s in range(3))
    angle = bends[1] + 0.4 * (bends[2] - bends[1])
    make: Any = Contact
    return inquiry(*[make(stop=20.0, angle_rad=angle)] * 3), angle


@pytest.mark.parametrize(
    "found, left, asked_of",
    [("base_tilt", 0.001, 0), ("actuator_ripple", 0.001, 1), ("base_tilt", 0.02, 1), ("base_tilt", 0.2, 2)],
)
def test_a_ripple_is_held_against_a_body_in_waves_however_little_it_leaves(monkeypatch, found, left, asked_of):
    kinds: list[Any] = []
    monkeypatch.setattr("ljjax.gap.inquiry.stand_in", lambda study, base, of: kinds.append(of) or {})
    asked: Any = Inquiry.__new__(Inquiry)
    asked.setting, asked.base, asked.floor, asked.excess = SimpleNamespace(study=None), None, 1.0, 10.0
    asked.found = SimpleNamespace(best=SimpleNamespace(ids=(found,)))
    asked.selection = SimpleNamespace(own_left=lambda _: left)
    assert asked.flexible == {}
    assert kinds == [QUICK, STAND_INS][:asked_of]


@pytest.mark.parametrize("first", ["contact", "sensor_scale"])
def test_of_two_effects_one_that_does_not_carry_over_gives_way_to_another(monkeypatch, first):
    """Beside a tilt a scale leaves less than an obstacle where all is fitted, and all of it in other conditions."""
    pairs: dict[str, Any] = {i: SimpleNamespace(ids=("base_tilt", i)) for i in ("contact", "sensor_scale")}
    asked: Any = Inquiry.__new__(Inquiry)
    asked.found = Found({}, {tuple(sorted(p.ids)): p for p in pairs.values()}, pairs[first])

    def evidence() -> Evidence:
        asked.standing = {i: pairs[i] for i in pairs}
        left = {"base_tilt": 0.01, "contact": 0.03, "sensor_scale": 0.01}
        unseen = {"base_tilt": 0.01, "contact": 0.03, "sensor_scale": 1.0}
        return Evidence(20.0, left, dict.fromkeys(left, 2), 1e-5, 1e-9, False, unseen)

    monkeypatch.setattr(asked, "_evidence", evidence)
    asked._judge()
    assert asked.found.best is pairs["contact"]


def shares(asked: Inquiry, trial: Trial) -> tuple[float, float, np.ndarray, np.ndarray]:
    """Left in the fits and where runs are left out; how far the others tell what an effect does in each, and what it
    closes there where that is left out."""
    (refit,) = asked.setting.study.refit(asked.base.model, [trial], None)
    left = (refit.total - asked.base.total) / asked.selection.gap + 1
    (unseen,) = asked.leave_unseen([refit])
    (told,) = asked.told_elsewhere([refit])
    return left, unseen, told, asked.closes(refit)


@pytest.mark.parametrize(
    ("promised", "best", "left"), [(0.0, 0.01, 0.35), (0.2, 0.6, 0.9), (0.95, 0.6, 0.95), (0.5, 0.9, 1.0)]
)
def test_an_effect_that_was_not_refitted_never_stands_beside_one_that_was(promised, best, left):
    assert fell_behind(promised, best) == pytest.approx(left)
    assert fell_behind(promised, best) > best


def test_runs_that_never_touch_an_obstacle_say_nothing_against_it(touched):
    asked, angle = touched
    start = {"effects.contact.stop": 10.0, "effects.contact.angle_rad": angle + 0.01}
    left, unseen, told, closes = shares(asked, Trial(("contact",), start))
    assert left < 0.1 and unseen < 0.3
    assert sorted(told)[0] < 0.5 and sorted(told)[1:] == [1.0, 1.0]
    assert np.isnan(closes[np.argmin(told)])
    (asked.chosen,) = asked.setting.study.refit(asked.base.model, [Trial(("contact",), start)], None)
    asked.evidence = SimpleNamespace(held_out={"contact": 0.3}, flexible={})
    *_, unlike, said = _left_over(asked)
    assert unlike.startswith("contact leaves ") and "but 30 % of that of runs no fit saw" in unlike
    touches = asked.setting.train[int(asked.folds[1].tolist().index(np.argmin(told)))].run.run_id
    assert said.startswith(f"of the runs fitted hardly any but {touches} shows contact: ")


def test_forms_that_an_effect_does_not_need_stay_where_runs_are_left_out(touched):
    asked, angle = touched
    forms = {f"effects.contact.{n}": float(about["null"]) for n, about in Contact.fields().items()}
    start = {**forms, "effects.contact.stop": 10.0, "effects.contact.angle_rad": angle + 0.01}
    (refit,) = asked.setting.study.refit(asked.base.model, [Trial(("contact",), start)], None)
    names = refit.estimate.problem.coordinates.names
    idle = {names[k] for k in asked.selection.idle(refit)}
    assert idle < forms.keys() and "effects.contact.angle_rad" not in idle
    assert asked.selection.used(refit)["contact"] == len(forms) - len(idle)
    assert refit.idle(0.0) and {*refit.idle(0.0)} <= {*asked.selection.idle(refit)}


def test_sizes_that_take_nothing_of_the_gap_are_left_out(touched):
    """Of an obstacle, and a tilt that there is not."""
    asked, angle = touched
    start = {
        "effects.contact.stop": 10.0,
        "effects.contact.angle_rad": angle + 0.01,
        "effects.base_tilt.tilt_rad": 0.02,
    }
    sizes = [f"effects.{k.id}.{n}" for k in (Contact, BaseTilt) for n in k.sizes()]
    trial = Trial(("contact", "base_tilt"), {**dict.fromkeys(sizes, 0.0), **start})
    (refit,) = asked.setting.study.refit(asked.base.model, [trial], None)
    gone = refit.needless(asked.selection._little(refit))
    assert "effects.contact.stop" not in gone and {*gone} < {*sizes} and {*gone.values()} == {0.0}
    (plain,) = asked.setting.study.without([(refit, gone)], "plain")
    assert {*plain.free_effects} == trial.start.keys() - gone.keys()
    assert asked.selection.own_left(plain) < asked.selection.own_left(refit) + 0.002
    assert asked.selection._plainest([refit])[0].free_effects.keys() == plain.free_effects.keys()


def test_what_acts_in_every_run_answers_for_each_of_them(touched):
    asked, _ = touched
    left, unseen, told, closes = shares(asked, Trial(("base_tilt",), {"effects.base_tilt.tilt_rad": 0.05}))
    assert list(told) == [1.0, 1.0, 1.0] and unseen > left > 0.5
    assert np.isfinite(closes).any() and np.nanmin(closes) < 0.1


def test_runs_that_no_fit_saw_are_asked_only_where_they_show_the_gap(touched):
    asked, angle = touched
    start = {"effects.contact.stop": 10.0, "effects.contact.angle_rad": angle + 0.01}
    (refit,) = asked.setting.study.refit(asked.base.model, [Trial(("contact",), start)], None)
    asked.setting.test = asked.setting.train  # what is left of the fitted ones is known
    assert asked.leave_held_out([asked.base, refit]) == pytest.approx([1.0, asked.selection.own_left(refit)], abs=2e-3)
    floor, loss = asked.setting.study.floor(asked.setting.train), asked.base.loss
    faint = int(
        np.argsort(loss)[1]
    )  # touched, but hardly: what it lacks of half the usual gap counts as fitted runs do
    asked.setting.test = [asked.setting.train[faint]]
    half = 0.5 * asked.selection.excess / asked.selection.floor
    lacks = half - (loss[faint] / floor[faint] - 1)
    assert lacks > 0.3 * half
    left = refit.loss[faint] / floor[faint] - 1 + lacks * asked.selection.own_left(refit)
    assert asked.leave_held_out([refit]) == pytest.approx([left / half], abs=0.01)
    quiet = int(np.argmin(asked.base.loss))
    asked.setting.test = [asked.setting.train[quiet]]
    assert asked.leave_held_out([refit]) == [0.0]


def test_a_latency_drawn_for_every_frame_is_known_in_runs_fitted_and_unseen_and_told():
    make: Any = SensorDelay

    def late(run: Any, seed: int) -> Any:
        shape, rng = run.signals["shape"], np.random.default_rng(seed)
        at = shape.t - 0.04 - 0.015 * rng.standard_normal(len(shape.t))
        value = np.stack([np.interp(at, shape.t, x) for x in shape.value.T], axis=1)
        return dataclasses.replace(run, signals={**run.signals, "shape": dataclasses.replace(shape, value=value)})

    asked: Any = inquiry(*[make()] * 4, kinds=(SensorDelay,), seen=late)
    asked.setting.test = asked.setting.train[3:]
    fitted = asked.setting.study.of(range(3))
    asked.setting.study, asked.setting.train, asked.base = fitted, asked.setting.train[:3], fitted.base()
    asked.selection.floor = float(fitted.floor(fitted.motions).sum())
    asked.selection.excess = asked.base.total - asked.selection.floor
    (refit,) = fitted.refit(
        asked.base.model, [Trial(("sensor_delay",), {"effects.sensor_delay.delay_seconds": 0.02})], None
    )
    own, excused = asked.own_left(refit), asked.selection.excused(refit)
    assert refit.scatter.sd_s == pytest.approx(0.015, rel=0.25)
    assert own > 0.1 and excused > 0.7 * own
    blind = dataclasses.replace(refit, scatter=NO_SCATTER)
    for left in (asked.leave_unseen, asked.leave_held_out):
        assert left([blind])[0] > 0.6 * own and left([refit])[0] < 0.5 * left([blind])[0]
    asked.chosen, asked.evidence = refit, SimpleNamespace(left={}, held_out={})
    assert "the latency scatters by 1" in _left_over(asked)[0]


IN_DOUBT = " (before, in or after {0} the fitted runs do not say: no error here counts {0})"


@pytest.mark.parametrize(
    ("onset", "share", "untold", "said"),
    [
        (1.5, 1.0, [True, False], f"after a and before c{IN_DOUBT.format('b')}"),
        (2.9, 1.0, [True, False], f"after a and before c{IN_DOUBT.format('b')}"),
        (0.5, 1.0, [False, False], "5.0 s into a"),
        (5.5, 1.0, [False, True], f"after d{IN_DOUBT.format('e')}"),
        (1.5, 0.0, [False, False], ""),  # it does not begin
    ],
)
def test_what_begins_between_fitted_runs_is_not_told_of_those_in_between(onset, share, untold, said):
    def slipped(run_id: str, first: float) -> Any:
        t = np.linspace(2.0, 12.0, 11)
        return SimpleNamespace(worn=np.linspace(first, first + 1, 11), t=t, run=SimpleNamespace(run_id=run_id))

    kind: Any = varying(BaseTilt)
    begun = kind(tilt_rad=0.01, by_onset=share, onset_rad=onset, over_rad=0.05)
    fitted = [slipped(i, x) for i, x in {"a": 0.0, "c": 2.95, "d": 3.98}.items()]
    others = [slipped("b", 1.5), slipped("e", 5.2)]
    assert unfixed([Contact(), begun], fitted, others).tolist() == untold
    assert began(begun, fitted, others) == said and began(Contact(), fitted, others) == ""


def varied(*effects: BaseTilt) -> tuple[Inquiry, Any]:
    """Of a tilt in each of three runs: the inquiry, and the tilt as found to vary."""
    asked = inquiry(*effects)
    study = asked.setting.study
    selection: Any = object.__new__(Selection)
    selection.floor = float(study.floor(asked.setting.train).sum())
    selection.excess = asked.base.total - selection.floor
    selection.measured, selection._joined = asked.measured, {}
    trial = Trial(("base_tilt",), {"effects.base_tilt.tilt_rad": 0.1})
    (plain,) = study.refit(asked.base.model, [trial], None)
    single = {"base_tilt": plain}
    assert selection.left(plain) > 0.3
    Variation(study, asked.base, study.screen(asked.base), selection.left, selection.gap).let(single)
    assert selection.left(single["base_tilt"]) < 0.02
    return asked, single["base_tilt"].effects[0]


def test_a_stand_that_is_knocked_is_found_and_when():
    """In the second of three runs; the third has it from the start."""
    make: Any = varying(BaseTilt)
    knock = make(tilt_rad=0.15, by_onset=1.0, onset_rad=0.4, over_rad=1e-3)
    asked, found = varied(BaseTilt(), knock, make(tilt_rad=0.15))
    runs = asked.setting.train
    assert float(found.onset_rad) == pytest.approx(runs[1].worn[0] + 0.4, abs=0.05)
    assert float(found.tilt_rad) == pytest.approx(0.15, abs=0.02)
    assert began(found, runs, ()).endswith(f" s into {runs[1].run.run_id}")


def test_a_robot_that_is_mounted_anew_for_each_run_is_found():
    make: Any = BaseTilt
    asked, found = varied(*(make(tilt_rad=x) for x in (0.12, -0.1, 0.03)))
    tilts = [float(found.tilt_rad) * (1 + float(getattr(found, f"in_run{r}"))) for r in (1, 2, 3)]
    np.testing.assert_allclose(tilts, [0.12, -0.1, 0.03], atol=0.01)
    runs = asked.setting.train
    assert by_run(found) and not began(found, runs, ())
    assert unfixed([found], runs, runs).all()


def test_the_noise_of_each_run_counts_by_its_samples():
    """A long run that is quiet beside a short one that is not."""
    runs: Any = [
        SimpleNamespace(t=np.zeros(6000), seen_noise=np.array([0.5])),
        SimpleNamespace(t=np.zeros(1000), seen_noise=np.array([2.0])),
    ]
    study: Any = object.__new__(Study)
    study.unit, study.motions = np.array([0.5]), runs
    np.testing.assert_allclose(study.floor(runs), [6000.0, 16000.0])
    np.testing.assert_allclose(study.noise, np.sqrt((6000 * 0.25 + 1000 * 4.0) / 7000))
