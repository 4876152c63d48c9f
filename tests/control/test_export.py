"""law.json and the C header: one law everywhere, files that prove themselves, one line for what is wrong."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ljjax import law
from ljjax.cli import main
from ljjax.control import export, parity
from ljjax.control.c99 import header
from ljjax.control.runtimes import FUSED, by_c, by_jax, by_python, errors, random_ticks
from ljjax.errors import InputError
from ljjax.law.file import content, dumps, load, parse, sha256
from ljjax.law.golden import COLUMNS, record
from ljjax.law.parts import State
from ljjax.modelfile import ModelFile
from ljjax.modelfile import dumps as dump_model

LAWS = tuple(law.KINDS)
ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def model_file(robot, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("robot") / "model.toml"
    path.write_text(dump_model(ModelFile(robot())), encoding="utf-8")
    return path


@pytest.mark.parametrize("kind", LAWS)
def test_a_law_comes_back_from_its_file_number_for_number(designs, tmp_path, kind):
    export(designs[kind], tmp_path / "law.json")
    assert load(tmp_path / "law.json") == designs[kind].law


@pytest.mark.parametrize("kind", LAWS)
def test_python_jax_and_c_are_the_same_law(designs, kind):
    found = parity(designs[kind].law, 3000)
    assert found.jax <= 1e-12 and found.c_double <= 1e-12 and found.c_float <= 1e-5, found


@pytest.mark.parametrize("kind", LAWS)
def test_contracted_multiply_adds_change_the_last_digits_alone(designs, kind):
    given = designs[kind].law
    ticks = random_ticks(given, 3000)
    expected = by_python(given, ticks)
    for real, most in (("double", 1e-13), ("float", 1e-5)):
        assert errors(by_c(given, ticks, real, FUSED), expected).max() <= most


@pytest.mark.parametrize("kind", LAWS)
def test_jax_and_c_reproduce_the_golden_vectors(designs, kind):
    given = designs[kind].law
    golden = record(given)
    rows = np.array(golden.rows)
    before = np.concatenate([[golden.initial], rows[:-1, 4:11]])
    ticks = np.concatenate([before, rows[:, :4]], axis=1)
    for run in (by_jax, by_c):
        assert errors(run(given, ticks), rows[:, 4:]).max() <= 1e-12


def test_the_golden_sequence_drives_the_law_into_each_of_its_limits(designs):
    given: law.Law = designs["observer"].law
    limits, t = given.limits, given.period_s
    rows = np.array(record(given).rows)
    column = {name: rows[:, i] for i, name in enumerate(COLUMNS)}
    change = {name: np.diff(column[f"state.{name}"]) for name in State._fields}
    assert (np.abs(change["net"]) > 0.999 * limits.tension_slew_n_s * t).any()
    strongest = limits.tension_max_n - limits.tension_min_n
    assert column["state.net"].max() == strongest and column["state.net"].min() == -strongest
    assert (np.abs(change["vacuum"]) > 0.999 * limits.vacuum_slew_kpa_s * t).any()
    assert (np.abs(column["command.theta"]) > limits.theta_max_rad).any()
    stiffness = column["command.stiffness"]
    assert (stiffness < limits.stiffness_min_n_m).any() and (stiffness > limits.stiffness_max_n_m).any()
    assert (change["integral"] == 0).any() and (change["integral"] != 0).any()
    assert np.abs(column["state.bristle"]).max() > 0.5 * given.robot.mu_s
    for side in ("left", "right"):
        assert (np.abs(column[f"output.{side}"] - limits.tension_min_n) < 1e-9).any()


def test_a_law_loads_without_jax_and_numpy(designs, tmp_path):
    export(designs["observer"], tmp_path / "law.json")
    code = (
        "import sys; from ljjax import law; given = law.load(sys.argv[1]); "
        "state = law.start(given, 0.0, 0.0, 0.0, 0.0); "
        "print(law.tick(given, state, law.Measured(0.0, 0.0), law.Command(0.1, 6000.0))[1], "
        "[m for m in ('jax', 'numpy') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code, tmp_path / "law.json"], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("Output(left=") and done.stdout.strip().endswith("[]")


def changed(data, *path, to):
    out = json.loads(json.dumps(data))
    place = out
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = to
    return out


def resealed(data):
    return {**data, "sha256": sha256(data)}


WRONG = [
    (lambda d: changed(d, "gains", "gamma", to=0.5), "the file was changed after its export"),
    (lambda d: changed(d, "schema", to="ljjax.law/2"), "schema is 'ljjax.law/2'; expected 'ljjax.law/1'"),
    (lambda d: changed(d, "law", to="magic"), "law is 'magic'; expected one of passivity"),
    (lambda d: changed(d, "gains", "gamma", to="much"), "gains.gamma is 'much'; expected a number [N·m]"),
    (lambda d: changed(d, "gains", "gamma", to=True), "gains.gamma is True"),
    (lambda d: changed(d, "gains", "gamma", to=10**400), "gains.gamma is inf"),
    (lambda d: changed(d, "gains", "more", to=1.0), "gains: unknown key 'more'"),
    (lambda d: changed(d, "tables", "phi", to=[1.0]), "tables.phi: expected a list of two numbers"),
    (lambda d: changed(d, "tables", "phi", to=[1.0, 2.0]), "tables.phi has 2 entries, tables.alpha2 65"),
    (lambda d: changed(d, "limits", "tension_min_n", to=-1.0), "limits.tension_min_n = -1: must be ≥ 0"),
    (lambda d: changed(d, "more", to=1), "unknown key 'more'"),
    (lambda d: {k: v for k, v in d.items() if k != "golden"}, "missing key golden"),
    (lambda d: resealed(changed(d, "golden", "rows", 7, 13, to=3.0)), "golden vectors: tick 7, "),
    (lambda d: resealed(changed(d, "golden", "rows", to=[])), "golden vectors: there are none"),
    (lambda d: resealed(changed(d, "golden", "rows", 3, to=[1.0])), "golden.rows: expected rows of 14 numbers"),
    (lambda d: resealed(changed(d, "gains", "damping", to=77.0)), "golden vectors: tick "),
    (lambda d: resealed(changed(d, "golden", "rows", 0, 0, to=1e250)), "golden vectors: tick 0, "),
    (
        lambda d: resealed(changed(d, "limits", "tension_slew_n_s", to=5e-324)),
        "golden vectors: cannot be computed (float",
    ),
    (lambda d: changed(d, "a\nb", to=1), r"unknown key 'a\nb'"),
]


@pytest.mark.parametrize("change,said", WRONG, ids=[said for _, said in WRONG])
def test_a_file_that_is_not_what_was_exported_is_refused_in_a_line(designs, change, said):
    data = json.loads(dumps(content(designs["integral"].law, {}, {})))
    with pytest.raises(InputError) as error:
        parse(change(data), "law.json")
    assert str(error.value).startswith("law.json: ") and said in str(error.value)


def test_files_that_are_no_law_are_refused(tmp_path):
    (tmp_path / "a.json").write_text("{")
    (tmp_path / "b.json").write_text("[]")
    for name, said in (("a.json", "not JSON"), ("b.json", "holds no law"), ("c.json", "no such file")):
        with pytest.raises(InputError, match=said):
            load(tmp_path / name)


def test_the_sum_does_not_depend_on_layout(designs):
    data = content(designs["integral"].law, {"model": "é"}, {})
    other = json.loads(json.dumps(data, indent=7, sort_keys=True))
    assert parse(other, "law.json") == designs["integral"].law


def test_the_command_writes_a_law_and_its_header(model_file, tmp_path, capsys):
    out, c = tmp_path / "law.json", tmp_path / "law.h"
    arguments = [
        "export",
        str(model_file),
        "--law",
        "observer",
        "--gain",
        "gamma=1.0",
        "--gain",
        "damping=9",
        "still_rad_s=0.03",
    ]
    assert main([*arguments, "--theta-max-deg", "10", "--out", str(out), "--header", str(c)]) == 0
    given = load(out)
    assert (given.kind, given.gains.gamma, given.gains.damping, given.gains.still_rad_s) == ("observer", 1.0, 9.0, 0.03)
    assert given.limits.theta_max_rad == pytest.approx(np.radians(10), rel=1e-12)
    said = capsys.readouterr().out
    assert "observer at 200 Hz: gamma 1, damping 9" in said and "reaches ±10° a segment" in said
    data = json.loads(out.read_text(encoding="utf-8"))
    assert data["provenance"]["model"] == "model.toml" and len(data["provenance"]["model_sha256"]) == 64
    text = c.read_text(encoding="ascii")
    about = {"software": data["provenance"]["software"], "model": f"model.toml {data['provenance']['model_sha256']}"}
    assert text == header(given, data["sha256"], about)
    assert {p.name for p in tmp_path.iterdir()} == {"law.json", "law.h"}


REFUSED = [
    (["--gain", "gamma"], "--gain gamma: expected NAME=VALUE"),
    (["--gain", "gamma=99"], "choose gamma <"),
    (["--gain", "gamma=1", "gamma=2"], "--gain gamma=2: gamma is given twice"),
    (["--gain", "compensation=0.5"], "--gain compensation=0.5: integral uses no such gain; its gains are gamma, damp"),
    (["--gain", "gama=1"], "--gain gama=1: integral uses no such gain"),
    (["--rate-hz", "100", "--rate-hz", "200"], "--rate-hz is given twice"),
    (["--vacuum-max-kpa", "90"], "give α₂ = -"),
    (["--law", "magic"], "magic"),
    (["--header", "OUT"], "the law and its header go to the same file"),
    (["--out", "nowhere/law.json"], "expected a file name in a folder that exists"),
]


@pytest.mark.parametrize("more,said", REFUSED, ids=[said for _, said in REFUSED])
def test_the_command_refuses_in_a_line_and_writes_nothing(model_file, tmp_path, capsys, more, said):
    out = str(tmp_path / "law.json")
    more = [out if x == "OUT" else x for x in more]
    where = [] if "--out" in more else ["--out", out]
    assert main(["export", str(model_file), *where, *more]) == 2
    errors_said = capsys.readouterr().err
    assert said in errors_said and errors_said.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_export_writes_both_files_or_none(designs, tmp_path, monkeypatch):
    """Whatever fails: the old ones stay, and nothing lies beside them."""
    made = designs["integral"]
    out, c = tmp_path / "law.json", tmp_path / "law.h"
    out.write_text("old")
    whole = Path.write_text

    def full(self, text, **how):
        if self.name.startswith(".law.h"):
            whole(self, text[:100], **how)
            raise OSError(28, "No space left on device")
        return whole(self, text, **how)

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(InputError, match="law.h: cannot be written"):
        export(made, out, header_out=c)
    assert [p.name for p in tmp_path.iterdir()] == ["law.json"] and out.read_text() == "old"


def test_export_knows_one_file_under_two_names_and_a_model_that_is_not_there(designs, tmp_path):
    made = designs["integral"]
    (tmp_path / "sub").mkdir()
    (tmp_path / "link.h").symlink_to(tmp_path / "law.json")
    for same in (tmp_path / "sub" / ".." / "law.json", tmp_path / "link.h"):
        with pytest.raises(InputError, match="go to the same file"):
            export(made, tmp_path / "law.json", header_out=same)
    with pytest.raises(InputError, match="none.toml: cannot be read"):
        export(made, tmp_path / "law.json", model_path=tmp_path / "none.toml")
    assert not (tmp_path / "law.json").exists()


def test_what_the_law_does_not_count_is_said(robot, tmp_path, capsys):
    effects = {
        "friction_saturation": {"rise": 3.0},
        "tip_payload": {"mass_kg": 0.1},
        "viscoelastic_creep": {"stiffness": 0.0, "slower": 0.0},
        "actuator_delay": {"delay_seconds": 0.01},
    }
    path = tmp_path / "model.toml"
    path.write_text(dump_model(ModelFile(robot(effects=effects))), encoding="utf-8")
    assert main(["export", str(path), "--out", str(tmp_path / "law.json")]) == 0
    said = capsys.readouterr().out.splitlines()
    assert (
        "the law does not count what changes neither α₂ nor φ of the robot at rest: actuator_delay, tip_payload" in said
    )
    reach = json.loads((tmp_path / "law.json").read_text(encoding="utf-8"))["reach"]
    assert reach["effects_not_counted"] == ["actuator_delay", "tip_payload"]


def test_the_header_uses_only_the_numbers_that_its_law_needs(designs):
    plain, full = (header(designs[kind].law) for kind in ("passivity", "observer"))
    assert "ljjax_law_mu_s" in full and "ljjax_law_mu_s" not in plain
    assert plain.isascii() and full.isascii()


def test_a_step_in_c_refuses_what_is_not_finite(designs):
    """Inputs, a state, and with a law that makes no numbers a result; the state given comes back, and no output."""
    given = designs["observer"].law
    good = random_ticks(given, 1)
    size = len(State._fields)
    for real in ("double", "float"):
        for i in range(good.shape[1]):
            tick = good.copy()
            tick[0, i] = np.nan
            np.testing.assert_array_equal(by_c(given, tick, real)[0], [*tick[0, :size], *[-1.0] * 3])
    good[0, [size, size + 2]] = 0.2, 0.0
    broken = dataclasses.replace(
        given, gains=given.gains._replace(gamma=1e39), robot=given.robot._replace(alpha1=1e39)
    )  # ∞ − ∞ in float
    np.testing.assert_array_equal(by_c(broken, good, "float")[0], [*good[0, :size], *[-1.0] * 3])


@pytest.mark.parametrize("kind", LAWS)
def test_bends_of_any_size_are_numbers_everywhere(designs, kind):
    """As large as double and float go; C in float, too, has a finite state after it."""
    given = designs[kind].law
    ticks = random_ticks(given, 60, seed=5)
    ticks[:30, 7], ticks[30:, 0] = np.float32(1e36) * (-1) ** np.arange(30), np.float32(1e37)
    expected = by_python(given, ticks)
    assert np.isfinite(expected).all()
    for found, most in (
        (by_jax(given, ticks), 1e-12),
        (by_c(given, ticks), 1e-12),
        (by_c(given, ticks, "float"), 1e-5),
    ):
        assert errors(found, expected).max() <= most
    ticks[:, 7] *= 1e270
    np.testing.assert_allclose(by_c(given, ticks), by_python(given, ticks), rtol=1e-12)
