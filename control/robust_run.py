"""The loops of a robustness study in batches that fit memory, each kept as it is done; a killed study goes on."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ljjax import sweep_file
from ljjax.control.robust_loop import OneLoop, Told
from ljjax.errors import InputError
from ljjax.sweep_file import Unfinished
from ljjax.sweep_run import free_bytes

PARTIAL, SAMPLES = "robust.partial", "samples.nc"
"""In the study's folder: the batches that are done, while it runs; every sample, when it is done."""
LARGEST_BATCH = 1024
"""Loops at a time on a processor; an accelerator takes as many as its memory holds."""


def digest(tree: Any) -> str:
    """sha256 of all numbers in a pytree."""
    found = hashlib.sha256()
    for leaf in jax.tree.leaves(tree):
        x = np.asarray(leaf, float)
        found.update(f"{x.shape}".encode() + np.ascontiguousarray(x).tobytes())
    return found.hexdigest()


class Kept:
    """The folder of a study: what the same study found before, and what is being simulated.

    Args:
        batch: draws at a time, of a study that begins; one that goes on keeps its own.

    Attributes:
        batch: draws at a time.
        finished: every loop, where the study is whole.

    Raises:
        InputError: a folder of another study.
    """

    def __init__(self, out: Path, identity: Mapping[str, Any], batch: int):
        identity = json.loads(json.dumps(identity))
        self.batch, self.finished = batch, None
        if (out / SAMPLES).exists():
            variables, about = sweep_file.read(out / SAMPLES)
            _same(out / SAMPLES, json.loads(about.get("identity", "{}")), identity)
            if all(f"all_{name}" in variables for name in Told._fields):  # a very large study keeps not all
                told = {name: variables[f"all_{name}"].data for name in Told._fields}
                self.finished = Told(**{**told, "ok": told["ok"] > 0})
        self.unfinished = Unfinished(out / PARTIAL)
        there = self.unfinished.plan()
        if there is not None:
            _same(self.unfinished.folder, there.get("identity", {}), identity)
            self.batch = int(there["batch"])
        elif self.finished is None:
            self.unfinished.begin({"identity": identity, "batch": batch})


def _same(place: Path, there: Mapping[str, Any], here: Mapping[str, Any]) -> None:
    differing = [key for key in here if there.get(key) != here[key]]
    if differing:
        raise InputError(
            f"{place}: is of another study (it differs in {', '.join(differing)}); choose another --out, or delete it"
        )


def batch_size(one: OneLoop, draws: int, targets: int, asked: int | None) -> int:
    """Draws at a time: as many as a quarter of the free memory holds, or as were asked for, evenly shared."""
    n = one.model.n
    a_loop = 8 * one.ticks * (8 * n + 24)
    most = LARGEST_BATCH if jax.default_backend() == "cpu" else 2**17
    loops = asked or int(max(1, min(most * jax.device_count(), free_bytes() / 4 // a_loop)))
    each = max(1, loops // targets)
    return -(-draws // -(-draws // each))


def simulate(
    one: OneLoop, xi: np.ndarray, courses: np.ndarray, size: int, kept: Kept | None, tell: Callable[[int, int], object]
) -> tuple[Told, int]:
    """Every draw (N) at every target (T), `size` draws at a time: results with the axes (N, T), and how many loops were
    simulated now.

    A loop whose numbers are not finite has `ok` False, and its own numbers, and leaves the others alone.
    """
    theta, stiffness = (np.array([getattr(x, k) for x in one.spec.targets]) for k in ("theta_rad", "stiffness_n_m"))
    targets, count, dtype = len(theta), len(xi), np.dtype(one.dtype)
    parts, fresh = [], 0
    for k in range(0, count, size):
        chosen = np.arange(k, min(k + size, count))
        name = f"{k // size:06d}"
        found = None if kept is None else kept.unfinished.get(name)
        if found is None:
            full = np.resize(chosen, size)  # the last batch is filled up with repeats
            cases = (
                np.repeat(xi[full], targets, axis=0).astype(dtype),
                np.repeat(courses[full], targets),
                np.tile(theta, size).astype(dtype),
                np.tile(stiffness, size).astype(dtype),
            )
            out = one.many(*cases)._asdict()
            out["theta"] = out["theta"].astype(np.float32)
            found = {key: np.asarray(x).reshape(size, targets, *x.shape[1:])[: len(chosen)] for key, x in out.items()}
            fresh += len(chosen) * targets
            if kept is not None:
                kept.unfinished.put(name, found)
        parts.append(found)
        tell((k + len(chosen)) * targets, count * targets)
    return Told(*(np.concatenate([part[name] for part in parts]) for name in Told._fields)), fresh
