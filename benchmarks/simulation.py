"""Simulation side by side: 64 robots at equal accuracy against others, 1,024 robots against one C thread."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import peers
from benchmarks.fleet import fleet, of_one
from benchmarks.one_c_thread import Batch
from benchmarks.peers import Task
from benchmarks.sides import Row, interleaved, ratio
from ljjax import batch, fast

SECONDS = 10.0
STEP_S = 0.005
LOOSE_STEP_S = 0.01
"""The longest step that reaches the accuracy, as the tolerances below are the loosest."""
ITERATIONS = 2
ACCURACY_RAD = 1e-4
SHORT_S = 2.0
"""diffrax is timed on this many seconds of the same motion, and so is ljjax beside it."""
HELD_S = 1.0
"""The same where commands are held: diffrax then starts anew a hundred times a second."""
DIFFRAX, DIFFRAX_HELD = (5e-3, 5e-5), (2e-3, 2e-5)
"""rtol, atol: the loosest that reach the accuracy, or nearly; so for the others."""
CVODE = (4e-4, 4e-6)
RADAU = (3e-3, 3e-5)
CASADI = (4e-4, 4e-6)


def ours(task: Task, dtype: Any = float, step_s: float = STEP_S, spread: Callable[..., Any] = batch.over):
    """ljjax's fast solver on a task: a function without arguments, compiled, that gives q (robots, T, n)."""
    cast = lambda tree: jax.tree.map(lambda x: x.astype(dtype), tree)  # noqa: E731
    models, inputs, states = cast(task)
    t, steps = inputs.t, round(float(task.inputs.t[-1]) / step_s)
    h = jnp.asarray(step_s, dtype)

    def one(model: Any, tendons: Any, vacuum: Any, state: Any) -> Any:
        return fast.run(model, of_one(inputs, tendons, vacuum), state, t, t[0], h, steps, ITERATIONS).q

    run = spread(one)
    given = (models, inputs.tendons, inputs.pressure_kpa, states)
    call = lambda: jax.block_until_ready(run(*given))  # noqa: E731
    call()
    return call


def short(task: Task, seconds: float) -> Task:
    """The beginning of a task."""
    count = round(100 * seconds) + 1
    i = task.inputs
    cut = type(i)(i.t[:count], i.tendons[:, :count], i.pressure_kpa[:, :count], hold=i.hold)
    return Task(task.models, cut, task.states)


def reference(task: Task) -> np.ndarray:
    """q (robots, T, n) [rad] after the first stamp, converged: the scheme in C at 0.25 ms, four iterations."""
    fine = Batch(*task, h=2.5e-4)
    fine.run(iterations=4)
    return fine.q


def error(q: Any, truth: np.ndarray) -> float:
    """90th percentile over the robots of max|Δq| [rad]; q with the first stamp, of the first robots and stamps."""
    q = np.asarray(q, float)[:, 1:]
    return float(np.quantile(np.abs(q - truth[: q.shape[0], : q.shape[1]]).max(axis=(1, 2)), 0.9))


