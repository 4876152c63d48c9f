"""The whole reference rig against one that is not there, with a spring for a robot, and with the model."""

import ast
import os
import re
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import pytest

from ljjax.cli.rig_emulate import command
from ljjax.errors import InputError
from ljjax.rig.emulator.faults import KINDS, parse
from ljjax.rig.reference import ReferenceRig
from ljjax.rig.robot import RigError
from tests.rig.emulated import PATIENCE_S, Parts, close, config, emulated, named, until

ROOT = Path(__file__).parents[2]


def children() -> set[str]:
    listed = subprocess.run(["ps", "--ppid", str(os.getpid()), "-o", "args="], capture_output=True, text=True).stdout
    return {line for line in listed.splitlines() if "ljjax.rig.eye" in line}


def test_a_run_reads_what_it_commands_and_stops_whatever_happens():
    with emulated() as rig:
        with pytest.raises(ZeroDivisionError), ReferenceRig(config(rig)) as robot:
            assert rig.tensions == (0.0, 0.0) and robot.read().t_shape > 0

            def tick():
                robot.command(16.0, 1.0, 20.0)

            until(lambda: close(robot.read().theta, 0.15, 0.01) and close(robot.read().vacuum_kpa, 20, 0.5), tick)
            reading = robot.read()
            assert close(reading.left_n, 16.0, 0.5) and close(reading.right_n, 1.0, 0.5)
            assert reading.left_m > 0 > reading.right_m and not reading.faults
            assert max(reading.t_shape, reading.t_pressure, reading.t_tendons) <= time.monotonic()
            raise ZeroDivisionError
        until(lambda: rig.tensions == (0.0, 0.0))
        assert not children()
        assert rig.vacuum_kpa > 15  # kept


def test_pictures_of_an_emulator_that_was_killed_are_taken_away_by_the_next():
    code = "import time; from benchmarks.rig_parts import Spring; from ljjax.rig.emulator.rig import EmulatedRig\n"
    code += "with EmulatedRig(Spring()) as rig:\n    print(rig.frames_path, flush=True)\n    time.sleep(60)"
    with subprocess.Popen([sys.executable, "-c", code], cwd=ROOT, stdout=subprocess.PIPE, text=True) as killed:
        assert killed.stdout is not None
        path = Path(killed.stdout.readline().strip())
        assert path.exists()
        with emulated():
            assert path.exists()  # it still runs
        killed.kill()
    with emulated() as rig:
        assert not path.exists() and Path(rig.frames_path).exists()
    assert not Path(rig.frames_path).exists()


def test_parts_fail_by_name_and_take_the_others_with_them():
    with emulated() as rig:
        wrong = config(rig)
        wrong.servos["port"] = "/dev/nowhere"
        with pytest.raises(RigError, match="servos.port /dev/nowhere"):
            ReferenceRig(wrong).connect()
        assert not children()
        with ReferenceRig(config(rig, "servos")) as robot:  # a rig without camera and vacuum
            assert robot.read().theta != robot.read().theta
            until(lambda: robot.read().left_n > 1, lambda: robot.command(2.0, 2.0, 0.0))
    with pytest.raises(InputError, match="missing key servos.port"):
        ReferenceRig(Parts({}, {}, {}))


def test_the_camera_s_faults_reach_the_reading():
    with emulated() as rig, ReferenceRig(config(rig)) as robot:
        until(lambda: close(robot.read().theta, 0.0, 0.01))
        rig.faults.put("tag_jump=0.5")
        until(lambda: close(robot.read().theta, 0.25, 0.01))
        rig.faults.put("tag_lost")
        until(lambda: robot.read().theta != robot.read().theta)
        rig.faults.put("camera_frozen")
        until(lambda: robot.read().t_shape < time.monotonic() - 0.5)
        rig.faults.put("servo_error=5")
        until(lambda: named(robot.read(), "overload"))


@pytest.mark.parametrize(
    "text", ["flood", "packet_loss=2", "servo_error=1", "tag_jump=x", "tag_lost@soon", "servo_unplugged=up"]
)
def test_a_fault_that_is_none_is_refused(text):
    with pytest.raises(InputError, match="fault '"):
        parse(text)


