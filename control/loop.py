"""The simulated closed loop: robot, effects, law, sampling, hold, delays and noise in one program under JAX.

Written for one robot as `ljjax.step` is: every scalar becomes one array over the batch under `vmap` (`ljjax.batch.over`
for many), and everything is differentiable in the law's numbers, the model's parameters and the delays. A tick of the
law spans a whole number of solver steps. The measurement is taken at a tick's beginning, and what the law commands
reaches the robot `compute_s` later and is held; delays need not be whole ticks (the mean over a tick then blends two
commands). Delays among the model's effects (`actuator_delay`, `sensor_delay`) add to them.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ljjax.control import jax_ops
from ljjax.errors import InputError
from ljjax.law.parts import Command, Law, Measured
from ljjax.law.reach import refuse_beyond
from ljjax.law.step import start as begin_law
from ljjax.law.step import step as step_law
from ljjax.model import Model, astype
from ljjax.step import Drive, How, Unrolled, advance, at_rest, constants

HOW = How(iterations=3)
STEP_S = 0.0025
"""Longest step of the solver."""


class Scenario(NamedTuple):
    """What one closed loop is put through, a row a tick of the law.

    Attributes:
        theta: (K,) segment angle wanted [rad].
        stiffness: (K,) transverse tip stiffness wanted [N/m].
        noise: (K,) added to the measured bend q_Σ [rad].
        noise_kpa: (K,) added to the measured vacuum [kPa].
        torque: (K, n) external torques on the joints [N·m].
        shape: (n,) angles of the joints, at rest, to begin with [rad].
        compute_s: from a measurement to its command's effect [s].
        sensor_s: from the bend to its measurement [s].
    """

    theta: Array
    stiffness: Array
    noise: Array
    noise_kpa: Array
    torque: Array
    shape: Array
    compute_s: Array
    sensor_s: Array


class Loop(NamedTuple):
    """A simulated closed loop, an entry a tick, taken at the tick's beginning.

    Attributes:
        t: (K,) stamps [s].
        q, v, z: (K, n) the robot's state [rad, rad/s, rad].
        seen: (K,) q_Σ as the sensor gives it, late and with noise [rad].
        left, right: (K,) tensions commanded [N]; `vacuum` the vacuum [kPa].
        integral, bristle: (K,) the law's torque by integral action [N·m] and observed deflection [rad].
        ok: whether every number is finite.
    """

    t: Array
    q: Array
    v: Array
    z: Array
    seen: Array
    left: Array
    right: Array
    vacuum: Array
    integral: Array
    bristle: Array
    ok: Array

    @property
    def theta(self) -> Array:
        """(K,) mean segment angle [rad]."""
        return jnp.mean(self.q, axis=-1)


def scenario(
    law: Law,
    theta: Any,
    stiffness: Any,
    duration_s: float,
    *,
    noise_rad: float = 0.0,
    seed: int = 0,
    shape: Any = 0.0,
    compute_ticks: float = 1.0,
    sensor_s: float = 0.0,
    dtype: Any = float,
) -> Scenario:
    """A plain scenario: commands (a number or one a tick), white noise of a standard deviation on the segment angle.

    Args:
        theta, stiffness: [rad, N/m], in reach.
        duration_s: rounded to whole ticks.
        noise_rad: standard deviation [rad]; `seed` is the noise's.
        shape: angles of the joints to begin with, a number or one a joint [rad].
        compute_ticks: from a measurement to its command's effect, in periods of the law.
        sensor_s: delay of the measurement [s].

    Raises:
        InputError: a duration of less than a tick; numbers that are not finite, delays or noise below 0, sequences of
            another length; commands out of the law's reach (a `Scenario` made by hand may hold them: the law cuts them
            to its limits).
    """
    period, n = float(law.period_s), int(law.robot.segments)
    amounts = {"duration_s": duration_s, "noise_rad": noise_rad, "compute_ticks": compute_ticks, "sensor_s": sensor_s}
    for name, x in amounts.items():
        if not (np.ndim(x) == 0 and 0 <= x < math.inf):
            raise InputError(f"scenario: {name} = {x}: expected a number from 0 on")
    count = round(duration_s / period)
    if count < 1:
        raise InputError(f"scenario: duration_s = {duration_s:g}: expected a period of the law or more, {period:g} s")
    rows = {"theta": (theta, count, "tick"), "stiffness": (stiffness, count, "tick"), "shape": (shape, n, "joint")}
    for name, (x, size, of) in rows.items():
        if np.shape(x) not in ((), (size,)):
            raise InputError(f"scenario: {name} has the shape {np.shape(x)}; expected a number or {size}, one a {of}")
        if not np.isfinite(np.asarray(x, float)).all():
            raise InputError(f"scenario: {name} holds a number that is not finite")
    for angle in (np.min(theta), np.max(theta)):
        for k in (np.min(stiffness), np.max(stiffness)):
            refuse_beyond(law, Command(float(angle), float(k)), "scenario")
    noise = n * noise_rad * np.random.default_rng(seed).standard_normal(count)

    def row(x: Any, *size: int) -> Array:
        return jnp.asarray(np.broadcast_to(np.asarray(x, float), size), dtype)

    return Scenario(
        row(theta, count),
        row(stiffness, count),
        row(noise, count),
        row(0.0, count),
        row(0.0, count, n),
        row(shape, n),
        row(compute_ticks * period),
        row(sensor_s),
    )


def to_jax(law: Law, dtype: Any = float) -> Law:
    """The law with arrays of one dtype for numbers, a pytree whose kind is static."""

    def table(x: Any) -> bool:
        return isinstance(x, tuple) and not hasattr(x, "_fields")

    return jax.tree.map(lambda x: jnp.asarray(x, dtype), law, is_leaf=table)


def depth(law: Law, given: Scenario, model: Model) -> int:
    """How many ticks the delays of a scenario and a model's effects reach back; what `run` must keep."""
    return ticks_back(law, *delays(model, given))


