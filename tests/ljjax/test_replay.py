"""A logged run beside its simulation: stamps, residuals, shapes of all kinds, and nothing learnt from the answer."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from ljjax.chain import tip_pose
from ljjax.errors import InputError
from ljjax.logs import Run, Signal
from ljjax.logs.contract import POSE, TENDONS
from ljjax.model import Model
from ljjax.replay import replay

N_JOINTS = 2
T_COMMAND = np.array([0.0, 0.02, 0.05, 0.09])
T_SHAPE = np.array([0.001, 0.01, 0.02, 0.03, 0.045, 0.06, 0.08, 0.1, 0.123])
BENT = np.array([0.10, 0.14])


@pytest.fixture(scope="module")
def model(robot: Callable[..., Model]) -> Model:
    return robot(N_JOINTS)


def make_run(shape: Any, columns: tuple[str, ...], tip: np.ndarray | None = None, drop: tuple[str, ...] = ()) -> Run:
    """Commands that move at 0.02 s and after, a measured shape, and measured inputs that are twice the commanded."""
    u = np.array([[6.0, 2.0], [9.0, 2.0], [3.0, 4.0], [12.0, 0.0]])
    pa = 101_325 - 1e3 * np.array([[5.0], [5.0], [20.0], [20.0]])
    signals = {
        "cmd_tendons": Signal(T_COMMAND, u, TENDONS, "N", "/real/cmd/tendons"),
        "cmd_pressure": Signal(T_COMMAND, pa, ("pressure",), "Pa", "/real/cmd/pressure"),
        "tendons": Signal(T_COMMAND, 2 * u, TENDONS, "N", "/real/tendons"),
        "pressure": Signal(T_COMMAND, pa, ("pressure",), "Pa", "/real/pressure"),
        "shape": Signal(T_SHAPE, np.asarray(shape, float), columns, "rad", "/real/shape"),
    }
    if tip is not None:
        signals["tip"] = Signal(T_SHAPE, tip, POSE[: tip.shape[1]], "m", "/real/tip/pose")
    signals = {name: s for name, s in signals.items() if name not in drop}
    return Run("a.mcap", "0" * 64, 10**18, signals, {"p_atm_pa": "101325", "run_id": "a"})


def wobble(seed: int = 0, still: int = 3) -> np.ndarray:
    """(9, 2) a bent shape; noise after the first samples, at which commands have not moved yet."""
    noise = np.random.default_rng(seed).normal(scale=0.3, size=(len(T_SHAPE), N_JOINTS))
    noise[:still] = 0
    return BENT + noise


Q = ("q1", "q2")


def test_joint_by_joint_at_the_logs_own_stamps(model: Model):
    out = replay(model, make_run(wobble(), Q))
    sim, residual = out["/sim"]["shape"], out["/residual"]["shape"]
    for signal in (sim, residual):
        np.testing.assert_array_equal(signal.t, T_SHAPE)
        assert (signal.columns, signal.unit) == (Q, "rad")
    np.testing.assert_allclose(residual.value, wobble() - sim.value, atol=1e-15)
    np.testing.assert_allclose(sim.value[0], BENT, atol=1e-3)  # at rest
    assert np.abs(sim.value[-1] - BENT).max() > 1e-3  # and then it moves
    assert out.keys() == {"/sim", "/residual"} and out["/sim"].keys() == {"shape"}


def test_theta_only(model: Model):
    theta = np.full((len(T_SHAPE), 1), 0.12)
    out = replay(model, make_run(theta, ("theta",)))
    sim = out["/sim"]["shape"]
    assert sim.columns == ("theta",) and sim.value.shape == (len(T_SHAPE), 1)
    joints = replay(model, make_run(np.full((len(T_SHAPE), 2), 0.12), Q))["/sim"]["shape"].value
    np.testing.assert_allclose(sim.value[:, 0], joints.mean(axis=1), atol=1e-12)
    np.testing.assert_allclose(out["/residual"]["shape"].value, theta - sim.value, atol=1e-15)


def pose(model: Model, q: np.ndarray) -> np.ndarray:
    """(7,) contract v1: z along the unbent body, x toward tendon_left, rotation about +y by q_Σ."""
    x, y, angle = (float(v) for v in tip_pose(model.chain, jnp.asarray(q)))
    return np.array([x, 0, y, 0, np.sin(angle / 2), 0, np.cos(angle / 2)])


@pytest.mark.parametrize("sign", [1, -1])
def test_a_logged_tip_is_simulated_too(model: Model, sign: int):
    """A quaternion and its negative are one rotation: no residual between them."""
    sim = replay(model, make_run(wobble(), Q))["/sim"]["shape"].value
    tip = np.array([pose(model, q) for q in sim])
    tip[:, 3:] *= sign
    out = replay(model, make_run(wobble(), Q, tip))
    np.testing.assert_allclose(out["/sim"]["tip"].value, tip, atol=1e-7)
    np.testing.assert_allclose(out["/residual"]["tip"].value, 0, atol=1e-7)
    np.testing.assert_array_equal(out["/sim"]["tip"].t, T_SHAPE)
    assert out["/sim"]["tip"].columns == POSE
    assert tip[-1, 0] > 0 and tip[-1, 2] > 0.04  # bent toward the left tendon, along the body


def test_a_tip_logged_without_its_rotation(model: Model):
    out = replay(model, make_run(wobble(), Q, np.zeros((len(T_SHAPE), 3))))
    np.testing.assert_allclose(out["/residual"]["tip"].value[:, :3], -out["/sim"]["tip"].value[:, :3])
    assert out["/residual"]["tip"].value.shape == (len(T_SHAPE), 7) and not out["/residual"]["tip"].value[:, 3:].any()


def test_the_answer_is_not_looked_at(model: Model):
    """Samples after the commands first move do not matter; the rest before them does."""
    first, second = (replay(model, make_run(wobble(seed), Q))["/sim"]["shape"].value for seed in (1, 2))
    np.testing.assert_array_equal(first, second)
    other = replay(model, make_run(wobble(1) + 0.05, Q))["/sim"]["shape"].value
    assert np.abs(other[0] - first[0]).min() > 0.04


def test_commands_or_measured_inputs(model: Model):
    run = make_run(wobble(), Q)
    commanded, measured = (replay(model, run, inputs=how)["/sim"]["shape"].value for how in ("commands", "measured"))
    assert np.abs(commanded - measured).max() > 1e-3
    alone = make_run(wobble(), Q, drop=("cmd_tendons", "cmd_pressure"))
    with pytest.raises(InputError, match="a.mcap: no signal cmd_tendons"):
        replay(model, alone)


MISSING = {"shape": "no signal shape", "cmd_tendons": "no signal cmd_tendons", "cmd_pressure": "no signal cmd_pressure"}


@pytest.mark.parametrize("signal", MISSING)
def test_a_run_that_lacks_a_signal_is_refused_by_name(model: Model, signal: str):
    with pytest.raises(InputError, match=f"a.mcap: {MISSING[signal]}"):
        replay(model, make_run(wobble(), Q, drop=(signal,)))


def test_joints_that_do_not_match_the_model_are_refused(robot: Callable[..., Model]):
    with pytest.raises(InputError, match="2 joint angles for a model of 3 segments"):
        replay(robot(3), make_run(wobble(), Q))
