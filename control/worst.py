"""The worst case nearby: uphill on a loop's smooth cost over ξ within a ball, and as a run that can be replayed."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ljjax.control.loop import Loop
from ljjax.control.robust_loop import OneLoop
from ljjax.control.spec import MEASURES
from ljjax.control.uncertain import possible
from ljjax.inputs import Inputs
from ljjax.logs import Writer
from ljjax.model import Model
from ljjax.simulation import rest, simulate

STARTS = 3
"""Samples to start from, beside the centre."""
FIRST, LAST = 0.5, 0.05
"""Length of the first and of the last step, in standard deviations."""
HALVINGS = 6
"""How often a step to an impossible robot is halved before it is left out."""


class Worst(NamedTuple):
    """A loop that costs as much as was found within the ball.

    Attributes:
        xi: (d,); its length is `away`, that of the ball `radius`.
        course, target: the noise's course and the target's index.
        values: the quantities by name.
        robot: with its effects.
        cost: of the loop; `begun` that of the worst sample in the ball, `centre` that of ξ = 0 at the same target.
        measures: as defined, by name; `centre_measures` those at ξ = 0.
        loop, centre_loop: with ξ, and with ξ = 0.
        loops: closed loops simulated for it, derivatives included.
    """

    xi: np.ndarray
    away: float
    radius: float
    course: int
    target: int
    values: dict[str, float]
    robot: Model
    cost: float
    begun: float
    centre: float
    measures: dict[str, float]
    centre_measures: dict[str, float]
    loop: Loop
    centre_loop: Loop
    loops: int


def usual_radius(d: int) -> float:
    """The radius within which 95 of 100 draws of ξ (d,) lie: χ's quantile by Wilson and Hilferty's formula."""
    return math.sqrt(d * (1 - 2 / (9 * d) + 1.6448536 * math.sqrt(2 / (9 * d))) ** 3) if d else 0.0


def climb(
    one: OneLoop, xi: np.ndarray, courses: np.ndarray, cost: np.ndarray, radius: float, steps: int, vacuum_kpa: float,
    tell: Any = None,
) -> Worst:  # fmt: skip
    """Normalised gradient ascent within |ξ| ≤ radius, from the worst samples there and from the centre.

    Steps shorten from `FIRST` to `LAST`. One that would end at an impossible robot is halved until it does not. The
    best point seen is taken, the starts included, so that no sample within the ball is worse.

    Args:
        xi, courses, cost: of samples (N, d), (N,), (N, T); costs that are not finite are passed over.
        vacuum_kpa: up to where robots must be possible.
    """
    theta, stiffness = (np.array([getattr(x, k) for x in one.spec.targets]) for k in ("theta_rad", "stiffness_n_m"))
    inside = np.linalg.norm(xi, axis=1) <= radius
    ranked = np.where(inside[:, None] & np.isfinite(cost), cost, -np.inf)
    order = np.argsort(-ranked, axis=None)[:STARTS]
    chosen = [np.unravel_index(k, ranked.shape) for k in order if ranked.flat[k] > -np.inf]
    sample, target = (np.array([c[k] for c in chosen], int) for k in (0, 1))
    worst = (sample[0], target[0]) if len(chosen) else (0, 0)
    x = np.concatenate([xi[sample], np.zeros((1, xi.shape[1]))])
    course, aim = np.append(courses[sample], courses[worst[0]]), np.append(target, worst[1])
    fixed = course, theta[aim], stiffness[aim]
    best, best_cost, begun = x.copy(), np.full(len(x), -np.inf), -math.inf
    used = 0
    for k in range(steps + 1):
        used += len(x)
        value, slope = (np.asarray(y) for y in one.slopes(x, *fixed))
        better = np.isfinite(value) & (value > best_cost)
        best[better], best_cost[better] = x[better], value[better]
        if k == 0:
            begun = float(np.max(best_cost[:-1], initial=-math.inf)) if len(chosen) else float(best_cost[-1])
        if tell:
            tell(k, steps)
        if k == steps or not xi.shape[1]:
            break
        slope = np.where(np.isfinite(slope), slope, 0.0)
        rate = LAST + 0.5 * (FIRST - LAST) * (1 + math.cos(math.pi * k / steps))
        lost = ~np.isfinite(value)
        x[lost] = best[lost]  # back to where it was, and from there by less
        x = _moved(one, x, np.where(lost[:, None], 0.0, slope), rate, radius, vacuum_kpa)
    i = int(np.argmax(best_cost))
    return _told(one, best[i], int(course[i]), int(aim[i]), radius, begun, used)


def _moved(one: OneLoop, x: np.ndarray, slope: np.ndarray, rate: float, radius: float, vacuum_kpa: float) -> np.ndarray:
    length = np.linalg.norm(slope, axis=1, keepdims=True)
    step = rate * slope / np.where(length > 0, length, 1.0)
    out = x.copy()
    for _ in range(HALVINGS):
        y = x + step
        y *= np.minimum(1.0, radius / np.maximum(np.linalg.norm(y, axis=1, keepdims=True), 1e-300))
        good = possible(one.model, one.given, y, vacuum_kpa)
        out[good] = y[good]
        if good.all():
            break
        step[~good] *= 0.5
    return out


def _told(one: OneLoop, xi: np.ndarray, course: int, target: int, radius: float, begun: float, loops: int) -> Worst:
    aim = one.spec.targets[target]
    asked = (jnp.asarray(course, jnp.uint32), *(jnp.asarray(v, one.dtype) for v in (aim.theta_rad, aim.stiffness_n_m)))
    (loop, _, plain, cost), (middle, _, centre, centre_cost) = (
        jax.tree.map(np.asarray, one.alone(jnp.asarray(y, one.dtype), *asked)) for y in (xi, np.zeros_like(xi))
    )
    values = {name: float(x[0]) for name, x in one.given.columns(xi[None]).items()}
    robot = one.robot({name: jnp.asarray(x) for name, x in values.items()})
    named, around = (dict(zip(MEASURES, map(float, y), strict=True)) for y in (plain, centre))
    return Worst(
        xi, float(np.linalg.norm(xi)), radius, course, target, values, robot, float(cost), begun, float(centre_cost),
        named, around, loop, middle, loops + 2,
    )  # fmt: skip


def commands(one: OneLoop, worst: Worst) -> Inputs:
    """What reaches the robot in the worst loop: tensions and vacuum as late as the computation makes them, and the
    push, held from tick to tick."""
    late = worst.values.get("compute_ticks", one.fixed("compute_ticks"))
    whole = math.floor(late)

    def back(x: np.ndarray, ticks: int) -> np.ndarray:
        return np.concatenate([np.zeros(ticks), x])[: len(x)]

    def reached(x: np.ndarray) -> np.ndarray:
        near, far = back(x, whole), back(x, whole + 1)
        return near + (late - whole) * (far - near)

    loop = worst.loop
    drawn = {name: jnp.asarray(x) for name, x in worst.values.items()}
    plan = one.scenario(drawn, worst.robot, jnp.asarray(0, jnp.uint32), *(jnp.zeros((), one.dtype),) * 2)
    left, right, vacuum = (reached(np.asarray(x, float)) for x in (loop.left, loop.right, loop.vacuum))
    return Inputs(jnp.asarray(loop.t), jnp.stack([left, right], axis=1), jnp.asarray(vacuum), plan.torque, hold=True)


def replayed(one: OneLoop, worst: Worst) -> tuple[np.ndarray, np.ndarray]:
    """The worst loop's commands through `ljjax.simulate`: (K, n) joint angles, and those that are logged [rad]."""
    given, loop = commands(one, worst), worst.loop
    slack = Inputs(given.t[:1], jnp.zeros((1, 2)), jnp.zeros(1), hold=True)
    first = rest(worst.robot, slack, jnp.asarray(loop.q[0]))
    motion = simulate(worst.robot, given, at=loop.t, initial=first, step_s=one.period / one.substeps)
    return np.asarray(motion.state.q), np.asarray(motion.seen)


