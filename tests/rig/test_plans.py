"""What a person writes for the rig: rig.toml, plans and schedules; and what a diagnosis asks for next."""

from __future__ import annotations

import json
import math
import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ljjax import law
from ljjax.errors import InputError
from ljjax.gap.experiment import EVERY_S, plan, protocols
from ljjax.law import Command
from ljjax.rig import config, experiments
from ljjax.rig.drivers import open_robot
from ljjax.rig.gate import Sent
from ljjax.rig.loop import run
from ljjax.rig.protocols import PROTOCOLS
from ljjax.rig.safety import Seen
from ljjax.rig.task import Point, follow, load_schedule

from .conftest import TOML, FakeClock, configured, make_law, mock_robot
from .test_faults import Kept

LIMITS = configured().limits
STILL, ZERO = Seen(0.0, 0.0), Sent()

RIGS = {
    "another schema": ("ljjax.rig/1", "ljjax.rig/2", "rig.toml: schema is 'ljjax.rig/2'; expected 'ljjax.rig/1'"),
    "an unknown key": ("p_atm_pa", "p_atm", "rig.toml: unknown key 'p_atm'; expected schema, robot_id"),
    "gauge for absolute": ("101325", "101.3", "rig.toml: p_atm_pa = 101.3; expected the atmosphere's pressure in Pa"),
    "a limit that is none": ("max_n = 30.0", "max_n = 0.0", "rig.toml: limits.tension_max_n = 0; must be > 0"),
    "a limit in words": ("max_n = 30.0", "max_n = 'much'", "limits.tension_max_n is 'much'; expected a finite number"),
    "NaN": ("max_n = 30.0", "max_n = nan", "limits.tension_max_n is nan; expected a finite number"),
    "a limit left out": ("theta_max_rad = 0.6", "", "rig.toml: limits.theta_max_rad is missing"),
    "a wrong limit": ("theta_max_rad", "theta_max_deg", "rig.toml: limits: unknown key 'theta_max_deg'"),
    "no vent and no hold": ("ramp_s", "vacuum = 'keep'\nramp_s", "safety.vacuum is 'keep'; expected 'vent' or 'hold'"),
    "no release": ("release_n_s = 40.0", "release_n_s = 0", "safety.release_n_s = 0; must be > 0"),
    "a driver without a name": ('driver = "mock"', "driver = 3", "rig.toml: driver is 3; expected a name in quotes"),
}


@pytest.mark.parametrize("case", RIGS)
def test_a_rig_that_cannot_be(case: str, tmp_path: Path):
    old, new, words = RIGS[case]
    text = TOML.format(safety="", mock="").replace(old, new)
    assert text != TOML.format(safety="", mock="")
    (tmp_path / "rig.toml").write_text(text)
    with pytest.raises(InputError) as refused:
        config.load(tmp_path / "rig.toml")
    assert words in str(refused.value)


def test_rigs_that_are_not_there_or_no_toml_and_drivers_nobody_knows(tmp_path: Path):
    with pytest.raises(InputError, match="none.toml: no such file"):
        config.load(tmp_path / "none.toml")
    (tmp_path / "rig.toml").write_text("[limits")
    with pytest.raises(InputError, match="rig.toml: not TOML"):
        config.load(tmp_path / "rig.toml")
    text = TOML.format(safety="", mock="").replace('"mock"', '"rocket"')
    with pytest.raises(InputError, match="driver is 'rocket'; expected mock"):
        open_robot(config.parse(tomllib.loads(text), "rig.toml"))
    with pytest.raises(InputError, match="mock: unknown key 'speed'"):
        open_robot(configured("", "speed = 1"))


def one(protocol: str, **keys: Any) -> experiments.Experiment:
    given = {"schema": "ljjax.plan/1", "runs": [{"protocol": protocol, **keys}]}
    return experiments.parse(given, "plan.toml", LIMITS).experiments[0]


def needed(protocol: str) -> dict[str, Any]:
    size = {"tension_n": 10.0, "vacuum_kpa": 20.0}
    lists = {"angles_deg": [2.0, -4.0], "vacuums_kpa": [0.0, 20.0]}
    return {key: (size | lists)[key] for key, value in PROTOCOLS[protocol][1].items() if value in (None, ())}


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_protocol_keeps_to_what_it_says_and_pulls_one_side_at_a_time(protocol: str):
    task = one(protocol, **needed(protocol))
    told = np.array([task.tick(t, STILL, ZERO) for t in np.arange(0.0, task.seconds, 0.01)])
    most = 20.2 if "vacuums_kpa" in needed(protocol) else 10.2
    assert told[:, :2].min() == pytest.approx(0.2) and told[:, :2].max() <= most + 1e-9
    assert (told[:, :2].min(axis=1) < 0.2 + 1e-9).all()
    assert np.ptp(told[:, :2]) > 5 or protocol == "probe_press"  # which leaves a straight body alone
    assert told[:, 2].min() >= 0 and told[:, 2].max() <= 20.0
    assert task.tick(-1.0, STILL, ZERO) == (0.0, 0.0, 0.0)


