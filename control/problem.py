"""The loss of a law's gains: simulated loops over targets and robots, with derivatives, counted.

One loop is one element of a batch. Its measures come with their derivatives by the gains in forward mode: with at most
eight gains this takes less than twice the time of the measures alone, and compiles twice as fast as reverse mode.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ljjax import batch
from ljjax.control.box import Box, box
from ljjax.control.loop import HOW, Loop, Scenario, depth, run, substeps_of
from ljjax.control.measures import Asked, plain, smooth
from ljjax.control.robots import stack
from ljjax.control.spec import MEASURES, Spec
from ljjax.control.statics import Hardware, Statics, felt, statics
from ljjax.control.synthesis import Design, assemble
from ljjax.law.parts import Gains, Kind, Law
from ljjax.model import Model

FAILED = 1000.0
"""Cost of a loop with numbers that are not finite."""
STEEPER = 4.0
"""How many times more a measure costs beyond its limit, on top."""


@dataclass
class Count:
    """Closed loops simulated: for their values alone, and with derivatives."""

    values: int = 0
    gradients: int = 0


def price(measures: Array, spec: Spec) -> Array:
    """(…) what loops with measures (…, m) cost: a measure x of limit l costs w[x/l + 4·max(x/l − 1, 0)], the corner
    rounded. Less is always better, and far more so beyond the limit."""

    def row(values: list[float]) -> Array:
        return jnp.broadcast_to(jnp.asarray(values, measures.dtype), measures.shape)

    limit = row([spec.require[k].limit if k in spec.require else 1.0 for k in MEASURES])
    weight = row([spec.require[k].weight if k in spec.require else 0.0 for k in MEASURES])
    share = measures / limit
    beyond = 0.05 * jax.nn.softplus((share - 1) / 0.05)
    return jnp.sum(jnp.where(weight > 0, weight * (share + STEEPER * beyond), 0.0), axis=-1)


def cost(measures: Array, ok: Array, spec: Spec) -> Array:
    """The loss of loops with measures (T, S, m) over targets and robots: the mean over robots of what each costs (the
    mean over targets), plus the weighted mean over the worst share of robots (CVaR)."""
    each = price(measures, spec)
    robots = jnp.mean(jnp.where(ok, each, FAILED), axis=0)
    worst = jnp.sort(robots)[-max(1, math.ceil(spec.cvar_share * robots.shape[0] - 1e-9)) :]
    return jnp.mean(robots) + spec.cvar_weight * jnp.mean(worst)


class Problem:
    """Tuning as an optimiser sees it: `loss(gains)`, its gradient, the box of coordinates, the loops simulated so far.

    Attributes:
        names: the k gains, in the order of every array of them.
        start: (k,) the gains to begin with.
        box: from coordinates in [0, 1]^k to feasible gains.
        count: closed loops simulated so far.
        size: targets T and robots S.
    """

    def __init__(
        self, made: Design, model: Model, hardware: Hardware, spec: Spec, robots: Sequence[Model], *,
        seed: int = 0, free: Sequence[str] | None = None,
    ):  # fmt: skip
        dtype = model.jamming.c4.dtype
        filled = hardware._replace(theta_max_rad=made.law.limits.theta_max_rad)
        numbers = Hardware(*(jnp.asarray(float(x), dtype) for x in filled))
        at_rest = statics(model, numbers.vacuum_max_kpa, numbers.co_contraction_n)
        self.spec, self.law, self.count = spec, made.law, Count()
        self.box: Box = box(model, at_rest, made.law, spec.targets, free)
        self.names = self.box.names
        self.start = np.array([self.box.base[name] for name in self.names])
        self.ticks = round(spec.duration_s / made.law.period_s)
        self._place(robots, seed)
        self._one = _One(model, at_rest, made.law, numbers, spec, self.names, self.box.base, self.ticks)
        plan = self._one.scenario(jnp.asarray(0.0, dtype), jnp.asarray(0.0, dtype), jnp.zeros(self.ticks, dtype))
        self._one.kept = max(depth(made.law, plan, robot) for robot in robots)
        self._value = batch.over(self._one.value)
        self._slope = batch.over(self._one.slope)
        self._told = batch.over(self._one.told)
        self._loss = jax.jit(jax.vmap(lambda m, ok: cost(m, ok, spec)))
        self._pull = jax.jit(jax.vmap(jax.value_and_grad(lambda m, ok: cost(m, ok, spec))))

    def on(self, robots: Sequence[Model], seed: int) -> Problem:
        """The same on as many other robots, with other noise; nothing is compiled anew."""
        other = copy.copy(self)
        other.count = Count()
        other._place(robots, seed)
        return other

    def _place(self, robots: Sequence[Model], seed: int) -> None:
        model = robots[0]
        self._robots = stack(list(robots))
        self.size = len(self.spec.targets), len(robots)
        noise = np.random.default_rng([seed, 1]).standard_normal((len(robots), self.ticks))
        self._noise = np.asarray(model.n * self.spec.noise_rad * noise, model.jamming.c4.dtype)

    def loss(self, gains: Any) -> float:
        """The loss of gains (k,), a plain function for any optimiser; infinite where they are not feasible."""
        return float(self.losses(np.asarray(gains, float)[None])[0])

    def losses(self, gains: Any) -> np.ndarray:
        """(R,) the losses of gains (R, k), side by side."""
        gains = np.asarray(gains, float)
        good = np.array([self.box.feasible(x) for x in gains])
        out = np.full(len(gains), np.inf)
        if good.any():
            measures, ok = self._all(self._value, gains[good])
            self.count.values += ok.size
            out[good] = self.priced(measures, ok)
        return out

    def value_and_gradient(self, gains: Any) -> tuple[np.ndarray, np.ndarray]:
        """(R,) losses of feasible gains (R, k), and derivatives (R, k) by the gains; loops that fail have none."""
        measures, ok, slopes = self.measures(gains)
        losses, pull = self._pull(measures, ok)
        return np.asarray(losses), np.einsum("rtsm,rtsmk->rk", np.asarray(pull), slopes)

    def priced(self, measures: np.ndarray, ok: np.ndarray) -> np.ndarray:
        """(R,) the losses of measures (R, T, S, m), of loops sound or not (R, T, S)."""
        return np.asarray(self._loss(measures, ok))

    def measures(self, gains: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Smooth measures (R, T, S, m) of the loops of feasible gains (R, k), whether each loop is sound (R, T, S), and
        the measures' derivatives (R, T, S, m, k) by the gains, 0 where there are none."""
        (measures, ok), slopes = self._all(self._slope, np.asarray(gains, float))
        self.count.gradients += ok.size
        return measures, ok, np.where(np.isfinite(slopes), slopes, 0.0)

    def told(self, gains: Any) -> tuple[float, list[list[dict[str, float]]], list[Loop]]:
        """The loss of gains (k,), plain measures of their loops by target and robot (NaN where a loop fails), and the
        first robot's loops, one a target."""
        loops, asked, measures, ok = self._all(self._told, np.asarray(gains, float)[None])
        self.count.values += ok.size
        loss = float(self.priced(measures, ok)[0])
        period, failed = float(self.law.period_s), dict.fromkeys(MEASURES, math.nan)

        def one(t: int, s: int) -> dict[str, float]:
            loop, wanted = jax.tree.map(lambda x: x[0, t, s], (loops, asked))
            return plain(loop, wanted, self.spec, period) if ok[0, t, s] else failed

        targets, robots = self.size
        first = [jax.tree.map(lambda x, t=t: x[0, t, 0], loops) for t in range(targets)]
        return loss, [[one(t, s) for s in range(robots)] for t in range(targets)], first

    def _all(self, function: Any, gains: np.ndarray) -> Any:
        """A function of all loops of gains (R, k): results with the axes (R, T, S)."""
        count, (t, s) = len(gains), self.size
        index = np.indices((count, t, s)).reshape(3, -1)
        theta, stiffness = (
            np.array([getattr(x, name) for x in self.spec.targets]) for name in ("theta_rad", "stiffness_n_m")
        )
        arguments = (
            gains[index[0]],
            jax.tree.map(lambda x: x[index[2]], self._robots),
            theta[index[1]],
            stiffness[index[1]],
            self._noise[index[2]],
        )
        found = function(*arguments)
        return jax.tree.map(lambda x: np.asarray(x).reshape(count, t, s, *x.shape[1:]), found)


