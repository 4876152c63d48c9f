"""What measured channels say of effects: tensions and the line's vacuum beside the shape."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ljjax.effects import REGISTRY
from ljjax.effects.varying import varying
from ljjax.gap.channels import Channel, Fitted, Measured, _Inputs, look
from tests.fit.test_dynamic import robot


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
