"""Steady error and stiffness over sampled robots: each law of ours against the published one, on the same robots.

Robots are drawn about the identified one. Each has a law designed from its own model, or from one that is off in every
parameter as after an identification, with the gains that `design` would choose, γ and damping the same for all laws
(the published law's steady error falls with γ: the published gain would make it larger). Each goes to an angle and a
stiffness of its own, with noise and a tick of delay.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from matplotlib.figure import Figure

from benchmarks.control.octrobot import identified
from benchmarks.control.rows import Row, Size
from ljjax import batch
from ljjax.chain import lateral_jacobian
from ljjax.control import Hardware, design, scenario
from ljjax.control.loop import HOW, run, substeps_of
from ljjax.control.robots import sample, stack
from ljjax.control.statics import statics, tip_stiffness
from ljjax.control.synthesis import assemble, default_gains
from ljjax.energy import alpha2, phi
from ljjax.law.parts import KINDS, Kind
from ljjax.model import Model, check, get, replace

SPREAD = 0.15
"""Standard deviation of the robots' parameters, as a share."""
OFF = 0.02
"""The same of what an identified model is off."""
VARIED = (
    *("chain.segment_mass_kg", "elastic.c2", "elastic.c3", "jamming.c4", "jamming.c5"),
    *(f"friction.{name}" for name in ("sigma1", "sigma2", "mu_c", "mu_s", "v_s")),
)
SECONDS, EARLY_S, PUSH_S, NOISE_RAD = 10.0, 5.0, 1.0, 1e-4
"""A loop's length before the push, when an early error is told beside, and the push's [s]; errors are those of the last
second before."""
PUSH = 0.05
"""The probe's push, as a share of what breaks the bristles away."""
OURS: tuple[Kind, ...] = ("integral", "observer")


class Cases(NamedTuple):
    """Robots side by side, an entry each (R, …): the robot, what its law takes it for, the shares of the reach in angle
    and stiffness that are asked for, noise on the bend (R, K) [rad]."""

    robot: Model
    seen: Model
    angle: np.ndarray
    stiffness: np.ndarray
    noise: np.ndarray


class Found(NamedTuple):
    """Of each robot (R,): steady error, and that half-way [rad], stiffness asked for and K_T at the vacuum commanded
    [N/m], the way of the tip's push along it [m], whether all numbers are finite."""

    error: Array
    early: Array
    wanted: Array
    felt: Array
    way: Array
    ok: Array


def cases(size: Size, known: bool, seed: int = 0) -> Cases:
    """Sampled robots; their laws from their own models, or from models that are off."""
    rng, model = np.random.default_rng(seed), identified(size.segments)
    most = Hardware().vacuum_max_kpa
    spread = {path: SPREAD * abs(float(get(model, path))) for path in VARIED}
    robots = sample(model, spread, size.robots, seed=seed, vacuum_max_kpa=most)
    seen = robots if known else [_off(robot, rng, most) for robot in robots]
    count = len(robots)
    angle, stiffness = rng.uniform([0.2, 0.1], [0.8, 0.9], (count, 2)).T
    noise = model.n * NOISE_RAD * rng.standard_normal((count, round((SECONDS + PUSH_S) * Hardware().rate_hz)))
    return Cases(stack(robots), stack(seen), angle * rng.choice([-1, 1], count), stiffness, noise)


def _off(robot: Model, rng: np.random.Generator, most: float) -> Model:
    """A robot as an identification may find it."""
    while True:
        seen = {path: float(get(robot, path)) * (1 + OFF * rng.standard_normal()) for path in VARIED}
        if seen["friction.mu_c"] <= seen["friction.mu_s"]:
            found = replace(robot, seen)
            check(found, (0.0, most))
            return found


def simulator(kind: Kind, segments: int) -> Callable[[Cases, np.ndarray], Found]:
    """Closed loops of one kind of law, compiled once: of cases under a push at the tip [N] (R,) after the rest."""
    base = design(identified(segments), kind)
    least = base.law.gains.damping  # which sampling carries
    numbers = Hardware()._replace(theta_max_rad=base.law.limits.theta_max_rad)
    hardware = Hardware(*(jnp.asarray(float(x)) for x in numbers))
    period, substeps, how = base.law.period_s, substeps_of(base.law), HOW._replace(loops=True)
    ends = [round(x / period) for x in (SECONDS, EARLY_S)]
    count = round((SECONDS + PUSH_S) / period)
    plan = scenario(base.law, 0.0, base.law.limits.stiffness_max_n_m, count * period)

    def one(case: Cases, push: jax.Array) -> Found:
        at_rest = statics(case.seen, hardware.vacuum_max_kpa, hardware.co_contraction_n)
        gains = default_gains(case.seen, at_rest, hardware.rate_hz)
        gains = gains._replace(damping=jnp.minimum(gains.damping, least))
        law = assemble(case.seen, at_rest, kind, gains, hardware)
        low, high = law.limits.stiffness_min_n_m, law.limits.stiffness_max_n_m
        theta, wanted = case.angle * hardware.theta_max_rad, low + case.stiffness * (high - low)
        a = lateral_jacobian(case.robot.chain, jnp.zeros((segments,)))
        ramp = jnp.clip((jnp.arange(count, dtype=float) - ends[0]) / (0.5 * PUSH_S / period), 0.0, 1.0)
        row = jnp.zeros((count,))
        own = plan._replace(
            theta=row + theta, stiffness=row + wanted, noise=case.noise, torque=push * ramp[:, None] * a[None]
        )
        loop = run(law, case.robot, own, kept=3, substeps=substeps, how=how)
        joint = alpha2(case.robot, loop.vacuum[-1]) + case.robot.friction.sigma0 * phi(case.robot, loop.vacuum[-1])
        felt = tip_stiffness(case.robot, joint * jnp.ones((1, segments)), gains.gamma)[0]
        error, early = (jnp.sqrt(jnp.mean((loop.theta - theta)[x - round(1 / period) : x] ** 2)) for x in ends)
        error = jnp.where(loop.ok, error, jnp.inf)
        return Found(error, early, wanted, felt, a @ loop.q[-1], loop.ok)

    return batch.over(one)