def ticks_back(law: Law, *late: Any) -> int:
    """How many ticks delays [s], arrays of any shape, reach back."""
    longest = max(float(np.max(np.asarray(x, float))) for x in late)
    return max(2, math.ceil(longest / float(law.period_s)) + 2)


def delays(model: Model, given: Scenario) -> tuple[Array, Array]:
    """Of the tensions and of the measurement [s]; no loop sees what is to come."""
    act, sense = given.compute_s, given.sensor_s
    for effect in model.effects:
        late, latency = effect.delay_s(), effect.latency_s()
        act = act if late is None else act + late
        sense = sense if latency is None else sense + latency
    return act, jnp.maximum(sense, 0.0)


class _Kept(NamedTuple):
    """A ring of the last values of a signal, the newest at `k` modulo its size."""

    ring: Array

    def put(self, value: Array, k: Array) -> _Kept:
        size = self.ring.shape[0]
        return _Kept(jax.lax.dynamic_update_index_in_dim(self.ring, value, k % size, 0))

    def back(self, ticks: Array, k: Array) -> Array:
        """The value so many ticks before, in between by a straight line."""
        size = self.ring.shape[0]
        whole = jnp.clip(jnp.floor(ticks), 0.0, size - 2.0)
        part, index = ticks - whole, whole.astype(k.dtype)
        near, far = self.ring[(k - index) % size], self.ring[(k - index - 1) % size]
        return near + part * (far - near)


def _filled(value: Array, size: int) -> _Kept:
    return _Kept(jnp.zeros((size,), value.dtype) + value)


