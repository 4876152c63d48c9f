"""`loop.c`: compile it around an exported law, lay a batch of closed loops out for it, run it on one thread."""

from __future__ import annotations

import ctypes
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.compiled import FLAGS, library, numbers_of
from ljjax.control.c99 import header
from ljjax.control.loop import HOW, substeps_of
from ljjax.law.parts import Law
from ljjax.model import Model


class Loops:
    """Closed loops of one law on many robots, laid out for C in blocks of robots side by side."""

    def __init__(self, law: Law, models: Model, wanted: np.ndarray, noise: np.ndarray, dtype: type = np.float64):
        """Robots stacked, angle and stiffness wanted (R, 2) [rad, N/m], noise on the bend (R, K) [rad]."""
        self.robots, self.ticks = noise.shape
        self.law, self.n = law, models.n
        self.kind, self.width = ("float", 8) if dtype is np.float32 else ("double", 4)
        self.blocks = -(-self.robots // self.width)
        self.numbers, self.wanted, self.noise, self.path = (
            self._blocks(np.asarray(x, dtype))
            for x in (numbers_of(models), wanted, noise, np.zeros((self.robots, self.ticks, 3)))
        )

    def _blocks(self, x: np.ndarray) -> np.ndarray:
        """(robots, …) → (blocks, …, width), aligned as the vector registers want it; the last robot fills up."""
        fill = self.blocks * self.width - self.robots
        x = np.concatenate([x, np.repeat(x[-1:], fill, axis=0)]).reshape(self.blocks, self.width, *x.shape[1:])
        x = np.moveaxis(x, 1, -1)
        room = np.empty(x.size * x.itemsize + 64, np.uint8)
        start = -room.ctypes.data % 64
        out = room[start : start + x.size * x.itemsize].view(x.dtype).reshape(x.shape)
        out[...] = x
        return out

    def compile(self, flags: tuple[str, ...] = FLAGS) -> None:
        """Compile; to be called before `run`, and again with other flags."""
        kind = (f"-DREAL={self.kind}", f"-DW={self.width}", f"-DN={self.n}")
        if self.kind == "float":
            kind += ("-DSINGLE", "-DLJJAX_FLOAT")
        with tempfile.TemporaryDirectory(prefix="ljjax-bench-") as folder:
            (Path(folder) / "law.h").write_text(header(self.law), encoding="ascii")
            self._loops = library("control/loop.c", (*flags, *kind, f"-I{folder}")).loops

    def run(self) -> None:
        """Simulate; the motion is in `found` afterwards."""
        substeps = substeps_of(self.law)
        refused = self._loops(
            *(ctypes.c_int(x) for x in (self.blocks, self.ticks, substeps, HOW.iterations)),
            ctypes.c_double(self.law.period_s / substeps),
            *(x.ctypes.data_as(ctypes.c_void_p) for x in (self.numbers, self.wanted, self.noise, self.path)),
        )
        if refused:
            raise RuntimeError(f"the law refused {refused} ticks")

    @property
    def found(self) -> np.ndarray:
        """(R, K, 3) mean segment angle [rad], left and right tension [N] at every tick's beginning."""
        out = np.moveaxis(self.path, -1, 1)
        return out.reshape(-1, *out.shape[2:])[: self.robots]