class _One:
    """One loop of one robot, from gains (k,): pure functions for `batch.over`."""

    def __init__(
        self, model: Model, at_rest: Statics, law: Law, hardware: Hardware, spec: Spec, names: tuple[str, ...],
        base: dict[str, float], ticks: int,
    ):  # fmt: skip
        self.model, self.at_rest, self.hardware, self.spec = model, at_rest, hardware, spec
        self.names, self.base, self.ticks = names, base, ticks
        self.kind: Kind = law.kind
        self.substeps, self.kept = substeps_of(law), 2

    def scenario(self, theta: Array, stiffness: Array, noise: Array) -> Scenario:
        row, n = jnp.zeros_like(noise), self.model.n
        late = jnp.asarray(self.spec.compute_ticks, noise.dtype) / self.hardware.rate_hz
        sensor = jnp.asarray(self.spec.sensor_s, noise.dtype)
        torque, shape = jnp.zeros((self.ticks, n), noise.dtype), jnp.zeros((n,), noise.dtype)
        return Scenario(row + theta, row + stiffness, noise, row, torque, shape, late, sensor)

    def loop(self, x: Array, robot: Model, theta: Array, stiffness: Array, noise: Array) -> tuple[Loop, Asked]:
        own = {name: jnp.asarray(value, x.dtype) for name, value in self.base.items()}
        gains = Gains(**{**own, **{name: x[i] for i, name in enumerate(self.names)}})
        law = assemble(self.model, self.at_rest, self.kind, gains, self.hardware)
        how = HOW._replace(loops=True)
        plan = self.scenario(theta, stiffness, noise)
        loop = run(law, robot, plan, kept=self.kept, substeps=self.substeps, how=how)
        level = self.hardware.co_contraction_n
        return loop, Asked(theta, stiffness, felt(robot, level, loop.vacuum[-1], gains.gamma))

    def told(self, *arguments: Any) -> tuple[Loop, Asked, Array, Array]:
        loop, asked = self.loop(*arguments)
        return loop, asked, smooth(loop, asked, self.spec, 1.0 / self.hardware.rate_hz), loop.ok

    def value(self, *arguments: Any) -> tuple[Array, Array]:
        return self.told(*arguments)[2:]

    def slope(self, x: Array, *arguments: Any) -> tuple[tuple[Array, Array], Array]:
        def along(v: Array) -> tuple[Array, Array, Array]:
            return jax.jvp(lambda y: self.value(y, *arguments), (x,), (v,), has_aux=True)

        measures, slopes, ok = jax.vmap(along, out_axes=(None, 1, None))(jnp.eye(x.shape[0], dtype=x.dtype))
        return (measures, ok), slopes
