"""The one gate that every command to the robot passes."""

from __future__ import annotations

import math
from typing import NamedTuple

from ljjax.rig.config import Limits


class Sent(NamedTuple):
    """Tensions [N] and vacuum [kPa] that a robot was last told."""

    left: float = 0.0
    right: float = 0.0
    vacuum: float = 0.0


class Gate:
    """Lets nothing through that is no number, beyond a limit or faster than a slew, whatever it is told.

    Tensions begin at 0, the vacuum where `start` found it. How far a command may go from the last one is the slew times
    the time since, at most one period of the loop: a loop that was late does not catch up in one jump.
    """

    def __init__(self, limits: Limits, period_s: float, release_n_s: float):
        self._limits, self._period, self._release = limits, period_s, min(release_n_s, limits.tension_slew_n_s)
        self._t = -math.inf
        self.sent = Sent()

    def start(self, vacuum: float) -> None:
        """The vacuum that is in the line before the first command [kPa]; 0 where nobody knows."""
        if math.isfinite(vacuum):
            self.sent = Sent(0.0, 0.0, _within(vacuum, 0.0, self._limits.vacuum_max_kpa))

    def let(self, now: float, left: float, right: float, vacuum: float, releasing: bool = False) -> Sent:
        """What may be sent of what is wanted. `releasing`: tensions fall no faster than the rate of release."""
        limits, before = self._limits, self.sent
        span = _within(now - self._t, 0.0, self._period)
        rate = self._release if releasing else limits.tension_slew_n_s
        pull, draw = rate * span, limits.vacuum_slew_kpa_s * span
        self._t = now
        self.sent = Sent(
            _step(before.left, left, pull, limits.tension_max_n),
            _step(before.right, right, pull, limits.tension_max_n),
            _step(before.vacuum, vacuum, draw, limits.vacuum_max_kpa),
        )
        return self.sent


def _step(before: float, wanted: float, change: float, most: float) -> float:
    if not math.isfinite(wanted):
        return before
    return _within(_within(wanted, before - change, before + change), 0.0, most)


def _within(x: float, low: float, high: float) -> float:
    return low if x < low else high if x > high else x
