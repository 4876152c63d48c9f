"""What ljjax raises for input it cannot use: one line that names the place and the mend; and files read that way."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any


class InputError(ValueError):
    """Bad input or usage. The message is one line: the file, the place, what was found, and the mend.

    The command line prints it on stderr and exits with 2.
    """

    def __init__(self, message: str):
        super().__init__(" ".join(str(message).split()))


class SolverError(RuntimeError):
    """A simulation that did not reach its end. The message is one line: the place, what happened, and what to try.

    The command line prints it on stderr and exits with 1.
    """


def read_file(path: str | os.PathLike[str], parse: Callable[[str], Any], kind: str, mend: str) -> tuple[str, Any]:
    """A file's text, and what `parse` (such as `tomllib.loads`) makes of it.

    Raises:
        InputError: no such file, one that cannot be read, or one that is not of the `kind`; ends with the `mend`.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
        return text, parse(text)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; {mend}") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}); {mend}") from None
    except (ValueError, RecursionError) as error:  # also no UTF-8, or more digits than Python reads
        raise InputError(f"{path}: not {kind} ({error}); {mend}") from None
