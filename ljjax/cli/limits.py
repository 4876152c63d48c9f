"""What a rig can do, as flags of the commands that make a law."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import tyro

if TYPE_CHECKING:
    from ljjax.control import Hardware


@dataclass(frozen=True)
class Limits:
    """What the rig can do."""

    rate_hz: float = 200.0
    """Rate of the loop, in Hz."""
    theta_max_deg: Annotated[float | None, tyro.conf.arg(metavar="DEG")] = None
    """Largest segment angle to command, in degrees; by default as far as the tensions reach."""
    tension_min_n: float = 0.5
    """Least tension of a tendon, in N."""
    tension_max_n: float = 60.0
    """Largest tension of a tendon, in N."""
    co_contraction_n: float = 2.0
    """Mean tension of the two tendons where the net tension allows, in N."""
    tension_slew_n_s: float = 400.0
    """How fast a tension may change, in N/s."""
    vacuum_max_kpa: float = 40.0
    """Highest vacuum, in kPa below atmosphere."""
    vacuum_slew_kpa_s: float = 50.0
    """How fast the vacuum may change, in kPa/s."""

    def hardware(self) -> Hardware:
        """The same in the units of `ljjax.control`."""
        from ljjax.control import Hardware

        same = {name: x for name, x in vars(self).items() if name != "theta_max_deg"}
        return Hardware(**same, theta_max_rad=None if self.theta_max_deg is None else math.radians(self.theta_max_deg))


DEFAULTS = Limits()
Flags = Annotated[Limits, tyro.conf.arg(name="")]
"""`Limits` of a command, without a prefix to its flags."""
