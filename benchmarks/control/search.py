"""Tuning by derivatives against searches without: closed loops simulated until the same loss.

One loss for all, `control.Problem`: the observer's eight gains, three targets, the robot and a variation of it, 2 s a
loop with noise, a tick of delay, slew and saturation. All begin at the gains that `design` chooses, in the same box.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

from benchmarks.control.cmaes import cmaes
from benchmarks.control.octrobot import identified
from benchmarks.control.rows import Row, Size
from benchmarks.sides import interleaved, ratio
from ljjax.control import Hardware, Problem, design
from ljjax.control.robots import sample
from ljjax.control.spec import default
from ljjax.control.tuning import SPREAD, descend
from ljjax.model import Model, get

VARIED = ("elastic.c2", "elastic.c3", "jamming.c4", "jamming.c5", "friction.mu_c", "friction.mu_s")
SHARE = 0.1
"""Standard deviation of the second robot's parameters."""
GENERATION = 10
"""Points that the random search takes at a time, as CMA-ES does."""
Source = Generator[np.ndarray, np.ndarray, None]
"""Points (λ, k) of the box out, their losses (λ,) in."""


class Course(NamedTuple):
    """A search's best loss so far after so many closed loops."""

    loops: np.ndarray
    best: np.ndarray

    def until(self, loss: float) -> float:
        """The loops until a loss; infinite where it was not reached."""
        reached = np.flatnonzero(self.best <= loss)
        return float(self.loops[reached[0]]) if len(reached) else np.inf


def by_gradient(problem: Problem, iterations: int, seed: int) -> Course:
    """The descent of `control.tune`, from the start alone."""
    history, _, _ = descend(problem, 1, iterations, seed, None)
    each = problem.count.gradients // iterations
    return Course(each * np.arange(1, iterations + 1), np.minimum.accumulate(history[:, 0]))


def without(problem: Problem, source: Source, most: int, target: float) -> Course:
    """A search that asks for values alone, until the target or `most` loops."""
    points, best, loops, course = next(source), np.inf, [], []
    begun = problem.count.values
    while problem.count.values - begun < most and best > target:
        losses = problem.losses(np.stack([np.asarray(problem.box.gains(jnp.asarray(u))) for u in points]))
        best = min(best, float(losses.min()))
        loops.append(problem.count.values - begun)
        course.append(best)
        points = source.send(losses)
    return Course(np.array(loops), np.array(course))


def at_random(k: int, seed: int) -> Source:
    """Points anywhere in the box."""
    rng = np.random.default_rng(seed)
    while True:
        yield rng.random((GENERATION, k))


def seconds_a_loop(problem: Problem) -> float:
    """How many times as long a loop with its derivatives takes as one without, side by side: the median of rounds."""
    gains = np.repeat(problem.start[None], GENERATION, axis=0)
    sides = {"with": lambda: problem.value_and_gradient(gains), "without": lambda: problem.losses(gains)}
    return ratio(interleaved(sides, rounds=5), "with", "without")


def tuning(size: Size, out: Path, say: Callable[[str], None]) -> list[Row]:
    """Loops by derivatives ÷ loops without, to the descent's best loss."""
    model, hardware = identified(size.segments), Hardware()
    made = design(model, "observer", hardware=hardware)
    spread = {path: SHARE * abs(float(get(model, path))) for path in VARIED}
    spec = replace(default(made.law), duration_s=2.0)

    def robots(seed: int) -> list[Model]:
        return sample(model, spread, 2, seed=seed, vacuum_max_kpa=hardware.vacuum_max_kpa)

    first = Problem(made, model, hardware, spec, robots(0))
    courses: list[dict[str, Course]] = []
    for seed in range(size.seeds):
        own = by_gradient(first.on(robots(seed), seed), size.iterations, seed)
        target, most = float(own.best[-1]), size.patience * int(own.loops[-1])
        start = first.box.coordinates(first.start)
        sources = {"CMA-ES": cmaes(start, SPREAD, seed), "random": at_random(len(start), seed)}
        found = {name: without(first.on(robots(seed), seed), source, most, target) for name, source in sources.items()}
        courses.append({"gradient": own, **found})
        words = ", ".join(f"{name} {c.best[-1]:.4g} after {c.loops[-1]} loops" for name, c in courses[-1].items())
        say(f"  seed {seed}: from {own.best[0]:.4g}: {words}")
    dearer = seconds_a_loop(first)
    draw(courses).savefig(out / "tuning.png", dpi=110)
    return [_row(courses, name, dearer) for name in ("CMA-ES", "random")]


def _row(courses: list[dict[str, Course]], name: str, dearer: float) -> Row:
    """The descent's loops ÷ another search's, to the loss at which the descent ended; where the other one did not get
    there its budget stands for what it would have taken."""
    shares, missed = [], 0
    for course in courses:
        target = float(course["gradient"].best[-1])
        until = course[name].until(target)
        missed += not np.isfinite(until)
        shares.append(course["gradient"].until(target) / min(until, float(course[name].loops[-1])))
    value = float(np.median(shares))
    missing = f"; {name} did not get there in {missed} of {len(courses)}, its budget counted" if missed else ""
    return Row(
        f"tuning to the same loss: closed loops by derivatives ÷ by {name}",
        value,
        "1",
        "≤ 1/20",
        value <= 1 / 20,
        len(courses),
        f"median over seeds; eight gains, the observer; a loop with its derivatives took {dearer:.2g} times as long as "
        f"one without: {value * dearer:.2g} in loop-equivalents{missing}",
        {"each seed": shares, "loop-equivalents": value * dearer, "a loop with derivatives ÷ one without": dearer},
    )


def draw(courses: list[dict[str, Course]]) -> Figure:
    """The best loss over the loops simulated."""
    figure = Figure(figsize=(7, 4), layout="constrained")
    ax = figure.add_subplot(xlabel="closed loops simulated", ylabel="best loss", xscale="log", yscale="log")
    for name, colour in (("random", "0.6"), ("CMA-ES", "tab:orange"), ("gradient", "tab:blue")):
        for i, course in enumerate(courses):
            ax.step(*course[name], where="post", color=colour, lw=1.2, label=None if i else name)
    ax.legend(frameon=False)
    return figure
