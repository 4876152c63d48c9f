"""The page of a moving diagnosis and the layout of its overlay, from small diagnoses made by hand."""

from __future__ import annotations

import dataclasses
import json
import re
from types import SimpleNamespace as Some
from typing import Any

import numpy as np
import pytest

from ljjax import effects, page
from ljjax.data import OCTROBOT
from ljjax.gap import report, where
from ljjax.gap.answer import worse
from ljjax.gap.candidates import in_words
from ljjax.gap.layout import layout
from ljjax.gap.result import LAST, Diagnosis, Finding, Gap, Region
from ljjax.gap.story import Story, cards, headline
from ljjax.logs import Run, Signal
from ljjax.modelfile import load

SAMPLES, NOISE = 120, 1e-3
LAG, DELAY = "actuator_lag", "actuator_delay"
EVIL = "run <script>alert(1)</script> & co"


def logged(name: str, joints: int, start_s: float) -> Run:
    t = np.linspace(0, 6, SAMPLES)
    shape = Signal(t, np.zeros((SAMPLES, joints)), tuple(f"q{k}" for k in range(joints)), "rad", "/real/shape")
    return Run(f"{name[:3]}.mcap", "c" * 64, 10**18 + int(start_s * 1e9), {"shape": shape}, {"run_id": name})


def motion(run: Run, joints: int) -> Any:
    t = np.linspace(0, 6, SAMPLES)
    pull = 10 * np.sin(t)
    return Some(
        run=run,
        input_t=t,
        tendons=np.stack([np.maximum(pull, 0), np.maximum(-pull, 0)], axis=1),
        vacuum=np.where(t < 3, 0.0, 20.0),
        noise=np.full(joints, NOISE),
    )


def estimate(motions: list, joints: int, error: float, seed: int) -> Any:
    """Predictions off a sine by so much [rad]."""
    rng = np.random.default_rng(seed)
    t = np.tile(np.linspace(0, 6, SAMPLES), len(motions))
    y = 0.2 * np.sin(t)[:, None] * np.ones(joints) + NOISE * rng.normal(size=(len(t), joints))
    predicted = y + NOISE * rng.normal(size=y.shape) + error * np.cos(t)[:, None]
    windows = Some(sample_run=np.repeat(np.arange(len(motions)), SAMPLES), sample_t=t, y=y, shape=lambda x: x)
    names = ("elastic.c3", "friction.mu_c")
    problem = Some(motions=motions, coordinates=Some(names=names))
    return Some(windows=windows, problem=problem, predicted=predicted, error=y - predicted)


def refit(motions: list, joints: int, error: float, ids: tuple[str, ...], seed: int) -> Any:
    return Some(ids=ids, estimate=estimate(motions, joints, error, seed), model=load(OCTROBOT / "nominal.toml").model)


def diagnosed(
    verdict: str, ids: tuple[str, ...] = (), joints: int = 1, name: str = "run-1", **change: Any
) -> Diagnosis:
    """Two runs fitted and one not, the given model off by 0.1 rad, the base by 0.03, what is selected by 0.003."""
    given = load(OCTROBOT / "nominal.toml")
    runs = [logged(n, joints, 60.0 * k) for k, n in enumerate((name, "run-2", "unseen"))]
    train, test = [motion(r, joints) for r in runs[:2]], [motion(runs[2], joints)]
    base, before = refit(train, joints, 0.03, (), 1), refit(train, joints, 0.1, (), 0)
    single = {i: refit(train, joints, e, (i,), 2) for i, e in ((LAG, 0.005), (DELAY, 0.01))}
    chosen = refit(train, joints, 0.003, ids, 3) if ids else base
    seen = [estimate(test, joints, e, 4) for e in ((0.03, 0.003, 0.1) if ids else (0.03, 0.1))]
    kinds = [effects.REGISTRY[i] for i in (LAG, DELAY, "tip_payload")]
    study = Some(kinds=kinds, noise=np.full(joints, NOISE), start=given.model, predict=lambda r, m: [seen[0]] * len(r))
    channel = Some(name="tension", rms=0.4, noise=0.1, left={LAG: 0.1}, best=LAG, speaks=True)
    inquiry: Any = Some(
        setting=Some(study=study, test=test),
        base=base,
        given=before,
        screen=Some(best=lambda i: (i, 0), alike=lambda a, b: 0.87),
        found=Some(single=single, joint={}, best=chosen, exchanged=[]),
        measured=Some(channels=change.pop("channels", [channel])),
        evidence=Some(left={LAG: 0.1, DELAY: 0.4}),
    )
    story = Story(inquiry, chosen, seen)
    lag = {"tau_s": {"value": 0.0612, "sd": 0.0017, "unit": "s"}}
    first = ids[0] if ids else verdict
    order = sorted([LAG, DELAY, "tip_payload", *LAST], key=lambda i: i != first)
    found = [
        Finding(i, 0.93 if i == first else 0.014, None if i in LAST else 0.42, 0.03, lag if i == LAG else {})
        for i in order
    ]
    whole: dict[str, Any] = {
        "verdict": verdict,
        "gap": Gap("theta", "rad", 0.0215, 0.0041, NOISE, 0.96, (0.91, 0.99), ("unseen",), 0.0707),
        "where": [Region("actuation", "theta", "rate", (0.1, 0.5), "rad/s", 0.7)],
        "effects": found,
        "selected": list(ids),
        "equivalent": [[LAG, DELAY]] if ids else [],
        "minimum_detectable": {LAG: {"parameter": "tau_s", "value": 0.0023, "unit": "s"}},
        "next_experiment": {
            "protocol": "fast_sweep", "separates": [LAG, DELAY], "expected_separation": 4.7, "why": "they part <fast>",
        },
        "base": given,
        "model": given,
        "runs": runs,
        "roles": ["train", "train", "held_out"],
        "said": ["left out: old.mcap: no excitation"],
        "warnings": ["take <care>"],
        "seed": 3,
        "options": {"without": [], "inputs": "commands", "model": "a.toml"},
        "story": story,
        "overlays": [{}, {}, {}],
    }  # fmt: skip
    return Diagnosis(**{**whole, **change})


