"""The law's arithmetic (`ljjax.law.ops`) under JAX: traced, differentiated, batched; and a law as a pytree."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from ljjax.law.parts import Law

sin = jnp.sin
exp = jnp.exp
sqrt = jnp.sqrt
power = jnp.power
floor = jnp.floor
absolute = jnp.abs
smaller = jnp.minimum
larger = jnp.maximum
where = jnp.where


def take(table: Any, index: Any) -> Any:
    """The entry of a table (N,) at a whole number."""
    return table[index.astype(int)]


jax.tree_util.register_dataclass(
    Law, data_fields=[f.name for f in dataclasses.fields(Law) if f.name != "kind"], meta_fields=["kind"]
)
