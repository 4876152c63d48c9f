"""The arithmetic a law is made of, on Python floats. JAX and the writer of C bring the same names.

Only what C99 has, too: no branch, no loop over data. `smaller(a, b)` is b where b < a, as in Python and in
`b < a ? b : a`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

sin = math.sin
exp = math.exp
sqrt = math.sqrt
power = math.pow
floor = math.floor
absolute = abs
smaller = min
larger = max


def where(condition: bool, yes: float, no: float) -> float:
    return yes if condition else no


def take(table: Sequence[float], index: float) -> float:
    """The entry at a whole number."""
    return table[int(index)]
