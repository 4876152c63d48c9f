"""The compiled kernel of `ljjax.fit.shooting`: windows simulated with their derivatives, in tiles on all cores."""

from __future__ import annotations

import contextlib
import gc
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from threadpoolctl import threadpool_limits

from ljjax import batch
from ljjax.fit import native
from ljjax.fit.lowering import Part
from ljjax.fit.windows import Logged
from ljjax.step import How, advance, constants, in_balance, unsensed


@contextlib.contextmanager
def at_work() -> Iterator[None]:
    """With JAX on the processor (`batch.on_processor`), and NumPy's and SciPy's linear algebra on one thread: products
    of long and narrow matrices gain little by more, and threads that wait for each other by spinning lose hundreds of
    times as much where another process has a core."""
    with batch.on_processor(), threadpool_limits(1, "blas"):
        yield


def tiled(kernel: Callable, arguments: Any, tile: int) -> Any:
    """A jitted kernel over arguments whose last axis is the windows, in tiles so wide, on all cores."""
    leaves = jax.tree.leaves(arguments)
    count = leaves[0].shape[-1]
    index = [np.minimum(np.arange(a, a + tile), count - 1) for a in range(0, count, tile)]

    def work(i: np.ndarray) -> Any:
        return jax.tree.map(np.asarray, kernel(*jax.tree.map(lambda x: np.ascontiguousarray(x[..., i]), arguments)))

    form = (getattr(kernel, "func", kernel), getattr(kernel, "args", ()), jax.tree.structure(arguments))
    parts = on_all_cores(work, index, (*form, *(x.shape[:-1] for x in leaves)))
    return jax.tree.map(lambda *x: np.concatenate(x, axis=-1)[..., :count], *parts)


def on_all_cores(work: Callable[[Any], Any], items: Sequence[Any], form: Any) -> list[Any]:
    """Work on items that run one program, known by `form`: the first by itself where it is new, so that it is compiled
    once and not in every thread."""
    done = []
    if form not in _ready:
        with _uncollected():
            done = [work(items[0])]
        _ready.add(form)
    rest = items[len(done) :]
    if len(rest) < 2:
        return done + [work(item) for item in rest]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return done + list(pool.map(work, rest))


_ready: set[Any] = set()


@contextlib.contextmanager
def _uncollected() -> Iterator[None]:
    """Without the garbage collector, which takes a quarter of the time of tracing, and finds nothing."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()


def _push(f: Callable, primals: Any, tangents: Any) -> Any:
    """f at the primals, and its derivatives along tangents stacked along a new first axis."""

    def along(t: Any) -> Any:
        return jax.jvp(f, primals, t)

    return jax.vmap(along, out_axes=(None, 0))(tangents)


def _in_balance(model, q, v, drive):
    """The state of a robot that shows the shape q, and moves at the rate v."""
    return in_balance(model, unsensed(model, q, v, drive), v, drive)


@batch.compiled(**batch.SOON)
def balance(model, slopes, q, v, drive):
    """Starting states from the data, (W,), and their derivatives (k + 1, W)."""

    def f(model, q):
        return jax.vmap(_in_balance)(model, q, v, drive)

    along = jnp.zeros_like(jax.tree.leaves(slopes)[0]).at[-1].set(1.0)
    return _push(f, (model, q), (slopes, tuple(along for _ in q)))


@batch.compiled(**batch.SOON)
def _constants(model, slopes):
    """What no step changes, and its derivatives."""
    return _push(constants, (model,), (slopes,))


def shoot(logged: Logged, model, slopes, *rest):
    """`_shoot` of windows by themselves, with the constants it needs."""
    return _shoot(logged, False, model, slopes, *_constants(model, slopes), *rest)


def onward(logged: Logged, model, slopes, data) -> tuple[Any, Any, Callable]:
    """The starting states of robots from the data, their derivatives, and a function of state, its derivatives, drive
    and step through a window: to the next state, its derivatives, the path (steps + 1, W) and its derivatives."""
    if native.available() and (found := _native(logged, model, slopes, data)):
        return found
    fixed = model, slopes, *_constants(model, slopes)

    def go(state, slope, drive, h):
        (_, state), (_, slope), *paths = _shoot(logged, True, *fixed, state, slope, drive, h)
        return state, slope, *jax.tree.map(np.asarray, paths)

    return *balance(model, slopes, *data), go


def _native(logged: Logged, model, slopes, data) -> tuple[Any, Any, Callable] | None:
    """The same by programs in C; None where they cannot be had. States are rows, known to nobody else."""
    along = np.zeros_like(jax.tree.leaves(slopes)[0])
    along[-1] = 1.0
    begin = native.program("begin", _begin, ("value", "slope", "value", "slope"), (model, slopes, data, along))
    if begin is None:
        return None
    lanes = along.shape[-1]
    none, forces = np.zeros((0, lanes), np.float32), np.zeros((1, 1, lanes), np.float32)
    found = begin.run(native.rows(model, data), native.rows(slopes, along), forces, none, none)
    (c, state), (c_slopes, slope) = (begin.form.unflatten(list(x[..., 0, :])) for x in found)
    kinds = "value", "slope", "value", "slope", "state", "state slope", "drive", "drive"
    given = model, slopes, c, c_slopes, state, slope, data[2], 0.0
    step = native.program(("step", logged), partial(_step, logged), kinds, given, _parts)
    if step is None:
        return None
    value, directed = native.rows(model, c), native.rows(slopes, c_slopes)
    there = step.there(value, directed)
    last = [native.rows(_path(logged, x)) for x in (state, slope)]

    def go(state, slope, drive, h):
        state, slope = state.copy(), slope.copy()
        forces = native.rows(drive, np.broadcast_to(h, jax.tree.leaves(drive)[0].shape))
        paths = step.run(value, directed, forces, state, slope, room=1, there=there)
        for x, before in zip(paths, last, strict=True):
            x[..., 0, :] = before
        last[:] = (x[..., -1, :] for x in paths)
        return state, slope, *(step.form.unflatten(list(x)) for x in paths)

    return native.rows(state), native.rows(slope), go


def _parts(model, slopes, c, c_slopes, state, slope, *_) -> list[Part]:
    """The effects, each absent where it vanishes (`Effect.sizes`), in trees of the numbers of a step's inputs."""
    out = []
    for effect, own, *memory in zip(model.effects, slopes.effects, state.memory, slope.memory, strict=True):
        nulls = {getattr(effect, n): float(effect.fields()[n]["null"]) for n in effect.sizes()}
        out.append(Part(nulls, jax.tree.leaves(own), jax.tree.leaves(memory)))
    return out


