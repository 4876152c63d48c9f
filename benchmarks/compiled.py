"""The two C files: compiled on demand, called through ctypes."""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from ljjax.chain import inertia_constants
from ljjax.model import Model, get

FLAGS = ("-O3", "-march=native", "-ffast-math")
"""What C peers are timed with."""
SCALARS = (
    *("chain.lever_arm_m", "gravity.alpha1", "elastic.c1", "elastic.c2", "elastic.c3", "jamming.c4", "jamming.c5"),
    *(f"friction.{name}" for name in ("sigma0", "sigma1", "sigma2", "sigma3", "mu_c", "mu_s", "v_s")),
)


@cache
def library(source: str, flags: tuple[str, ...] = FLAGS) -> ctypes.CDLL:
    """A C file of this folder as a loaded library."""
    with tempfile.TemporaryDirectory(prefix="ljjax-bench-") as folder:
        part, out = Path(folder) / "out.o", Path(folder) / "out.so"
        subprocess.run(["cc", *flags, "-c", "-fPIC", "-o", part, Path(__file__).parent / source], check=True)
        # Linked without the flags: -ffast-math at the link makes the whole process lose its subnormal numbers.
        subprocess.run(["cc", "-shared", "-o", out, part, "-lm"], check=True)
        return ctypes.CDLL(str(out))


def numbers_of(models: Model) -> np.ndarray:
    """(robots, 14 + n² + n) what the C files call a robot's numbers: scalars, A, J."""
    a, j = jax.vmap(inertia_constants)(models.chain)
    scalars = jnp.stack([get(models, path) for path in SCALARS], axis=1)
    return np.array(jnp.concatenate([scalars, a.reshape(len(a), -1), j], axis=1))
