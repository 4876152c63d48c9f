"""What turns tensions into motor currents and back: spools, torque constant, what gearbox and spool rub away."""

from __future__ import annotations

from ljjax.errors import InputError
from ljjax.rig import xm430
from ljjax.rig.keys import Keys


class Spools:
    """I = T r/K_t + I₀, from [servos] of rig.toml. Raises InputError naming the key."""

    def __init__(self, keys: Keys):
        self.radius_m = keys.number("spool_radius_m", unit="m", low=1e-4, high=1.0)
        self.torque_nm_a = keys.number("torque_constant_nm_a", 1.78, "N·m/A", 1e-3, 100.0)
        self.friction_ma = keys.number("friction_ma", 0.0, "mA", 0.0, 1000.0)
        self.limit_ma = keys.number("current_max_ma", 1000.0, "mA", 1.0, 1193 * xm430.CURRENT_MA)
        self.direction = keys.pair("direction", (1, 1), whole=True, low=-1, high=1)
        if 0 in self.direction:
            raise InputError(f"rig.toml: servos.direction is {list(self.direction)}; expected 1 or -1 for each servo")

    def current_ma(self, tension_n: float) -> float:
        """The current for a tension [mA], within the limit; none for none, and never one that pushes."""
        if not tension_n > 0:
            return 0.0
        return min(1000 * tension_n * self.radius_m / self.torque_nm_a + self.friction_ma, self.limit_ma)

    def tension_n(self, current_ma: float) -> float:
        """The tension that a current holds [N]."""
        return max(0.0, (current_ma - self.friction_ma) / 1000) * self.torque_nm_a / self.radius_m
