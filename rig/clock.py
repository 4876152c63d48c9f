"""Time as the loop takes it: monotonic, so that nobody who sets the wall clock can hurry or stop a robot."""

from __future__ import annotations

import time


class Clock:
    """Seconds of `time.monotonic`, and waiting until one of them. Tests bring a clock of their own."""

    def now(self) -> float:
        """The time [s]."""
        return time.monotonic()

    def wait(self, until: float) -> None:
        """Returns at that time [s] or later."""
        rest = until - time.monotonic()
        if rest > 0:
            time.sleep(rest)
