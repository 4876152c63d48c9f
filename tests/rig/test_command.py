"""`ljjax rig`: what a user types, and what it never loads."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from ljjax.cli import main
from ljjax.logs import read
from ljjax.rig.check import check

from .conftest import FakeClock, configured, mock_robot

ROOT = Path(__file__).parents[2]
CALM = "log_s = 60.0\nlate_s = 60\nmissed_share = 1e3\nshape_s = 60\ntendons_s = 60\npressure_s = 60"


def test_no_jax_and_nothing_heavy():
    code = (
        "import sys, runpy; sys.argv = ['rig', 'run', '--help']\n"
        "try: runpy.run_module('ljjax.rig', run_name='__main__')\n"
        "except SystemExit as stop: assert not stop.code\n"
        "import ljjax.rig.session, ljjax.rig.experiments, ljjax.rig.check, ljjax.rig.mock, ljjax.rig.logger\n"
        "heavy = ('jax', 'jaxlib', 'equinox', 'scipy', 'matplotlib')\n"
        "print('LOADED', [m for m in heavy if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0 and "LOADED []" in done.stdout, done.stderr


def test_a_person_can_read_the_loop():
    assert len((ROOT / "rig" / "loop.py").read_text(encoding="utf-8").splitlines()) < 220


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("", "ljjax rig run"),
        ("--help", "ljjax rig experiment"),
        ("run --help", "--theta-deg"),
        ("experiment --help", "PLAN.toml"),
        ("check --help", "--move"),
    ],
)
def test_help(words: str, said: str, capsys: pytest.CaptureFixture[str]):
    assert main(["rig", *words.split()]) == 0
    assert said in capsys.readouterr().out


def test_a_law_runs_and_its_log_is_shown(law_file: Path, rig_file: Path, tmp_path: Path, capsys):
    rig_file.write_text(rig_file.read_text().replace("log_s = 60.0", CALM))
    words = ["rig", "run", str(law_file), "--rig", str(rig_file), "--out", str(tmp_path / "runs")]
    assert main([*words, "--theta-deg", "5", "--stiffness", "5000", "--seconds", "0.5"]) == 0
    assert "completed" in capsys.readouterr().out
    (path,) = (tmp_path / "runs").iterdir()
    assert len(read(path).metadata["law_sha256"]) == 64
    assert main(["info", str(path)]) == 0
    assert "completed" in capsys.readouterr().out


REFUSED = {
    "nothing to do": ("run LAW --rig RIG --out new", "give --theta-deg and --stiffness, or --schedule"),
    "out of reach": ("run LAW --rig RIG --out new --theta-deg 80 --stiffness 5000", "theta = 1.396 rad"),
    "no time": ("run LAW --rig RIG --out new --theta-deg 5 --stiffness 5000 --seconds -1", "seconds = -1"),
    "no law": ("run none.json --rig RIG --out new --theta-deg 5 --stiffness 5000", "none.json: no such file"),
    "no rig": ("run LAW --rig none.toml --out new --theta-deg 5 --stiffness 5000", "none.toml: no such file"),
    "no plan": ("experiment none.toml --rig RIG --out new", "none.toml: no such file"),
    "no command": ("dance", "rig: no command 'dance'; expected run, experiment, check"),
    "an unknown option": ("check --rig RIG --quick", "rig check: "),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refusals(case: str, law_file: Path, rig_file: Path, tmp_path: Path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words, said = REFUSED[case]
    assert main(["rig", *words.replace("LAW", str(law_file)).replace("RIG", str(rig_file)).split()]) == 2
    shown = capsys.readouterr()
    assert said in shown.err and len(shown.err.splitlines()) == 1 and not (tmp_path / "new").exists()


def test_a_check_of_a_good_robot_and_of_one_that_is_off():
    clock, about = FakeClock(), configured()
    findings = check(mock_robot(about, clock), about, move=True, clock=clock)
    assert [f.name for f in findings if not f.good] == [] and len(findings) > 12
    backwards, leaking = configured("", "lever_m = -0.02"), configured("", "fault = 'leak'\nfault_s = 0.0")
    off = [f.name for f in check(mock_robot(backwards, clock), backwards, move=True, clock=clock) if not f.good]
    assert {"left pull bends", "right pull bends"} <= set(off)
    off = [f.name for f in check(mock_robot(leaking, clock), leaking, move=True, clock=clock) if not f.good]
    assert off == ["vacuum"]


def test_a_check_that_finds_something_exits_with_2(rig_file: Path, capsys: pytest.CaptureFixture[str]):
    rig_file.write_text(rig_file.read_text() + "fault = 'servo_error'\nfault_s = 0.2\n")
    assert main(["rig", "check", "--rig", str(rig_file), "--seconds", "0.5"]) == 2
    shown = capsys.readouterr()
    assert "OFF hardware: servo 1: overload" in shown.out and "off; see above" in shown.err


def test_a_file_a_gpio_and_a_key_stop(tmp_path: Path):
    from dataclasses import replace

    from ljjax.rig.stop import Stop

    safety, gpio, file = configured().safety, tmp_path / "value", tmp_path / "stop"
    gpio.write_text("1\n")
    with Stop(replace(safety, stop_file=str(file), stop_gpio=str(gpio))) as stop:
        assert stop() == ""
    gpio.write_text("0\n")
    with Stop(replace(safety, stop_gpio=str(gpio))) as stop:
        assert "is open" in stop() and "is open" in stop()
    gpio.unlink()
    with Stop(replace(safety, stop_gpio=str(gpio))) as stop:
        assert "cannot be read" in stop()
    file.write_text("")
    with Stop(replace(safety, stop_file=str(file))) as stop:
        assert "is there" in stop()
