"""The effects: all there, nothing at their nulls, the derivatives right, in model.toml, and a user's own."""

from __future__ import annotations

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ljjax import effects, modelfile
from ljjax.effects import BLOCKS, REGISTRY
from ljjax.errors import InputError
from ljjax.model import get, limits, replace, units
from ljjax.modelfile import ModelFile
from ljjax.simulation import rest, simulate, unsensed
from tests.ljjax.motion import drive, seen

IDS = {
    "actuation": "tendon_friction tendon_slack actuator_lag actuator_delay actuator_deadband actuator_gain "
    "actuator_ripple actuator_saturation",
    "jamming": "pressure_lag pressure_leak pressure_bias stiffness_saturation friction_saturation layer_hysteresis "
    "layer_wear",
    "structure": "viscoelastic_creep viscous_damping stiffness_hardening rest_curvature base_tilt tip_payload "
    "gravity_distribution nonuniform_stiffness contact",
    "friction": "friction_asymmetry load_dependent_friction thermal_drift",
    "sensing": "sensor_bias sensor_scale sensor_delay sensor_filter",
}
WARMING = ("thermal_drift",)
"""Seen only where the temperature rises, which a plain simulation is not told."""


@pytest.fixture(scope="module")
def everything(robot):
    """A robot with all effects at their nulls, and what it shows."""
    model = dataclasses.replace(robot(3), effects=tuple(kind() for kind in REGISTRY.values()))
    return model, seen(model, drive())


def sized(path: str, model) -> dict[str, float]:
    """The parameter at twice its typical size; forms where they act on this motion."""
    _, effect, name = path.split(".")
    forms = {"actuator_saturation.limit_n": 8.0, "contact.angle_rad": 0.05}
    about = REGISTRY[effect].fields()[name]
    values = {f"effects.{k}": v for k, v in forms.items() if k.startswith(effect + ".")}
    return {**values, path: about["null"] + 1.93 * about["scale"]}


SIZES = [
    f"effects.{kind.id}.{name}"
    for kind in REGISTRY.values()
    for name in kind.sizes()
    if kind.id not in WARMING and name not in ("mode3", "mode4", "mode5")  # those want more joints than three
]


def test_all_31_effects_are_there_in_their_blocks():
    assert {i: kind.block for i, kind in REGISTRY.items()} == {i: b for b, ids in IDS.items() for i in ids.split()}
    assert set(IDS) == set(BLOCKS)


def test_at_their_nulls_nothing_changes(robot, everything):
    _, same = everything
    np.testing.assert_allclose(same, seen(robot(3), drive()), rtol=0, atol=1e-13)  # to rounding


@pytest.mark.parametrize("path", SIZES)
def test_each_size_changes_the_motion_and_has_the_right_derivative(everything, path):
    model, plain = everything
    values = sized(path, model)
    large = replace(model, values)
    assert float(jnp.abs(seen(large, drive()) - plain).max()) > 1e-4, "it changes nothing"
    tangent = jax.tree.map(jnp.zeros_like, large)
    tangent = replace(tangent, {path: 1.0})
    _, slope = eqx.filter_jvp(seen, (large, drive()), (tangent, jax.tree.map(jnp.zeros_like, drive())))
    d = 1e-5 * values[path]
    up, down = (seen(replace(large, {path: values[path] + s}), drive()) for s in (d, -d))
    expected = (up - down) / (2 * d)
    error = float(jnp.abs(slope - expected).max())
    assert error < 0.02 * float(jnp.abs(expected).max()) + 1e-9


def test_parameters_have_units_bounds_and_paths(everything):
    model, _ = everything
    assert units(model)["effects.actuator_lag.tau_s"] == "s"
    assert float(get(model, "effects.contact.stop")) == 0.0
    for path, (low, high) in limits(model).items():
        assert low <= float(get(model, path)) <= high
    with pytest.raises(InputError, match="no parameter 'effects.actuator_lag.tau'"):
        get(model, "effects.actuator_lag.tau")