def test_the_shape_is_locked_while_the_tendon_lets_go():
    task = one("bend_vacuum_release", tension_n=10.0, vacuum_kpa=20.0)
    told = np.array([task.tick(t, STILL, ZERO) for t in np.arange(0.0, task.seconds, 0.01)])
    bent, drawn = told[:, 0] > 10, told[:, 2] > 19.9
    assert (bent & drawn).any() and (drawn & (told[:, 0] < 0.3)).any()
    assert told[0, 2] == 0 and told[np.argmax(bent), 2] == 0 and told[-1, 2] == pytest.approx(0.0, abs=0.5)


def test_held_angles_are_reached_on_a_robot():
    about, clock, log = configured(), FakeClock(), Kept()
    given = {"protocol": "hold_angles", "angles_deg": [4], "vacuums_kpa": [10], "move_s": 4.0, "rate_n_s": 8.0}
    made = experiments.parse({"schema": "ljjax.plan/1", "runs": [given]}, "p", about.limits)
    run(made.experiments[0], mock_robot(about, clock), about, log, clock=clock)
    held = [tick.reading.theta for tick in log.ticks if tick.state == 2][-200:]
    assert np.mean(held) == pytest.approx(math.radians(4), abs=2e-3)


GAPS = ("slow_triangle_vented", "slow_triangle_jammed", "fast_sweep", "pressure_steps", "long_hold", "staircase",
        "larger_angle", "one_sided")  # fmt: skip


@pytest.mark.parametrize("name", GAPS)
def test_what_the_diagnosis_planned_is_what_the_rig_does(name: str, tmp_path: Path):
    planned = protocols(10.0, 20.0)
    assert tuple(planned) == GAPS
    _, net, vacuum = planned[name]
    following = {"protocol": name, "separates": ["a", "b"], "plan": plan(name, 10.0, 20.0)}
    (tmp_path / "gap.json").write_text(json.dumps({"schema": "ljjax.gap/1", "next_experiment": following}))
    (task,) = experiments.load(tmp_path / "gap.json", LIMITS).experiments
    told = np.array([task.tick(k * EVERY_S, STILL, ZERO) for k in range(len(net))])
    assert task.name == name and task.seconds == pytest.approx(len(net) * EVERY_S)
    differs = np.abs(told[:, 0] - told[:, 1] - net) > 0.02 * np.abs(net).max() + 1e-6
    assert differs.mean() < 0.005  # a staircase's edge may come a sample earlier
    np.testing.assert_allclose(told[:, 2], vacuum, atol=1e-6)


def test_steady_measurements_that_a_diagnosis_asks_for():
    from ljjax.fit.points import Points
    from ljjax.gap.static_next import plan as steady_plan

    x = np.radians([2.0, 6.0, 2.0])
    for kind, protocol, count in (("steady", "hold_angles", 1), ("probe", "probe_press", 2)):
        points = Points(kind, x, x, np.array([5.0, 5.0, 15.0]), x, x, x.astype(int), x.astype(bool))
        runs = steady_plan(points)
        assert [r["protocol"] for r in runs] == [protocol] * count and runs[0]["vacuums_kpa"] == [5.0, 15.0]
        experiments.parse({"schema": "ljjax.plan/1", "runs": runs}, "gap.json", LIMITS)


PLANS = {
    "no protocol": ("protocol = 'jump'", "runs[0]: protocol is 'jump'; expected one of triangle"),
    "no tension": ("protocol = 'hold'", "runs[0]: hold: tension_n is missing; it needs tension_n, vacuum_kpa"),
    "too much tension": ("protocol = 'hold'\ntension_n = 40", "asks for 40.2 N; limits.tension_max_n is 30 N"),
    "too much vacuum": (
        "protocol = 'hold'\ntension_n = 4\nvacuum_kpa = 60", "asks for 60 kPa; limits.vacuum_max_kpa is 40 kPa"),
    "too far": (
        "protocol = 'hold_angles'\nangles_deg = [50]\nvacuums_kpa = [0]", "asks for 50°; limits.theta_max_rad is"),
    "an unknown key": ("protocol = 'hold'\ntension = 4", "hold: unknown key 'tension'; expected tension_n"),
    "a negative": ("protocol = 'hold'\ntension_n = -4", "hold: tension_n = -4; must be > 0"),
    "a number for a list": (
        "protocol = 'hold_angles'\nangles_deg = 4\nvacuums_kpa = [0]", "angles_deg is 4; expected a list of numbers"),
    "repeats": ("protocol = 'hold'\ntension_n = 4\nrepeat = 0", "repeat is 0; expected 1 to 1000"),
    "a path for a name": ("protocol = 'hold'\ntension_n = 4\nname = '../x'", "name is '../x'; expected letters"),
}  # fmt: skip


