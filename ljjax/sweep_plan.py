"""Which parameter sets a sweep goes through: a grid, columns side by side, or samples of ranges."""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from ljjax.errors import InputError
from ljjax.model import UNITS

How = Literal["grid", "zip", "samples"]
LARGEST = 10_000_000
"""Parameter sets that one sweep may have."""


@dataclass(frozen=True, eq=False)
class Plan:
    """The parameter sets of a sweep.

    Attributes:
        how: `"grid"`, `"zip"` or `"samples"`.
        values: for a grid, the values of each path's own axis, ascending; else (S,) a column a path.
        columns: path → (S,) the value in each parameter set, the last path of a grid running fastest.
        dims, shape: the dimensions of the sets: one a path for a grid, `set` otherwise, none where nothing is varied.
    """

    how: How
    values: Mapping[str, np.ndarray]
    columns: Mapping[str, np.ndarray]
    dims: tuple[str, ...]
    shape: tuple[int, ...]

    @property
    def count(self) -> int:
        return math.prod(self.shape)


def unit(path: str) -> str:
    """The unit of what can be varied. Raises InputError for a path that is none; angles q₁ … are checked elsewhere."""
    if path == "initial.theta" or (path.startswith("initial.q") and path[9:].isdigit()):
        return "rad"
    if path not in UNITS:
        raise InputError(
            f"vary: no parameter {path!r}; expected initial.theta, initial.q1 … or one of {', '.join(UNITS)}"
        )
    return UNITS[path]


def plan(vary: Mapping[str, Any], how: How = "grid", samples: int | None = None, seed: int = 0) -> Plan:
    """The parameter sets that `vary` means.

    Args:
        vary: path → values; for samples path → (low, high) or (low, high, "log").
        how: `"grid"`, every value with every other, each axis ascending and without repeats; `"zip"`, the first values
            of all, the second values of all, …; `"samples"`, a Latin hypercube: each range, or its logarithm, is cut
            into `samples` equal slices, and each slice is met once.
        samples: how many samples.
        seed: of the samples.

    Raises:
        InputError: naming the path, what was found and what is expected.
    """
    if how not in get_args(How):
        raise InputError(f"how is {how!r}; expected grid, zip or samples")
    for path in vary:
        unit(path)
    if how != "samples" and samples is not None:
        raise InputError(f"samples is {samples} with how = {how!r}; expected how = 'samples'")
    if how == "samples":
        return _samples(vary, samples, seed)
    values = {path: _numbers(path, x) for path, x in vary.items()}
    if how == "zip":
        lengths = {path: len(x) for path, x in values.items()}
        if len(set(lengths.values())) > 1:
            raise InputError(
                "vary: the columns are to be of one length, and are "
                + ", ".join(f"{path}: {k}" for path, k in lengths.items())
                + "; for all combinations take how = 'grid'"
            )
        return Plan(how, values, values, ("set",) if values else (), tuple(lengths.values())[:1])
    values = {path: np.unique(x) for path, x in values.items()}
    shape = tuple(len(x) for x in values.values())
    _countable(math.prod(shape))
    mesh = np.meshgrid(*values.values(), indexing="ij")
    columns = {path: x.ravel() for path, x in zip(values, mesh, strict=True)}
    return Plan(how, values, columns, tuple(values), shape)


def _samples(vary: Mapping[str, Any], samples: int | None, seed: int) -> Plan:
    if not vary:
        raise InputError("how = 'samples' with nothing to vary; name parameters with their ranges (low, high)")
    if not isinstance(samples, int) or samples < 1:
        raise InputError(f"samples is {samples!r}; expected how many, such as 1000")
    _countable(samples)
    rng = np.random.default_rng(seed)
    columns = {}
    for path, given in vary.items():
        given = tuple(given) if isinstance(given, Sequence) and not isinstance(given, str) else (given,)
        log = given[-1] == "log"
        bounds = _numbers(path, given[:2])
        if len(given) != 2 + log or not bounds[0] < bounds[1] or not np.isfinite(bounds).all():
            raise InputError(f"vary: {path} is {given}; expected a range (low, high) with low < high to sample from")
        if log and bounds[0] <= 0:
            raise InputError(f"vary: {path} starts at {bounds[0]:g}; a logarithmic range expects low > 0")
        low, high = np.log(bounds) if log else bounds
        x = low + (high - low) * (rng.permutation(samples) + rng.random(samples)) / samples
        columns[path] = np.exp(x) if log else x
    return Plan("samples", columns, columns, ("set",), (samples,))


