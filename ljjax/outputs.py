"""Artefacts appear whole or not at all: they are made in a folder beside the target and moved in at the end."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ljjax.errors import InputError


@contextmanager
def artefacts(out: str | os.PathLike[str]) -> Iterator[Path]:
    """A folder to write into; on a clean exit its files replace those of the same name in `out`, else it vanishes.

    Raises:
        InputError: `out` is a file, or cannot be made or written.
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
        target.mkdir(parents=True, exist_ok=True)
        for path in sorted(made.iterdir()):
            os.replace(path, target / path.name)
    finally:
        shutil.rmtree(made, ignore_errors=True)
