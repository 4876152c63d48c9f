"""Which candidates the search begins, from where, and what it goes on with."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ljjax.effects import REGISTRY
from ljjax.effects.varying import varying
from ljjax.gap.candidates import CAUTIOUS, Trial
from ljjax.gap.channels import Measured
from ljjax.gap.scatter import NO_SCATTER
from ljjax.gap.screening import Column, Screen
from ljjax.gap.search import Study
from ljjax.gap.selection import Found, Selection
from ljjax.gap.variation import Variation


def test_pairs_are_begun_on_few_runs_where_no_effect_comes_near():
    selection: Any = object.__new__(Selection)
    asked: list[str] = []
    selection.study = SimpleNamespace(kinds=list(REGISTRY.values()), start=None)
    selection.study.refit = lambda *_, stage, finish: asked.append(stage) or ["whole"]
    selection._on_few = lambda trials, found, stage, finish: asked.append(f"{stage}, few") or ["few"]
    selection._from_given = SimpleNamespace()
    singles: Any = [SimpleNamespace(ids=(i,), free_effects={}) for i in ("contact", "base_tilt")]
    assert selection._pairs(singles, hopeless=True) == ["few"]
    assert selection._pairs(singles, hopeless=False) == ["whole"]
    assert asked == ["pairs, few", "pairs"]


def test_the_pair_that_promises_most_is_tried_though_another_effect_promises_more_than_either():
    """In each run a robot does what two effects do; a third one resembles their sum, and each alone does little."""
    rng = np.random.default_rng(2)
    q = np.linalg.qr(rng.standard_normal((400, 4)))[0].T
    traces = {
        "contact": q[2],
        "tip_payload": q[0] + 0.8 * q[2],
        "actuator_gain": 0.5 * q[0] + 0.5 * q[1] + 0.2 * q[3],
        "base_tilt": q[1] - 0.8 * q[2],
    }
    columns = [Column(i, 0, next(iter(REGISTRY[i].sizes())), -1e9, 1e9, 10.0) for i in traces]
    j = np.stack(list(traces.values()), axis=1)
    gram, score = j.T @ j, j.T @ (3 * traces["tip_payload"] + 2 * traces["base_tilt"])
    forms: Any = {(c.id, 0): {"form": 7.0} for c in columns}
    alone = {(c.id, 0): float(s**2 / g) for c, s, g in zip(columns, score, np.diag(gram), strict=True)}
    assert max(alone, key=lambda k: alone[k])[0] == "actuator_gain"
    seen = Screen(columns, forms, gram, score, np.ones(1), alone, alone, {}, {}, np.zeros((2, 1, 1)))
    ((ids, values), second) = seen.promised(2)
    assert set(ids) == {"tip_payload", "base_tilt"} != set(second[0])
    sizes = {i: [x for n, x in values[i].items() if n != "form"] for i in ids}
    assert sizes["tip_payload"][0] == pytest.approx(3, rel=0.02)
    assert sizes["base_tilt"][0] == pytest.approx(2, rel=0.02)

    asked: dict[str, list[Trial]] = {}
    selection: Any = object.__new__(Selection)
    selection.screen = selection._from_given = seen
    selection.base = SimpleNamespace(model="the base")
    selection.study = SimpleNamespace(
        start="as given",
        kinds=list(REGISTRY.values()),
        refit=lambda like, trials, *_, **__: [*asked.setdefault(like, trials)],
    )
    tried = selection._promised()
    whole, less = asked["as given"][0], asked["the base"][len(asked["as given"])]
    assert whole is asked["the base"][0] and tried.count(whole) == 2 and less in tried
    assert set(whole.ids) == set(less.ids) == {"tip_payload", "base_tilt"} and whole.size == 4
    assert whole.start["effects.base_tilt.form"] == less.start["effects.base_tilt.form"] == 7.0
    first = next(p for p in whole.start if not p.endswith(".form"))
    assert less.start[first] == pytest.approx(0.3 * whole.start[first])


def test_no_gap_is_unexplained_before_every_effect_has_been_tried():
    """Of all effects the one that explains the runs is that of which the derivative promises least."""
    kinds, cause = list(REGISTRY.values()), "tendon_slack"
    keys = {(k.id, 0): float(k.id != cause) * (2 + i) for i, k in enumerate(kinds)}
    columns = [Column(k.id, 0, next(iter(k.sizes())), -1.0, 1.0, 1.0) for k in kinds]
    steps = {(c.id, 0): {c.name: 0.1} for c in columns}
    none: Any = np.zeros((2, 0))
    forms: dict[tuple[str, int], dict[str, float]] = {k: {} for k in keys}
    still = {k: np.zeros(0) for k in keys}
    seen = Screen(columns, forms, none, none, none, keys, keys, steps, still, none)

    def refitted(trial: Trial, explains: str) -> Any:
        total = 101.0 if trial.ids == (explains,) else 900.0
        loss, start = np.array([total / 2, total / 2]), dict(trial.start)
        return SimpleNamespace(
            trial=trial, ids=trial.ids, total=total, loss=loss, free_effects=start, scatter=NO_SCATTER
        )

    def tried(explains: str) -> tuple[list[str], set[str]]:
        """The effects refitted to all runs, the last last, and all of them begun."""
        begun: set[str] = set()

        class Told(Study):
            def screen(self, from_, forms_of=None):
                return seen

            def refit(self, like, trials, screen, steps=None, stage="", finish=1, sure=0, within=np.inf):
                begun.update(t.ids[0] for t in trials)
                return [refitted(t, explains) for t in trials]

            def weeded(self, like, trials, screen, stage):
                return self.refit(like, trials, screen)

            def taken_over(self, refits, stage, finish, further):
                return list(refits)

        any_: Any = None
        selection: Any = object.__new__(Selection)
        selection.study = Told(any_, (), kinds, (any_, any_), 0.0, {})
        estimate = SimpleNamespace(windows=SimpleNamespace(sample_run=np.arange(2)))
        selection.screen = seen
        selection.base = SimpleNamespace(model=None, total=1000.0, loss=np.array([400.0, 600.0]), estimate=estimate)
        selection.given, selection.measured = selection.base, Measured([])
        selection.floor, selection.excess = 100.0, 900.0
        selection._promising = lambda: True
        return [r.ids[0] for r in selection._leaders()], begun

    refits, begun = tried(cause)
    assert begun == set(REGISTRY)
    assert refits[-1] == cause  # it alone was worth refitting to all runs
    first = max(keys, key=lambda k: keys[k])[0]
    assert cause not in tried(first)[1]  # what explains the runs at once leaves the rest untried


@pytest.mark.parametrize("alone, leaves, kept", [(0.4, 0.05, True), (0.4, 0.2, False), (0.2, 0.01, True)])
def test_where_no_second_effect_is_worth_it_one_is_looked_for_beside_the_first_as_it_was_before_it_varied(
    alone, leaves, kept, monkeypatch
):
    """The first does the second's part by varying."""

    def refitted(trial: Trial, left: float) -> Any:
        more: Any = {"fitted": (), "free_effects": trial.start, "scatter": NO_SCATTER}
        return SimpleNamespace(trial=trial, ids=trial.ids, total=100 + 900 * left, **more)

    plain = refitted(Trial(("contact",), {"effects.contact.stop": 7.0}), 1.2 * alone)
    first = refitted(Trial(("contact",), {"effects.contact.stop": 3.0, "effects.contact.by_bend": 2.0}), alone)
    monkeypatch.setattr(Variation, "let", lambda self, single: self.steady.update(contact=plain))
    monkeypatch.setattr(Variation, "of_several", lambda self, refits: [])
    grounds: list[Any] = []

    def further(best, unit) -> list[Any]:
        grounds.append(best)
        if best is plain:
            return [refitted(Trial(("contact", "sensor_bias")), leaves)]
        return [refitted(Trial(("contact", "base_tilt")), 0.95 * alone)]

    selection: Any = object.__new__(Selection)
    selection.floor, selection.excess, selection.measured = 100.0, 900.0, Measured([])
    selection.left = lambda refit: (refit.total - 100) / 900
    selection.unit_of = lambda refit: 1e-4
    selection._further = further
    selection._pairs = lambda singles, hopeless: []
    selection._promised = lambda: []
    selection._prune = selection._exchange = lambda *_: None
    selection._mounted = lambda *_: []
    selection.base = selection.screen = selection.study = None
    found = selection._forward([first])
    assert grounds[:2] == [first, plain]
    assert found.best.ids == (("contact", "sensor_bias") if kept else ("contact",))


