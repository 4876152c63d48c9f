"""The gains that tuning moves, as coordinates in a unit box, every point of which is a feasible law."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ljjax.control.refusals import UNIQUE
from ljjax.control.sampled import most_damping
from ljjax.control.spec import Target
from ljjax.control.statics import Statics, tip_stiffness
from ljjax.errors import InputError
from ljjax.law.parts import USED, Law
from ljjax.model import Model

SLOWEST = 8
"""Longest time constant of the rate's filter, in ticks."""
MARGIN = 0.98
"""How much of what uniqueness and Routh's condition allow is used at most."""


class Box(NamedTuple):
    """Coordinates of gains: log(1 + gain/scale), from `low` at 0 to `high` at 1.

    `integral` is a share of what Routh's condition allows at the other gains, so that it holds all over the box.

    Attributes:
        names: the k gains.
        low, high, scale: (k,) of the gains, in their units; of the share for `integral`.
        viscous, stiffness, inertia, reach: what Routh's condition takes of the robot: at every vacuum (V,) the equal
            bend's viscous friction [N·m·s/rad] and stiffness less n²γ [N·m/rad], its inertia [kg·m²], and (n, n·g).
        base: values of the gains that do not move, by name.
    """

    names: tuple[str, ...]
    low: np.ndarray
    high: np.ndarray
    scale: np.ndarray
    viscous: Array
    stiffness: Array
    inertia: float
    reach: tuple[float, float]
    base: dict[str, float]

    def gains(self, u: Array) -> Array:
        """(k,) the gains at a point u (k,) of the box; differentiable."""
        low, high = np.log1p(self.low / self.scale), np.log1p(self.high / self.scale)
        gains = jnp.asarray(self.scale) * jnp.expm1(low + u * (high - low))
        if "integral" not in self.names:
            return gains
        i = self.names.index("integral")
        return gains.at[i].set(gains[i] * self.routh(gains))

    def coordinates(self, gains: Any) -> np.ndarray:
        """(k,) the point of the box nearest to gains (k,)."""
        values = np.array(gains, float)
        if "integral" in self.names:
            values[self.names.index("integral")] /= float(self.routh(jnp.asarray(values)))
        low, high, at = (np.log1p(np.maximum(x, 0.0) / self.scale) for x in (self.low, self.high, values))
        return np.clip((at - low) / (high - low), 0.0, 1.0)

    def routh(self, gains: Array) -> Array:
        """The integral gain below which Routh's condition holds [N·m/(rad·s)] (`ljjax.control.refusals.routh`)."""
        n, arm = self.reach
        gamma, damping = (gains[self.names.index(x)] if x in self.names else self.base[x] for x in ("gamma", "damping"))
        d = self.viscous + damping * arm**2
        return jnp.min(d * (n * n * gamma + self.stiffness)) / (self.inertia * n**2)

    def feasible(self, gains: Any) -> bool:
        """Whether gains (k,) are finite, within the box's widest values, and meet uniqueness and Routh's condition."""
        values = np.asarray(gains, float)
        limit = self.high.copy()
        if "integral" in self.names:
            limit[self.names.index("integral")] = np.inf
        within = np.all(np.isfinite(values)) and np.all(values >= 0) and np.all(values <= limit * (1 + 1e-9))
        if not within or not values[self.names.index("gamma")] >= self.low[self.names.index("gamma")] * (1 - 1e-9):
            return False
        return "integral" not in self.names or float(values[self.names.index("integral")]) < float(
            self.routh(jnp.asarray(values))
        )