def _begin(model, slopes, data, along):
    """Constants and starting state of one robot, and their derivatives."""

    def f(model, q):
        return constants(model), _in_balance(model, q, *data[1:])

    q = data[0]
    values, derivatives = _push(f, (model, q), (slopes, tuple(along for _ in q)))
    return (), (), values, derivatives


def _step(logged: Logged, model, slopes, c, c_slopes, state, slope, drive, h):
    """One step of one robot: the next state, its derivatives, and `_path` of both."""
    state, slope = _push(
        lambda m, c, s: advance(m, c, s, drive, h, How(2)), (model, c, state), (slopes, c_slopes, slope)
    )
    return state, slope, _path(logged, state), _path(logged, slope)


def _path(logged: Logged, state):
    """(q, v, what is seen − q) of states or of derivatives of states: means, or all joints; beside them the tip's turn
    over the joints' number, where that is logged."""
    seen = () if state.sensed is None else tuple(a - b for a, b in zip(state.sensed, state.q, strict=True))
    path = (state.q, state.v, seen)
    mean = tuple((sum(x) / len(x),) if x else () for x in path)
    of_shape = path if logged.joints else mean
    if not logged.tip:
        return of_shape
    tip = (mean[0], mean[1], tuple(0 * x for x in mean[2]))  # as it is, not as the shape's sensor says
    return tuple(a + b for a, b in zip(of_shape, tip, strict=True))


@batch.compiled(static=(0, 1), xla_backend_optimization_level=1)  # once a fit: less is optimised, and it runs as fast
def _shoot(logged: Logged, onward: bool, model, slopes, c, c_slopes, state, slope, drive, h):
    """Middles and ends of the windows, the path (q, v, what is seen − q) from start to end, and all derivatives."""

    how = How(2 if onward else 3, loops=True)

    def one(model, c, state, drive, h):
        return advance(model, c, state, drive, h, how)

    if model.effects or model.lever:  # which know of one robot only
        one = jax.vmap(one)  # the model itself is arithmetic on whole batches, traced sooner so

    def step(both, d):  # derivatives inside the loop, not of the loop: it is traced once
        state, slope = both
        new = _push(lambda m, c, s: one(m, c, s, d, h), (model, c, state), (slopes, c_slopes, slope))
        return new, new

    def read(first, after):
        full = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, after)
        half = len(drive.left) // 2
        middle_and_end = jax.tree.map(lambda x: x[half - 1 :: half], after)
        return tuple(jax.tree.map(lambda x, i=i: x[i], middle_and_end) for i in (0, 1)), _path(logged, full)

    after, after_slopes = jax.lax.scan(step, (state, slope), drive)[1]
    ends, path = read(state, after)
    end_slopes, path_slopes = jax.vmap(read, in_axes=(0, 1))(slope, after_slopes)
    return ends, end_slopes, path, path_slopes