def words(page: str) -> str:
    """What a reader sees, without pictures and marks."""
    page = re.sub(r"<style>.*?</style>", "", page, flags=re.S)
    return re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", page))


@pytest.fixture(scope="module")
def told() -> tuple[str, str]:
    """The page of an actuator lag, and its words."""
    d = diagnosed("listed_effect", (LAG,), name=EVIL)
    page = d.report(d.as_dict())
    return page, words(page)


def test_the_page_says_what_gap_json_says(told):
    page, text = told
    for said in (
        "The model lacks actuator lag",
        "falls from 1.23° to 0.235° (noise 0.0573°)",
        "1.23° → 0.235°",
        "96 % of the gap closed on unseen runs (95 %: 91 to 99 %)",
        "93 % probability that the main cause is: actuator lag",
        "actuation theta rate 5.73 … 28.6 deg/s 70 %",
        "tau_s 0.0612 ± 0.0017 s",
        "actuator lag, actuator delay : with any of them",
        "Fast sweep parts actuator lag from actuator delay best, by 4.7 × the noise. They part",
        "actuator lag actuation tau_s 0.0023 s 0.0612",
        "measured tension 0.4 0.1 N actuator lag explains 90 %",
        "take",
        "left out: old.mcap: no excitation",
        "a.toml",
        "Seed 3",
        "unseen not fitted",
    ):
        assert said in text, said
    titles = re.findall(r"<strong>([^<]*), ((?:not )?fitted).</strong>", page)
    assert titles[0] == ("unseen", "not fitted") and ("run-2", "fitted") in titles


def test_an_estimate_that_is_nothing_beside_its_deviation_reads_0():
    assert page.estimate(5.4e-21, 9.3e-5) == "0 ± 9.3e-05"
    assert [page.estimate(-0.0612, 0.0017), page.estimate(2e-5, None)] == ["-0.0612 ± 0.0017", "2.00e-05 ± –"]


def test_what_logs_and_options_say_is_escaped(told):
    page, _ = told
    assert "<script" not in page and "<care>" not in page and "<fast>" not in page
    assert "run &lt;script&gt;" in page


@pytest.mark.parametrize(
    ("verdict", "said"),
    [
        ("no_gap", "No gap: the given model errs by 4.05°"),
        ("unlisted_effect", "the best listed effect would leave 10 % of the gap"),
    ],
)
def test_an_answer_without_an_effect_is_told_in_words(verdict, said):
    gap = Gap("theta", "rad", 0.0215, 0.0215, NOISE, None, None, ("unseen",), 0.0707)
    d = diagnosed(verdict, gap=gap, where=[], next_experiment=None, minimum_detectable={}, channels=[])
    page = d.report(d.as_dict())
    text = words(page)
    assert said in text and "The model lacks" not in text and "with the effects" not in text
    assert ("given model" in "".join(re.findall(r"<strong>Map, ([^<]*)", page))) == (verdict != "unlisted_effect")


def test_a_refit_that_suffices_is_told_in_words():
    d = diagnosed("parameters_only")
    said = (
        "refitting the model’s own parameters closes the gap. The error on 1 run that no fit has seen falls from 4.05°"
    )
    assert said in headline(d.story, d) and cards(d)[0][0] == "Parameters only"
    assert d.story.models(d) == ["given", "base"] and len(d.story.steps) == 2


def test_two_effects_close_the_gap_one_after_the_other():
    d = diagnosed("listed_effect", (LAG, DELAY), joints=3, equivalent=[])
    assert [s.what for s in d.story.steps] == ["given model", "base refitted", "+ actuator lag", "+ actuator delay"]
    assert [s.test for s in d.story.steps] == pytest.approx([0.0689, 0.0207, 0.0207, 0.0023], rel=0.05)
    text = words(d.report(d.as_dict()))
    assert "Joint by joint" in text and "joint 1, in which the base errs most" in text


