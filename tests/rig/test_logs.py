"""Logs of a rig: contract v1, whole or cut short, and what the other rooms make of them."""

from __future__ import annotations

import json
import math
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from ljjax import law
from ljjax.errors import InputError
from ljjax.law import Command
from ljjax.logs import read
from ljjax.logs.reader import read_attachment
from ljjax.rig import experiments
from ljjax.rig.gate import Sent
from ljjax.rig.loop import RUN, Tick
from ljjax.rig.mock import MockRobot
from ljjax.rig.recorder import Recorder
from ljjax.rig.robot import Reading
from ljjax.rig.safety import Fault
from ljjax.rig.session import record
from ljjax.rig.task import Point, follow

from .conftest import FakeClock, configured, mock_robot

META = {"run_id": "1", "robot_id": "r", "experiment": "e", "p_atm_pa": "101325.0", "start_utc": "2026-03-03T09:40:37Z"}
WALL_NS = 1_772_530_837_000_000_000


def some(k: int, **reading) -> Tick:
    t = 100 + 0.005 * k
    given = Reading(t_shape=t - 0.01, theta=0.01 * k, t_pressure=t, vacuum_kpa=3.0)._replace(**reading)
    return Tick(t, RUN, 1e-4, 2e-4, 0, 0, Sent(1.0 + k, 2.0, 3.0), given, {})


def recorder(path: Path, most_s: float = 60.0) -> Recorder:
    return Recorder(path, META, 101325.0, t=100.0, wall_ns=WALL_NS, most_s=most_s, attachments={"a": b"xyz"})


def until(holds) -> None:
    """Wait for another process; a minute is for machines with much else to do."""
    end = time.monotonic() + 60
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_what_was_handed_over_is_in_the_log(tmp_path: Path):
    with recorder(tmp_path / "a.mcap") as log:
        for k in range(10):
            log.tick(some(k, left_n=1.0, right_n=2.0, t_tendons=100 + 0.005 * k, t_probe=100 + 0.005 * k,
                          probe_m=1e-3, probe_n=0.5, theta=math.nan if k == 4 else 0.01 * k))  # fmt: skip
        wrong = some(10)
        log.tick(wrong._replace(faults={"tag_lost": Fault("tag_lost", "no number", wrong.t)}))
        assert log.trouble() == ""
        log.end("fault: tag_lost")
    run = read(tmp_path / "a.mcap")
    assert run.damage is None and run.notes == () and run.metadata["end_reason"] == "fault: tag_lost"
    np.testing.assert_allclose(run.signals["cmd_tendons"].value[:, 0], 1.0 + np.arange(11))
    np.testing.assert_allclose(run.signals["cmd_pressure"].value, 101325 - 3000)
    np.testing.assert_allclose(run.signals["shape"].value[:, 0], 0.01 * np.array([0, 1, 2, 3, 5, 6, 7, 8, 9, 10]))
    np.testing.assert_allclose(run.signals["probe"].value, [[1e-3, 0.5]] * 10)
    assert run.signals["cmd_tendons"].t[0] + run.t0_ns / 1e9 == pytest.approx(WALL_NS / 1e9, abs=1e-6)
    assert run.signals["shape"].log_t is not None and "spool" not in run.signals and "temperature" not in run.signals
    assert read_attachment(tmp_path / "a.mcap", "a") == b"xyz"
    assert b"tag_lost: no number" in b"".join(_diagnostics(tmp_path / "a.mcap"))


def _diagnostics(path: Path) -> list[bytes]:
    from mcap.reader import make_reader

    with path.open("rb") as stream:
        return [m.data for _, _, m in make_reader(stream).iter_messages(["/real/rig/diagnostics"])]


