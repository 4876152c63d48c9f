"""How a person stops the robot: Enter or Ctrl-C, a file, a GPIO."""

from __future__ import annotations

import os
import select
import signal
import sys
import threading
import time
from types import FrameType, TracebackType
from typing import Any, Self

from ljjax.rig.config import Safety

LOOK_S = 0.02
"""How often keys, file and GPIO are looked at [s]."""


class Stop:
    """Says who wants the robot stopped, as a context manager; once said, it stays so.

    While it is open, Ctrl-C, SIGTERM and SIGHUP stop the robot instead of this process; a second Ctrl-C does not wait
    for the tensions to fall. Enter counts where the input is a terminal.
    """

    def __init__(self, safety: Safety):
        self._file, self._gpio = safety.stop_file, safety.stop_gpio
        self._who, self._next = "", 0.0
        self._before: dict[int, Any] = {}
        self._keys = sys.stdin is not None and sys.stdin.isatty()

    def __call__(self) -> str:
        """Who stopped the robot, or nothing."""
        now = time.monotonic()
        if not self._who and now >= self._next:
            self._next = now + LOOK_S
            self._who = self._look()
        return self._who

    def _look(self) -> str:
        if self._file and os.path.exists(self._file):
            return f"the file {self._file} is there"
        if self._gpio:
            try:
                with open(self._gpio, encoding="ascii") as value:
                    level = value.read(1)
            except (OSError, ValueError) as error:
                return f"{self._gpio} cannot be read ({error})"
            if level != "1":
                return f"{self._gpio} is open"
        if self._keys and select.select([sys.stdin], [], [], 0)[0]:
            sys.stdin.readline()
            return "Enter"
        return ""

    def _signal(self, number: int, frame: FrameType | None) -> None:
        if self._who and number == signal.SIGINT:
            raise KeyboardInterrupt
        self._who = self._who or ("Ctrl-C" if number == signal.SIGINT else signal.Signals(number).name)

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                self._before[number] = signal.signal(number, self._signal)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
