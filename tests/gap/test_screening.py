"""What the screen reads off residuals before anything is refitted."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ljjax.effects import REGISTRY
from ljjax.gap.candidates import Trial, either_side, pilots, sizes
from ljjax.gap.screening import Column, beat, clock, gather, waves


def residuals(true: float, noise: float = 0.002) -> Any:
    """Of two runs over bends of ±1.5 rad, a wave of `true` 1/rad in them that the vacuum makes smaller."""
    rng = np.random.default_rng(5)
    t = np.linspace(0.0, 10.0, 800)
    motion = SimpleNamespace(q0=np.zeros(6), input_t=t, vacuum=np.where(t < 5, 0.0, 20.0))
    bend = np.concatenate([1.5 * np.sin(2 * np.pi * k * t / 10) for k in (2, 3)])
    size = np.tile(np.where(t < 5, 0.004, 0.002), 2)
    error = size * np.sin(true * bend + 0.7) + 0.01 * bend**2 + noise * rng.standard_normal(len(bend))
    windows = SimpleNamespace(
        y=bend[:, None] / 6, sample_run=np.repeat([0, 1], len(t)), sample_t=np.tile(t, 2), shape=lambda x: x
    )
    return SimpleNamespace(
        windows=windows, problem=SimpleNamespace(motions=[motion, motion]), shape_error=error[:, None]
    )


@pytest.mark.parametrize("true", [9.0, 23.0, 71.0])
def test_a_ripple_is_found_among_waves_of_any_length(true):
    found = waves(residuals(true))
    assert min(abs(w - true) for w in found) < 1.0
    assert found == sorted(found) and len(found) <= 34
    low = [w for w in found if w < 30]
    assert max(np.diff(low)) < np.pi / 3 and low[0] == 4.0  # a bend of 3 rad is half a wave out by that much
    kind = REGISTRY["actuator_ripple"]
    span = {"": 1.0, "tension": 20.0}
    forms = pilots(kind, span, found)
    assert sorted({form["waves"] for form in forms}) == found
    others = [len(about["pilots"]) for name, about in kind.fields().items() if about["pilots"] and name != "waves"]
    assert len(forms) == len(found) * np.prod(others)
    guessed = pilots(kind, span)
    assert {form["waves"] for form in guessed} == set(kind.fields()["waves"]["pilots"])


@pytest.mark.parametrize(("way", "reset", "phase"), [(1.0, 3.7, 0.3), (-1.0, 7.0, 0.8), (1.0, 0.32, 0.6)])
def test_a_clock_that_is_set_now_and_then_is_heard_in_what_goes_with_the_rate(way, reset, phase):
    rng, t = np.random.default_rng(3), np.linspace(0.0, 15.0, 1500)
    rate = np.concatenate([0.17 * np.cos(1.7 * t) + 0.155 * np.cos(3.1 * t + k) for k in (0.0, 1.0)])
    late = 0.02 + way * 0.02 * (np.tile((t / reset + phase + 0.5) % 1.0, 2) - 0.5)
    error = 0.002 * rng.standard_normal(len(rate)) - late * rate
    heard = clock(np.tile(t, 2), error[:, None], rate[:, None])
    assert heard["drift"] == way
    assert heard["reset_s"] == pytest.approx(reset, rel=0.05)
    assert abs((heard["phase"] - phase + 0.5) % 1.0 - 0.5) < 0.1


@pytest.mark.parametrize(("period", "phase", "late"), [(0.0782, 0.3, 0.0), (0.03, 0.9, 0.0), (0.21, 0.5, 0.02)])
def test_a_beat_is_heard_in_what_is_held_in_between(period, phase, late):
    """Whatever else jumps; `phase` of a beat has gone by at a run's start half a beat before a change."""
    rng, t = np.random.default_rng(5), np.arange(0.0, 15.0, 0.01)

    def given(at):
        return 5 + 2 * np.sin(2.1 * at) + np.sin(5.3 * at + 1) + 3.0 * (np.floor(at / 3.3) % 2)

    read = (np.floor(t / period + phase - 0.5 + 1e-9) - phase + 0.5) * period
    runs = np.tile(t, 2), np.repeat([0, 1], len(t))
    noise = 0.02 * rng.standard_normal((2 * len(t), 1))
    ask = np.tile(given(t), 2)[:, None]
    hz, heard = beat(runs[0], np.tile(given(read - late), 2)[:, None] + noise, ask, runs[1]) or (0.0, 0.0)
    assert 1 / hz == pytest.approx(period, rel=0.005)
    assert abs((heard - phase + 0.5) % 1.0 - 0.5) < 0.12
    later = np.tile(given(t - 0.05), 2)[:, None] + noise
    assert beat(runs[0], later, ask, runs[1]) is None
    assert beat(t[:2], later[:2], ask[:2], runs[1][:2]) is None
    both = np.tile(given(read), 2)[:, None]  # commanded at that beat, and followed
    assert beat(runs[0], both + noise, both, runs[1]) is None