def test_a_tension_that_a_motor_s_current_tells_is_not_logged_as_measured(tmp_path: Path):
    with recorder(tmp_path / "a.mcap") as log:
        for k in range(10):
            log.tick(some(k, left_n=1.0, right_n=2.0, t_tendons=100 + 0.005 * k, by_current=1.0, left_ma=12.5))
        log.end("completed")
    assert "tendons" not in read(tmp_path / "a.mcap").signals
    assert b"12.50" in _diagnostics(tmp_path / "a.mcap")[-1]


def test_joints_are_logged_where_each_has_a_marker(tmp_path: Path):
    with recorder(tmp_path / "a.mcap") as log:
        for k in range(5):
            log.tick(some(k, joints=(0.1, 0.2, 0.3)))
        log.end("completed")
    shape = read(tmp_path / "a.mcap").signals["shape"]
    assert shape.columns == ("q1", "q2", "q3") and len(shape) == 5


def test_a_loop_that_goes_without_a_word_loses_nothing_and_reads_as_cut_short(tmp_path: Path):
    with recorder(tmp_path / "a.mcap") as log:
        for k in range(700):
            log.tick(some(k))
    run = read(tmp_path / "a.mcap")
    assert "end_reason" not in run.metadata and any("cut short" in note for note in run.notes)
    assert len(run.signals["cmd_tendons"]) == 700


def test_a_logging_process_that_is_killed_loses_what_had_not_reached_the_disk_and_the_loop_hears_of_it(tmp_path: Path):
    with recorder(tmp_path / "a.mcap") as log:
        for k in range(50):
            log.tick(some(k))
        given = time.monotonic()
        until(lambda: log.synced > given)
        for k in range(50, 60):
            log.tick(some(k))
        os.kill(log.pid, signal.SIGKILL)
        until(lambda: log.trouble() != "")
        assert "has gone" in log.trouble()
        with pytest.raises(InputError, match="does not answer"):
            log.end("completed")
    run = read(tmp_path / "a.mcap")
    assert "end_reason" not in run.metadata and 50 <= len(run.signals["cmd_tendons"]) <= 60


KEEPS = """import os, shutil, time
sync = os.fsync
def kept(fd):
    entered = time.monotonic()
    sync(fd)
    path = os.readlink(f"/proc/self/fd/{fd}")
    if path.endswith(".mcap"):
        shutil.copy(path, os.path.join(os.path.dirname(__file__), f"{entered:.6f}.kept"))
os.fsync = kept
"""
"""What a disk holds after each sync, kept aside."""


