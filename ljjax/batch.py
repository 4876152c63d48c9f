"""Many robots or runs at once: on a processor in tiles, one thread a core, compiled without duplicated work."""

from __future__ import annotations

import contextlib
import functools
import math
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

LEAST, MOST = 32, 512
"""Elements a tile: fewer waste the time in which operations start, more leave the cache."""
OPTIONS: dict[str, Any] = {"xla_disable_hlo_passes": "cse_barrier_expander,small-while-loop-hoisting"}
"""Compiler options for processors: the barriers in `ljjax.step` hold until operations are fused. XLA removes them
earlier by default, and then computes anew what several results share, several times over; and it puts small loops into
one kernel, in which (from JAX 0.12 on) it knows no barrier."""
GONE = {"xla_cpu_use_fusion_emitters"} if jax.__version_info__ >= (0, 11) else set()
"""Options that this version of XLA no longer knows."""
SOON: dict[str, Any] = {"xla_backend_optimization_level": 0, "xla_cpu_use_fusion_emitters": False}
"""Further ones for what takes longer to compile than to run: as little work of the compiler as there is."""
CONFIG: Any = jax.config


def platform() -> str:
    """Where programs run now: "cpu", "gpu", …"""
    chosen = CONFIG.jax_default_device
    return jax.default_backend() if chosen is None else getattr(chosen, "platform", chosen)


@contextlib.contextmanager
def on_processor() -> Iterator[None]:
    """With JAX's programs on the processor even where there is a graphics card, which starts the many short steps of
    few windows more slowly than a core computes them. Who has chosen a default device, or by JAX_PLATFORMS leaves no
    processor, has it."""
    if platform() == "cpu" or CONFIG.jax_default_device is not None:
        yield
        return
    with contextlib.suppress(RuntimeError):
        CONFIG.update("jax_default_device", jax.devices("cpu")[0])
    try:
        yield
    finally:
        CONFIG.update("jax_default_device", None)


def options(**more: Any) -> dict[str, Any]:
    """What to hand to `jax.jit(compiler_options=…)` where the solver runs in batches, and `more` of XLA's options, but
    for those that it no longer knows: they change how fast a program is, not what it gives."""
    return {k: x for k, x in {**OPTIONS, **more}.items() if k not in GONE} if platform() == "cpu" else {}


def compiled(static: tuple[int, ...] = (), **more: Any) -> Callable[[Callable], Callable]:
    """`jax.jit` with compiler options that suit the place where the program runs, known only then."""

    def decorate(function: Callable) -> Callable:
        @functools.cache
        def program(_: str) -> Callable:
            return jax.jit(function, static_argnums=static, compiler_options=options(**more))

        @functools.wraps(function)
        def run(*arguments: Any) -> Any:
            return program(platform())(*arguments)

        return run

    return decorate


def over(function: Callable[..., Any], threads: int | None = None) -> Callable[..., Any]:
    """`jax.vmap(function)` over the leading axis of all arguments, computed in tiles on several threads.

    The results are those of `jax.jit(jax.vmap(function))`; an element that fails (NaN) leaves the others alone. One
    program is compiled a width of tile; the last tile is filled up with its last element. For use outside jit. On
    other devices than processors it is one `vmap`; where there are several devices each takes a share of the elements.

    Args:
        function: of one element's arguments, pytrees of arrays; pure.
        threads: tiles computed at the same time; the machine's cores by default.
    """
    program = jax.jit(jax.vmap(function), compiler_options=options())
    workers = threads or os.cpu_count() or 1
    compiled: set[int] = set()

    def run(*arguments: Any) -> Any:
        if platform() == jax.default_backend() and jax.device_count() > 1:
            return _shared(program, arguments)
        if platform() != "cpu":
            return program(*arguments)
        arrays = jax.tree.map(np.asarray, arguments)  # without a copy; slices of NumPy's are views
        size = jax.tree.leaves(arrays)[0].shape[0]
        width = min(max(math.ceil(size / workers), LEAST), MOST, size)

        def compute(start: int) -> Any:
            def tile(x: np.ndarray) -> np.ndarray:
                part = x[start : start + width]
                return np.concatenate([part, np.repeat(part[-1:], width - len(part), axis=0)])

            return jax.block_until_ready(program(*jax.tree.map(tile, arrays)))

        starts = range(0, size, width)
        if width not in compiled:  # once, not once a thread
            compute(0)
            compiled.add(width)
        with ThreadPoolExecutor(workers) as pool:
            parts = list(pool.map(compute, starts))
        return jax.tree.map(lambda *x: jnp.concatenate(x)[:size], *parts)

    return run


def _shared(program: Callable[..., Any], arguments: Any) -> Any:
    """A batched program with its elements laid out over all devices; filled up with the last one where they do not
    come out even."""
    devices = jax.devices()
    size = jax.tree.leaves(arguments)[0].shape[0]
    more = -size % len(devices)
    layout = NamedSharding(Mesh(np.array(devices), ("elements",)), PartitionSpec("elements"))

    def laid(x: Any) -> jax.Array:
        x = np.asarray(x)
        return jax.device_put(np.concatenate([x, np.repeat(x[-1:], more, axis=0)]) if more else x, layout)

    return jax.tree.map(lambda x: x[:size], program(*jax.tree.map(laid, arguments)))
