"""The blind check in small: labels stay sealed, answers are judged as told, and one robot goes through all of it."""

from __future__ import annotations

import json

import numpy as np
import pytest

from benchmarks.blind import cases, causes, judge, mujoco_plant, page, plant, seal, sensing, study
from benchmarks.recovery.experiments import plan
from benchmarks.recovery.robots import draw

SEED = 17
"""The first from 11 on whose first large effect has the plant's first shape: another shape may be what another effect
does, as an actuator_gain whose iron saturates is."""


def test_a_label_opens_only_after_the_answer_and_only_if_it_is_the_one_sealed(tmp_path):
    sealed, public, answer = tmp_path / "label.json", tmp_path / "public", tmp_path / "gap.json"
    public.mkdir()
    seal.close({"causes": ["contact"]}, sealed, public)
    with pytest.raises(PermissionError, match="stays closed"):
        seal.opened(sealed, public, answer)
    answer.write_text("{}")
    assert seal.opened(sealed, public, answer) == {"causes": ["contact"]}
    sealed.write_text(sealed.read_text().replace("contact", "base_tilt"))
    with pytest.raises(ValueError, match="not the one published"):
        seal.opened(sealed, public, answer)


def label(kind: str, *causes: str, tension: bool = True, gap: float = 10.0) -> dict:
    sensors = {"tension": tension, "pressure": True, "temperature": False}
    about = {"case_id": "case-1", "kind": kind, "causes": list(causes), "size": "large", "columns": 6}
    return {**about, "sensors": sensors, "gap_over_noise": gap, "theta_noise_rad": 1e-3}


def answer(first: str, *selected: str, verdict: str = "listed_effect", equivalent: tuple = ()) -> dict:
    return {
        "verdict": verdict,
        "effects": [{"id": first, "probability": 0.9}, {"id": "tip_payload", "probability": 0.1}],
        "selected": list(selected),
        "equivalent": [list(x) for x in equivalent],
        "where": [{"block": "actuation", "axis": "rate"}],
        "gap": {"closed_fraction": 0.9, "closed_fraction_ci95": [0.8, 1.0]},
    }


def test_answers_are_judged_by_the_rules():
    lag = judge.judge(label("effects", "actuator_lag"), answer("actuator_lag", "actuator_lag"), [2e-2, 2e-3])
    assert lag["top_right"] and lag["found"] and lag["block_right"] and lag["axis_right"]
    assert lag["closed"] == pytest.approx(1 - 3 / 399)
    assert lag["covered"]

    loaded = label("effects", "tip_payload")
    for shape, told in ((0, True), (4, False)):  # one put on between runs is unknown to a run replayed by itself
        row = judge.judge(
            loaded | {"forms": {"tip_payload": shape}}, answer("tip_payload", "tip_payload"), [2e-2, 2e-3]
        )
        assert (row["closed"] is not None) == told

    delay = answer("sensor_delay", "sensor_delay")  # where tension is measured it could have been told
    assert not judge.judge(label("effects", "actuator_delay"), delay, None)["top_right"]
    assert judge.judge(label("effects", "actuator_delay", tension=False), delay, None)["top_right"]
    both = delay | {
        "effects": [{"id": "sensor_delay", "probability": 0.6}, {"id": "actuator_delay", "probability": 0.3}]
    }
    stated = [judge.judge(label("effects", "actuator_delay", tension=t), both, None)["stated"] for t in (True, False)]
    assert stated == pytest.approx([0.6, 0.9])  # what counts as one when it is right, is stated as one

    near = answer("contact", "contact", equivalent=(("contact", "stiffness_hardening"),))
    row = judge.judge(label("effects", "stiffness_hardening"), near, None)
    assert row["found"] and not row["top_right"]

    both = label("pairs", "actuator_lag", "contact")
    assert judge.judge(both, answer("contact", "contact", "actuator_lag"), None)["exactly"]
    assert not judge.judge(both, answer("contact", "contact"), None)["found"]
    assert not judge.judge(both, answer("contact", "contact", "actuator_lag", "base_tilt"), None)["exactly"]

    nothing = judge.judge(label("controls", gap=0.0), answer("no_gap", verdict="no_gap"), None)
    assert nothing["top_right"] and not nothing["claimed"]
    assert judge.judge(label("controls", gap=0.0), answer("contact", "contact"), None)["claimed"]
    outside = judge.judge(label("unlisted", "dropout"), answer("unlisted_effect", verdict="unlisted_effect"), None)
    assert outside["unlisted"] and outside["top_right"]
    failed = judge.judge(label("effects", "contact"), None, None)
    assert failed["failed"] and failed["claimed"] and not failed["top_right"]


