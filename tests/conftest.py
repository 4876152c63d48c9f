"""Strict numerics for every test: float64, no silent promotion, no silent rank promotion."""

import os

import jax

os.environ["LJJAX_CACHE"] = ""  # tests leave nothing in the user's cache
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")
