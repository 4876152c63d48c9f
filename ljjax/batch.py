"""Many robots or runs at once on a processor: tiles that stay in its cache, one thread a core."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp

TILE = 64
"""Elements a tile."""


def over(function: Callable[..., Any], tile: int = TILE, threads: int | None = None) -> Callable[..., Any]:
    """`jax.vmap(function)` over the leading axis of all arguments, computed tile by tile on several threads.

    The result equals that of `jax.jit(jax.vmap(function))`. One program is compiled for a tile, whatever the size of
    the batch; the last tile is filled up with the last element. For use outside jit, on data that is known.

    Args:
        function: of one element's arguments, pytrees of arrays; pure.
        tile: elements computed together; a smaller batch is split evenly over the threads.
        threads: tiles computed at the same time; the machine's cores by default.
    """
    program = jax.jit(jax.vmap(function))
    workers = threads or os.cpu_count() or 1

    def run(*arguments: Any) -> Any:
        size = jax.tree.leaves(arguments)[0].shape[0]
        width = min(tile, math.ceil(size / workers))
        starts = range(0, size, width)

        def compute(start: int) -> Any:
            index = jnp.minimum(jnp.arange(start, start + width), size - 1)
            return jax.block_until_ready(program(*jax.tree.map(lambda x: x[index], arguments)))

        first = compute(0)  # alone, so that the program is compiled once
        with ThreadPoolExecutor(workers) as pool:
            parts = [first, *pool.map(compute, starts[1:])]
        return jax.tree.map(lambda *x: jnp.concatenate(x)[:size], *parts)

    return run
