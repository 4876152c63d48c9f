"""The loop's side of logging: a process of its own writes the file, so that no disk can delay the loop."""

from __future__ import annotations

import base64
import json
import os
import subprocess
import sys
import time
from collections.abc import Mapping
from types import TracebackType
from typing import Self

from ljjax.errors import InputError
from ljjax.rig.loop import Tick
from ljjax.rig.ring import DONE, FAILED, RUNNING, Ring

START_S, END_S = 60.0, 30.0
"""How long the process may take to begin, and to put the last rows on the disk [s]."""


class Recorder:
    """A log being written by another process, as a context manager.

        with Recorder("run.mcap", metadata, p_atm_pa, t=clock.now()) as log:
            outcome = loop.run(task, robot, config, log)
            log.end(outcome.end_reason)

    A log that was not ended, because this process was killed or raised, holds every tick that came and reads as cut
    short. Where the logging process dies, its disk is full, or what was measured waits longer than `most_s` for the
    disk, `trouble` says so.

    Args:
        path: the file; replaced if it exists.
        metadata: what `ljjax.logs.Writer` takes.
        p_atm_pa: atmospheric pressure [Pa].
        t: now [s] by the loop's clock; this is when `wall_ns` (since 1970, by default now) is.
        most_s: how long a row may wait for the disk [s].
        attachments: files to put into the log, by name.

    Raises:
        InputError: the file cannot be written.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        metadata: Mapping[str, str],
        p_atm_pa: float,
        *,
        t: float,
        wall_ns: int | None = None,
        most_s: float = 0.5,
        attachments: Mapping[str, bytes] | None = None,
    ):
        self.path, self._most_s = os.fspath(path), most_s
        self._ring, self._said = Ring(), 0
        self._process = subprocess.Popen(
            [sys.executable, "-m", "ljjax.rig.logger", str(self._ring.fd)],
            stdin=subprocess.PIPE, pass_fds=(self._ring.fd,), start_new_session=True,
        )  # fmt: skip
        about = {
            "path": self.path,
            "metadata": dict(metadata),
            "p_atm_pa": p_atm_pa,
            "t": t,
            "wall_ns": time.time_ns() if wall_ns is None else wall_ns,
            "attachments": {k: base64.b64encode(v).decode() for k, v in (attachments or {}).items()},
        }
        try:
            self._tell(about)
            self._await((RUNNING,), START_S)
        except BaseException:
            self._close()
            raise

    @property
    def pid(self) -> int:
        """The logging process."""
        return self._process.pid

    @property
    def synced(self) -> float:
        """All that was handed over before this time [s, `time.monotonic`] is on the disk."""
        return self._ring.synced

    def tick(self, tick: Tick) -> None:
        """Hand over a tick; some microseconds, never waits."""
        text = ""
        if len(tick.faults) > self._said:
            text = "; ".join(str(fault) for fault in list(tick.faults.values())[self._said :])
            self._said = len(tick.faults)
        self._ring.put((*tick[:6], *tick.sent), tick.reading, text)

    def trouble(self) -> str:
        """What is wrong with the log, or nothing."""
        if self._ring.state == FAILED:
            return self._ring.words
        if (code := self._process.poll()) is not None:
            return f"{self.path}: the logging process has gone (exit {code})"
        if self._ring.lost:
            return f"{self.path}: {self._ring.lost} ticks found no room; the logging process is too slow"
        waiting = time.monotonic() - self.synced
        if waiting > self._most_s:
            return f"{self.path}: nothing has reached the disk for {waiting:.2g} s; take a faster one"
        return ""

    def end(self, reason: str) -> None:
        """Say how the run ended, and wait until the file is whole.

        Raises:
            InputError: it could not be finished; what has reached the disk reads as cut short.
        """
        self._tell({"end_reason": reason})
        self._await((DONE,), END_S)

    def _tell(self, message: Mapping[str, object]) -> None:
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(message).encode() + b"\n")
            self._process.stdin.flush()
        except OSError:
            pass  # it has gone; `_await` says so

    def _await(self, states: tuple[int, ...], seconds: float) -> None:
        until = time.monotonic() + seconds
        while self._ring.state not in states:
            if self._ring.state == FAILED or self._process.poll() is not None or time.monotonic() > until:
                why = self._ring.words or f"{self.path}: the logging process does not answer"
                raise InputError(f"{why}; the log holds what had reached the disk")
            time.sleep(0.005)

    def _close(self) -> None:
        if self._process.stdin is not None:
            try:
                self._process.stdin.close()
            except OSError:
                pass  # bytes for a process that has gone
        try:
            self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._ring.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._close()