def test_a_deleted_effect_takes_its_known_confusions_with_it():
    def left_out(*causes: str) -> tuple[str, set[str]]:
        first, *ids = cases.Case("case-000", "without", causes, "large", 1).flags
        return first, set(ids)

    assert left_out("contact") == ("--without", {"contact"})
    assert left_out("actuator_delay")[1] == {"actuator_delay", "sensor_delay"}
    assert left_out("rest_curvature")[1] == {"rest_curvature", "base_tilt", "sensor_bias"}
    assert not cases.Case("case-000", "effects", ("contact",), "large", 1).flags


def test_the_scoreboard_counts_and_the_page_shows_failures(tmp_path):
    rows = [
        judge.judge(label("effects", "contact"), answer("contact", "contact"), [2e-2, 2e-3]),
        judge.judge(label("effects", "base_tilt"), answer("contact", "contact"), [2e-2, 2e-2]),
        judge.judge(label("effects", "base_tilt", gap=1.0), answer("contact", "contact"), None),  # too weak to count
        judge.judge(label("parameters", gap=0.0), answer("contact", "contact"), None),
    ]
    rows = [r | {"code": "abc1234", "case": f"case-{i:03d}"} for i, r in enumerate(rows)]
    quick, slow = {"ratio": 7.0, "fit_s": 1.0, "gap_s": 7.0}, {"ratio": 16.0, "fit_s": 1.0, "gap_s": 16.0}
    found = judge.scoreboard(rows, {"case-000": quick})
    by_name = {r["name"]: r for r in found["rows"]}
    assert (
        by_name["true cause ranked first"] | {"value": 0.5, "met": False, "cases": 2}
        == by_name["true cause ranked first"]
    )
    assert by_name["effect claimed where there is none"]["value"] == 1.0
    assert by_name["time of the diagnosis over that of ljjax fit"]["met"]
    longest = judge.scoreboard(rows, {"case-000": slow, "case-001": quick})["rows"][-1]
    assert (longest["value"], longest["met"], longest["cases"]) == (16.0, False, 2)
    assert found["calibration"]["ece"] == pytest.approx(0.9 - 1 / 3)
    # three answers of 0.9 in one bin: the mean of |k/3 - 0.9| over the binomial k of true probabilities
    chance = sum(w * abs(k / 3 - 0.9) for k, w in enumerate((0.001, 0.027, 0.243, 0.729)))
    assert found["calibration"]["by_chance"] == pytest.approx(chance, rel=0.1)
    kept = tmp_path / "answered.json"
    page.keep(found | {"seed": 1}, "make blind", kept)
    page.write(kept, tmp_path)
    text = (tmp_path / "blind.md").read_text()
    assert "| true cause ranked first | ≥ 0.90 | 0.5 | 0.09 – 0.91 | 2 | **missed** |" in text
    assert "as the code of commit abc1234 answered" in text
    assert "| effects | 2 | 0.5 |" in text and "| parameters | 1 | 0 |" in text
    assert text.count("| **no** |") == 3
    assert (tmp_path / "blind_confusion.png").exists() and (tmp_path / "blind_reliability.png").exists()
    assert "## With the seeds before it" not in text
    # another seed comes first, and counts together with the one before; the same one again in its place
    for _ in range(2):
        page.keep(judge.scoreboard(rows[:1], {"case-000": slow}) | {"seed": 2}, "make blind SEED=2", kept)
    page.write(kept, tmp_path)
    text = (tmp_path / "blind.md").read_text()
    first, together = text.split("## With the seeds before it")
    assert "make blind SEED=2\n" in first and "make blind\n" not in first and "on 1 robots" in first
    assert "| true cause ranked first | ≥ 0.90 | 1 |  | 1 | met |" in first and "seeds 1, 2," in together
    assert "| true cause ranked first | ≥ 0.90 | 0.667 | 0.21 – 0.94 | 3 | **missed** |" in together
    assert "| ≤ 15 | 16 |  | 2 | **missed** |" in together


def test_the_published_page_is_what_the_kept_answers_give(tmp_path):
    page.write(docs=tmp_path)
    assert (tmp_path / "blind.md").read_text(encoding="utf-8") == (page.DOCS / "blind.md").read_text(encoding="utf-8")


