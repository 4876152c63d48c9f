"""Whether the law is the same law everywhere: Python, JAX and C side by side, on random states and inputs."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ljjax.control import jax_ops
from ljjax.control.c99 import PREFIX, header
from ljjax.control.loop import to_jax
from ljjax.errors import InputError
from ljjax.law import ops
from ljjax.law.parts import Command, Law, Measured, Output, State
from ljjax.law.step import step

FLOOR = 0.1
"""Errors are relative to a value, or to this share of its column's largest where it is smaller than that."""
STRICT = ("-std=c99", "-pedantic", "-O2")
FUSED = ("-std=gnu99", "-O3", "-march=native", "-ffp-contract=fast")
"""GCC's own dialect, in which it contracts multiply-adds to one rounding where the processor can."""
_S, _M, _C, _O = (len(kind._fields) for kind in (State, Measured, Command, Output))

_DRIVER = """
#include <stdio.h>
#include "law.h"
int main(void) {
  double in[%(inputs)d];
  while (fread(in, sizeof(double), %(inputs)d, stdin) == %(inputs)d) {
    %(prefix)s_state s = {%(state)s};
    const %(prefix)s_measured m = {%(measured)s};
    const %(prefix)s_command c = {%(command)s};
    %(prefix)s_output o = {-1, -1, -1};
    (void)%(prefix)s_step(&s, &m, &c, &o);
    const double out[%(outputs)d] = {%(after)s};
    if (fwrite(out, sizeof(double), %(outputs)d, stdout) != %(outputs)d) return 1;
  }
  return 0;
}
"""


def random_ticks(law: Law, count: int, seed: int = 0) -> np.ndarray:
    """(count, 11) states, measurements and commands, all of float32's numbers: bends at any rate and about the angle
    wanted, inputs within and beyond the limits."""
    rng = np.random.default_rng(seed)
    limits, n = law.limits, law.robot.segments
    most, strongest = limits.theta_max_rad, limits.tension_max_n - limits.tension_min_n
    theta = rng.uniform(-1.3, 1.3, count) * most
    q_sum = n * (np.clip(theta, -most, most) + rng.choice([1e-4, 1e-3, 1e-2, 0.2], count) * rng.normal(size=count))
    rate = rng.choice([0.01, 0.3, 3.0], count) * rng.normal(size=count)
    width = limits.stiffness_max_n_m - limits.stiffness_min_n_m
    net = rng.uniform(-strongest, strongest, count)
    half = 0.5 * np.abs(net)
    level = rng.uniform(limits.tension_min_n + half, limits.tension_max_n - half)
    bend = law.robot.mu_s / law.robot.sigma0
    columns = (
        q_sum - rate * law.period_s * rng.uniform(0.0, 2.0, count),
        rate,
        law.robot.lever_arm_m * strongest * rng.uniform(-1, 1, count),
        rng.uniform(-bend, bend, count),
        net,
        level,
        rng.uniform(0.0, limits.vacuum_max_kpa, count),
        q_sum,
        limits.vacuum_max_kpa * rng.uniform(-0.1, 1.2, count),
        theta,
        limits.stiffness_min_n_m + width * rng.uniform(-0.2, 1.2, count),
    )
    return np.stack(columns, axis=1).astype(np.float32).astype(np.float64)


def by_python(law: Law, ticks: np.ndarray) -> np.ndarray:
    """(count, 10) states after the tick and outputs, by the arithmetic that a rig runs."""
    out = []
    for row in ticks.tolist():
        state, output = step(ops, law, State(*row[:_S]), Measured(*row[_S : _S + _M]), Command(*row[_S + _M :]))
        out.append((*state, *output))
    return np.array(out, float)


def by_jax(law: Law, ticks: np.ndarray) -> np.ndarray:
    """(count, 10) the same by JAX in float64, batched."""

    def one(row: jax.Array) -> jax.Array:
        x = [row[i] for i in range(len(State._fields) + _M + _C)]
        state, output = step(jax_ops, arrays, State(*x[:_S]), Measured(*x[_S : _S + _M]), Command(*x[_S + _M :]))
        return jnp.stack([*state, *output])

    arrays = to_jax(law, jnp.float64)
    return np.asarray(jax.jit(jax.vmap(one))(jnp.asarray(ticks)))


def by_c(law: Law, ticks: np.ndarray, real: str = "double", flags: tuple[str, ...] = STRICT) -> np.ndarray:
    """(count, 10) the same by the C header, compiled here by `cc` (or $CC) with warnings as errors, as strict C99 where
    no other flags are given; the state given and outputs of −1 where its step refuses.

    Raises:
        InputError: no compiler.
    """
    compiler = os.environ.get("CC") or shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if not compiler:
        raise InputError("no C compiler found; install one, or name it in CC")
    names = [f"in[{i}]" for i in range(ticks.shape[1])]
    words = {
        "inputs": ticks.shape[1],
        "outputs": _S + _O,
        "prefix": PREFIX,
        "state": ", ".join(f"(ljjax_real){x}" for x in names[:_S]),
        "measured": ", ".join(f"(ljjax_real){x}" for x in names[_S : _S + _M]),
        "command": ", ".join(f"(ljjax_real){x}" for x in names[_S + _M :]),
        "after": ", ".join([f"(double)s.{x}" for x in State._fields] + [f"(double)o.{x}" for x in Output._fields]),
    }
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        (home / "law.h").write_text(header(law), encoding="ascii")
        (home / "main.c").write_text(_DRIVER % words, encoding="ascii")
        more = ["-DLJJAX_FLOAT"] if real == "float" else []
        line = [compiler, *flags, "-Wall", "-Wextra", "-Werror", *more, "main.c", "-o", "law", "-lm"]
        done = subprocess.run(line, cwd=home, capture_output=True, text=True)
        if done.returncode:
            raise InputError(f"{' '.join(line)}: {done.stderr.strip()[:400]}")
        ran = subprocess.run(
            [home / "law"], input=np.ascontiguousarray(ticks).tobytes(), capture_output=True, check=True
        )
    return np.frombuffer(ran.stdout).reshape(len(ticks), _S + _O)


class Parity(NamedTuple):
    """Largest errors against the law in Python over all states and outputs, and the worst column of each."""

    jax: float
    c_double: float
    c_float: float
    worst: dict[str, str]


def parity(law: Law, count: int = 100_000, seed: int = 0) -> Parity:
    """JAX in float64, C in double and C in float beside Python, on `count` random ticks."""
    ticks = random_ticks(law, count, seed)
    expected = by_python(law, ticks)
    found = {"jax": by_jax(law, ticks), "c_double": by_c(law, ticks), "c_float": by_c(law, ticks, "float")}
    names, largest, worst = (*State._fields, *Output._fields), {}, {}
    for name, x in found.items():
        each = errors(x, expected)
        i = int(np.argmax(each.max(axis=0)))
        largest[name], worst[name] = float(each.max()), names[i]
    return Parity(**largest, worst=worst)


def errors(found: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """|found − expected| over the larger of |expected| and `FLOOR` of its column's largest."""
    size = np.abs(expected)
    return np.abs(found - expected) / np.maximum(np.maximum(size, FLOOR * size.max(axis=0)), 1e-300)
