"""Effects that vary: the same without, the right derivatives, model files."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ljjax import modelfile
from ljjax.effects import REGISTRY, build
from ljjax.effects.varying import WAYS, varies, varying, ways
from ljjax.model import get, limits, replace
from ljjax.modelfile import ModelFile
from ljjax.simulation import simulate
from tests.ljjax.motion import drive, seen


def with_sizes(model, share: float, kinds):
    """The model with these effects, each so large a share of its typical size."""
    effects = tuple(k(**{n: k.fields()[n]["null"] + share * k.fields()[n]["scale"] for n in k.sizes()}) for k in kinds)
    return dataclasses.replace(model, effects=effects)


def test_an_effect_that_does_not_vary_is_as_it_was(robot):
    plain, free = (
        seen(with_sizes(robot(3), 0.3, kinds), drive())
        for kinds in (REGISTRY.values(), map(varying, REGISTRY.values()))
    )
    bare = seen(robot(3), drive())
    assert float(jnp.abs(plain - bare).max()) > 0.01
    np.testing.assert_allclose(free, plain, rtol=0, atol=1e-11)
    assert [k.id for k in REGISTRY.values() if not varies(k)] == ["actuator_delay"]


def test_a_way_to_vary_changes_the_motion_and_has_the_right_derivative(robot):
    """An effect of each hook, all in one model, each varying in one way."""
    chosen = {
        "actuator_gain": "by_load",
        "actuator_lag": "by_sense",
        "pressure_lag": "by_rate",
        "stiffness_saturation": "by_vacuum",
        "viscous_damping": "by_bend",
        "base_tilt": "by_load",
        "layer_hysteresis": "by_vacuum",
        "sensor_filter": "by_rate",
    }
    model = with_sizes(robot(3), 1.0, [varying(REGISTRY[effect]) for effect in chosen])

    @jax.jit
    def at(x):
        return seen(
            replace(model, {f"effects.{i}.{way}": a for (i, way), a in zip(chosen.items(), x, strict=True)}), drive()
        )

    slope_at, middle, d = jax.jit(lambda x, t: jax.jvp(at, (x,), (t,))[1]), jnp.full(len(chosen), 0.4), 1e-5
    for effect, along in zip(chosen, jnp.eye(len(chosen)), strict=True):
        expected = (at(middle + d * along) - at(middle - d * along)) / (2 * d)
        assert float(jnp.abs(at(middle) - at(middle - 0.4 * along)).max()) > 1e-5, effect
        error = jnp.abs(slope_at(middle, along) - expected).max()
        assert float(error) < 0.02 * float(jnp.abs(expected).max()) + 1e-9, effect


def test_an_effect_never_turns_round(robot):
    """However much less of it there is to be: −1 by everything is none at all."""
    model = with_sizes(robot(3), 1.5, [varying(REGISTRY["base_tilt"])])
    none = replace(model, {f"effects.base_tilt.{way}": limits(model)[f"effects.base_tilt.{way}"][0] for way in WAYS})
    some = replace(model, {"effects.base_tilt.by_load": -1.0, "effects.base_tilt.by_vacuum": -1.0})
    bare, plain = (seen(m, drive()) for m in (robot(3), model))
    for less in (none, some):
        assert float(jnp.abs(seen(less, drive()) - bare).max()) < float(jnp.abs(plain - bare).max())


def test_a_robot_may_cool():
    """By any number of kelvin: what it varies with stays between −1 and 1."""
    kind: Any = varying(REGISTRY["base_tilt"])
    zero = jnp.zeros(())
    still: Any = SimpleNamespace(q=(zero,), v=(zero,), vacuum=zero)
    for warm, expected in ((2.0, 1.5), (-2.0, 0.5), (-1e6, 0.0)):
        still.warm = jnp.asarray(warm)
        np.testing.assert_allclose(kind(by_warmth=1.0)._amount(still, zero), expected, atol=1e-5)


def test_a_model_file_holds_how_an_effect_varies(tmp_path, robot):
    model = dataclasses.replace(robot(3), effects=(build("base_tilt", {"tilt_rad": 0.1, "by_load": 0.7}),))
    path = tmp_path / "model.toml"
    path.write_text(modelfile.dumps(ModelFile(model)))
    back = modelfile.load(path).model
    assert float(get(back, "effects.base_tilt.by_load")) == 0.7
    np.testing.assert_allclose(simulate(back, drive()).seen, simulate(model, drive()).seen, atol=1e-13)


def test_a_camera_feels_neither_load_nor_vacuum():
    assert set(ways(REGISTRY["sensor_scale"])) == {"by_bend", "by_rate", "by_warmth"}
    assert set(ways(REGISTRY["tendon_friction"])) == set(WAYS)
