"""Finding logs as a user names them, and `ljjax info`."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from ljjax.errors import InputError
from ljjax.logs import Writer, copy_overlay, find, read
from ljjax.logs.info import missing_for, rhythm

T0 = 1_772_530_837_000_000_000
META = {
    "run_id": "7",
    "robot_id": "octrobot-1",
    "experiment": "bend",
    "p_atm_pa": "101325",
    "start_utc": "2026-03-03T09:40:37Z",
}


def write(path: Path, *signals: str, p_atm: str = "101325") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    values = {
        "cmd_tendons": [1.0, 2.0],
        "tendons": [1.0, 2.0],
        "cmd_pressure": [9e4],
        "pressure": [9e4],
        "shape": [0.5],
        "probe": [0.001, 0.2],
    }
    with Writer(path, META | {"p_atm_pa": p_atm}) as log:
        for i in (0, 1, 2, 3, 4, 9, 10):
            for signal in signals:
                t = T0 + i * 10_000_000
                log.write(signal, t, values[signal], log_ns=t + 2_000_000, publish_ns=t + 1_000_000)
        log.write_diagnostics(T0, [(0, "loop", "", {})])
    return path


def test_find_files_folders_and_globs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    a, b = write(tmp_path / "a.mcap", "shape"), write(tmp_path / "sub/deep/b.mcap", "shape")
    (tmp_path / "notes.txt").write_text("x")
    assert find([tmp_path]) == [a, b]
    assert find([b, a, str(tmp_path)]) == [b, a]
    assert find([str(tmp_path / "*.mcap")]) == [a]
    assert find([str(tmp_path / "**/*.mcap")]) == [a, b]
    assert find([str(tmp_path / "s*")]) == [b]
    assert find(a) == [a]
    monkeypatch.chdir(tmp_path)
    assert find(["a.mcap", str(a)]) == [Path("a.mcap")]
    os.symlink(a, tmp_path / "link.mcap")
    assert len(find([tmp_path])) == 2


def test_a_folder_search_passes_over_results(tmp_path: Path):
    a = write(tmp_path / "a.mcap", "shape")
    copy_overlay([read(a)], tmp_path / "out.mcap", [{}])
    assert find([tmp_path]) == [a]
    assert find([tmp_path / "out.mcap"]) == [tmp_path / "out.mcap"]


@pytest.mark.parametrize("name", ["none.mcap", "empty", "*.mcap", "empt*"])
def test_find_names_what_is_missing(tmp_path: Path, name: str):
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="empty|none|mcap|empt") as caught:
        find([tmp_path / name])
    assert str(tmp_path / name) in str(caught.value)
    with pytest.raises(InputError, match="no log given"):
        find([])


USES = {
    ("cmd_tendons", "cmd_pressure", "shape"): {"replay (ljjax simulate)", "steady fit"},
    ("tendons", "pressure", "shape"): {"steady fit"},
    ("tendons", "pressure", "probe"): {"stiffness fit"},
    ("shape",): set(),
}


@pytest.mark.parametrize("signals", USES)
def test_what_a_log_is_good_for(tmp_path: Path, signals: tuple[str, ...]):
    missing = missing_for(read(write(tmp_path / "a.mcap", *signals)))
    assert {use for use, lacks in missing.items() if not lacks} == USES[signals]
    missing = missing_for(read(write(tmp_path / "b.mcap", *signals, p_atm="unknown")))
    assert all("p_atm_pa" in lacks for lacks in missing.values())


def test_rhythm():
    beat = rhythm(np.array([0, 1, 2, 3, 8, 9.0]))
    assert beat is not None and (beat.rate, beat.longest, beat.gaps) == (1.0, 5.0, 1)
    assert rhythm(np.zeros(1)) is None


def test_info_shows_signals_clocks_and_damage(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    from ljjax.cli.info import command

    path = write(tmp_path / "a.mcap", "cmd_tendons", "pressure", "shape")
    command((str(path),))
    shown = capsys.readouterr().out
    row = next(line for line in shown.splitlines() if "/real/shape" in line).split()
    assert row[:6] == ["shape[1]", "/real/shape", "7", "100", "0.05", "1"]
    assert row[-6:] == ["2", "±", "0", "1", "±", "0"]
    assert "octrobot-1" in shown and "/real/rig/diagnostics (1)" in shown and "lacks cmd_pressure" in shown
    path.write_bytes(path.read_bytes()[:-20])
    command((str(path),))
    assert "DAMAGED at byte" in capsys.readouterr().out


def test_info_shows_the_good_logs_and_then_fails_for_the_bad(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    from ljjax.cli.info import command

    good = write(tmp_path / "good.mcap", "shape")
    (tmp_path / "bad.mcap").write_text("no log")
    with pytest.raises(InputError, match="bad.mcap.*not an MCAP"):
        command((str(tmp_path),))
    assert str(good) in "".join(capsys.readouterr().out.split())
    with pytest.raises(InputError, match="2 logs cannot be used.*none.mcap.*bad.mcap"):
        command((str(tmp_path / "none.mcap"), str(tmp_path / "bad.mcap")))