@pytest.mark.parametrize("leaves, kept", [(0.01, {"sensor_bias"}), (0.3, set())])
def test_a_second_effect_may_be_another_in_each_run(leaves, kept, monkeypatch):
    """Of four runs the second and the fourth tell most: what a bias is there is where it begins in the others."""
    monkeypatch.setattr("ljjax.gap.selection.level", lambda kind, model, count: model)
    sudden = {i: varying(k, (1.0, 2.0, 3.0)) for i, k in REGISTRY.items() if k.sudden}
    known: list[Any] = []
    all_runs: list[Trial] = []
    staying: dict[str, Any] = {}

    def refitted(trial: Trial, left: float) -> Any:
        return SimpleNamespace(trial=trial, ids=trial.ids, free_effects=trial.start, total=left, model=trial)

    asym = refitted(Trial(("friction_asymmetry",), {"effects.friction_asymmetry.share": 0.3}), 0.5)
    hysteresis = refitted(Trial(("layer_hysteresis",), {"effects.layer_hysteresis.torque_nm": 0.1}), 0.4)
    pair = refitted(Trial(("layer_hysteresis", "friction_asymmetry")), 0.1)

    def told_by_few(study, trials, found, stage) -> list[Any]:
        known.append((found, trials))
        found = [t for t in trials if t.ids == ("friction_asymmetry", "sensor_bias")]
        return [refitted(Trial(t.ids, {**t.start, "effects.sensor_bias.in_run2": 3.0}), 0.1) for t in found[:1]]

    def refit(like, trials, screen, stage) -> list[Any]:
        all_runs.extend(trials)
        return [refitted(t, leaves) for t in trials]

    selection: Any = object.__new__(Selection)
    selection.left, selection.base = lambda refit: refit.total, SimpleNamespace(loss=np.array([1.0, 5.0, 2.0, 9.0]))
    selection._told_by_few = told_by_few
    steps = {(i, 0): Trial((i,), {f"effects.{i}.{next(iter(k.sizes()))}": 0.1}) for i, k in REGISTRY.items()}
    trial = lambda screen, key: (steps[key], None)  # noqa: E731
    selection.study = SimpleNamespace(kinds=list(REGISTRY.values()), motions=[None] * 4, trial=trial, refit=refit)
    selection._from_given = SimpleNamespace(best=lambda i: (i, 0))
    variation: Any = SimpleNamespace(plain={}, by_run=lambda: sudden, only=lambda _: selection.study)
    variation.keep = staying.update
    found = selection._mounted(variation, [hysteresis, asym], [pair])
    assert found[0].ids == ("friction_asymmetry", "sensor_bias")
    assert [g[0].ids for g, _ in known][:2] == [("layer_hysteresis",), ("friction_asymmetry",)]
    assert {t.ids[1] for _, trials in known for t in trials} == {*sudden}
    names = [f"effects.sensor_bias.in_run{k}" for k in (1, 2, 3, 4)]
    few = [t for t in known[1][1] if t.ids[1] == "sensor_bias"]
    assert [few[0].start.get(n) for n in names] == [None, 0.0, None, None]
    freely, anchored = (t.start for t in all_runs)
    assert [freely[n] for n in names] == pytest.approx([3.0, 3.0, 1.5, 0.0])
    assert [anchored.get(n) for n in names] == pytest.approx([None, 0.0, -0.375, -0.75]), "largest in the first"
    assert anchored["effects.sensor_bias.offset_rad"] == 4 * freely["effects.sensor_bias.offset_rad"] != 0
    assert {*staying} == kept


