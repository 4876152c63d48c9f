"""One table of rig.toml, taken key by key: a wrong key is refused in a line that names it and what is expected."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from ljjax.errors import InputError

MISSING: Any = object()


class Keys:
    """Takes keys of a table; `done` refuses what nobody took.

    Raises:
        InputError: from every method, naming the key.
    """

    def __init__(self, name: str, table: Mapping[str, Any]):
        if not isinstance(table, Mapping):
            raise InputError(f"rig.toml: {name} is {table!r}; expected a table [{name}]")
        self._name, self._left = name, dict(table)

    def _take(self, key: str, default: Any, expected: str) -> Any:
        if key not in self._left and default is MISSING:
            raise InputError(f"rig.toml: missing key {self._name}.{key}; expected {expected}")
        return self._left.pop(key, default)

    def _refuse(self, key: str, value: Any, expected: str) -> InputError:
        return InputError(f"rig.toml: {self._name}.{key} is {value!r}; expected {expected}")

    def number(
        self, key: str, default: Any = MISSING, unit: str = "1", low: float = -math.inf, high: float = math.inf
    ) -> float:
        """A finite number within [low, high]."""
        expected = f"a number [{unit}]" + (f" from {low:g}" if low > -math.inf else "")
        expected += f" up to {high:g}" if high < math.inf else ""
        value = self._take(key, default, expected)
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise self._refuse(key, value, expected)
        if not low <= value <= high:
            raise self._refuse(key, value, expected)
        return float(value)

    def whole(self, key: str, default: Any = MISSING, low: int = 0, high: int = 2**31) -> int:
        """A whole number within [low, high]."""
        expected = f"a whole number from {low} to {high}"
        value = self._take(key, default, expected)
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise self._refuse(key, value, expected)
        return value

    def text(self, key: str, default: Any = MISSING, expected: str = "a text") -> str:
        """A text that is not empty."""
        value = self._take(key, default, expected)
        if not isinstance(value, str) or not value:
            raise self._refuse(key, value, expected)
        return value

    def pair(
        self, key: str, default: Any = MISSING, whole: bool = False, low: float = -math.inf, high: float = math.inf
    ) -> tuple[Any, Any]:
        """Two numbers within [low, high], of the left tendon and the right."""
        expected = f"two {'whole ' if whole else ''}numbers, [left, right]"
        value = self._take(key, default, expected)
        kinds = int if whole else (int, float)
        if not isinstance(value, list | tuple) or len(value) != 2:
            raise self._refuse(key, value, expected)
        if any(isinstance(x, bool) or not isinstance(x, kinds) or not low <= x <= high for x in value):
            raise self._refuse(key, value, expected)
        return value[0], value[1]

    def calibrated(self, key: str) -> tuple[int, float, float]:
        """A channel, its scale, which is not 0, and its offset."""
        expected = "[channel, scale, offset], the scale not 0"
        value = self._take(key, MISSING, expected)
        numbers = isinstance(value, list | tuple) and len(value) == 3
        if not numbers or any(isinstance(x, bool) or not isinstance(x, int | float) for x in value):
            raise self._refuse(key, value, expected)
        channel, scale, offset = value
        if channel != int(channel) or channel < 0 or scale == 0 or not math.isfinite(scale + offset):
            raise self._refuse(key, value, expected)
        return int(channel), float(scale), float(offset)

    def done(self) -> None:
        """Refuse what is left."""
        if self._left:
            raise InputError(f"rig.toml: unknown key {self._name}.{next(iter(self._left))}; take it out")
