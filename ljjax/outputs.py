"""Artefacts appear whole or not at all: they are made in a folder beside the target and moved in at the end."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from ljjax.errors import InputError


@contextmanager
def artefacts(out: str | os.PathLike[str], keep: Sequence[str | os.PathLike[str]] = ()) -> Iterator[Path]:
    """A folder to write into; on a clean exit its files replace those of the same name in `out`, else it vanishes.

    Args:
        out: the folder; made where there is none.
        keep: files never to replace, such as the logs that the artefacts are made from.

    Raises:
        InputError: `out` is a file, cannot be made or written, or holds a file of `keep` under an artefact's name.
    """
    target = Path(out)
    if target.exists() and not target.is_dir():
        raise InputError(f"{target}: is a file; --out names a folder")
    parents = [p for p in (target, *target.parents) if p.exists()]
    try:
        made = Path(tempfile.mkdtemp(prefix=".ljjax-", dir=parents[0]))
    except OSError as error:
        raise InputError(f"{target}: cannot be written ({error.strerror}); choose another --out") from None
    try:
        yield made
        kept = {os.path.realpath(path) for path in keep}
        files = sorted(made.iterdir())
        for path in files:
            there = target / path.name
            if there.is_dir():
                raise InputError(f"{there}: is a folder where a file is to go; move it, or choose another --out")
            if os.path.realpath(there) in kept:
                raise InputError(f"{there}: is an input and would be replaced; choose another --out")
        try:
            target.mkdir(parents=True, exist_ok=True)
            for path in files:
                os.replace(path, target / path.name)
        except OSError as error:
            raise InputError(f"{target}: cannot be written ({error.strerror}); choose another --out") from None
    finally:
        shutil.rmtree(made, ignore_errors=True)