def test_a_run_starts_where_its_log_does_whatever_the_sensor_adds(robot):
    scale, bias = (
        REGISTRY["sensor_scale"](**{"error": 0.1, "aside": -0.02, "lens": 0.03}),
        REGISTRY["sensor_bias"](**{"offset_rad": 0.02, "mode1": 0.01}),
    )
    model = dataclasses.replace(robot(3), effects=(scale, bias))
    logged = jnp.array([0.05, 0.02, -0.01])
    start = rest(model, drive(), unsensed(model, logged))
    np.testing.assert_allclose(simulate(model, drive(), initial=start).seen[0], logged, atol=1e-12)


def test_a_model_file_holds_effects(tmp_path, robot):
    lag, bias = REGISTRY["actuator_lag"](**{"tau_s": 0.07}), REGISTRY["sensor_bias"](**{"offset_rad": 0.02})
    model = dataclasses.replace(robot(3), effects=(lag, bias))
    sd = {"effects.actuator_lag.tau_s": 0.003, "elastic.c3": 0.01}
    path = tmp_path / "model.toml"
    path.write_text(modelfile.dumps(ModelFile(model, sd)))
    back = modelfile.load(path)
    assert [e.id for e in back.model.effects] == ["actuator_lag", "sensor_bias"]
    assert float(get(back.model, "effects.actuator_lag.tau_s")) == 0.07
    assert back.uncertainty == sd
    np.testing.assert_allclose(simulate(back.model, drive()).seen, simulate(model, drive()).seen, atol=1e-13)


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ('id = "actuator_lagg"', "effects\\[0\\].id is 'actuator_lagg'"),
        ('id = "actuator_lag"\ntau = 0.1', "unknown key effects\\[0\\].tau"),
        ('id = "actuator_lag"\ntau_s = -0.1', "effects.actuator_lag.tau_s = -0.1: must lie between 0 and 1"),
        ('id = "actuator_lag"\n[[effects]]\nid = "actuator_lag"', "twice"),
        ('id = "actuator_lag"\ntau_s = "slow"', "effects\\[0\\].tau_s is 'slow'"),
        ('id = "mine"\nfile = "nowhere.py"', "nowhere.py: no such file"),
    ],
)
def test_bad_effects_are_refused(tmp_path, robot, table, said):
    path = tmp_path / "model.toml"
    path.write_text(modelfile.dumps(ModelFile(robot(3))) + "\n[[effects]]\n" + table + "\n")
    with pytest.raises(InputError, match=said):
        modelfile.load(path)


OWN = '''
import jax
from ljjax.effect import Effect, parameter


class Spring(Effect):
    """A spring between neighbours would be one; this one is a plain torque."""

    id, block = "own_spring", "structure"
    push: jax.Array = parameter("N·m", 0.0, -1.0, 1.0, 0.1)

    def load(self, memory, load, now):
        return tuple(x + self.push for x in load)
'''


def test_a_users_own_effect_needs_no_change_of_the_package(tmp_path, robot):
    (tmp_path / "own.py").write_text(OWN)
    path = tmp_path / "model.toml"
    text = modelfile.dumps(ModelFile(robot(3)))
    path.write_text(text + '\n[[effects]]\nid = "own_spring"\nfile = "own.py"\npush = 0.1\n')
    try:
        model = modelfile.load(path).model
        pushed = simulate(model, drive()).seen
        assert float(jnp.abs(pushed - simulate(robot(3), drive()).seen).max()) > 1e-3
        again = tmp_path / "again.toml"
        again.write_text(modelfile.dumps(ModelFile(model)))
        np.testing.assert_allclose(simulate(modelfile.load(again).model, drive()).seen, pushed)
    finally:
        REGISTRY.pop("own_spring", None)
    with pytest.raises(InputError, match="this id is taken"):
        effects.register(type("Lag", (REGISTRY["actuator_lag"],), {}))
