"""`sdirk2.c`: compile it, lay a batch out for it, call it on one thread."""

from __future__ import annotations

import ctypes

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.compiled import FLAGS, library, numbers_of
from ljjax import fast
from ljjax.dynamics import State
from ljjax.inputs import Inputs
from ljjax.model import Model


class Batch:
    """A batch laid out for C: blocks of robots side by side; a shorter last block is filled up with its last robot."""

    def __init__(self, models: Model, inputs: Inputs, states: State, h: float, dtype: type = np.float64):
        self.robots, self.n = states.q.shape
        self.kind, self.width = ("float", 8) if dtype is np.float32 else ("double", 4)
        self.blocks = -(-self.robots // self.width)
        self.steps = round(float(inputs.t[-1]) / h)
        self.every, self.h = round(0.01 / h), h
        edges = h * jnp.arange(self.steps + 1)
        tendons, vacuum, _ = jax.vmap(lambda u, p: fast.means(Inputs(inputs.t, u, p, hold=inputs.hold), edges))(
            inputs.tendons, inputs.pressure_kpa
        )
        drive = jnp.stack([tendons[..., 0] - tendons[..., 1], vacuum], axis=-1)
        self.numbers, self.first, self.drive = (
            self._blocks(np.asarray(x, dtype)) for x in (numbers_of(models), states.z, drive)
        )
        frames = (self.robots, self.steps // self.every, self.n)
        self.path = self._blocks(np.zeros(frames, dtype))

    def _blocks(self, x: np.ndarray) -> np.ndarray:
        """(robots, …) → (blocks, …, width), aligned as the vector registers want it."""
        fill = self.blocks * self.width - self.robots
        x = np.concatenate([x, np.repeat(x[-1:], fill, axis=0)]).reshape(self.blocks, self.width, *x.shape[1:])
        x = np.ascontiguousarray(np.moveaxis(x, 1, -1))
        room = np.empty(x.nbytes + 64, np.uint8)
        start = -room.ctypes.data % 64
        out = room[start : start + x.nbytes].view(x.dtype).reshape(x.shape)
        out[...] = x
        return out

    def run(self, iterations: int = 2, flags: tuple[str, ...] = FLAGS) -> None:
        """Simulate; the motion is in `q` afterwards."""
        arrays = (self.numbers, self.first, self.drive, self.path)
        kind = (f"-DREAL={self.kind}", f"-DW={self.width}", *(("-DSINGLE",) if self.kind == "float" else ()))
        simulate = library("sdirk2.c", (*flags, *kind)).simulate
        simulate.restype = None
        simulate(
            *(ctypes.c_int(x) for x in (self.blocks, self.steps, self.every, iterations)),
            ctypes.c_double(self.h),
            *(x.ctypes.data_as(ctypes.c_void_p) for x in arrays),
        )

    @property
    def q(self) -> np.ndarray:
        """(robots, T, n) angles [rad] at 0.01, 0.02, … s."""
        q = np.moveaxis(self.path, -1, 1)
        return q.reshape(-1, *q.shape[2:])[: self.robots]