def test_a_further_effect_whose_first_step_leads_astray_is_begun_again_with_care():
    """Of two further effects one at first leaves more than without it, and begun nearer explains the rest."""
    asked: dict[str, tuple[Any, list[Trial], Any]] = {}
    onto: Any = SimpleNamespace(
        ids=("contact",), total=500.0, model="with contact", free_effects={"effects.contact.stop": 7.0}
    )
    tilted, biased = (
        Trial(("contact", i), {"effects.contact.stop": 7.0, f"effects.{i}.{n}": 0.1})
        for i, n in (("base_tilt", "tilt_rad"), ("sensor_bias", "offset_rad"))
    )
    steps = {("base_tilt", 0): (tilted, np.array([0.02])), ("sensor_bias", 0): (biased, np.array([0.01]))}

    def refit(like, trials, screen, steps=None, stage="", finish=1, sure=0):
        asked[stage] = like, list(trials), steps
        left = {"several effects": {"base_tilt": 5e5, "sensor_bias": 450.0}, "several effects, with care": {}}[stage]
        return [SimpleNamespace(trial=t, ids=t.ids, total=left.get(t.ids[1], 101.0)) for t in trials]

    selection: Any = object.__new__(Selection)
    selection.floor, selection.excess, selection.measured = 100.0, 400.0, Measured([])
    selection.left = lambda refit: (refit.total - 100) / 400
    keys = {k: 1.0 for k in steps}
    seen = SimpleNamespace(ids=[k[0] for k in keys], best=lambda i: (i, 0), gains=keys, firm=keys)
    selection.study = SimpleNamespace(
        kinds=list(REGISTRY.values()), refit=refit, screen=lambda _: seen, trial=lambda _, key, onto: steps[key]
    )
    more = selection._further(onto, 1e-4)

    like, (again,), less = asked["several effects, with care"]
    assert like == "with contact" and again.ids == ("contact", "base_tilt")
    assert again.start == {"effects.contact.stop": 7.0, "effects.base_tilt.tilt_rad": pytest.approx(0.1 * CAUTIOUS)}
    assert less[again] == pytest.approx(0.02 * CAUTIOUS)
    assert min(more, key=selection.left).trial is again