def write_log(path: Path, one: OneLoop, worst: Worst, started: str, law: bytes | None, law_sha256: str) -> float:
    """The worst loop as a log in contract v1, and by how much an angle in its replay differs at most [rad].

    The commands are those that reach the robot, after the computation's delay; a slack robot at rest comes first, a
    nanosecond before them. A push is in no topic of the contract: `ljjax simulate` replays the run without it.
    """
    given, (q, seen) = commands(one, worst), replayed(one, worst)
    about = {"run_id": "worst", "robot_id": "worst", "experiment": "robust", "p_atm_pa": "101325", "start_utc": started}
    begin = 1_000_000_000
    with Writer(path, about | {"law_sha256": law_sha256}) as log:
        log.write("cmd_tendons", begin, [0.0, 0.0])
        log.write("cmd_pressure", begin, [101_325.0])
        rows = zip(np.asarray(given.t), np.asarray(given.tendons), np.asarray(given.pressure_kpa), seen, strict=True)
        for t, tendons, vacuum, shape in rows:
            stamp = begin + round(1e9 * float(t))
            log.write("cmd_tendons", stamp + (t == 0), np.maximum(tendons, 0.0))
            log.write("cmd_pressure", stamp + (t == 0), [101_325.0 - 1e3 * vacuum])
            log.write("shape", stamp, shape)
        if law is not None:
            log.attach("law.json", law, "application/json")
    return float(np.max(np.abs(q - worst.loop.q)))
