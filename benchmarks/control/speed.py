"""Closed loops against a C loop of the same scheme on one thread; and the exported law against the law, everywhere."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.control.c_loop import Loops
from benchmarks.control.octrobot import identified
from benchmarks.control.rows import Row, Size
from benchmarks.sides import interleaved, ratio
from ljjax import batch
from ljjax.control import design, parity, scenario
from ljjax.control.loop import HOW, run, substeps_of, to_jax
from ljjax.control.robots import sample, stack
from ljjax.law.parts import KINDS, Law
from ljjax.model import Model, astype, get

VARIED = ("elastic.c2", "elastic.c3", "jamming.c4", "jamming.c5", "friction.mu_c", "friction.mu_s")
SPREAD, NOISE_RAD, ASKED = 0.1, 1e-4, 10_000
ALIKE_RAD, ALIKE_S = 1e-6, 2.0
"""How near the motion in C must be to that in JAX, in double and without -ffast-math, and over how long."""


def by_jax(law: Law, models: Model, wanted: np.ndarray, noise: np.ndarray, dtype: Any) -> Callable[[], Any]:
    """The closed loops as a function without arguments, giving what `Loops.found` holds."""
    given, robots = to_jax(law, dtype), astype(models, dtype)
    plan = scenario(law, 0.0, law.limits.stiffness_max_n_m, noise.shape[1] * law.period_s, dtype=dtype)
    substeps, how = substeps_of(law), HOW._replace(loops=True)

    def one(model: Model, wanted: jax.Array, noise: jax.Array) -> jax.Array:
        row = jnp.zeros_like(noise)
        own = plan._replace(theta=row + wanted[0], stiffness=row + wanted[1], noise=noise)
        loop = run(given, model, own, kept=3, substeps=substeps, how=how)
        return jnp.stack([loop.theta, loop.left, loop.right], axis=-1)

    many, arguments = batch.over(one), (robots, wanted.astype(dtype), noise.astype(dtype))
    return lambda: jax.block_until_ready(many(*arguments))


def speed(size: Size, out: Path, say: Callable[[str], None]) -> list[Row]:
    """Closed loops in JAX ÷ in C."""
    model = identified(size.segments)
    law = design(model, "observer").law
    spread = {path: SPREAD * abs(float(get(model, path))) for path in VARIED}
    models = stack(sample(model, spread, size.loops, vacuum_max_kpa=law.limits.vacuum_max_kpa))
    rng, limits = np.random.default_rng(0), law.limits
    low, high = limits.stiffness_min_n_m, limits.stiffness_max_n_m
    wanted = rng.uniform([-0.8 * limits.theta_max_rad, low], [0.8 * limits.theta_max_rad, high], (size.loops, 2))
    noise = model.n * NOISE_RAD * rng.standard_normal((size.loops, round(size.loop_s / law.period_s)))

    few = min(size.loops, 8)
    start = jax.tree.map(lambda x: x[:few], models), wanted[:few], noise[:few, : round(ALIKE_S / law.period_s)]
    plain = Loops(law, *start)
    plain.compile(("-O3", "-march=native"))
    plain.run()
    apart = float(np.abs(np.asarray(by_jax(law, *start, np.float64)())[..., 0] - plain.found[..., 0]).max())
    say(f"  C and JAX differ by {apart:.0e} rad on {few} robots")
    del plain

    rows, sides = {}, {}
    for dtype in (np.float64, np.float32):
        there = Loops(law, models, wanted, noise, dtype)
        there.compile()
        name = np.dtype(dtype).name
        sides |= {f"JAX {name}": by_jax(law, models, wanted, noise, dtype), f"C {name}": there.run}
    times = interleaved(sides, rounds=3)
    rows = {name: ratio(times, f"C {name}", f"JAX {name}") for name in ("float64", "float32")}
    name = max(rows, key=lambda x: rows[x])
    value = rows[name]
    note = (
        f"speed ÷ one C thread's, both in {name}, observer; {size.loops} loops of {size.loop_s:g} s at "
        f"{1 / law.period_s:g} Hz timed in place of {ASKED:,}, in turns; float64 {rows['float64']:.2f}, float32 "
        f"{rows['float32']:.2f}; JAX on {os.cpu_count()} cores, as it comes; C by hand around the exported header, -O3 "
        f"-march=native -ffast-math; angles in C and JAX differ by {apart:.0e} rad (double, without -ffast-math)"
    )
    met = value >= 0.3 and apart <= ALIKE_RAD
    name = f"{ASKED:,} closed loops of 10 s at 200 Hz: JAX ÷ one C thread of the same scheme"
    return [Row(name, value, "× speed", "≥ 0.3", met, size.loops, note, {**rows, "apart_rad": apart})]


def same(size: Size, out: Path, say: Callable[[str], None]) -> list[Row]:
    """The law in Python, in JAX and in C."""
    model = identified()
    found = {kind: parity(design(model, kind).law, size.ticks) for kind in KINDS}
    rows = []
    for side, name, most in (
        ("jax", "in JAX (float64)", 1e-12),
        ("c_double", "exported, C in double", 1e-12),
        ("c_float", "exported, C in float", 1e-5),
    ):
        each = {kind: float(getattr(x, side)) for kind, x in found.items()}
        worst = max(each, key=lambda kind: each[kind])
        note = f"largest relative error over states and outputs of {size.ticks:,} random ticks a law, at worst {worst}"
        good = each[worst] <= most
        row = Row(f"the law {name} ÷ in Python", each[worst], "1", f"≤ {most:g}", good, 3 * size.ticks, note, each)
        rows.append(row)
    return rows