def test_places_are_told_in_words():
    places = [
        Region("friction", "theta", "direction", (-1.0, 0.0), "1", 0.5),
        Region("friction", "theta", "run", (1.0, 2.0), "1", 0.3),
        Region("sensing", "theta", "everywhere", (0.0, 0.0), "1", 0.2),
    ]
    d = diagnosed("listed_effect", (LAG,), where=places)
    text = words(report._regions(d.story, d))
    assert "direction back to straight" in text and "run run-1 … run-2" in text and "everywhere everywhere" in text


def test_of_many_runs_eight_are_drawn():
    d = diagnosed("listed_effect", (LAG,))
    many = [dataclasses.replace(c, run_id=f"run-{k}") for k in range(4) for c in d.story.courses]
    d.story.courses = many
    drawn, which = report._drawn(d.story)
    assert len(drawn) == 8 and which.startswith("8 of 12 runs")


def test_the_layout_shows_measured_model_and_what_is_left():
    made = json.loads(json.dumps(layout([logged("a", 2, 0.0)])))
    paths = {p["value"] for panel in made["configById"].values() for p in panel["paths"]}
    for topic in ("/real/shape", "/sim/shape", "/residual/shape"):
        assert {f"{topic}.position[{k}].@rad2deg" for k in (0, 1)} <= paths
    assert {"/real/tendons.effort[1]", "/real/cmd/pressure.fluid_pressure"} <= paths

    def leaves(node):
        return [node] if isinstance(node, str) else leaves(node["first"]) + leaves(node["second"])

    assert sorted(leaves(made["layout"])) == sorted(made["configById"])
    assert all(p["timestampMethod"] == "headerStamp" for x in made["configById"].values() for p in x["paths"])
    assert layout([])["layout"]


@pytest.mark.parametrize(
    ("before", "after", "chosen", "said"),
    [(2.0, 5.0, ["contact"], 1), (1.05, 3.0, ["contact"], 1), (5.0, 2.0, ["contact"], 0), (1.0, 1.02, ["contact"], 0)],
)
def test_effects_that_make_unseen_runs_worse_are_not_left_unsaid(before, after, chosen, said):
    """Errors in units of the noise, near which there is no closed fraction."""
    gap = Gap("theta", "rad", before * NOISE, after * NOISE, NOISE, None, None, ("unseen",))
    lines = worse(gap, chosen)
    assert len(lines) == said
    assert all("unseen" in line and "contact" in line and "do not trust" in line for line in lines)
    assert worse(gap, []) == []


def test_everywhere_is_the_place_only_of_what_no_axis_shows_more_plainly(monkeypatch):
    """Of two effects one lies at large loads, the other is an offset; half of the gap each."""
    load = np.linspace(0.0, 10.0, 200)
    monkeypatch.setattr(where, "coordinates", lambda found: {"load": load, "angle": load[::-1]})
    loud, offset = np.where(load > 8, 1.0, 0.0)[:, None], np.full((200, 1), 0.2**0.5)
    found = where.places(
        None,  # type: ignore[arg-type]
        "theta",
        [
            where.Contribution("actuation", ("load", "everywhere", "angle"), loud),
            where.Contribution("sensing", ("everywhere", "angle"), offset),
        ],
    )
    assert {(r.block, r.axis) for r in found[:2]} == {("sensing", "everywhere"), ("actuation", "load")}
    assert ("actuation", "everywhere") not in {(r.block, r.axis) for r in found}
    assert next(r for r in found if r.axis == "load").range[0] == pytest.approx(8.0, abs=0.5)


def test_a_lesser_axis_is_no_place_where_it_takes_all_of_it_to_hold_as_much(monkeypatch):
    """Loud at high vacuum, whichever way the robot moves: from −1 to 1 the direction holds all and says nothing."""
    vacuum, way = np.linspace(0.0, 40.0, 400), np.tile([-1.0, 1.0], 200)
    monkeypatch.setattr(where, "coordinates", lambda found: {"pressure": vacuum, "direction": way, "angle": way})
    part = where.Contribution("jamming", ("pressure", "direction"), np.where(vacuum > 20, 1.0, 0.1)[:, None])
    found = where.places(None, "theta", [part])  # type: ignore[arg-type]
    assert [r.axis for r in found] == ["pressure"]


def test_segments_are_told_by_the_joints_where_their_mean_alone_is_measured(monkeypatch):
    angle = np.linspace(0.0, 0.3, 200)
    monkeypatch.setattr(where, "coordinates", lambda found: {"angle": angle})
    joints = np.outer(angle, [0.0, 0.1, -1.0, 1.0, 0.0, 0.0])
    part = where.Contribution("structure", ("segment", "angle"), 0.1 * angle[:, None], joints)
    first = where.places(None, "theta", [part])[0]  # type: ignore[arg-type]
    assert (first.axis, first.range) == ("segment", (3.0, 4.0))


@pytest.mark.parametrize("effect", effects.REGISTRY)
def test_an_effect_is_described_by_a_whole_clause(effect):
    kind = effects.REGISTRY[effect]
    said, whole = in_words(kind), " ".join((kind.__doc__ or "").split())
    assert len(said.split()) > 1 and not said[0].isupper()
    assert whole.lower().startswith(said.lower()) and whole[len(said) :].startswith((". ", ".", ",", ";", ":", " ("))