def probed(run: Callable[[Cases, np.ndarray], Found], given: Cases, found: Found) -> np.ndarray:
    """What a small push after the move feels, as a share of the stiffness asked for."""
    a = 0.021 * (2 * given.robot.n - 1)
    wanted = np.asarray(found.wanted)
    push = PUSH * np.asarray(given.robot.friction.mu_s) * wanted * a
    return push / np.asarray(run(given, push).way - found.way) / wanted


def accuracy(size: Size, out: Path, say: Callable[[str], None]) -> list[Row]:
    """Steady errors ÷ the published law's, and how near the stiffness is."""
    exact, off = cases(size, known=True), cases(size, known=False)
    few = jax.tree.map(lambda x: x[: size.probed], exact)
    none, nobody = np.zeros(size.robots), np.zeros(size.probed)
    found: dict[str, dict[bool, Found]] = {}
    felt: dict[str, float] = {}
    for kind in KINDS:
        run = simulator(kind, size.segments)
        found[kind] = {True: run(exact, none), False: run(off, none)}
        felt[kind] = float(np.median(probed(run, few, run(few, nobody))))
        words = ", ".join(f"{np.degrees(np.median(x.error)):.3g}°" for x in found[kind].values())
        say(f"  {kind}: median steady error {words} (robot known, {100 * OFF:g} % off)")
    rows = []
    for known in (True, False):
        shares = {kind: found[kind][known].error / found["passivity"][known].error for kind in OURS}
        best = min(OURS, key=lambda kind: float(np.median(shares[kind])))
        side = found[best][known]
        stiff = np.abs(side.felt / side.wanted - 1)
        value, error = float(np.median(shares[best])), {k: float(np.median(v[known].error)) for k, v in found.items()}
        failed = sum(int(np.sum(~f[known].ok)) for f in found.values())
        whose = "the robot's own model" if known else f"a model {100 * OFF:g} % (sd) off in each parameter"
        every = ", ".join(f"{k} {np.degrees(x):.3g}°" for k, x in error.items())
        early = float(np.median(side.early / found["passivity"][known].early))
        above = int(np.sum(shares[best] > 0.2))
        note = (
            f"median over robots, best: {best}; median errors {every}; RMS of the second before {SECONDS:g} s (before "
            f"{EARLY_S:g} s {early:.2g}; all creep on under the noise); {above} robots above 1/5, {failed} loops failed"
            f"; law from {whose}; K_T of the unbent robot at z = 0 under the vacuum commanded is off by "
            f"{100 * np.median(stiff):.2g} % (median), {100 * np.quantile(stiff, 0.95):.2g} % (95th percentile)"
        )
        if known:
            shown = ", ".join(f"{k} {100 * x:.0f} %" for k, x in felt.items())
            note += (
                f"; what a small push of {PUSH_S:g} s after the move feels of it: {shown} (bristles bent already; "
                "integral action answers a push that lasts)"
            )
        good = value <= 0.2 and float(stiff.max()) <= 0.02
        beside = {"shares": {k: float(np.median(x)) for k, x in shares.items()}, "median_error_rad": error}
        beside |= {"stiffness_error_95": float(np.quantile(stiff, 0.95)), "probe_share": felt, "early": early}
        name, goal = "steady error of the best law ÷ the published law's", "≤ 1/5, stiffness within 2 %"
        if known:
            rows.append(Row(name, value, "1", goal, good, size.robots, note, beside))
        else:
            rows.append(Row(f"{name}, the model off", value, "1", "", None, size.robots, note, beside))
    draw({k: v[True] for k, v in found.items()}).savefig(out / "accuracy.png", dpi=110)
    return rows


def draw(found: dict[str, Found]) -> Figure:
    """Steady errors over the robots, a law a line."""
    figure = Figure(figsize=(6, 4), layout="constrained")
    ax = figure.add_subplot(xlabel="steady error [deg]", ylabel="share of the robots below", xscale="log")
    for kind, x in found.items():
        ax.plot(np.sort(np.degrees(x.error)), (np.arange(len(x.error)) + 0.5) / len(x.error), label=kind)
    ax.legend(frameon=False)
    return figure
