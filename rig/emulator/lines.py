"""Pseudo-terminals: a serial port that a driver opens, and the end that an emulated device holds."""

from __future__ import annotations

import contextlib
import os
import tty


class Line:
    """A pair of ends; `path` is what a driver opens. The other is kept open too, so that drivers may come and go."""

    def __init__(self) -> None:
        self.master, self._slave = os.openpty()
        tty.setraw(self.master)
        tty.setraw(self._slave)
        os.set_blocking(self.master, False)
        self.path = os.ttyname(self._slave)
        self.open = True

    def read(self) -> bytes:
        """What came in so far."""
        try:
            return os.read(self.master, 4096)
        except (BlockingIOError, OSError):
            return b""

    def write(self, data: bytes) -> None:
        """Send what the line takes; a full line loses the rest, as nobody reads it."""
        with contextlib.suppress(BlockingIOError, OSError):
            os.write(self.master, data)

    def close(self) -> None:
        """Pull the plug."""
        if self.open:
            self.open = False
            os.close(self.master)
            os.close(self._slave)
