"""`python -m benchmarks.rig_faults [--only NAME …]`: what the rig does when something goes wrong, case by case.

Each case is `ljjax rig run` in a process of its own, the reference rig's drivers against an emulated rig in this one (a
spring for a robot), and something that goes wrong in the middle of the run. What is told beside the log: how long it
took until the fault was in the log, until the tendons were slack as the emulated robot felt them, the largest tension
that it ever felt, and how the log says it ended. Writes out/bench/rig_faults.json.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import resource
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from benchmarks.rig_parts import Spring, emulated, mock_law
from ljjax.law.file import content, dumps
from ljjax.logs import read
from ljjax.rig.emulator.rig import EmulatedRig

LIMITS = {
    "tension_max_n": 30.0,
    "tension_slew_n_s": 200.0,
    "vacuum_max_kpa": 40.0,
    "vacuum_slew_kpa_s": 50.0,
    "theta_max_rad": 0.6,
}
SECONDS, BEGIN_S = 8.0, 2.0
PATIENCE_S = 60.0
"""How long anything may take before a case is given up."""
SCHEDULE = 'schema = "ljjax.schedule/1"\nseconds = {seconds}\n'
POINT = "[[points]]\nt_s = {t}\ntheta_deg = {angle}\nstiffness_n_m = {stiffness}\n"
STEPPED = """import sys, threading, time
now, begun = time.time_ns, time.monotonic()
time.time_ns = lambda: now() - (3600 * 10**9 if time.monotonic() > begun + 5 else 0)
time.time = lambda: time.time_ns() * 1e-9
from ljjax.cli import main
sys.exit(main())"""
"""The command under a wall clock that goes back by an hour after 5 s."""


class Case(NamedTuple):
    """What goes wrong, by name; how it is done to the emulated rig and the command's process; the faults that may be
    named (none where the run is to complete); whether the log may end as cut short."""

    name: str
    do: Callable[[EmulatedRig, int], None]
    named: tuple[str, ...] = ()
    cut: bool = False


class Told(NamedTuple):
    """What came of a case: exit code, the log's end_reason (or "cut short"), the terminal's last line, time from the
    fault until it was in the log and until the tendons were slack [s], the largest tension [N], commands missing from
    the log's end [s]."""

    code: int
    end: str
    line: str
    named_s: float
    slack_s: float
    most_n: float
    lost_s: float


def _put(text: str) -> Callable[[EmulatedRig, int], None]:
    return lambda rig, pid: rig.faults.put(text)


def _logger(pid: int) -> int:
    listed = subprocess.run(["ps", "--ppid", str(pid), "-o", "pid=,args="], capture_output=True, text=True).stdout
    return next(int(line.split()[0]) for line in listed.splitlines() if "ljjax.rig.logger" in line)


def _fill(rig: EmulatedRig, pid: int) -> None:
    resource.prlimit(_logger(pid), resource.RLIMIT_FSIZE, (100_000, 100_000))


def _pause(rig: EmulatedRig, pid: int) -> None:
    os.kill(pid, signal.SIGSTOP)
    time.sleep(0.3)
    os.kill(pid, signal.SIGCONT)


CASES = (
    Case("nothing", lambda rig, pid: None),
    Case("one servo unplugged", _put("servo_unplugged=right"), ("hardware", "tendons_stale")),
    Case("the adapter unplugged", _put("servo_unplugged=bus"), ("hardware", "tendons_stale")),
    Case("1 % of packets lost", _put("packet_loss=0.01")),
    Case("5 % of packets lost", _put("packet_loss=0.05")),
    Case("20 % of packets lost", _put("packet_loss=0.2"), ("", "tendons_stale", "hardware")),
    Case("5 % of packets corrupted", _put("packet_corrupt=0.05")),
    Case("a servo's error bit (overload)", _put("servo_error=5"), ("hardware",)),
    Case("the camera repeats its picture", _put("camera_frozen"), ("camera_stuck", "camera_stale")),
    Case("the tag is lost", _put("tag_lost"), ("tag_lost",)),
    Case("the tag jumps", _put("tag_jump=0.6"), ("tag_jump",)),
    Case("the gauge is stuck", _put("gauge_stuck"), ("gauge_stuck",)),
    Case("the gauge says no number", _put("gauge_nan"), ("gauge_nan", "gauge_stale", "hardware")),
    Case("half the vacuum leaks", _put("vacuum_leak=0.5"), ("vacuum_leak",)),
    Case("the wall clock goes back an hour", lambda rig, pid: None),
    Case("the disk fills", _fill, ("log",), cut=True),
    Case("the logger is killed", lambda rig, pid: os.kill(_logger(pid), signal.SIGKILL), ("log",), cut=True),
    Case("the loop is stopped for 0.3 s", _pause, ("late_loop", "hardware", "tendons_stale")),
    Case("Ctrl-C", lambda rig, pid: os.kill(pid, signal.SIGINT), ("operator",)),
    Case("the process is killed (−9)", lambda rig, pid: os.kill(pid, signal.SIGKILL), cut=True),
    Case("the law was edited by hand", lambda rig, pid: None),
)


