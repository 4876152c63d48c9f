"""Entries of a TOML file, checked: a refusal names the file, the key, what was found and what is expected."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from ljjax.errors import InputError


def table(where: str, key: str, value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise InputError(f"{where}: {key} is {value!r}; expected a table")
    return value


def only(where: str, name: str, entries: Mapping[str, Any], known: Any) -> None:
    """Refuse keys that are not known, of the table `name` (empty for the file's own)."""
    for key in entries:
        if key not in known:
            full = f"{name}.{key}" if name else key
            raise InputError(f"{where}: unknown key {full}; expected {', '.join(known)}")


def number(where: str, key: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < math.inf:
        raise InputError(f"{where}: {key} is {value!r}; expected a finite number")
    return float(value)


def pair(where: str, key: str, value: Any, first: str, second: str) -> tuple[float, float]:
    if not isinstance(value, list) or len(value) != 2:
        raise InputError(f"{where}: {key} is {value!r}; expected [{first}, {second}]")
    return number(where, key, value[0]), number(where, key, value[1])