def _numbers(path: str, values: Any) -> np.ndarray:
    try:
        x = np.atleast_1d(np.asarray(values, dtype=float))
    except (TypeError, ValueError):
        raise InputError(f"vary: {path} is {values!r}; expected numbers [{unit(path)}]") from None
    if x.ndim != 1 or not len(x):
        raise InputError(f"vary: {path} has shape {x.shape}; expected a row of numbers [{unit(path)}]")
    return x


def _countable(count: int) -> None:
    if count > LARGEST:
        raise InputError(f"vary: {count:,} parameter sets; expected at most {LARGEST:,}: take samples, or fewer values")


def parse(text: str, how: How) -> tuple[str, Any]:
    """(path, values) from `PATH=LOW:HIGH:COUNT`, `PATH=LOW:HIGH:COUNT:log`, `PATH=A,B,C`; for samples from
    `PATH=LOW:HIGH` or `PATH=LOW:HIGH:log`. Raises InputError."""
    form = "PATH=LOW:HIGH or PATH=LOW:HIGH:log" if how == "samples" else "PATH=LOW:HIGH:COUNT or PATH=A,B,C"
    example = "friction.mu_s=0.003:0.008" + ("" if how == "samples" else ":50")
    wrong = InputError(f"--vary {text}: expected {form}, such as {example}")
    path, equals, rest = text.partition("=")
    path = path.strip()
    if not equals or not path:
        raise wrong
    unit(path)
    parts = rest.split(":")
    log = parts[-1].strip() == "log"
    parts = parts[:-1] if log else parts
    try:
        if how == "samples":
            low, high = (float(x) for x in parts)
            return path, (low, high, "log") if log else (low, high)
        if len(parts) == 1 and not log:
            return path, [float(x) for x in rest.split(",")]
        low, high, count = float(parts[0]), float(parts[1]), int(parts[2])
        if len(parts) != 3 or not 1 <= count <= LARGEST or not np.isfinite([low, high]).all():
            raise wrong
    except (ValueError, IndexError):
        raise wrong from None
    if log and not (low > 0 and high > 0):
        raise InputError(f"--vary {text}: a logarithmic range expects LOW and HIGH > 0")
    return path, np.geomspace(low, high, count) if log else np.linspace(low, high, count)


def read_columns(file: str | os.PathLike[str]) -> dict[str, np.ndarray]:
    """Columns of a CSV file with paths in its first line, for `how="zip"`. Raises InputError naming file and line."""
    try:
        with Path(file).open(newline="", encoding="utf-8-sig") as stream:
            rows = [(i, row) for i, row in enumerate(csv.reader(stream), 1) if any(cell.strip() for cell in row)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise InputError(f"{file}: cannot be read as CSV ({why}); expected paths in the first line") from None
    if len(rows) < 2:
        raise InputError(
            f"{file}: {len(rows)} lines; expected paths in the first line and a parameter set in each other"
        )
    heads = [cell.strip() for cell in rows[0][1]]
    for k, path in enumerate(heads):
        try:
            unit(path)
        except InputError as error:
            raise InputError(f"{file}, line 1, column {k + 1}: {error}") from None
        if path in heads[:k]:
            raise InputError(f"{file}, line 1: {path} stands there twice; expected each path once")
    table = np.empty((len(rows) - 1, len(heads)))
    for row, (line, cells) in zip(table, rows[1:], strict=True):
        if len(cells) != len(heads):
            raise InputError(f"{file}, line {line}: {len(cells)} values; expected {len(heads)}, one a path")
        for k, cell in enumerate(cells):
            try:
                row[k] = float(cell)
            except ValueError:
                raise InputError(f"{file}, line {line}: {heads[k]} is {cell!r}; expected a number") from None
    return {path: table[:, k] for k, path in enumerate(heads)}
