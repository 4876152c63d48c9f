"""A sweep on disk: one NetCDF-3 file, and beside it, while the sweep runs, a folder with the batches that are done."""

from __future__ import annotations

import json
import os
import shutil
import warnings
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ljjax.errors import InputError

PathLike = str | os.PathLike[str]
LARGEST = 2**31 - 8
"""Bytes that one variable may have in the file."""


class Variable(NamedTuple):
    """An array with the names of its dimensions and what is known about it (units, long_name, …)."""

    dims: tuple[str, ...]
    data: np.ndarray
    attributes: Mapping[str, Any] = {}


def write(path: PathLike, variables: Mapping[str, Variable], attributes: Mapping[str, Any]) -> None:
    """Write a NetCDF-3 file (64-bit offsets). Texts become characters along a dimension of their own, in UTF-8, as
    xarray does it."""
    from scipy.io import netcdf_file

    with Path(path).open("wb") as stream:
        file = netcdf_file(stream, "w", version=2)
        for name, value in attributes.items():
            setattr(file, name, _attribute(value))
        for name, variable in variables.items():
            _add(file, name, *variable)
        file.flush()
        stream.flush()
        os.fsync(stream.fileno())


def _add(file: Any, name: str, dims: tuple[str, ...], data: np.ndarray, about: Mapping[str, Any]) -> None:
    about = dict(about)
    if data.dtype.kind == "U":
        encoded = np.char.encode(data, "utf-8")
        size = max(1, encoded.dtype.itemsize)
        data = np.ascontiguousarray(encoded.astype(f"S{size}"))[..., None].view("S1")
        dims, about["_Encoding"] = (*dims, f"string{size}"), "utf-8"
    for dim, size in zip(dims, data.shape, strict=True):
        if dim not in file.dimensions:
            file.createDimension(dim, size)
    variable = file.createVariable(name, "c" if data.dtype.kind == "S" else data.dtype, dims)
    variable[...] = data
    for key, value in about.items():
        setattr(variable, key, _attribute(value))


def _attribute(value: Any) -> Any:
    if isinstance(value, int) and not -(2**31) <= value < 2**31:
        value = str(value)
    if isinstance(value, str):
        return value.encode()
    return np.asarray(value, np.int32 if isinstance(value, int) else None)


def read(path: PathLike) -> tuple[dict[str, Variable], dict[str, Any]]:
    """Variables and global attributes of a file that `write` wrote. Raises InputError where it is no NetCDF-3 file."""
    from scipy.io import netcdf_file

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            file = netcdf_file(os.fspath(path), "r", mmap=False)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); expected a sweep's .nc file") from None
    except Exception:  # whatever scipy stumbles over in a file that is none
        raise InputError(f"{path}: is no NetCDF-3 file; expected a sweep's .nc file") from None
    variables = {}
    for name, variable in file.variables.items():
        about = {key: _plain(value) for key, value in variable._attributes.items()}
        data, dims = np.array(variable.data), variable.dimensions
        if about.pop("_Encoding", None) == "utf-8":
            data = np.char.decode(np.ascontiguousarray(data).view(f"S{data.shape[-1]}")[..., 0], "utf-8")
            dims = dims[:-1]
        elif data.dtype.byteorder == ">":
            data = data.astype(data.dtype.newbyteorder("="))
        variables[name] = Variable(tuple(dims), data, about)
    attributes = {key: _plain(value) for key, value in file._attributes.items()}
    file.close()
    return variables, attributes


def _plain(value: Any) -> Any:
    if isinstance(value, bytes):
        return value.decode()
    value = np.asarray(value)
    return value.item() if value.ndim == 0 or value.size == 1 else value.astype(value.dtype.newbyteorder("="))


class Unfinished:
    """The folder of a sweep that is not done: its plan, and each batch as a file of its own.

    A file appears whole or not at all, and one that cannot be read counts as not there, so that a sweep killed at any
    moment goes on where it was.
    """

    def __init__(self, folder: PathLike):
        self.folder = Path(folder)

    def plan(self) -> dict[str, Any] | None:
        """What was begun here, or None."""
        try:
            return json.loads((self.folder / "plan.json").read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None

    def begin(self, plan: Mapping[str, Any]) -> None:
        """Make the folder. Raises InputError where that cannot be."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._put("plan.json", lambda stream: stream.write(json.dumps(plan, indent=1).encode()))
        except OSError as error:
            raise InputError(f"{self.folder}: cannot be written ({error.strerror}); choose another place") from None

    def get(self, name: str) -> dict[str, np.ndarray] | None:
        """A batch that is done, or None."""
        try:
            with (self.folder / f"{name}.npz").open("rb") as stream, np.load(stream) as file:
                return dict(file)
        except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile):
            return None

    def put(self, name: str, batch: Mapping[str, np.ndarray]) -> None:
        """Keep a batch. Raises InputError where the disk is full."""
        try:
            self._put(f"{name}.npz", lambda stream: np.savez(stream, allow_pickle=False, **batch))
        except OSError as error:
            raise InputError(
                f"{self.folder}: cannot be written ({error.strerror}); make room, and run the same sweep again to go on"
            ) from None

    def _put(self, name: str, fill: Any) -> None:
        fresh = self.folder / f".{name}.{os.getpid()}"
        with fresh.open("wb") as stream:
            fill(stream)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(fresh, self.folder / name)

    def remove(self) -> None:
        shutil.rmtree(self.folder, ignore_errors=True)