def run(law: Law, model: Model, given: Scenario, *, kept: int, substeps: int, how: How = HOW) -> Loop:
    """The closed loop of one robot; pure and without checks, for use under jit, vmap and differentiation.

    Args:
        law: with arrays for numbers (`to_jax`), of the same dtype as the model and the scenario.
        kept: ticks that delays may reach back, at least 2 (`depth`).
        substeps: solver steps a tick.
        how: the solver's options; `How(3, loops=True)` compiles several times faster.
    """
    n, period = model.n, law.period_s
    c = constants(model)
    zero = jnp.zeros_like(period)
    late, latency = (x / period for x in delays(model, given))
    shape = tuple(given.shape[i] for i in range(n))
    h = period / substeps
    apart = Drive(zero, zero, zero, t=zero)
    robot = at_rest(model, shape, apart)
    bend = _bend(robot)
    brain = begin_law(law, bend, zero, zero, zero)
    pipes = _filled(bend, kept), _filled(zero, kept), _filled(zero, kept)
    vacuums = _filled(zero, kept)

    def tick(carry: Any, at: Any) -> tuple[Any, Any]:
        robot, brain, (bends, lefts, rights), vacuums = carry
        k, theta, stiffness, noise, noise_kpa, torque = at
        bends = bends.put(_bend(robot), k)
        seen = bends.back(latency, k) + noise
        measured = Measured(seen, brain.vacuum + noise_kpa)
        brain, output = step_law(jax_ops, law, brain, measured, Command(theta, stiffness))
        lefts, rights, vacuums = lefts.put(output.left, k), rights.put(output.right, k), vacuums.put(output.vacuum, k)
        drive = Drive(
            lefts.back(late, k),
            rights.back(late, k),
            vacuums.back(given.compute_s / period, k),
            tuple(torque[i] for i in range(n)),
        )
        t = k.astype(period.dtype) * period

        def onward(state: Unrolled, j: Array) -> tuple[Unrolled, None]:
            return advance(model, c, state, drive._replace(t=t + j * h), h, how), None

        after, _ = jax.lax.scan(onward, robot, jnp.arange(substeps, dtype=period.dtype))
        row = (
            *(jnp.stack(x) for x in (robot.q, robot.v, robot.z)),
            *(seen, output.left, output.right, output.vacuum, brain.integral, brain.bristle),
        )
        return (after, brain, (bends, lefts, rights), vacuums), (t, *row)

    count = given.theta.shape[0]
    rows = jnp.arange(count), given.theta, given.stiffness, given.noise, given.noise_kpa, given.torque
    _, out = jax.lax.scan(jax.checkpoint(tick), (robot, brain, pipes, vacuums), rows)
    finite = jnp.all(jnp.stack([jnp.all(jnp.isfinite(x)) for x in out]))
    return Loop(*out, ok=finite)


def _bend(robot: Unrolled) -> Array:
    """q_Σ as logged [rad]."""
    return sum(robot.q if robot.sensed is None else robot.sensed, 0.0 * robot.q[0])


def substeps_of(law: Law) -> int:
    """Solver steps a tick, of at most `STEP_S`."""
    return max(1, math.ceil(float(law.period_s) / STEP_S - 1e-9))


@eqx.filter_jit
def _compiled(law: Law, model: Model, given: Scenario, kept: int, substeps: int, how: How) -> Loop:
    return run(law, model, given, kept=kept, substeps=substeps, how=how)


def simulate(law: Law, model: Model, given: Scenario, *, loops: bool = True) -> Loop:
    """One closed loop in the scenario's dtype; the front door to `run`.

    Args:
        law: as loaded or designed.
        model: the robot, which need not be the one that the law was designed for.
        loops: compile fast rather than run fast (`ljjax.step.How`).

    Raises:
        InputError: a law for a robot of another number of segments.
    """
    if int(law.robot.segments) != model.n:
        raise InputError(f"the law is for {int(law.robot.segments)} segments, the model has {model.n}")
    dtype = given.theta.dtype
    kept = depth(law, given, model)
    return _compiled(to_jax(law, dtype), astype(model, dtype), given, kept, substeps_of(law), HOW._replace(loops=loops))
