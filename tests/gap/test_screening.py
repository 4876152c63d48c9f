"""What the screen reads off residuals before anything is refitted."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from ljjax.effects import REGISTRY
from ljjax.effects.varying import HALFWAY, WAYS, varies, varying
from ljjax.gap import screening
from ljjax.gap.candidates import Trial, either_side, pilots, sizes
from ljjax.gap.channels import Channel, Fitted, Measured, _Inputs, look
from ljjax.gap.screening import Column, Screen, beat, clock, gather, waves
from ljjax.gap.search import FIRST, Study, _best, needed, units
from ljjax.gap.variation import Variation
from tests.fit.test_dynamic import robot


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


def test_a_measured_tension_takes_an_effect_within_the_shapes_doubt():
    """The motors pull a tenth less than the shape's fit says, which leaves it open or does not."""
    kind: Any = REGISTRY["actuator_gain"]
    truth = 0.1

    def error(_, x: np.ndarray) -> np.ndarray:
        return (x[:, :1] - truth) * np.linspace(1.0, 5.0, 50)

    channel = Channel("tension", 1.0, 0.01, {"actuator_gain": 0.0}, {}, error, np.ones(50, bool))
    fitted = kind(error=0.2, difference=0.0)
    apart = float(np.sqrt(np.mean(error(kind, np.array([[0.2]])) ** 2)))
    channel = dataclasses.replace(channel, rms=0.2 * apart)  # so that 0.2 contradicts

    def off(sd: float) -> float:
        return channel.rms_with([Fitted(fitted, ["error"], np.array([[sd**2]]))]) or 0.0

    assert off(0.05) == pytest.approx(0.0, abs=1e-3)
    assert 0.9 * apart < off(1e-4) < apart  # no further than a part of its typical size
    assert off(np.nan) == off(0.0)
    assert channel.rms_with([]) is None


@pytest.mark.parametrize("period", [0.3, 0.0782])
def test_measured_tensions_tell_of_commands_read_at_a_beat(period):
    t = np.arange(0.0, 12.0, 0.01)
    command = np.stack([5 + 2 * np.sin(2.0 * t), 5 + 2 * np.sin(2.0 * t + 1)], axis=1)
    command += np.sin(4.0 * t + np.arange(2)[:, None]).T * (period < 0.2)
    held = command[np.searchsorted(t, np.floor(t / period + 1e-9) * period, side="right") - 1]
    value = held + 0.01 * np.random.default_rng(1).standard_normal(held.shape)
    run = SimpleNamespace(signals={"tendons": SimpleNamespace(t=t, value=value)})
    given = {"t": t, "y": np.zeros((len(t), 1)), "input_t": t, "tendons": command, "vacuum": 0.0 * t, "hold": False}
    given |= {"warm": 0.0 * t, "worn": 0.0 * t}
    motion: Any = SimpleNamespace(run=run, source="commands", q0=np.zeros(2), **given)
    (tension,) = look([motion], [REGISTRY["actuator_delay"], REGISTRY["actuator_lag"]], robot(2)).channels
    assert tension.best == "actuator_delay" and tension.left["actuator_lag"] > 0.15
    assert tension.left["actuator_delay"] < 0.5 * tension.left["actuator_lag"]
    assert tension.values["actuator_delay"]["reset_s"] == pytest.approx(period, rel=0.01)
    assert tension.values["actuator_delay"]["delay_seconds"] == pytest.approx(period / 2, rel=0.15)


def test_a_measured_line_hears_a_bias_that_begins_with_the_wear():
    """Of 5 kPa from 0.3 rad of the mean joint's way on: the channel follows the slip of the measured shape."""
    t = np.arange(0.0, 6.0, 0.01)
    way = 0.2 * np.abs((t / 1.5 + 1) % 2 - 1)
    line = SimpleNamespace(t=t, value=np.full((len(t), 1), 20.0))
    run = SimpleNamespace(signals={"pressure": line}, vacuum_kpa=lambda name: line)
    given = {"t": t, "y": way[:, None], "input_t": t, "tendons": np.zeros((len(t), 2)), "vacuum": 20.0 + 0.0 * t}
    given |= {"warm": 0.0 * t, "worn": 0.0 * t, "hold": False}
    motion: Any = SimpleNamespace(run=run, source="commands", q0=np.zeros(2), **given)
    kind = varying(REGISTRY["pressure_bias"])
    values = {n: float(a["null"]) for n, a in kind.fields().items()}
    values |= {"offset_kpa": 5.0, "by_onset": 1.0, "onset_rad": 0.3, "over_rad": 1e-3}
    error = _Inputs([motion], "pressure", robot(2)).error(kind, np.array([list(values.values())]))[0]
    slip = np.cumsum(np.abs(np.diff(way, prepend=way[0])))
    np.testing.assert_allclose(error[slip < 0.28], 0.0, atol=1e-6)
    np.testing.assert_allclose(error[slip > 0.32], 5.0, atol=1e-6)


@pytest.mark.parametrize("late_s, speaks", [(0.0, False), (0.01, True)])
def test_a_tension_stamped_as_its_command_changes_may_be_the_one_before(late_s, speaks):
    """Commands are held; the sensor's stamps are those of every second one, its values of just before."""
    t = np.arange(0.0, 12.0, 0.005)
    command = np.stack([5 + 4 * np.sin(9.0 * t), 5 + 4 * np.sin(9.0 * t + 1)], axis=1)
    stamps = t[4::2]
    value = command[3 : len(t) - 1 : 2] if late_s == 0.0 else command[1 : len(t) - 3 : 2]
    value = value + 0.02 * np.random.default_rng(1).standard_normal(value.shape)
    run = SimpleNamespace(signals={"tendons": SimpleNamespace(t=stamps, value=value)})
    given = {"t": t, "y": np.zeros((len(t), 1)), "input_t": t, "tendons": command, "vacuum": 0.0 * t, "hold": True}
    given |= {"warm": 0.0 * t, "worn": 0.0 * t}
    motion: Any = SimpleNamespace(run=run, source="commands", q0=np.zeros(2), **given)
    (tension,) = look([motion], [REGISTRY["actuator_lag"]], robot(2)).channels
    assert tension.rms > 2 * tension.noise
    assert tension.speaks == speaks


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


