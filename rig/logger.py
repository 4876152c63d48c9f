"""`python -m ljjax.rig.logger FD`: the process that writes a run's log while the loop runs.

It reads the ring, writes contract v1, and puts everything on the disk four times a second. When the loop's process goes
without a word, it writes what is left and leaves the file without an end_reason: cut short.
"""

from __future__ import annotations

import base64
import contextlib
import json
import math
import os
import select
import signal
import sys
import time
from pathlib import Path
from typing import Any

from ljjax.logs import Writer
from ljjax.rig.loop import STATES
from ljjax.rig.ring import DONE, FAILED, RUNNING, Ring, Row
from ljjax.rig.robot import Reading

SYNC_S, LOOK_S, SAY_S = 0.2, 0.02, 0.1
"""How often the file is put on the disk, the ring is read, and the loop's state is written [s]."""
OK, WARN, ERROR = 0, 1, 2


def main(fd: int) -> int:
    """Write a log until the loop says how the run ended, or goes; returns the exit code."""
    for name in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(name, signal.SIG_IGN)  # the loop decides when a run ends
    ring = Ring(fd)
    about: dict[str, Any] = {}
    try:
        about = json.loads(sys.stdin.buffer.readline())
        reason = _write(ring, about)
    except Exception as error:  # whatever it is, the loop must hear of it
        why = error.strerror if isinstance(error, OSError) and error.strerror else error
        ring.say(FAILED, f"{about.get('path', 'log')}: cannot be written ({why}); make room, or take another disk")
        return 1
    if reason:
        ring.say(DONE)
    return 0


def _write(ring: Ring, about: dict[str, Any]) -> str:
    path = Path(about["path"])
    writer = Writer(path, about["metadata"], library="ljjax rig")
    for name, data in about["attachments"].items():
        writer.attach(name, base64.b64decode(data), t_ns=about["wall_ns"])
    writer.flush(sync=True)
    with contextlib.suppress(OSError):  # a folder that cannot be synced is the system's own affair
        folder = os.open(path.parent, os.O_RDONLY)
        os.fsync(folder)
        os.close(folder)
    rows = Rows(writer, about)
    ring.synced = time.monotonic()
    ring.say(RUNNING)
    reason, listening = "", True
    while listening:
        if select.select([sys.stdin], [], [], LOOK_S)[0]:
            listening = False
            line = sys.stdin.buffer.readline()
            reason = json.loads(line)["end_reason"] if line.endswith(b"\n") else ""
        now = time.monotonic()
        for row in ring.take():
            rows.write(row)
        if now - ring.synced > SYNC_S or not listening:
            writer.flush(sync=True)
            ring.synced = now
    if reason:
        writer.close(reason)
    return reason


class Rows:
    """Rows as messages of the contract: commands at every tick, a reading once, and only what is a number."""

    def __init__(self, writer: Writer, about: dict[str, Any]):
        self._writer, self._p_atm = writer, about["p_atm_pa"]
        self._t, self._wall_ns = about["t"], about["wall_ns"]
        self._last: dict[str, float] = {}
        self._joints = -1  # how many the first angle came with; a log's angles have one form
        self._state, self._said, self._worst = -1.0, -math.inf, {"late_s": 0.0, "busy_s": 0.0}

    def _ns(self, t: float) -> int:
        return self._wall_ns + round((t - self._t) * 1e9)

    def write(self, row: Row) -> None:
        """A row's messages, each under its own stamp."""
        x, r = row.numbers, row.reading
        now = self._ns(x["t"])
        if STATES[int(x["state"])] != "wait":
            self._writer.write("cmd_tendons", now, [x["left"], x["right"]])
            self._writer.write("cmd_pressure", now, [self._p_atm - 1e3 * x["vacuum"]])
        spool = [r.left_m, r.right_m]
        tendons = [r.left_n, r.right_n, *(spool if all(map(math.isfinite, spool)) else [])]
        if self._joints < 0 and math.isfinite(r.t_shape):
            self._joints = len(r.joints)
        if len(r.joints) == self._joints:
            self._sample("shape", r.t_shape, now, list(r.joints) or [r.theta])
        self._sample("pressure", r.t_pressure, now, [self._p_atm - 1e3 * r.vacuum_kpa])
        if not r.by_current:
            self._sample("tendons", r.t_tendons, now, tendons)
        self._sample("probe", r.t_probe, now, [r.probe_m, r.probe_n])
        self._diagnostics(x, r, row.text, now)

    def _sample(self, signal_name: str, t: float, now: int, value: list[float]) -> None:
        if t == self._last.get(signal_name) or not all(map(math.isfinite, (t, *value))):
            return
        self._last[signal_name] = t
        self._writer.write(signal_name, self._ns(t), value, log_ns=now, publish_ns=now)

    def _diagnostics(self, x: dict[str, float], r: Reading, text: str, now: int) -> None:
        self._worst = {name: max(worst, x[name]) for name, worst in self._worst.items()}
        if not text and x["state"] == self._state and x["t"] - self._said < SAY_S:
            return
        state = STATES[int(x["state"])]
        values = {f"{name.removesuffix('_s')}_ms": f"{1e3 * worst:.3f}" for name, worst in self._worst.items()}
        values |= {"missed": str(int(x["missed"])), "rejected": str(int(x["rejected"]))}
        motors = {"left_ma": r.left_ma, "right_ma": r.right_ma, "temperature_c": r.temperature_c}
        motors |= {"left_mm": 1e3 * r.left_m, "right_mm": 1e3 * r.right_m}
        values |= {name: f"{value:.2f}" for name, value in motors.items() if math.isfinite(value)}
        statuses = [(WARN if state == "safe" else OK, "loop", state, values)]
        if text:
            statuses.append((ERROR, "fault", text, {}))
        self._writer.write_diagnostics(now, statuses)
        self._state, self._said, self._worst = x["state"], x["t"], dict.fromkeys(self._worst, 0.0)


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1])))