def test_every_shape_of_every_cause_changes_what_the_camera_sees_and_vanishes_at_strength_0():
    robot = draw(1, seed=1)[0]
    runs = plan(robot, 5.0, seed=1)[4:6]  # at all pressures
    setting = causes.Setting(max(float(run.tendons.max()) for run in runs), np.array([0.1, 0.1]), 5.0, 5.0)

    def angles(session, planted: plant.Causes):
        motions = session(robot.truth, planted, runs, 6)
        return np.concatenate([sensing.shape(motion, 6, planted, i) for i, motion in enumerate(motions)])

    for session, ids in ((plant.session, list(causes.CAUSES)), (mujoco_plant.session, list(mujoco_plant.IDS))):
        usual = angles(session, {})
        for name in ids:
            changes = set()
            shapes = causes.CAUSES[name].shapes[: None if session == plant.session else -len(cases.NEWEST)]
            for form, shape in enumerate(shapes):
                numbers = shape.numbers(np.random.default_rng(1), setting)
                there = angles(session, {name: causes.row(form, shape.start, numbers)})
                assert np.all(np.isfinite(there)), (name, form)
                changes.add(round(float(np.sqrt(np.mean((there - usual) ** 2))), 9))
                if session == plant.session:
                    without = angles(session, {name: causes.row(form, 0.0, numbers)})
                    assert np.allclose(without, usual, rtol=0, atol=1e-9), (name, form)
            assert 0.0 not in changes, name
            assert session != plant.session or len(changes) == len(shapes)  # no two the same


def test_robots_of_earlier_seeds_stay_what_they_were():
    """The last shapes of an effect, and the last causes outside the library, are of later seeds' robots."""

    def forms(seed: int, mujoco: bool = False) -> set[int]:
        return {cases._form(seed * 1000 + k, 0, 0, "contact", mujoco) for k in range(200)}

    before, first = len(causes.CAUSES["contact"].shapes) - len(cases.NEWEST), cases.NEWEST[0]
    for late, seed in enumerate(cases.NEWEST):
        assert forms(seed) == {*range(before + late + 1)}
        assert forms(seed - 1) == {*range(before + late)}
        assert forms(seed, mujoco=True) == {*range(before)}
    new = {cause.id for cause in causes.UNLISTED[cases.OUTSIDE_BEFORE :]}
    for seed, some in ((first - 1, set()), (first, new)):
        assert {c.causes[0] for c in cases.catalogue(seed, ("unlisted",))} & new == some
    for late, seed in enumerate(cases.NEWEST):
        assert cases.on_purpose(f"contact:{before + late}", 0, 0).seed // 10**6 == seed


def test_a_robot_made_on_purpose_has_the_causes_and_shapes_asked_for(monkeypatch):
    monkeypatch.setattr(cases, "SECONDS", 2.0)
    case = cases.on_purpose("actuator_delay:2+base_tilt:1", 3, SEED)
    _, _, planted, reached, asked = cases.planted(case, 0)
    assert {name: plant.form(x) for name, x in planted.items()} == {"actuator_delay": 2, "base_tilt": 1}
    assert case.kind == "pairs" and reached == pytest.approx(asked, rel=0.15)
    assert cases.on_purpose("actuator_delay:2+base_tilt:1", 3, SEED) == case != cases.on_purpose("contact:0", 3, SEED)
    for what, size in (("contact:1", "large"), ("contact:1:small", "small"), ("dropout:0", "")):
        assert cases.on_purpose(what, 0, SEED).size == size
    for wrong, line in (
        ("friction:0", "friction: no cause"),
        ("contact:9", "a shape from 0 to"),
        ("contact", "expected contact:SHAPE"),
        ("contact:0:huge", "small or large"),
        ("contact:0:small+base_tilt:0", "only of one effect"),
        ("contact:0+dropout:0", "two different ones that the library has"),
    ):
        with pytest.raises(ValueError, match=line):
            cases.on_purpose(wrong, 0, SEED)


def test_one_robot_from_the_draw_to_the_scoreboard(tmp_path, monkeypatch):
    """The first large effect of a seed, in shorter runs; the command in a process of its own."""
    monkeypatch.setattr(cases, "SECONDS", 5.0)
    (case,) = [c for c in cases.small_set(SEED) if c.kind == "effects"][:1]
    found = study.study([case], tmp_path, 1, timing=False)
    (row,) = found["cases"]
    folder = tmp_path / "cases" / case.case_id
    assert not row["failed"] and row["code"] == study.code()
    assert {p.name for p in folder.iterdir()} == {"logs", "model.toml", "label.sha256"}
    said = b"".join(p.read_bytes() for p in folder.rglob("*") if p.is_file())
    assert not any(cause.encode() in said for cause in case.causes)
    data = json.loads((tmp_path / "answers" / case.case_id / "gap.json").read_text())
    assert row["top_right"] and set(row["forms"].values()) == {0}, data["effects"][:3]
    again = study.study([case], tmp_path, 1, timing=False)  # what is done is kept
    assert again["cases"] == found["cases"]


def test_the_code_that_answers_is_that_beside_the_study(tmp_path, monkeypatch):
    """Whichever is installed: an answer is of the commit that it is said to be of."""
    (tmp_path / "ljjax").mkdir()
    (tmp_path / "ljjax" / "__main__.py").write_text("print('of this tree')\n", encoding="utf-8")
    (tmp_path / "ljjax" / "__init__.py").touch()
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.setattr(study, "ROOT", tmp_path)
    assert study.command([], tmp_path / "elsewhere").stdout == "of this tree\n"