def equal_accuracy(say: Callable[[str], None]) -> list[Row]:
    """64 robots against adaptive solvers."""
    task = Task(*fleet(64, SECONDS))
    truth = reference(task)
    exact = peers.cvode(task.some(2), 1e-6, 1e-8)()
    apart = np.abs(exact[:, 1:] - truth[:2]).max()
    say(f"  the converged reference and SUNDIALS CVODE at rtol 1e-6 differ by {apart:.0e} rad on two robots")

    start = short(task, SHORT_S)
    mine, theirs = ours(start, step_s=LOOSE_STEP_S), peers.diffrax_vmap(start, diffrax.Kvaerno5(), *DIFFRAX)
    errors = {"ljjax": error(mine(), truth), "diffrax": error(theirs(), truth)}
    times = interleaved({"ljjax": mine, "diffrax": theirs}, rounds=3, least_s=3.0)
    gain = ratio(times, "diffrax", "ljjax")
    say(f"  90th percentile of max|Δq|, first {SHORT_S:g} s: {_words(errors)}")

    full = ours(task, step_s=LOOSE_STEP_S)
    single, fine = ours(task, jnp.float32, LOOSE_STEP_S), ours(task)
    few, fewer = task.some(8), task.some(2)
    sides = {
        "ljjax": (full, 64),
        "ljjax float32": (single, 64),
        "ljjax, 5 ms steps": (fine, 64),
        "SUNDIALS CVODE": (peers.cvode(few, *CVODE), 8),
        "SciPy Radau": (peers.scipy_radau(fewer, *RADAU), 2),
        "CasADi CVODES": (peers.casadi_cvodes(few, *CASADI), 8),
        "MuJoCo (another friction)": (peers.mujoco_rollout(task, 0.0025, os.cpu_count() or 1), 64),
    }
    errors = {name: error(side(), truth) for name, (side, _) in sides.items() if not name.startswith("MuJoCo")}
    say(f"  90th percentile of max|Δq|, {SECONDS:g} s: {_words(errors)}")
    seconds = interleaved({name: side for name, (side, _) in sides.items()}, rounds=3, least_s=0.5)
    each = {name: seconds[name] / count for name, (_, count) in sides.items()}
    beside = {name: ratio(each, name, "ljjax") for name in sides if name != "ljjax"}
    held = _held(say)
    return [
        held,
        Row(
            "the same, commands linear between their stamps",
            gain,
            "×",
            "≥ 250",
            bool(errors["ljjax"] < ACCURACY_RAD and gain >= 250),
            beside,
            f"beside it: each one's time a trajectory ÷ ljjax's, {SECONDS:g} s; one after the other but for MuJoCo, "
            "whose chain has stiffness, damping and frictionloss in place of LuGre",
        ),
    ]


def _held(say: Callable[[str], None]) -> Row:
    """64 robots against diffrax under commands that hold until the next one, as logs have them."""
    task = Task(*fleet(64, HELD_S, hold=True))
    truth = reference(task)
    mine = ours(task, step_s=LOOSE_STEP_S)
    theirs = peers.diffrax_vmap(task, diffrax.Kvaerno5(), *DIFFRAX_HELD)
    errors = {"ljjax": error(mine(), truth), "diffrax": error(theirs(), truth)}
    say(f"  90th percentile of max|Δq|, commands held, first {HELD_S:g} s: {_words(errors)}")
    gain = ratio(interleaved({"ljjax": mine, "diffrax": theirs}, rounds=2, least_s=1.0), "diffrax", "ljjax")
    good = bool(errors["ljjax"] < ACCURACY_RAD and gain >= 250)
    name = "64 robots, equal accuracy: diffrax Kvaerno5 under vmap, time ÷ ljjax's"
    return Row(name, gain, "×", "≥ 250", good, {}, "commands at 100 Hz, each held until the next, as logs have them")


def against_c(say: Callable[[str], None]) -> list[Row]:
    """1,024 robots against one C thread of the same scheme."""
    task = Task(*fleet(1024, 2.0))
    few = task.some(8)
    plain = Batch(*few, h=STEP_S)
    plain.run(ITERATIONS, flags=("-O3", "-march=native"))
    apart = np.abs(np.asarray(ours(few)())[:, 1:] - plain.q).max()
    say(f"  C and ljjax differ by {apart:.0e} rad on 8 robots, 2 s, without -ffast-math")
    double, single = Batch(*task, h=STEP_S), Batch(*task, h=STEP_S, dtype=np.float32)
    sides = {
        "ljjax": ours(task),
        "ljjax float32": ours(task, jnp.float32),
        "ljjax, one vmap": ours(task, spread=lambda f: jax.jit(jax.vmap(f))),
        "C": lambda: double.run(ITERATIONS),
        "C float32": lambda: single.run(ITERATIONS),
    }
    times = interleaved(sides, rounds=7, least_s=0.3)
    value = ratio(times, "C", "ljjax")
    beside = {name: ratio(times, "C", name) for name in sides if name not in ("ljjax", "C")}
    good = bool(value >= 0.3 and apart < 1e-9)
    note = "speed ÷ one C thread's in float64 (-O3 -march=native -ffast-math, AVX where the machine has it)"
    return [Row("1,024 robots ÷ one C thread of the same scheme", value, "×", "≥ 0.3", good, beside, note)]


def _words(errors: dict[str, float]) -> str:
    return ", ".join(f"{name} {x:.1e}" for name, x in errors.items()) + " rad"
