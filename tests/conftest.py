"""Strict numerics for every test: float64, no silent promotion, no silent rank promotion."""

import atexit
import os
import shutil
import tempfile

import jax

from ljjax.batch import GONE
from ljjax.cli import start_jax

# Most of the tests' time is XLA's; code that is generated more plainly is there sooner. `XLA_FLAGS= make test`
# tests what a user's XLA generates by default.
PLAIN = "--xla_backend_optimization_level=0"
if "xla_cpu_use_fusion_emitters" not in GONE:  # XLA stops at a flag that it does not know
    PLAIN += " --xla_cpu_use_fusion_emitters=false"
os.environ.setdefault("XLA_FLAGS", PLAIN)
if "PYTEST_XDIST_WORKER" not in os.environ:  # what one process compiles the others read; nothing is left behind
    os.environ["LJJAX_CACHE"] = tempfile.mkdtemp(prefix="ljjax-tests-")
    atexit.register(shutil.rmtree, os.environ["LJJAX_CACHE"], ignore_errors=True)
start_jax()
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")
