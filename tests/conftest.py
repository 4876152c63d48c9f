"""Strict numerics for every test: float64, no silent promotion, no silent rank promotion."""

import os

import jax

# Most of the tests' time is XLA's; code that is generated more plainly is there a fifth sooner. `XLA_FLAGS= make test`
# tests what a user's XLA generates by default.
os.environ.setdefault("XLA_FLAGS", "--xla_cpu_use_fusion_emitters=false")
os.environ["LJJAX_CACHE"] = ""  # tests leave nothing in the user's cache
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")