def test_a_channel_is_heard_where_what_it_shows_matters_to_the_shape():
    """A lag in the measured tension, real but far too small for the shape's gap, and one that causes it."""
    kind: Any = REGISTRY["actuator_lag"]

    def error(_, x: np.ndarray) -> np.ndarray:
        return (x[:, :2].sum(axis=1, keepdims=True) - 0.02) * np.linspace(1.0, 5.0, 50) / 0.02

    channel = Channel("tension", 3.0, 0.01, {"actuator_lag": 0.0}, {}, error, np.ones(50, bool))
    lag = [Fitted(kind(tau_s=0.02, second_s=0.0), ["tau_s"], np.array([[1e-8]]))]
    for left, heard in ((0.85, False), (0.1, True)):
        measured = Measured([channel])
        measured.listen(left, lag)
        assert bool(measured.heard) == heard
        assert measured.joined(left, lag) == pytest.approx(left, abs=1e-3)
        assert (measured.joined(0.05, []) > 0.15) == heard  # by something else, that leaves as little of the shape


def test_what_the_shape_knows_of_two_parameters_together_holds():
    """Two lags of which the shape knows the sum only, and the measured tension asks for a smaller one."""
    kind: Any = REGISTRY["actuator_lag"]

    def error(_, x: np.ndarray) -> np.ndarray:
        return (x[:, :2].sum(axis=1, keepdims=True) - 0.005) * np.linspace(1.0, 5.0, 50) / 0.03

    channel = Channel("tension", 0.2, 0.01, {"actuator_lag": 0.0}, {}, error, np.ones(50, bool))
    fitted, free = kind(tau_s=0.015, second_s=0.015), ["tau_s", "second_s"]
    apart = float(np.sqrt(np.mean(error(kind, np.array([[0.015, 0.015]])) ** 2)))
    sum_known = 0.05**2 * np.array([[1.0, -1.0], [-1.0, 1.0]]) + 1e-8 * np.eye(2)
    assert (channel.rms_with([Fitted(fitted, free, sum_known)]) or 0.0) > 0.7 * apart
    assert (channel.rms_with([Fitted(fitted, free, 0.05**2 * np.eye(2))]) or 0.0) < 0.05 * apart


@pytest.mark.parametrize("real", [0.0, 1.0])
def test_a_measured_tension_contradicts_what_it_does_not_show(real):
    """A gain of 2 %, its trace well below the sensor's noise, that the motors have or have not."""
    kind: Any = REGISTRY["actuator_gain"]
    command, noise = np.linspace(1.0, 5.0, 4000), 0.1 * np.random.default_rng(0).standard_normal(4000)
    measured = (1 + 0.02 * real) * command + noise

    def error(_, x: np.ndarray) -> np.ndarray:
        return (1 + x[:, :1].sum(axis=1, keepdims=True)) * command - measured

    rms = float(np.sqrt(np.mean(error(None, np.zeros((1, 0))) ** 2)))
    tension = Measured([Channel("tension", rms, 0.1, {}, {}, error, np.ones(4000, bool))])

    def gain(value: float, sd: float = 1e-4) -> Fitted:
        return Fitted(kind(error=value), ["error"], np.array([[sd**2]]))

    assert tension.joined(0.05, [gain(0.02)]) == pytest.approx(0.05 if real else 0.35)
    assert tension.joined(0.05, [gain(0.02), gain(1e-6)]) == tension.joined(0.05, [gain(0.02)])  # beside a dummy too
    assert tension.joined(0.05, [gain(1e-4)]) == pytest.approx(0.05)  # too little to be seen either way
    assert tension.joined(0.05, [gain(0.0)]) == pytest.approx(0.05)  # and nothing at all
    assert tension.joined(0.05, [gain(0.02, sd=0.05)]) == pytest.approx(0.05)  # the shape would have it otherwise too


@pytest.mark.parametrize("real", [0.0, 1.0])
def test_what_a_measured_tension_does_show_hides_nothing_that_it_does_not(real):
    """A gain of 2 % that the motors have or have not, beside a lag that they have."""
    gain: Any = REGISTRY["actuator_gain"]
    lag: Any = REGISTRY["actuator_lag"]
    command, noise = np.linspace(1.0, 5.0, 4000), 0.1 * np.random.default_rng(0).standard_normal(4000)
    late = np.sin(np.arange(4000))
    measured = (1 + 0.02 * real) * command + 0.2 * late + noise

    def error(kind, x: np.ndarray) -> np.ndarray:
        if kind is None:
            return np.zeros((len(x), 1)) + command - measured
        return command - measured + x[:, :1] * (command if kind is gain else late)

    rms = float(np.sqrt(np.mean(error(None, np.zeros((1, 0))) ** 2)))
    tension = Measured([Channel("tension", rms, 0.1, {}, {}, error, np.ones(4000, bool))])
    known = np.array([[1e-8]])
    both = [Fitted(gain(error=0.02), ["error"], known), Fitted(lag(tau_s=0.2), ["tau_s"], known)]
    assert tension.joined(0.05, both[1:]) == pytest.approx(0.05)
    assert tension.joined(0.05, both) == pytest.approx(0.05 if real else 0.35)


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