def test_power_that_fails_takes_half_a_second_at_most(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """At any moment the disk holds what it held after the last sync: a file that reads, with all but the last rows."""
    (tmp_path / "sitecustomize.py").write_text(KEEPS)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    given = []
    with recorder(tmp_path / "a.mcap") as log:
        end = time.monotonic() + 2.5
        while time.monotonic() < end:
            given.append(time.monotonic())
            log.tick(some(len(given) - 1))
            time.sleep(0.005)
    kept = sorted(tmp_path.glob("*.kept"))[1:]  # the first one holds what the run is about
    synced, missing = np.array([float(path.stem) for path in kept]), []
    for path, t in zip(kept, synced, strict=True):
        run = read(path)
        assert any("cut short" in note for note in run.notes)
        held = len(run.signals["cmd_tendons"])
        np.testing.assert_allclose(run.signals["cmd_tendons"].value[:, 0], 1.0 + np.arange(held))
        missing.append(t - min(given[held:], default=t))
    assert len(kept) >= 5
    lost = np.diff(synced) + np.maximum(missing[:-1], 0)  # just before the next sync
    assert np.median(lost) < 0.5, lost


def test_a_disk_that_fills_is_told(tmp_path: Path):
    with recorder(tmp_path / "a.mcap") as log:
        resource.prlimit(log.pid, resource.RLIMIT_FSIZE, (20_000, 20_000))
        k = 0
        while log.trouble() == "":
            log.tick(some(k))
            k += 1
            time.sleep(0.001)
        assert "a.mcap: cannot be written" in log.trouble() and "make room" in log.trouble()
    assert len(read(tmp_path / "a.mcap").signals["cmd_tendons"]) > 0


def test_a_disk_that_is_full_already_is_refused(tmp_path: Path):
    (tmp_path / "a.mcap").symlink_to("/dev/full")
    with pytest.raises(InputError, match="a.mcap: cannot be written .No space left"):
        recorder(tmp_path / "a.mcap")


def test_a_disk_that_is_too_slow_is_told(tmp_path: Path):
    with recorder(tmp_path / "a.mcap", most_s=0.0) as log:
        assert "nothing has reached the disk" in log.trouble()


def test_a_run_whose_logger_is_killed_stops_the_robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    clock, about, made = FakeClock(), configured(), []

    class Spied(Recorder):
        def __init__(self, *args, **kwargs):
            super().__init__(*args, **kwargs)
            made.append(self)

    def kill() -> str:
        if clock.t > 1002 and not made[0].trouble():
            os.kill(made[0].pid, signal.SIGKILL)
            until(lambda: made[0].trouble() != "")
        return ""

    monkeypatch.setattr("ljjax.rig.session.Recorder", Spied)
    job = experiments.parse(_plan("triangle", tension_n=6.0), "p", about.limits).experiments[0]
    robot = mock_robot(about, clock)
    told = record(job, robot, about, tmp_path, clock=clock, stopped=kill)
    assert told.outcome.fault is not None and told.outcome.fault.name == "log"
    assert not robot.connected and robot.wanted[:2] == (0.0, 0.0)


def _plan(protocol: str, **keys) -> dict:
    return {"schema": "ljjax.plan/1", "runs": [{"protocol": protocol, **keys}]}


def test_a_law_on_the_mock_arrives_and_its_log_holds_law_and_rig(law_file: Path, tmp_path: Path):
    clock, about, given = FakeClock(), configured(), law.load(law_file)
    job = follow(given, [Point(0.0, Command(0.12, 5000.0)), Point(3.0, Command(-0.08, 7000.0))], 6.0, 0.5)
    files = {"law.json": law_file.read_bytes()}
    told = record(job, mock_robot(about, clock), about, tmp_path, law_sha256="abc", attachments=files, clock=clock)
    assert told.outcome.end_reason == "completed"
    run = read(told.path)
    assert run.metadata["law_sha256"] == "abc" and run.robot_id == "mock-1" and run.doubts == ()
    assert read_attachment(told.path, "law.json") == law_file.read_bytes()
    assert read_attachment(told.path, "rig.toml").decode() == about.text
    theta, t = run.signals["shape"].value[:, 0], run.signals["shape"].t
    begun = t[-1] - 6.0 - 0.8  # before ramping out
    assert abs(np.interp(begun + 2.8, t, theta) - 0.12) < 0.01
    tensions = run.signals["cmd_tendons"].value
    assert tensions.max() <= 30 and tensions.min() >= 0 and (tensions[-1] == 0).all()


def test_what_is_logged_as_commanded_is_what_the_hardware_takes(tmp_path: Path):
    clock, about = FakeClock(), configured()

    class Coarse(MockRobot):
        def command(self, left_n: float, right_n: float, vacuum_kpa: float) -> tuple[float, float]:
            super().command(round(left_n), round(right_n), vacuum_kpa)
            return round(left_n), round(right_n)

    job = experiments.parse(_plan("triangle", tension_n=6.0, seconds=2.0), "p", about.limits).experiments[0]
    run = read(record(job, Coarse(about.mock, clock.now), about, tmp_path, clock=clock).path)
    told = run.signals["cmd_tendons"].value
    assert (told == np.round(told)).all() and told.max() == 6.0


def test_stamps_stay_in_order_when_the_wall_clock_is_set_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    clock, about, walls = FakeClock(), configured(), [WALL_NS]

    def wall() -> int:
        walls.append(walls[-1] - 10**12)
        return walls[-1]

    monkeypatch.setattr(time, "time_ns", wall)
    job = experiments.parse(_plan("triangle", tension_n=6.0, seconds=2.0), "p", about.limits).experiments[0]
    run = read(record(job, mock_robot(about, clock), about, tmp_path, clock=clock).path)
    assert run.notes == () and (np.diff(run.signals["cmd_tendons"].t) > 0).all()
    assert abs(run.signals["cmd_tendons"].t[-1] - run.signals["cmd_tendons"].t[0] - 2.5) < 0.5


def test_other_rooms_take_the_logs_of_experiments(tmp_path: Path):
    from ljjax.fit.points import points_of
    from ljjax.fit.windows import motion

    clock, about = FakeClock(), configured()
    for protocol, keys in {
        "triangle": {"tension_n": 8.0, "vacuum_kpa": 10.0, "seconds": 6.0},
        "hold_angles": {"angles_deg": [2, 4], "vacuums_kpa": [0, 20], "move_s": 2.0, "rate_n_s": 8.0},
    }.items():
        job = experiments.parse(_plan(protocol, **keys), "p", about.limits).experiments[0]
        run = read(record(job, mock_robot(about, clock), about, tmp_path, clock=clock).path)
        run.trusted()
        assert run.notes == () and run.experiment == protocol
        if protocol == "triangle":
            assert len(motion(run, 2).t) > 300
        else:
            (points,), _ = points_of(run)
            assert points.kind == "steady" and len(points) >= 3


@pytest.mark.parametrize("who", ["the loop", "Ctrl-C"])
def test_a_process_that_is_killed_or_stopped(who: str, rig_file: Path, tmp_path: Path):
    """In real time, by the command: a killed loop's log reads as cut short; Ctrl-C ends as a run does."""
    rig_file.write_text(rig_file.read_text().replace("log_s = 60.0", "log_s = 60.0\nlate_s = 60\nmissed_share = 1e3\n"
                        "shape_s = 60\ntendons_s = 60\npressure_s = 60"))  # fmt: skip
    plan, out = tmp_path / "plan.toml", tmp_path / "out"
    plan.write_text('schema = "ljjax.plan/1"\n[[runs]]\nprotocol = "triangle"\ntension_n = 5\nseconds = 300\n')
    command = [sys.executable, "-m", "ljjax.rig", "experiment", str(plan), "--rig", str(rig_file), "--out", str(out)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        until(lambda: list(out.glob("*.mcap")) and list(out.glob("*.mcap"))[0].stat().st_size > 20_000)
        process.send_signal(signal.SIGKILL if who == "the loop" else signal.SIGINT)
        _, err = process.communicate(timeout=60)
    (path,) = out.glob("*.mcap")
    if who == "Ctrl-C":
        assert process.returncode == 2 and "stopped by operator: Ctrl-C" in err and len(err.splitlines()) == 1
        run = read(path)
        assert run.metadata["end_reason"] == "fault: operator: Ctrl-C"
        assert (run.signals["cmd_tendons"].value[-1] == 0).all()
    else:
        run = read(path)
        assert "end_reason" not in run.metadata and len(run.signals["cmd_tendons"]) > 50


def test_a_law_edited_by_hand_never_reaches_the_robot(law_file: Path, rig_file: Path, tmp_path: Path, capsys):
    from ljjax.cli import main

    data = json.loads(law_file.read_text())
    data["limits"]["tension_max_n"] = 200.0
    edited, out = tmp_path / "law.json", tmp_path / "out"
    edited.write_text(json.dumps(data))
    words = ["rig", "run", str(edited), "--rig", str(rig_file), "--out", str(out)]
    assert main([*words, "--theta-deg", "5", "--stiffness", "5000"]) == 2
    assert "changed after its export" in capsys.readouterr().err and not out.exists()
