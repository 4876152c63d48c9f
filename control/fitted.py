"""What a fit says of its parameters' errors: standard deviations and correlations out of `fit.json`."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import NamedTuple

from ljjax.errors import InputError, read_file

FILE = "fit.json"


class Fitted(NamedTuple):
    """Standard deviations by path, in the parameters' units, and correlations by pair of paths."""

    sd: dict[str, float]
    correlation: dict[tuple[str, str], float]


def read(path: str | os.PathLike[str]) -> Fitted:
    """From a fit.json or the folder of one. What the fit does not know (null) is left out.

    Raises:
        InputError: no such file, or one that is of no single robot's fit.
    """
    place = Path(path) / FILE if Path(path).is_dir() else Path(path)
    _, data = read_file(place, json.loads, "JSON", "give the fit.json of ljjax fit, or its folder")
    if not isinstance(data, dict) or data.get("schema") != "ljjax.fit/1" or "parameters" not in data:
        raise InputError(f'{place}: is no fit of one robot; expected schema = "ljjax.fit/1" with parameters')
    try:
        sd = {k: float(about["sd"]) for k, about in data["parameters"].items() if about.get("sd") is not None}
        known = data.get("correlation") or {"names": [], "matrix": []}
        pairs = {
            (one, other): float(r)
            for i, one in enumerate(known["names"])
            for other, r in zip(known["names"][:i], known["matrix"][i], strict=False)
            if r is not None
        }
    except (KeyError, TypeError, ValueError, AttributeError, IndexError):
        raise InputError(f"{place}: parameters or correlation are not as ljjax fit writes them; fit again") from None
    if not all(math.isfinite(x) and x >= 0 for x in sd.values()) or not all(abs(r) <= 1 + 1e-9 for r in pairs.values()):
        raise InputError(f"{place}: standard deviations must be ≥ 0 and correlations within ±1; fit again")
    return Fitted(sd, pairs)
