"""What drives the robot over time: tensions, vacuum and external torques, held or linear between stamps."""

from __future__ import annotations

from typing import Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ljjax._types import Joints, Scalar, Tendons
from ljjax.errors import InputError
from ljjax.logs.run import Run


class Inputs(eqx.Module):
    """Inputs on one grid of stamps.

    Attributes:
        t: (T,) stamps [s], increasing.
        tendons: (T, 2) tensions u [N].
        pressure_kpa: (T,) vacuum u_P [kPa].
        torque: (T, n) external joint torques [N·m], or None.
        hold: a value holds until the next stamp (commands); otherwise linear between stamps (measurements).
    """

    t: Float[Array, " T"]
    tendons: Float[Array, "T 2"]
    pressure_kpa: Float[Array, " T"]
    torque: Float[Array, "T n"] | None = None
    hold: bool = eqx.field(static=True, default=True)

    def at(self, t: Scalar, within: Scalar | None = None) -> tuple[Tendons, Scalar, Joints | None]:
        """u [N], u_P [kPa] and τ_ext [N·m] at time t; the first values hold before the first stamp, the last after.

        `within`: the interval between stamps that holds this time is continued to t, for a solver whose stages may
        lie beyond the end of its step.
        """
        now = t if within is None else within
        low = jnp.clip(jnp.searchsorted(self.t, now, side="right") - 1, 0, self.t.shape[0] - 1)
        high = jnp.minimum(low + 1, self.t.shape[0] - 1)
        width = self.t[high] - self.t[low]
        inside = (width > 0) & (now >= self.t[0])
        weight = jnp.where(inside, (t - self.t[low]) / jnp.where(inside, width, jnp.ones_like(width)), 0.0 * t)

        def read(x):
            return x[low] if self.hold else (1 - weight) * x[low] + weight * x[high]

        return read(self.tendons), read(self.pressure_kpa), None if self.torque is None else read(self.torque)

    def pressure_rate(self, t: Scalar) -> Scalar:
        """u̇_P [kPa/s] between stamps (0 where values hold)."""
        if self.hold or self.t.shape[0] == 1:
            return jnp.zeros_like(t)
        low = jnp.clip(jnp.searchsorted(self.t, t, side="right") - 1, 0, self.t.shape[0] - 2)
        slope = (self.pressure_kpa[low + 1] - self.pressure_kpa[low]) / (self.t[low + 1] - self.t[low])
        return jnp.where((t >= self.t[0]) & (t < self.t[-1]), slope, jnp.zeros_like(slope))


def from_run(run: Run, source: Literal["commands", "measured"] = "commands") -> Inputs:
    """Inputs of a logged run: its commands (held), or its measured tension and pressure (linear between samples).

    Stamps at which nothing changes are left out of held inputs.

    Raises:
        InputError: the run lacks the signals, naming them, or their values cannot be in the contract's units.
    """
    run.trusted()
    if source == "commands":
        tendons, pressure = run.signal("cmd_tendons"), run.vacuum_kpa("cmd_pressure")
        t = np.union1d(tendons.t, pressure.t)
        u, p = tendons.held_at(t), pressure.held_at(t)[:, 0]
        changes = np.r_[True, np.any(np.diff(u, axis=0) != 0, axis=1) | (np.diff(p) != 0)]
        t, u, p = t[changes], u[changes], p[changes]
    elif source == "measured":
        tendons, pressure = run.signal("tendons"), run.vacuum_kpa("pressure")
        t = np.union1d(tendons.t, pressure.t)
        u, p = tendons.interpolated_at(t), pressure.interpolated_at(t)[:, 0]
    else:
        raise InputError(f"inputs are 'commands' or 'measured', not {source!r}")
    return Inputs(jnp.asarray(t, float), jnp.asarray(u, float), jnp.asarray(p, float), hold=source == "commands")
