"""model.toml: what is written comes back to the last digit, and what is impossible is refused by name."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from ljjax import energy
from ljjax.errors import InputError
from ljjax.friction import friction_torque
from ljjax.model import UNITS, astype, check, get, in_gauge, replace
from ljjax.modelfile import ModelFile, dumps, load

NOMINAL = Path(str(files("ljjax"))) / "data" / "octrobot" / "nominal.toml"


@pytest.fixture(scope="module")
def text(robot) -> str:
    return dumps(ModelFile(robot(4), {"elastic.c3": 0.05}, ("gravity.alpha1",)))


@pytest.mark.parametrize("dtype", [jnp.float64, jnp.float32])
def test_round_trip_to_the_last_digit(tmp_path, random_robot, dtype):
    for seed in range(5):
        model = replace(astype(random_robot(seed, n=seed + 1), dtype), {"friction.sigma0": 1.0})
        written = ModelFile(model, {"elastic.c1": 1 / 3, "friction.mu_s": 0.0}, ("gravity.alpha1", "chain.radius_m"))
        path = tmp_path / "model.toml"
        path.write_text(dumps(written, comment="made by a test\nin two lines"), encoding="utf-8")
        back = load(path)
        assert back.model.n == model.n
        assert {p: float(get(back.model, p)) for p in UNITS} == {p: float(get(model, p)) for p in UNITS}
        assert dict(back.uncertainty) == dict(written.uncertainty)
        assert back.frozen == written.frozen
        assert dumps(back, comment="made by a test\nin two lines") == path.read_text(encoding="utf-8")


def test_the_bundled_robot_loads():
    model = load(NOMINAL).model
    assert model.n == 6
    assert float(model.chain.half_length_m) == 0.021
    check(model, [0.0, 90.0])


def test_whole_numbers_are_numbers(tmp_path, text):
    path = tmp_path / "model.toml"
    path.write_text(text.replace("alpha1 = 0.4", "alpha1 = 1"), encoding="utf-8")
    assert float(load(path).model.gravity.alpha1) == 1.0


REFUSED = {
    "no schema": ('schema = "ljjax.model/1"', "", "schema"),
    "another schema": ("ljjax.model/1", "ljjax.model/2", "schema"),
    "unknown table": ("[gravity]", "[gravitation]\nx = 1\n[gravity]", "gravitation"),
    "unknown key at the top": ('schema = "ljjax.model/1"', 'schema = "ljjax.model/1"\nname = "robot"', "name"),
    "unknown key": ("alpha1 = 0.4", "alpha1 = 0.4\nalpha3 = 1.0", "gravity.alpha3"),
    "unknown key with a newline": ("alpha1 = 0.4", 'alpha1 = 0.4\n"al\\npha" = 1.0', "gravity.al"),
    "law where there is none": ("[gravity]", '[gravity]\nlaw = "sine"', "gravity.law"),
    "missing key": ("mu_s = 0.03", "", "friction.mu_s"),
    "missing law": ('law = "sqrt"', "", "jamming.law"),
    "missing gauge": ('gauge = "sigma0=1"', "", "friction.gauge"),
    "missing gauge value": ("sigma0 = 1.0", "", "friction.sigma0"),
    "missing segments": ("segments = 4", "", "chain.segments"),
    "missing table": ("[gravity]\nalpha1 = 0.4", "", "gravity"),
    "table that is a number": ("[gravity]\nalpha1 = 0.4", "", "gravity", "gravity = 1\n"),
    "text for a number": ("alpha1 = 0.4", 'alpha1 = "0.4"', "gravity.alpha1"),
    "truth for a number": ("alpha1 = 0.4", "alpha1 = true", "gravity.alpha1"),
    "list for a number": ("alpha1 = 0.4", "alpha1 = [0.4]", "gravity.alpha1"),
    "nan": ("alpha1 = 0.4", "alpha1 = nan", "gravity.alpha1"),
    "inf": ("alpha1 = 0.4", "alpha1 = inf", "gravity.alpha1"),
    "-inf": ("alpha1 = 0.4", "alpha1 = -inf", "gravity.alpha1"),
    "overflow": ("alpha1 = 0.4", "alpha1 = 1e400", "gravity.alpha1"),
    "whole number too large": ("alpha1 = 0.4", "alpha1 = 1" + 400 * "0", "gravity.alpha1"),
    "more digits than Python reads": ("alpha1 = 0.4", "alpha1 = 1" + 5000 * "0", "not TOML"),
    "segments = 0": ("segments = 4", "segments = 0", "chain.segments"),
    "segments = 2.5": ("segments = 4", "segments = 2.5", "chain.segments"),
    "segments = true": ("segments = 4", "segments = true", "chain.segments"),
    "mass = 0": ("segment_mass_kg = 0.06", "segment_mass_kg = 0", "chain.segment_mass_kg"),
    "mass < 0": ("segment_mass_kg = 0.06", "segment_mass_kg = -0.06", "chain.segment_mass_kg"),
    "length < 0": ("half_length_m = 0.021", "half_length_m = -0.021", "chain.half_length_m"),
    "α₂ ≤ 0": ("c3 = 0.8", "c3 = 0.0", "elastic.c"),
    "φ ≤ 0": ("c4 = 3.0", "c4 = -3.0", "jamming.c4"),
    "μ_S < μ_C": ("mu_s = 0.03", "mu_s = 0.02", "friction.mu_s"),
    "μ_C = 0": ("mu_c = 0.025", "mu_c = 0.0", "friction.mu_c"),
    "σ₁ < 0": ("sigma1 = 0.004", "sigma1 = -0.004", "friction.sigma1"),
    "σ₂ < 0": ("sigma2 = 0.012", "sigma2 = -0.012", "friction.sigma2"),
    "σ₃ < 1": ("sigma3 = 1.6", "sigma3 = 0.5", "friction.sigma3"),
    "v_s = 0": ("v_s = 0.045", "v_s = 0.0", "friction.v_s"),
    "another gauge": ('gauge = "sigma0=1"', 'gauge = "c4=1"', "friction.gauge"),
    "σ₀ ≠ 1": ("sigma0 = 1.0", "sigma0 = 2.0", "friction.sigma0"),
    "another law": ('law = "sqrt"', 'law = "saturating"', "jamming.law"),
    "effects": ("[gravity]", '[[effects]]\nid = "wear"\n[gravity]', "effects"),
    "effects that are no tables": ('schema = "ljjax.model/1"', 'schema = "ljjax.model/1"\neffects = 0', "effects"),
    "uncertainty of nothing": ("[uncertainty.elastic]", "[uncertainty.elastics]", "uncertainty.elastics.c3"),
    "uncertainty of an unknown key": ("c3 = 0.05", "c4 = 0.05", "uncertainty.elastic.c4"),
    "uncertainty < 0": ("c3 = 0.05", "c3 = -0.05", "uncertainty.elastic.c3"),
    "uncertainty nan": ("c3 = 0.05", "c3 = nan", "uncertainty.elastic.c3"),
    "uncertainty text": ("c3 = 0.05", 'c3 = "5 %"', "uncertainty.elastic.c3"),
    "uncertainty that is no table": (
        "[uncertainty.elastic]  # standard deviations\nc3 = 0.05", "", "uncertainty", "uncertainty = 3\n"),
    "frozen unknown": ('["gravity.alpha1"]', '["gravity.beta"]', "fit.frozen"),
    "frozen is no list": ('["gravity.alpha1"]', '"gravity.alpha1"', "fit.frozen"),
    "frozen lists": ('["gravity.alpha1"]', '[["gravity.alpha1"]]', "fit.frozen"),
    "fit with an unknown key": ("frozen =", "freeze =", "fit.freeze"),
    "not TOML": ("[gravity]", "[gravity", "line"),
    "a key twice": ("alpha1 = 0.4", "alpha1 = 0.4\nalpha1 = 0.4", "line"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED.values(), ids=REFUSED.keys())
def test_refusals_name_file_and_key_in_one_line(tmp_path, text, case):
    old, new, named, *before = case
    assert text.count(old) == 1, "the example no longer has this line"
    path = tmp_path / "robot.toml"
    path.write_text("".join(before) + text.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError) as refused:
        load(path)
    message = str(refused.value)
    assert message.startswith(str(path))
    assert named in message[len(str(path)) :]
    assert "\n" not in message


def test_refusals_of_files(tmp_path):
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00schema")
    (tmp_path / "empty.toml").write_bytes(b"")
    for path in (tmp_path / "absent.toml", tmp_path, binary, tmp_path / "empty.toml"):
        with pytest.raises(InputError) as refused:
            load(path)
        assert str(refused.value).startswith(str(path))


def test_the_gauge_is_explained_and_the_advice_works(tmp_path, robot, text):
    """`σ₀ ≠ 1` tells how to change the scale; doing so gives a file that loads and the same friction."""
    model = robot(4)
    scaled = {f"friction.{p}": get(model, f"friction.{p}") * 2 for p in ("sigma0", "sigma1", "sigma2", "mu_c", "mu_s")}
    scaled |= {f"jamming.{p}": get(model, f"jamming.{p}") / 2 for p in ("c4", "c5")}
    other = replace(model, scaled)
    path = tmp_path / "robot.toml"
    s0 = float(other.friction.sigma0)
    advised = replace(
        other,
        {p: get(other, p) * (s0 if p.startswith("jamming") else 1 / s0) for p in scaled},
    )
    path.write_text(dumps(ModelFile(advised)), encoding="utf-8")
    for p in UNITS:
        assert float(get(load(path).model, p)) == pytest.approx(float(get(model, p)), rel=1e-15)


POLYNOMIALS = [
    ("falls below 0 beyond 74.6 kPa", (-0.001483, 0.089058, 1.6242), 74.0, 80.0),
    ("dips between the ends", (0.01, -0.5, 5.0), 10.0, 40.0),
    ("falls linearly", (0.0, -0.1, 1.0), 9.0, 11.0),
]


@pytest.mark.parametrize(("name", "c", "good", "bad"), POLYNOMIALS, ids=[p[0] for p in POLYNOMIALS])
def test_stiffness_is_not_extrapolated_below_zero(robot, name, c, good, bad):
    model = robot(parameters=dict(zip(("elastic.c1", "elastic.c2", "elastic.c3"), c, strict=True)))
    check(model, [0.0, good])
    with pytest.raises(InputError, match="elastic"):
        check(model, [5.0, bad, 1.0], "log.mcap")


def test_friction_scale_must_stay_positive(robot):
    model = robot(parameters={"jamming.c5": -1.0})
    check(model, [4.0])
    with pytest.raises(InputError, match="jamming"):
        check(model, [16.0])


def test_unknown_parameters_are_named(robot):
    for use in (lambda: get(robot(), "friction.mu"), lambda: replace(robot(), {"friction.mu": 1.0})):
        with pytest.raises(InputError, match="friction.mu"):
            use()


def test_another_gauge_is_written_in_the_files_own(tmp_path, robot):
    """A model with σ₀ ≠ 1 is the same robot in the file: same torques, and the file loads."""
    other = replace(in_gauge(robot(3)), {"friction.sigma0": 2.0})
    path = tmp_path / "model.toml"
    path.write_text(dumps(ModelFile(other)), encoding="utf-8")
    back = load(path).model
    v, z, phi = jnp.asarray([0.03, -0.2, 0.0]), jnp.asarray([0.002, 0.001, -0.001]), jnp.asarray(15.0)
    ours = friction_torque(other.friction, v, z, energy.phi(other, phi))
    assert np.allclose(friction_torque(back.friction, v, z, energy.phi(back, phi)), ours, rtol=1e-12)
    assert float(back.friction.sigma0) == 1.0