def test_an_effect_without_a_slope_somewhere_promises_nothing():
    """It does not take the screen with it: the other effect's promise is that of a regression."""
    rng = np.random.default_rng(0)
    y, base, bad, good = rng.standard_normal((4, 90))
    bad[7] = np.nan
    run = np.repeat([0, 1, 2], 30)

    def search(*columns: np.ndarray) -> Any:
        jacobian = np.stack([*columns, np.zeros(90)], axis=-1)[:, None]  # the last is of the starting angle
        return SimpleNamespace(
            point=SimpleNamespace(answer=SimpleNamespace(jacobian=jacobian, predicted=np.zeros((90, 1)))),
            windows=SimpleNamespace(y=y[:, None], sample_run=run),
            _scale=lambda point: SimpleNamespace(weight=np.ones((90, 1)), sigma=np.ones(1)),
            **{"sample_group": run, "groups": 3, "offset_sd": 1.0},
        )

    columns = [Column(i, 0, "size", -np.inf, np.inf, 1.0) for i in ("bad", "good")]
    screen = gather([search(base), search(bad, good)], [columns], {})
    assert screen.gains["bad", 0] == 0.0 and screen.steps["bad", 0] == {"size": 0.0}
    x = np.linalg.lstsq(np.stack([base, good], axis=1), y)[0]
    assert screen.steps["good", 0]["size"] == pytest.approx(x[1], rel=1e-2)


def test_a_search_is_begun_to_either_side_of_nothing_where_there_are_two():
    """Sizes of one sign alone stay on their side, forms as they are, and the largest is as large as usual."""
    bias, friction = REGISTRY["pressure_bias"], REGISTRY["tendon_friction"]
    start = {"effects.pressure_bias.offset_kpa": -7.0, "effects.pressure_bias.vented_kpa": 0.5}
    one, other = either_side(Trial(("pressure_bias",), start), [bias, friction])
    scale = bias.fields()["offset_kpa"]["scale"]
    assert [t.start["effects.pressure_bias.offset_kpa"] for t in (one, other)] == [-scale, scale]
    assert one.start["effects.pressure_bias.vented_kpa"] == other.start["effects.pressure_bias.vented_kpa"] == 0.5
    (alone,) = either_side(Trial(("tendon_friction",), {"effects.tendon_friction.mu": 0.0}), [bias, friction])
    assert alone.start["effects.tendon_friction.mu"] == friction.fields()["mu"]["scale"]


def test_only_modes_that_the_log_can_show_are_on_trial():
    logged = {1: 0, 6: 5}
    for columns, modes in logged.items():
        assert sum(n.startswith("mode") for n in sizes(REGISTRY["sensor_bias"], 6, columns)) == modes
    # joints of unequal stiffness bend unequally under gravity, and the mean angle shows some of it
    assert sizes(REGISTRY["nonuniform_stiffness"], 6, 1) == [f"mode{i}" for i in range(1, 6)]
    assert sizes(REGISTRY["nonuniform_stiffness"], 2, 1) == ["mode1"]
    assert sizes(REGISTRY["stiffness_hardening"], 6, 1) == ["cubic", *(f"mode{i}" for i in range(1, 6))]


def test_a_stop_that_is_barely_touched_is_looked_for():
    """On either side, where joints hardly get: a stop touched only there shows from no other start."""
    angles = [form["angle_rad"] for form in pilots(REGISTRY["contact"], {"": 1.0, "angle": 0.25})]
    assert any(0.2 < x < 0.25 for x in angles) and any(-0.25 < x < -0.2 for x in angles)
