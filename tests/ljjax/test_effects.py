"""The effects: all there, nothing at their nulls, the derivatives right, in model.toml, a user's own, and that vary."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ljjax import effects, modelfile, step
from ljjax.effects import BLOCKS, REGISTRY, build
from ljjax.effects.varying import WAYS, onsets, varies, varying, ways
from ljjax.errors import InputError
from ljjax.model import get, limits, replace, units
from ljjax.modelfile import ModelFile
from ljjax.simulation import rest, simulate
from ljjax.simulation import unsensed as unsensed_at_rest
from ljjax.step import Drive, unsensed
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


def moved(model, paths: list[str]):
    """What the model shows with values by path, and its derivative by one of them: one program for both, as values
    alone would take another."""
    x0 = np.array([float(get(model, path)) for path in paths])
    pushed = jax.jit(
        lambda x, t: jax.jvp(lambda x: seen(replace(model, dict(zip(paths, x, strict=True))), drive()), (x,), (t,))
    )

    def at(values, along=None):
        x = x0.copy()
        x[[paths.index(path) for path in values]] = list(values.values())
        shown, slope = pushed(x, np.array([float(path == along) for path in paths]))
        return np.asarray(shown), np.asarray(slope)

    return at


@pytest.fixture(scope="module")
def everything(robot):
    """A robot with all effects at their nulls, `moved` of it, and what it shows."""
    model = dataclasses.replace(robot(3), effects=tuple(kind() for kind in REGISTRY.values()))
    at = moved(model, [f"effects.{e.id}.{name}" for e in model.effects for name in e.fields()])
    return model, at, at({})[0]


def sized(path: str, model) -> dict[str, float]:
    """The parameter at twice its typical size; forms where they act on this motion, which warms by hundredths of a
    kelvin."""
    _, effect, name = path.split(".")
    many = 100.0 if effect == "thermal_drift" else 1.93
    forms = {"actuator_saturation.limit_n": 8.0, "contact.angle_rad": 0.05}
    about = REGISTRY[effect].fields()[name]
    values = {f"effects.{k}": v for k, v in forms.items() if k.startswith(effect + ".")}
    return {**values, path: about["null"] + many * about["scale"]}


SIZES = [
    f"effects.{kind.id}.{name}"
    for kind in REGISTRY.values()
    for name in kind.sizes()
    if name not in ("mode3", "mode4", "mode5")  # those want more joints than three
]


def test_all_31_effects_are_there_in_their_blocks():
    assert {i: kind.block for i, kind in REGISTRY.items()} == {i: b for b, ids in IDS.items() for i in ids.split()}
    assert set(IDS) == set(BLOCKS)


def test_at_their_nulls_nothing_changes(robot, everything):
    np.testing.assert_allclose(everything[2], seen(robot(3), drive()), rtol=0, atol=1e-13)  # to rounding


@pytest.mark.parametrize("path", SIZES)
def test_each_size_changes_the_motion_and_has_the_right_derivative(everything, path):
    model, at, plain = everything
    values = sized(path, model)
    shown, slope = at(values, path)
    assert float(np.abs(shown - plain).max()) > 1e-4, "it changes nothing"
    d = 1e-5 * values[path]
    expected = (at({**values, path: values[path] + d})[0] - at({**values, path: values[path] - d})[0]) / (2 * d)
    error = float(jnp.abs(slope - expected).max())
    assert error < 0.02 * float(jnp.abs(expected).max()) + 1e-9


def test_parameters_have_units_bounds_and_paths(everything):
    model, *_ = everything
    assert units(model)["effects.actuator_lag.tau_s"] == "s"
    assert float(get(model, "effects.contact.stop")) == 0.0
    for path, (low, high) in limits(model).items():
        assert low <= float(get(model, path)) <= high
    with pytest.raises(InputError, match="no parameter 'effects.actuator_lag.tau'"):
        get(model, "effects.actuator_lag.tau")


def sensed_late(robot):
    """Three effects in one model, which two tests share."""
    given = {
        "actuator_lag": {"tau_s": 0.07},
        "sensor_scale": {"error": 0.1, "aside": -0.02, "lens": 0.03},
        "sensor_bias": {"offset_rad": 0.02, "mode1": 0.01},
    }
    return dataclasses.replace(robot(3), effects=tuple(REGISTRY[id](**values) for id, values in given.items()))


def test_a_run_starts_where_its_log_does_whatever_the_sensor_adds(robot):
    model = sensed_late(robot)
    logged = jnp.array([0.05, 0.02, -0.01])
    start = rest(model, drive(), unsensed_at_rest(model, drive(), logged))
    np.testing.assert_allclose(simulate(model, drive(), initial=start).seen[0], logged, atol=1e-12)


def test_a_model_file_holds_effects(tmp_path, robot):
    model = sensed_late(robot)
    sd = {"effects.actuator_lag.tau_s": 0.003, "elastic.c3": 0.01}
    path = tmp_path / "model.toml"
    path.write_text(modelfile.dumps(ModelFile(model, sd)))
    back = modelfile.load(path)
    assert [e.id for e in back.model.effects] == [e.id for e in model.effects]
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
        pushed = seen(model, drive())
        assert float(jnp.abs(pushed - seen(robot(3), drive())).max()) > 1e-3
        again = tmp_path / "again.toml"
        again.write_text(modelfile.dumps(ModelFile(model)))
        np.testing.assert_allclose(seen(modelfile.load(again).model, drive()), pushed)
    finally:
        REGISTRY.pop("own_spring", None)
    with pytest.raises(InputError, match="this id is taken"):
        effects.register(type("Lag", (REGISTRY["actuator_lag"],), {}))


# --- effects that vary


def with_sizes(model, share: float, kinds):
    """The model with these effects, each so large a share of its typical size."""
    effects = tuple(k(**{n: k.fields()[n]["null"] + share * k.fields()[n]["scale"] for n in k.sizes()}) for k in kinds)
    return dataclasses.replace(model, effects=effects)


def test_an_effect_that_does_not_vary_is_as_it_was(robot, everything):
    _, at, _ = everything
    sizes = with_sizes(robot(3), 0.3, REGISTRY.values())
    plain = at({path: float(get(sizes, path)) for path in limits(sizes) if path.startswith("effects.")})[0]
    free = seen(with_sizes(robot(3), 0.3, map(varying, REGISTRY.values())), drive())
    bare = seen(robot(3), drive())
    assert float(jnp.abs(plain - bare).max()) > 0.01
    np.testing.assert_allclose(free, plain, rtol=0, atol=1e-11)
    assert [k.id for k in REGISTRY.values() if not varies(k)] == ["actuator_delay", "sensor_delay"]


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
    model = with_sizes(robot(2), 1.0, [varying(REGISTRY[effect]) for effect in chosen])

    at = moved(model, [f"effects.{effect}.{way}" for effect, way in chosen.items()])
    middle, d = {f"effects.{effect}.{way}": 0.4 for effect, way in chosen.items()}, 1e-5
    for path in middle:
        shown, slope = at(middle, path)
        expected = (at({**middle, path: 0.4 + d})[0] - at({**middle, path: 0.4 - d})[0]) / (2 * d)
        assert float(jnp.abs(shown - at({**middle, path: 0.0})[0]).max()) > 1e-5, path
        assert float(jnp.abs(slope - expected).max()) < 0.02 * float(jnp.abs(expected).max()) + 1e-9, path


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
    still: Any = SimpleNamespace(q=(zero,), v=(zero,), vacuum=zero, t=zero)
    still.warm = zero
    assert (
        float(kind(by_load=5.0)._amount((zero, zero), still, jnp.asarray(-10.0))) == 1.0
    )  # a drive that overshoots below 0
    for warm, expected in ((2.0, 1.5), (-2.0, 0.5), (-1e6, 0.0)):
        still.warm = jnp.asarray(warm)
        np.testing.assert_allclose(kind(by_warmth=1.0)._amount((zero, zero), still, zero), expected, atol=1e-5)


def test_what_wears_in_or_settles_in_each_run_is_half_done_where_it_says():
    kind: Any = varying(REGISTRY["actuator_deadband"])
    zero = jnp.zeros(())
    less, settles = kind(by_use=-0.8, half_use_rad=3.0), kind(by_time=-0.8, half_time_s=3.0)
    for x, left in ((0.0, 1.0), (3.0, 0.6), (1e9, 0.2)):
        still: Any = SimpleNamespace(q=(zero,), v=(zero,), vacuum=zero, warm=zero, t=jnp.asarray(x))
        assert float(less._amount((zero, jnp.asarray(x)), still, zero)) == pytest.approx(left)
        assert float(settles._amount((zero, zero), still, zero)) == pytest.approx(left)


def test_what_begins_at_a_moment_is_as_if_it_had_not_been_before(robot):
    """A marker that slips by 0.02 rad after 0.2 rad of the mean joint's way, and one that has slipped in earlier runs
    already, which is so at the start too."""
    bare, kind = seen(robot(3), drive()), varying(REGISTRY["sensor_bias"])
    way = np.cumsum(np.abs(np.diff(np.asarray(bare).mean(axis=1), prepend=bare[0].mean())))
    later = kind(**{"offset_rad": 0.02, "by_onset": 1.0, "onset_rad": 0.2, "over_rad": 1e-3})
    shown = seen(dataclasses.replace(robot(3), effects=(later,)), drive()) - bare
    np.testing.assert_allclose(shown[way < 0.15], 0.0, atol=1e-9)
    assert np.any(way > 0.25)
    np.testing.assert_allclose(shown[way > 0.25], 0.02, atol=1e-9)
    y, v = (jnp.asarray(0.1),) * 3, (jnp.zeros(()),) * 3
    before, after = (
        unsensed(dataclasses.replace(robot(3), effects=(later,)), y, v, Drive(*jnp.zeros(3), worn=jnp.asarray(worn)))
        for worn in (0.0, 1.0)
    )
    np.testing.assert_allclose(before, 0.1, atol=1e-9)
    np.testing.assert_allclose(after, 0.08, atol=1e-9)


def test_an_effect_may_be_another_in_each_run(tmp_path, robot):
    """Which run it is the slip at its start tells, whatever slips in it."""
    given = {"offset_rad": 0.01, "in_run2": 1.0, "in_run3": -3.0, "until1_rad": 0.2, "until2_rad": 9.0}
    path = tmp_path / "model.toml"
    path.write_text(modelfile.dumps(ModelFile(dataclasses.replace(robot(3), effects=(build("sensor_bias", given),)))))
    model = modelfile.load(path).model
    y, v = (jnp.asarray(0.1),) * 3, (jnp.zeros(()),) * 3
    for worn, bias in ((0.0, 0.01), (6.0, 0.02), (10.0, -0.02)):
        before = unsensed(model, y, v, Drive(*jnp.zeros(3), worn=jnp.asarray(worn)))
        np.testing.assert_allclose(before, 0.1 - bias, atol=1e-9)
    np.testing.assert_allclose(seen(model, drive()) - seen(robot(3), drive()), 0.01, atol=1e-9)


def test_in_no_run_is_an_effect_of_one_sign_another_way_round(robot):
    """A payload that is put on in the first run is taken off in the second, not hung from a balloon."""
    given = {"mass_kg": 0.1, "in_run2": -3.0, "until1_rad": 0.2}
    made = build("tip_payload", given)
    model = dataclasses.replace(robot(3), effects=(made,))
    still = (jnp.zeros(()),) * 3
    bare = ((jnp.ones(()),) * 3,) * 3
    for worn, heavier in ((0.0, True), (1.0, False)):
        drive_ = Drive(*jnp.zeros(3), worn=jnp.asarray(worn))
        now = step._now(model, step.Unrolled(still, still, still), drive_, jnp.asarray(1e-3))
        m = made.inertia(made.start(now), bare, now)
        assert (float(m[0][0]) > 1.0) == heavier and float(m[0][0]) >= 1.0


def test_a_run_of_a_log_begins_where_its_camera_says_however_its_marker_comes_to_slip(robot):
    later = build("sensor_bias", {"offset_rad": 0.1, "by_onset": 1.0, "onset_rad": 10.0})
    model = dataclasses.replace(robot(3), effects=(later,))
    np.testing.assert_allclose(unsensed_at_rest(model, drive(), jnp.full(3, 0.2)), 0.2, atol=1e-9)


def test_a_delay_may_be_another_in_each_run():
    """Half as long again in the second one: to first order by half of it times the rate, of commands and of stamps."""
    h, d, rate, zero = 0.01, 0.02, 3.0, jnp.zeros(())
    for effect, hook in (("actuator_delay", "actuate"), ("sensor_delay", "sense")):
        late: Any = varying(REGISTRY[effect], (1.0,))(**{"delay_seconds": d, "in_run2": 0.5})
        assert float(late.delay_s() if hook == "actuate" else late.latency_s()) == d
        for worn, more in ((0.0, 0.0), (5.0, 0.5)):
            at = [(jnp.asarray(0.1 + rate * h * k),) * 2 for k in range(2)]
            q = at[0] if hook == "sense" else (zero, zero)
            before: Any = SimpleNamespace(
                q=q, v=(zero, zero), u=at[0], vacuum=zero, warm=zero, t=zero, h=jnp.asarray(h)
            )
            before.worn = jnp.asarray(worn)
            out, _ = getattr(late, hook)(late.start(before), at[1], before)
            np.testing.assert_allclose(np.array(out), 0.1 + rate * h - more * d * rate, rtol=1e-6)


def test_what_an_effect_remembers_at_the_start_is_what_reaches_it(robot):
    """A lag behind a wrong gain rests at the tension that the gain makes, and a late stamp sees the biased shape."""
    gain, lag = build("actuator_gain", {"error": 0.5}), build("actuator_lag", {"tau_s": 0.3})
    at = Drive(jnp.asarray(10.0), jnp.asarray(0.0), jnp.asarray(0.0), t=jnp.asarray(0.0))
    still, shape = (jnp.zeros(()),) * 3, (jnp.asarray(0.1),) * 3
    begun = step.begin(dataclasses.replace(robot(3), effects=(gain, lag)), shape, still, still, at)
    assert float(begun.memory[1][0][0]) == pytest.approx(15.0)
    bias = build("sensor_bias", {"offset_rad": 0.01})
    late = build("sensor_delay", {"delay_seconds": 0.03, "drift": 1.0, "phase": 0.3})
    seen_first = step.begin(dataclasses.replace(robot(3), effects=(bias, late)), shape, still, still, at).sensed
    np.testing.assert_allclose(np.asarray(seen_first), 0.11, atol=1e-9)


def test_no_effect_makes_a_friction_or_a_stiffness_that_drives(robot):
    """However far it takes them down, a fiftieth is left."""
    at, still = Drive(*jnp.zeros(3), warm=jnp.asarray(10.0)), (jnp.zeros(()),) * 3
    bent = step.Unrolled((jnp.asarray(0.3),) * 3, still, still, ((at.warm, at.warm),))

    def after(**per_k: float) -> np.ndarray:
        model = dataclasses.replace(robot(3), effects=(build("thermal_drift", per_k),))
        return np.asarray(step.advance(model, step.constants(model), bent, at, 0.005, step.How(3)).q)

    for name in ("friction_per_k", "stiffness_per_k"):
        some, least, beyond = (after(**{name: x}) for x in (-0.05, -0.098, -0.5))
        assert np.abs(beyond - least).max() < 0.05 * np.abs(some - least).max()


def test_the_moment_at_which_an_effect_begins_has_the_right_derivative(robot):
    chosen, begun = ("base_tilt", "tip_payload"), {"by_onset": 0.6, "onset_rad": 0.2, "over_rad": 0.1}
    model = with_sizes(robot(2), 1.0, [varying(REGISTRY[effect]) for effect in chosen])
    middle = {f"effects.{effect}.{name}": x for effect in chosen for name, x in begun.items()}
    at, d = moved(model, [*middle]), 1e-5
    for path, x in middle.items():
        _, slope = at(middle, path)
        expected = (at({**middle, path: x + d})[0] - at({**middle, path: x - d})[0]) / (2 * d)
        assert float(np.abs(expected).max()) > 1e-5, path
        assert float(np.abs(slope - expected).max()) < 0.02 * float(np.abs(expected).max()) + 1e-9, path


def test_what_is_put_on_moved_or_set_may_begin_at_a_moment():
    begun = {i for i, k in REGISTRY.items() if "by_onset" in varying(k).fields()}
    moved = {"rest_curvature", "base_tilt", "tip_payload", "contact", "sensor_bias", "sensor_scale"}
    assert begun == moved | {"pressure_bias", "pressure_leak", "actuator_gain", "actuator_delay", "sensor_delay"}
    first, last = onsets(48.0, 24)[::23]
    assert (first["onset_rad"], last["onset_rad"], first["over_rad"]) == (1.0, 47.0, 0.48)


def test_a_model_file_holds_how_an_effect_varies(tmp_path, robot):
    model = dataclasses.replace(robot(3), effects=(build("base_tilt", {"tilt_rad": 0.1, "by_load": 0.7}),))
    path = tmp_path / "model.toml"
    path.write_text(modelfile.dumps(ModelFile(model)))
    back = modelfile.load(path).model
    assert float(get(back, "effects.base_tilt.by_load")) == 0.7
    np.testing.assert_allclose(seen(back, drive()), seen(model, drive()), atol=1e-13)


def test_a_camera_feels_neither_load_nor_vacuum():
    assert set(ways(REGISTRY["sensor_scale"])) == {"by_bend", "by_rate", "by_warmth", "by_use", "by_time"}
    assert set(ways(REGISTRY["tendon_friction"])) == set(WAYS)