@pytest.mark.parametrize(
    "known, anew, uses, best",
    [
        (0.12, 0.05, 1, "actuator_delay"),
        (0.12, 0.3, 1, "actuator_lag"),
        (0.005, 0.001, 2, "actuator_delay"),  # by less: a parameter more is worth that
        (0.002, 0.001, 4, "actuator_lag"),  # hardly: two of each are not
    ],
)
def test_an_effect_tried_beside_another_before_is_begun_anew_where_that_one_is_known(known, anew, uses, best):
    """A tilt leaves less with a lag than with a delay as that was begun at first."""

    def refitted(ids: tuple[str, ...], left: float) -> Any:
        used = dict.fromkeys(ids, uses if delay in ids else 1)
        more: Any = {"used": lambda free: used, "trial": Trial(ids), "scatter": NO_SCATTER}
        return SimpleNamespace(ids=ids, total=100 + 900 * left, model=ids, **more)

    tilt, lag, delay = "base_tilt", "actuator_lag", "actuator_delay"
    pair = refitted((lag, tilt), known)
    found = Found({i: refitted((i,), 0.5) for i in (tilt, lag)}, {}, pair)
    found.joint = {(lag, tilt): pair, (delay, tilt): refitted((delay, tilt), 0.2)}
    asked: list[tuple[str, ...]] = []

    def refit(like, trials, screen, steps, stage, finish):
        asked.append(like)
        return [refitted(t.ids, anew) for t in trials if t.ids == (delay, tilt)]

    selection: Any = object.__new__(Selection)
    selection.floor, selection.excess = 100.0, 900.0
    selection.left = lambda refit: (refit.total - 100) / 900
    selection.unit_of = lambda refit: 1e-5
    selection._begun = lambda screen, keys, onto: {Trial((delay, *onto.ids)): np.zeros(0)}
    selection._anew = lambda refits: []
    seen = SimpleNamespace(ids=[], gains={}, firm={})
    selection.study = SimpleNamespace(refit=refit, screen=lambda _: seen)
    selection._exchange(found)
    assert {(tilt,), (lag,)} == set(asked)
    assert found.best.ids == (best, tilt)
    assert found.joint[(delay, tilt)].total == pytest.approx(100 + 900 * min(anew, 0.2))
