"""A designed law as files: `law.json`, which proves itself on load, and the C99 header that goes with it."""

from __future__ import annotations

import hashlib
import os
from importlib.metadata import version
from pathlib import Path
from typing import Any

from ljjax.control.c99 import header
from ljjax.control.synthesis import Design
from ljjax.errors import InputError
from ljjax.law.file import content, dumps, parse

PathLike = str | os.PathLike[str]


def provenance(model_path: PathLike | None) -> dict[str, Any]:
    """Where a law comes from: the model's file and its sha256 (None: a model from nowhere but memory), the version.

    Raises:
        InputError: a file that cannot be read.
    """
    said: dict[str, Any] = {"software": f"ljjax {version('ljjax')}"}
    if model_path is not None:
        path = Path(model_path)
        try:
            text = path.read_bytes()
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror}); give the model's file, or none") from None
        said |= {"model": path.name, "model_sha256": hashlib.sha256(text).hexdigest()}
    return said


def texts(made: Design, model_path: PathLike | None = None) -> tuple[str, str]:
    """`law.json` and the header, as text; the former has been read back and checked."""
    data = content(made.law, provenance(model_path), made.reach)
    law = parse(data, "law")
    said = data["provenance"]
    about = {"software": said["software"], "model": f"{said.get('model', '-')} {said.get('model_sha256', '')}".strip()}
    return dumps(data), header(law, data["sha256"], about)


def export(
    made: Design, out: PathLike, *, header_out: PathLike | None = None, model_path: PathLike | None = None
) -> None:
    """Write `law.json`, and the C99 header where asked for. Both are written beside their places first and moved there
    at the end, so that none is half-written, or new without the other.

    Raises:
        InputError: a place that cannot be written, or that holds the model; a model's file that cannot be read.
    """
    wanted = [Path(out), *([] if header_out is None else [Path(header_out)])]
    if len({place.resolve() for place in wanted}) < len(wanted):
        raise InputError(f"{header_out}: the law and its header go to the same file; give two names")
    for place in wanted:
        if place.is_dir() or not place.absolute().parent.is_dir():
            raise InputError(f"{place}: expected a file name in a folder that exists, such as law.json")
        if model_path is not None and place.resolve() == Path(model_path).resolve():
            raise InputError(f"{place}: is the model itself and would be replaced; give another name")
    written = list(zip(wanted, texts(made, model_path), strict=False))
    made_beside: list[Path] = []
    place = wanted[0]
    try:
        for place, text in written:
            made_beside.append(place.with_name(f".{place.name}.{os.getpid()}"))
            made_beside[-1].write_text(text, encoding="utf-8")
        for beside, (place, _) in zip(made_beside, written, strict=True):
            os.replace(beside, place)
    except OSError as error:
        raise InputError(f"{place}: cannot be written ({error.strerror}); choose another name") from None
    finally:
        for beside in made_beside:
            beside.unlink(missing_ok=True)