def box(model: Model, at_rest: Statics, law: Law, targets: Sequence[Target], free: Sequence[str] | None) -> Box:
    """The box of a law that is feasible, around its gains.

    Args:
        law: with the gains to start from; those not in `free` stay.
        free: gains to move; None for all that the law uses.
    """
    names = tuple(USED[law.kind] if free is None else free)
    for name in names:
        if name not in USED[law.kind]:
            raise InputError(f"{name!r} is no gain that {law.kind} uses; its gains are {', '.join(USED[law.kind])}")
    if not names or len(set(names)) < len(names):
        raise InputError(
            f"gains to tune: {', '.join(names) or 'none'}; expected each once, of {', '.join(USED[law.kind])}"
        )
    n, arm = float(model.n), model.n * float(model.chain.lever_arm_m)
    alpha2, phi = (jnp.mean(x, axis=1) for x in (at_rest.alpha2, at_rest.phi))
    viscous = n * model.friction.sigma2 * phi
    inertia = float(at_rest.inertia)
    gamma, period = float(law.gains.gamma), float(law.period_s)
    critical = 2 * math.sqrt(inertia * n * float(n * gamma + jnp.max(alpha2))) / arm**2
    lowest, highest = _gammas(model, at_rest, gamma, MARGIN * UNIQUE * float(jnp.min(alpha2)) / n, targets)
    degree = math.radians(1.0)
    ranges = {
        "gamma": (lowest, highest, 1e-3 * lowest),
        "damping": (0.0, min(10 * critical, _carried(model, at_rest, law, (lowest, highest))), 0.03 * critical),
        "filter_s": (0.5 * period, SLOWEST * period, 0.01 * period),
        "integral": (1e-4, MARGIN, 1e-6),
        "leak_per_s": (0.0, min(2.0, 1 / period), 0.02),
        "dead_zone_rad": (0.0, 0.5 * degree, 0.02 * degree),
        "compensation": (0.0, 1.0, 1.0),
        "still_rad_s": (1e-3, 0.5, 1e-5),
    }
    base = {name: float(x) for name, x in law.gains._asdict().items()}
    low, high, scale = (np.array([ranges[name][i] for name in names]) for i in range(3))
    made = Box(names, low, high, scale, viscous, n * alpha2, inertia, (n, arm), base)
    start = np.array([base[name] for name in names])  # which is to be in the box
    if "integral" in names:
        start[names.index("integral")] /= float(made.routh(jnp.asarray(start)))
    return made._replace(low=np.minimum(low, start), high=np.maximum(high, start))


def _carried(model: Model, at_rest: Statics, law: Law, gammas: tuple[float, float]) -> float:
    """The damping [N·s/m] that sampling carries at every γ and filter of the box, less a margin; no less than the
    law's own, whose `design` has been checked."""
    period = float(law.period_s)
    corners = [
        law.gains._replace(gamma=gamma, filter_s=filter_s)
        for gamma in gammas
        for filter_s in (0.5 * period, float(law.gains.filter_s), SLOWEST * period)
    ]
    most = min(most_damping(model, at_rest, gains, period) for gains in corners)
    return max(0.9 * MARGIN * most, float(law.gains.damping))


def _gammas(
    model: Model, at_rest: Statics, start: float, most: float, targets: Sequence[Target]
) -> tuple[float, float]:
    """The range of γ [N·m] around `start`, up to `most`, in which the stiffness rises with the vacuum and all targets'
    stiffness is in reach."""
    joint = at_rest.alpha2 + model.friction.sigma0 * at_rest.phi
    wanted = np.array([t.stiffness_n_m for t in targets])
    grid = np.unique(np.concatenate([[start], np.geomspace(0.02 * most, most, 97)]))
    k = np.asarray(jax.vmap(lambda g: tip_stiffness(model, joint, g))(jnp.asarray(grid)))
    good = (np.diff(k, axis=1) > 0).all(axis=1) & (k[:, 0] <= wanted.min()) & (wanted.max() <= k[:, -1])
    first = last = int(np.searchsorted(grid, start))
    while first > 0 and good[first - 1]:
        first -= 1
    while last + 1 < len(grid) and good[last + 1]:
        last += 1
    return float(grid[first]), float(grid[last])