def tried(case: Case, folder: Path, safety: str = "", servos: str = "") -> Told:
    """Run one case in a folder; `safety` are more lines of rig.toml's [safety], `servos` of [servos]."""
    law = folder / "law.json"
    text = dumps(content(mock_law(), {}, {}))
    law.write_text(text.replace('"gamma": 0.3', '"gamma": 0.2') if "edited" in case.name else text)
    stiffness = 4 * [8000] + 4 * [6500]
    points = [POINT.format(t=k, angle=(9, -6)[k % 2], stiffness=x) for k, x in enumerate(stiffness)]
    (folder / "schedule.toml").write_text(SCHEDULE.format(seconds=SECONDS) + "".join(points))
    with emulated() as rig:
        plant = rig.plant
        assert isinstance(plant, Spring)
        about = rig.toml({"limits": LIMITS}).replace("[servos]", f"[safety]\n{safety}\n[servos]\n{servos}")
        (folder / "rig.toml").write_text(about)
        begin = ["-c", STEPPED] if "wall clock" in case.name else ["-m", "ljjax"]
        words = ["rig", "run", str(law), "--rig", str(folder / "rig.toml"), "--out", str(folder / "logs")]
        words += ["--schedule", str(folder / "schedule.toml")]
        process = subprocess.Popen([sys.executable, *begin, *words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                                   stdin=subprocess.DEVNULL, text=True)  # fmt: skip
        try:
            end = time.monotonic() + PATIENCE_S
            while plant.slack_since != math.inf and process.poll() is None and time.monotonic() < end:
                time.sleep(0.01)
            if process.poll() is None:
                time.sleep(BEGIN_S)
            at, wall = time.monotonic(), time.time()
            case.do(rig, process.pid)
            said = process.communicate(timeout=PATIENCE_S)[0].strip()
            while plant.slack_since == math.inf and time.monotonic() < end + PATIENCE_S:
                time.sleep(0.01)
        finally:
            process.kill()
        slack = max(0.0, plant.slack_since - at)
        return _told(folder / "logs", process.returncode, said, wall, slack, plant.most_n)


def _told(logs: Path, code: int, said: str, wall: float, slack_s: float, most_n: float) -> Told:
    line = said.splitlines()[-1] if said else ""
    paths = sorted(logs.glob("*.mcap")) if logs.exists() else []
    if not paths:
        return Told(code, "no log", line, math.nan, slack_s, most_n, math.nan)
    run = read(paths[-1])
    commands = run.signals["cmd_tendons"]
    start = run.t0_ns * 1e-9
    lost = wall - (start + float(commands.t[-1]))
    return Told(code, run.metadata.get("end_reason", "cut short"), line, _named(paths[-1], wall), slack_s, most_n, lost)


def _named(path: Path, wall: float) -> float:
    """Seconds from a time [s, 1970] until the first fault in a log's diagnostics."""
    from mcap.exceptions import McapError
    from mcap.reader import NonSeekingReader
    from mcap_ros2.decoder import DecoderFactory

    with path.open("rb") as stream, contextlib.suppress(McapError, struct.error):  # it may be cut short
        found = NonSeekingReader(stream, decoder_factories=[DecoderFactory()])
        for item in found.iter_decoded_messages(["/real/rig/diagnostics"], log_time_order=False):
            if any(status.name == "fault" for status in item.decoded_message.status):
                return item.message.log_time * 1e-9 - wall
    return math.nan


def main() -> None:
    """Try the cases, print the table, write it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", default=[], help="cases whose name contains one of these words")
    parser.add_argument("--out", type=Path, default=Path("out/bench"))
    chosen = parser.parse_args()
    rows = {}
    print("| what goes wrong | the log ends with | in the log after | slack after | largest tension |")
    print("|---|---|---|---|---|")
    for case in CASES:
        if chosen.only and not any(word in case.name for word in chosen.only):
            continue
        with tempfile.TemporaryDirectory() as folder:
            told = tried(case, Path(folder))
        rows[case.name] = told._asdict()
        end = (
            told.end
            if told.code in (0, -9) or told.end.startswith("fault")
            else f"{told.end}; exit {told.code}: {told.line}"
        )
        end = end.replace("|", "/").replace(folder + "/logs/", "").replace(folder + "/", "")
        if told.end == "cut short" and told.code == -9:
            end += f", the last {1e3 * told.lost_s:.0f} ms lost"
        named = "–" if math.isnan(told.named_s) else f"{told.named_s:.2f} s"
        slack = "–" if told.end in ("completed", "no log") else f"{told.slack_s:.2f} s"
        print(f"| {case.name} | {end} | {named} | {slack} | {told.most_n:.1f} N |", flush=True)
    chosen.out.mkdir(parents=True, exist_ok=True)
    (chosen.out / "rig_faults.json").write_text(json.dumps(rows, indent=2) + "\n")


if __name__ == "__main__":
    main()
