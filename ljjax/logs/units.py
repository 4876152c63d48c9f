"""Units that a mapping may name, and what one of them is in SI."""

from __future__ import annotations

import math

# quantity → unit → (factor, offset): SI = factor · value + offset
UNITS: dict[str, dict[str, tuple[float, float]]] = {
    "angle": {"rad": (1.0, 0.0), "deg": (math.pi / 180, 0.0), "mrad": (1e-3, 0.0)},
    "force": {"N": (1.0, 0.0), "mN": (1e-3, 0.0), "kgf": (9.80665, 0.0), "gf": (9.80665e-3, 0.0)},
    "pressure": {
        "Pa": (1.0, 0.0),
        "hPa": (1e2, 0.0),
        "kPa": (1e3, 0.0),
        "mbar": (1e2, 0.0),
        "bar": (1e5, 0.0),
        "psi": (6894.757293168361, 0.0),
        "mmHg": (133.322387415, 0.0),
    },
    "length": {"m": (1.0, 0.0), "cm": (1e-2, 0.0), "mm": (1e-3, 0.0)},
    "temperature": {"degC": (1.0, 0.0), "K": (1.0, -273.15)},
    "number": {"1": (1.0, 0.0)},
}
RAW = (
    "mA",
    "A",
    "mV",
    "V",
    "counts",
    "ticks",
    "rev",
    "%",
)  # what sensors and drives count in; a scale makes them SI
SI = {"angle": "rad", "force": "N", "pressure": "Pa", "length": "m", "temperature": "degC", "number": "1"}


def known() -> tuple[str, ...]:
    """Every unit that may be named."""
    return tuple(dict.fromkeys([unit for table in UNITS.values() for unit in table] + list(RAW)))
