"""One loop of a robustness study, from standard normal numbers ξ to measures: pure functions for `batch.over`."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ljjax import batch
from ljjax.chain import lateral_jacobian
from ljjax.control.loop import HOW, Loop, Scenario, delays, run, substeps_of, ticks_back, to_jax
from ljjax.control.measures import Asked, exact, smooth
from ljjax.control.problem import price
from ljjax.control.spec import Spec
from ljjax.control.statics import felt
from ljjax.control.uncertain import Inputs
from ljjax.control.vary import Vary
from ljjax.law.parts import Law
from ljjax.model import Model, astype, replace

POINTS = 100
"""Stamps at which a loop's angle is kept, at most."""


class Told(NamedTuple):
    """What is kept of a loop: measures (m,) as defined and smooth, what it costs, whether all its numbers are finite,
    its angle (P,) at `OneLoop.stamps` [rad]; arrays of JAX, or of NumPy once they are computed."""

    plain: Any
    smooth: Any
    price: Any
    ok: Any
    theta: Any


class OneLoop:
    """A law on the robots of a study. Every function takes ξ (d,), the noise's course (a whole number), the angle
    [rad] and the stiffness [N/m] asked for.

    Attributes:
        ticks: of the loop; `stamps` (P,) the times at which its angle is kept [s].
        kept: ticks that delays reach back; set by `reach`, before anything is computed.
        many, slopes, alone: `told` and `slope` of many loops at once, and `whole` of one, compiled when first called.
    """

    def __init__(self, law: Law, model: Model, spec: Spec, vary: Vary, given: Inputs, dtype: Any):
        self.law, self.model, self.given, self.dtype = to_jax(law, dtype), astype(model, dtype), given, dtype
        self.spec, self.vary, self.period = spec, vary, float(law.period_s)
        self.ticks, self.substeps, self.kept = round(spec.duration_s / self.period), substeps_of(law), 2
        self.many, self.slopes, self.alone = batch.over(self.told), batch.over(self.slope), jax.jit(self.whole)
        self._every = -(-self.ticks // POINTS)
        self.stamps = np.arange(0, self.ticks, self._every) * self.period

    def reach(self, xi: np.ndarray) -> None:
        """Keep as many ticks as the delays of ξ (N, d) reach back, and of quantities at their ends."""
        d = xi.shape[1]
        rows = np.concatenate([xi, np.full((1, d), 4.0), np.full((1, d), -4.0)])

        def late(x: Array) -> tuple[Array, Array]:
            values = self.given.physical(x)
            robot = self.robot(values)
            nothing = jnp.zeros((), x.dtype)
            return delays(robot, self.scenario(values, robot, jnp.asarray(0, jnp.uint32), nothing, nothing))

        self.kept = ticks_back(self.law, *jax.jit(jax.vmap(late))(jnp.asarray(rows, self.dtype)))

    def fixed(self, name: str) -> float:
        """What a quantity of the scenario is where it is not drawn."""
        ends = getattr(self.vary, name)
        return getattr(self.spec, name) if ends is None else ends[0]

    def robot(self, values: dict[str, Array]) -> Model:
        """With the quantities that are its parameters."""
        own = {k: x for k, x in values.items() if "." in k and not k.startswith("shape.")}
        return replace(self.model, own)

    def scenario(
        self, values: dict[str, Array], robot: Model, course: Array, theta: Array, stiffness: Array
    ) -> Scenario:
        """What the robot is put through, with the quantities that are not its parameters."""
        n, row = robot.n, jnp.zeros((self.ticks,), self.dtype)

        def quantity(name: str) -> Array:
            return values[name] if name in values else jnp.asarray(self.fixed(name), self.dtype)

        drawn = jax.random.normal(jax.random.key(course), (self.ticks,), jnp.float32).astype(self.dtype)
        noise = n * quantity("noise_rad") * drawn
        shape = jnp.stack([values.get(f"shape.q{i + 1}", jnp.zeros((), self.dtype)) for i in range(n)])
        torque = jnp.zeros((self.ticks, n), self.dtype)
        if self.vary.push_n is not None:
            lateral = lateral_jacobian(robot.chain, jnp.zeros((n,), self.dtype))
            begin, lasts = quantity("push_at_s"), quantity("push_for_s")
            t = jnp.arange(self.ticks).astype(self.dtype) * self.period
            on = jnp.clip((t - begin) / self.period + 1, 0, 1) * jnp.clip((begin + lasts - t) / self.period, 0, 1)
            torque = quantity("push_n") * on[:, None] * lateral[None]
        late = quantity("compute_ticks") * self.period
        return Scenario(row + theta, row + stiffness, noise, row, torque, shape, late, quantity("sensor_s"))

    def loop(self, xi: Array, course: Array, theta: Array, stiffness: Array) -> tuple[Loop, Asked]:
        values = self.given.physical(xi)
        robot = self.robot(values)
        plan = self.scenario(values, robot, course, theta, stiffness)
        how = HOW._replace(loops=True)
        loop = run(self.law, robot, plan, kept=self.kept, substeps=self.substeps, how=how)
        level = self.law.limits.co_contraction_n
        return loop, Asked(theta, stiffness, felt(robot, level, loop.vacuum[-1], self.law.gains.gamma))

    def measured(self, loop: Loop, asked: Asked) -> tuple[Array, Array, Array]:
        """Measures (m,) as defined and smooth, and what the loop costs."""
        period = jnp.asarray(self.period, self.dtype)
        gentle = smooth(loop, asked, self.spec, period)
        return exact(jnp, loop, asked, self.spec, period), gentle, price(gentle, self.spec)

    def told(self, *case: Array) -> Told:
        loop, asked = self.loop(*case)
        plain, gentle, cost = self.measured(loop, asked)
        ok = loop.ok & jnp.isfinite(cost) & ~jnp.any(jnp.isnan(plain))
        return Told(plain, gentle, cost, ok, loop.theta[:: self._every])

    def whole(self, *case: Array) -> tuple[Loop, Asked, Array, Array]:
        """The loop with its measures (m,) as defined and what it costs."""
        loop, asked = self.loop(*case)
        plain, _, cost = self.measured(loop, asked)
        return loop, asked, plain, cost

    def slope(self, xi: Array, *case: Array) -> tuple[Array, Array]:
        """What the loop costs, and its derivatives (d,) by ξ; forward, as there are few."""

        def costs(x: Array) -> Array:
            loop, asked = self.loop(x, *case)
            return price(smooth(loop, asked, self.spec, jnp.asarray(self.period, self.dtype)), self.spec)

        def along(v: Array) -> tuple[Array, Array]:
            return jax.jvp(costs, (xi,), (v,))

        return jax.vmap(along, out_axes=(None, 0))(jnp.eye(xi.shape[0], dtype=xi.dtype))
