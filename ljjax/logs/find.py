"""Which logs a user means: a file, a folder, a glob."""

from __future__ import annotations

import glob
import os
from collections.abc import Sequence
from pathlib import Path

from ljjax.errors import InputError
from ljjax.logs import contract, records


def find(args: Sequence[str | os.PathLike[str]] | str | os.PathLike[str]) -> list[Path]:
    """Files named by `args`, each once, in the order of the arguments (sorted within a folder or a glob).

    A folder is searched, all the way down, for `*.mcap`; results of ljjax in it (`result.mcap`) are passed
    over, so that a fit whose results lie beside the logs can be run again. Raises InputError where an
    argument names nothing.
    """
    if isinstance(args, str | os.PathLike):
        args = [args]
    if not args:
        raise InputError("no log given; expected files, folders or globs of *.mcap")
    found: dict[str, Path] = {}
    for arg in args:
        for path in _one(os.fspath(arg)):
            found.setdefault(os.path.realpath(path), path)
    return list(found.values())


def _one(arg: str) -> list[Path]:
    path = Path(arg)
    if path.is_dir():
        return _folder(path)
    if path.exists():
        return [path]
    if not glob.has_magic(arg):
        raise InputError(f"{arg}: no such file or folder; expected an MCAP file, a folder of them, or a glob")
    hits = [Path(hit) for hit in sorted(glob.glob(arg, recursive=True))]
    files = [f for hit in hits for f in (_logs_in(hit) if hit.is_dir() else [hit] if not is_result(hit) else [])]
    if not files:
        raise InputError(f"{arg}: matches no log; check the folder and the pattern")
    return files


def _folder(path: Path) -> list[Path]:
    files = _logs_in(path)
    if not files:
        raise InputError(f"{path}: has no *.mcap in it; expected a folder of logs")
    return files


def _logs_in(path: Path) -> list[Path]:
    return [f for f in sorted(path.rglob("*.mcap")) if f.is_file() and not is_result(f)]


def is_result(path: Path) -> bool:
    """Whether a file is an overlay that ljjax wrote, by the library named in its first record."""
    try:
        with path.open("rb") as stream:
            start = stream.read(256)
    except OSError:
        return False
    if not start.startswith(records.MAGIC + bytes([records.HEADER])):
        return False
    length = int.from_bytes(start[9:17], "little")
    try:
        return records.header(start[17 : 17 + length])[1].startswith(contract.RESULT_LIBRARY)
    except records.Malformed:
        return False