@pytest.mark.parametrize("case", PLANS)
def test_a_plan_that_cannot_be(case: str, tmp_path: Path):
    lines, words = PLANS[case]
    (tmp_path / "plan.toml").write_text(f'schema = "ljjax.plan/1"\n[[runs]]\n{lines}\n')
    with pytest.raises(InputError) as refused:
        experiments.load(tmp_path / "plan.toml", LIMITS)
    assert words in str(refused.value) and "plan.toml: runs[0]" in str(refused.value)


@pytest.mark.parametrize(("following", "words"), [(None, "nothing is left to part"), ({"protocol": "x"}, "no plan")])
def test_a_diagnosis_with_nothing_to_do(following: Any, words: str, tmp_path: Path):
    (tmp_path / "gap.json").write_text(json.dumps({"schema": "ljjax.gap/1", "next_experiment": following}))
    with pytest.raises(InputError, match=words):
        experiments.load(tmp_path / "gap.json", LIMITS)


def test_repeats_and_what_becomes_of_the_vacuum():
    runs = [{"protocol": "hold", "tension_n": 4, "name": "creep", "repeat": 3}]
    made = experiments.parse({"schema": "ljjax.plan/1", "runs": runs, "vacuum_after": "hold"}, "p", LIMITS)
    assert [task.name for task in made.experiments] == ["creep"] * 3 and made.vent is False


def test_schedules(tmp_path: Path):
    path = tmp_path / "schedule.toml"
    point = "[[points]]\nt_s = {}\ntheta_deg = {}\nstiffness_n_m = 5000\n"
    head = 'schema = "ljjax.schedule/1"\nseconds = 4\n'
    path.write_text(head + point.format(0, 9) + point.format(2, -9))
    points, seconds = load_schedule(path)
    assert seconds == 4 and points[1].t == 2 and points[1].command.theta == pytest.approx(-math.radians(9))
    follow(make_law(), points, seconds, 0.5)
    path.write_text(head + point.format(0, 9) + point.format(0, 2))
    with pytest.raises(InputError, match="points.1..t_s = 0 is not after 0"):
        follow(make_law(), *load_schedule(path), 0.5)
    path.write_text(head + "[[points]]\nt_s = 0\n")
    with pytest.raises(InputError, match="points.0.: expected t_s, theta_deg and stiffness_n_m"):
        load_schedule(path)


def test_commands_beyond_reach_are_refused():
    with pytest.raises(InputError, match="theta = 1.*out of reach"):
        follow(make_law(), [Point(0.0, Command(1.0, 5000.0))], 4.0, 0.5)
    with pytest.raises(InputError, match="stiffness = 10 N/m is out of reach"):
        follow(make_law(), [Point(0.0, Command(0.1, 10.0))], 4.0, 0.5)


def test_a_law_knows_what_the_gate_let_through():
    """Where the rig's own limits are tighter than the law's, the law goes on from what was sent."""
    task = follow(make_law(), [Point(0.0, Command(0.2, 5000.0))], 4.0, 0.0)
    state = law.start(task.law, 0.0, 0.0, 1.0, 1.0)
    left, right, _ = task.tick(0.0, STILL, Sent(1.0, 1.0, 0.0))
    assert (left, right) == law.tick(task.law, state, law.Measured(0.0, 0.0), Command(0.2, 5000.0))[1][:2]
    again = task.tick(0.005, STILL, Sent(1.0, 1.0, 0.0))
    assert abs(again[0] - 1.0) <= 200.0 * 0.005 + 1e-9 and abs(again[1] - 1.0) <= 200.0 * 0.005 + 1e-9


def test_what_the_docs_show_is_so(tmp_path: Path):
    text = (Path(__file__).parents[2] / "docs" / "rig.md").read_text(encoding="utf-8")
    rig, made, schedule = re.findall(r"```toml\n(.*?)```", text, re.DOTALL)
    about = config.parse(tomllib.loads(rig), "rig.toml")
    assert about.safety == config.Safety() and set(tomllib.loads(rig)["safety"]) == set(vars(config.Safety()))
    assert len(experiments.parse(tomllib.loads(made), "plan.toml", about.limits).experiments) == 2
    (tmp_path / "schedule.toml").write_text(schedule)
    assert load_schedule(tmp_path / "schedule.toml")[1] == 10
    for protocol, (_, keys) in PROTOCOLS.items():
        assert f"| `{protocol}` |" in text and all(key in text for key in keys)
    source = (Path(__file__).parents[2] / "rig" / "safety.py").read_text(encoding="utf-8")
    for name in re.findall(r'(?:latch|_Sensor|bad)\("([a-z_]+)"(?:, "([a-z_]+)")?', source):
        assert all(f"`{part}`" in text for part in name if part)