def test_faults_are_read():
    assert parse("packet_loss=0.2@1.5") == ("packet_loss", "0.2", 1.5)
    assert {parse(kind).kind for kind in KINDS} == set(KINDS)


def test_the_model_in_real_time_answers_the_same_drivers(tmp_path):
    model = tmp_path / "model.toml"
    model.write_text((ROOT / "ljjax/data/octrobot/nominal.toml").read_text().replace("segments = 6", "segments = 1"))
    out = tmp_path / "rig.toml"
    words = [sys.executable, "-m", "ljjax", "rig", "emulate", str(model), "--out", str(out), "--rate-hz", "40"]
    options = ["--effects", "actuator_lag.tau_s=0.05", "sensor_delay.delay_seconds=0.01", "--fault", "vacuum_leak=0.2"]
    with subprocess.Popen(
        words + options, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=os.environ | {"LJJAX_CACHE": ""}
    ) as process:
        try:
            assert process.stdout is not None and process.stdin is not None
            line = process.stdout.readline()
            assert line.startswith("servos /dev/")
            until(out.exists)
            tables = tomllib.loads(out.read_text())
            assert tables["schema"] == "ljjax.rig/1" and tables["driver"] == "reference"
            tables["camera"] |= {"wait_s": PATIENCE_S}
            with ReferenceRig(Parts(tables["servos"], tables["camera"], tables["pressure"])) as robot:
                until(lambda: robot.read().vacuum_kpa > 7, lambda: robot.command(8.0, 1.0, 10.0))
                until(lambda: robot.read().theta > 0.05, lambda: robot.command(8.0, 1.0, 10.0))
                until(lambda: close(robot.read().vacuum_kpa, 8.0, 0.5), lambda: robot.command(8.0, 1.0, 10.0))
                process.stdin.write("-vacuum_leak\nservo_error=5\n")
                process.stdin.flush()
                until(lambda: named(robot.read(), "overload"), lambda: robot.command(8.0, 1.0, 10.0))
                until(lambda: robot.read().vacuum_kpa > 9.5)
            process.send_signal(signal.SIGTERM)
            assert process.wait(PATIENCE_S) == 0
        finally:
            process.kill()
    assert not Path(tables["camera"]["source"].removeprefix("file:")).exists()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"fault": ("flood",)}, "no fault 'flood'"),
        ({"rate_hz": 0.0}, "--rate-hz 0"),
        ({"duration_s": -1.0}, "--duration-s -1"),
        ({"out": Path("/nowhere/rig.toml")}, "--out /nowhere/rig.toml"),
        ({"effects": ("actuator_lag=1",)}, "--effects actuator_lag=1: no such parameter"),
        ({"effects": ("actuator_lag.tau_s=much",)}, "'much' is no number"),
        ({"effects": ("actuator_lag.tau_s=-1",)}, "must lie between"),
    ],
)
def test_emulate_refuses_what_makes_no_sense(options, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=re.escape(said)):
        command(ROOT / "ljjax/data/octrobot/nominal.toml", **options)
    assert not list(tmp_path.iterdir())


def test_drivers_and_emulator_import_no_jax():
    names = sorted(path for path in (ROOT / "rig").rglob("*.py") if path.name != "__main__.py")
    modules = ["ljjax." + ".".join(path.relative_to(ROOT).with_suffix("").parts) for path in names]
    code = "import importlib, sys\nfor n in sys.argv[1:]: importlib.import_module(n)\nprint('jax' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code, *modules], capture_output=True, text=True, cwd=ROOT)
    assert done.stdout.strip() == "False", done.stderr
    for path in names:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            found = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            found += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            for name in found:
                top = name.split(".")
                ours = {("ljjax", "rig"), ("ljjax", "law"), ("ljjax", "logs"), ("ljjax", "errors")}
                assert top[0] in {*sys.stdlib_module_names, "numpy"} or tuple(top[:2]) in ours or name == "ljjax", name
