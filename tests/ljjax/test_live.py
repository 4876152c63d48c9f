"""A robot advanced as time goes is the robot simulated from the whole of its inputs."""

import jax.numpy as jnp
import numpy as np
import pytest

from ljjax.effects import REGISTRY
from ljjax.inputs import Inputs
from ljjax.live import Live
from ljjax.simulation import simulate
from tests.ljjax.conftest import make_robot

STEP_S = 0.0025
EFFECTS = {
    "actuator_delay": {"delay_seconds": 4 * STEP_S},
    "actuator_lag": {"tau_s": 0.02},
    "pressure_lag": {"fill_s": 0.05, "vent_s": 0.05},
    "sensor_scale": {"error": 0.1},
    "sensor_delay": {"delay_seconds": 2 * STEP_S},
}


def test_step_by_step_is_the_whole():
    effects = tuple(REGISTRY[name](**EFFECTS[name]) for name in REGISTRY if name in EFFECTS)
    model = make_robot(1, effects=effects)
    count = 60
    t = STEP_S * np.arange(count)
    pulls = np.stack([24 * np.sin(9 * t) ** 2, 3 * np.cos(9 * t) ** 2 * (t > 0.02)], axis=1)
    vacuum = 20 * (t > 0.05)
    live, seen, bends = Live(model, STEP_S), [], []
    for pull, kpa in zip(pulls, vacuum, strict=True):
        live.advance(float(pull[0]), float(pull[1]), float(kpa))
        seen.append(live.joints)
        bends.append(live.bend)
    assert live.t == pytest.approx(count * STEP_S) and (live.half_length_m, live.lever_arm_m) == (0.021, 0.02)
    inputs = Inputs(jnp.asarray(t), jnp.asarray(pulls), jnp.asarray(vacuum, float))
    whole = simulate(model, inputs, at=t + STEP_S, step_s=STEP_S)
    assert np.abs(bends).max() > 0.05
    np.testing.assert_allclose(bends, np.asarray(whole.state.q).sum(axis=1), atol=1e-6)
    np.testing.assert_allclose(np.array(seen)[3:], np.asarray(whole.seen)[3:], atol=1e-5)
