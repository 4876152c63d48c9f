"""A mapping file: how to read a log that does not follow the contract. Nothing is guessed."""

from __future__ import annotations

import math
import os
import re
import tomllib
from dataclasses import dataclass, field
from typing import Any

from ljjax.errors import InputError, read_file
from ljjax.logs import units
from ljjax.logs.contract import RUN_KEYS
from ljjax.logs.path import Step, parse_path

SCHEMA = "ljjax.mapping/1"
CLOCKS = ("header", "log", "publish")
REFERENCES = ("absolute", "vacuum", "gauge")

QUANTITY = {
    "cmd_tendon_left": "force", "cmd_tendon_right": "force", "tendon_left": "force", "tendon_right": "force",
    "spool_left": "length", "spool_right": "length", "cmd_pressure": "pressure", "pressure": "pressure",
    "theta": "angle",
    "tip_x": "length", "tip_y": "length", "tip_z": "length", "tip_qx": "number", "tip_qy": "number", "tip_qz": "number",
    "tip_qw": "number", "probe_position": "length", "probe_force": "force", "temperature": "temperature",
}  # fmt: skip


def quantity_of(name: str) -> str | None:
    """What kind of quantity a mapped signal is; None for a name that is none."""
    return "angle" if re.fullmatch(r"q[1-9][0-9]*", name) else QUANTITY.get(name)


@dataclass(frozen=True)
class Source:
    """Where one signal comes from, and how its numbers become SI.

    A raw number r becomes sign · (scale · r + offset) in `unit`, and that becomes SI. Where `unit` is not one
    of the signal's own quantity (mA for a tension, deg for a spool), scale is in SI per unit and offset in
    SI.
    """

    name: str
    topic: str
    path: str
    steps: tuple[Step, ...]
    unit: str
    scale: float = 1.0
    offset: float = 0.0
    sign: int = 1
    time: str = "header"
    reference: str = ""

    @property
    def quantity(self) -> str:
        found = quantity_of(self.name)
        assert found is not None
        return found

    def si(self, raw: float) -> float:
        """The number in SI (a pressure still against its own reference)."""
        value = self.sign * (self.scale * raw + self.offset)
        factor, shift = units.UNITS[self.quantity].get(self.unit, (1.0, 0.0))
        return factor * value + shift


@dataclass(frozen=True)
class Mapping:
    """A mapping file once read: `run` metadata that the log does not hold, and a source for each signal."""

    path: str
    run: dict[str, str] = field(default_factory=dict)
    sources: dict[str, Source] = field(default_factory=dict)

    @property
    def topics(self) -> frozenset[str]:
        return frozenset(s.topic for s in self.sources.values())


def load_mapping(path: str | os.PathLike[str]) -> Mapping:
    """Read a mapping TOML. Raises InputError naming the line and the key."""
    name = os.fspath(path)
    text, table = read_file(path, tomllib.loads, "TOML", "give a mapping file, as docs/logs.md shows one")
    return _Reader(name, text).mapping(table)


class _Reader:
    def __init__(self, name: str, text: str):
        self.name, self.lines = name, text.splitlines()

    def fail(self, section: str, key: str, message: str) -> InputError:
        label = f"[{section}] {key}".strip() if section else key
        line = self.line(section, key)
        return InputError(f"{self.name}{f', line {line}' if line else ''}: {label}: {message}")

    def line(self, section: str, key: str) -> int:
        """Where a key stands, or its section where the key is missing; 0 where neither is found."""
        here, at_section = "", 0
        for number, text in enumerate(self.lines, 1):
            head = re.match(r"\s*\[\s*([^\[\]]+?)\s*\]", text)
            if head:
                here = re.sub(r"[\s\"']", "", head[1])
                at_section = number if here == section else at_section
            elif here == section and key and re.match(rf"\s*[\"']?{re.escape(key)}[\"']?\s*[=.]", text):
                return number
        return at_section

    def mapping(self, table: dict[str, Any]) -> Mapping:
        self.only("", table, ("schema", "run", "signals"))
        if table.get("schema") != SCHEMA:
            raise self.fail("", "schema", f"is {table.get('schema')!r}, expected {SCHEMA!r}")
        run = self.table("", "run", table.get("run", {}))
        signals = self.table("", "signals", table.get("signals", {}))
        if not signals and not run:
            raise self.fail("", "signals", "is empty; expected at least one, such as [signals.theta], or a [run] table")
        sources = {name: self.source(name, self.table("signals", name, entry)) for name, entry in signals.items()}
        self.whole(sources)
        return Mapping(self.name, self.run(run), sources)

    def table(self, section: str, key: str, value: Any) -> dict[str, Any]:
        if not isinstance(value, dict):
            raise self.fail(section, key, f"is {value!r}, expected a table")
        return value

    def only(self, section: str, table: dict[str, Any], allowed: tuple[str, ...]) -> None:
        for key in table:
            if key not in allowed:
                raise self.fail(section, key, f"unknown key; expected {', '.join(allowed)}")

    def run(self, table: dict[str, Any]) -> dict[str, str]:
        self.only("run", table, RUN_KEYS[1:])
        for key, value in table.items():
            if isinstance(value, bool) or not isinstance(value, str | int | float):
                raise self.fail("run", key, f"is {value!r}, expected a string or a number")
        if "p_atm_pa" in table:
            try:
                plausible = 2e4 < float(table["p_atm_pa"]) < 1.2e5
            except ValueError:
                plausible = False
            if not plausible:
                raise self.fail(
                    "run", "p_atm_pa", f"is {table['p_atm_pa']!r}, expected a pressure in Pa such as 101325"
                )
        return {key: str(value) for key, value in table.items()}

    def source(self, name: str, table: dict[str, Any]) -> Source:
        section = f"signals.{name}"
        quantity = quantity_of(name)
        if quantity is None:
            raise self.fail(section, "", f"unknown signal; expected {', '.join(QUANTITY)} or q1 … qn")
        keys = ("topic", "path", "unit", "scale", "offset", "sign", "time", "reference")
        self.only(section, table, keys)
        topic, path, unit = (self.text(section, table, key) for key in ("topic", "path", "unit"))
        own = units.UNITS[quantity]
        if unit not in units.known():
            raise self.fail(section, "unit", f"unknown unit {unit!r}; expected one of {', '.join(units.known())}")
        scale, offset, sign = (
            self.number(section, table, key, d) for key, d in (("scale", 1.0), ("offset", 0.0), ("sign", 1.0))
        )
        if unit not in own and "scale" not in table:
            raise self.fail(
                section,
                "scale",
                f"is missing; {unit} is no unit of {quantity}, so say how many {units.SI[quantity]} one {unit} is",
            )
        if scale == 0:
            raise self.fail(section, "scale", "is 0, which would erase the signal")
        if sign not in (1, -1):
            raise self.fail(section, "sign", f"is {sign:g}, expected 1 or -1 (a factor goes into scale)")
        time = table.get("time", "header")
        if time not in CLOCKS:
            raise self.fail(section, "time", f"is {time!r}, expected {', '.join(CLOCKS)}")
        reference = table.get("reference", "")
        if quantity == "pressure" and reference not in REFERENCES:
            found = "is missing" if "reference" not in table else f"is {reference!r}"
            raise self.fail(
                section,
                "reference",
                f"{found}; for a pressure say {', '.join(REFERENCES)}; it is not guessed",
            )
        if quantity != "pressure" and reference:
            raise self.fail(section, "reference", "only a pressure has one")
        try:
            steps = parse_path(path)
        except ValueError as error:
            raise self.fail(section, "path", str(error)) from None
        return Source(name, topic, path, steps, unit, scale, offset, int(sign), time, reference)

    def text(self, section: str, table: dict[str, Any], key: str) -> str:
        value = table.get(key)
        if value is None:
            raise self.fail(section, key, "is missing; it is not guessed")
        if not isinstance(value, str) or not value:
            raise self.fail(section, key, f"is {value!r}, expected a string")
        return value

    def number(self, section: str, table: dict[str, Any], key: str, default: float) -> float:
        value = table.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise self.fail(section, key, f"is {value!r}, expected a number")
        return float(value)

    def whole(self, sources: dict[str, Source]) -> None:
        """Signals of several columns must have all of them."""
        for group in (
            ("cmd_tendon_left", "cmd_tendon_right"),
            ("tendon_left", "tendon_right"),
            ("spool_left", "spool_right"),
            ("probe_position", "probe_force"),
            ("tip_x", "tip_y", "tip_z"),
            ("tip_qx", "tip_qy", "tip_qz", "tip_qw"),
        ):
            given = [name for name in group if name in sources]
            if given and len(given) < len(group):
                missing = ", ".join(name for name in group if name not in sources)
                raise self.fail(f"signals.{given[0]}", "", f"goes together with {missing}, which is missing")
        if "tip_qx" in sources and "tip_x" not in sources:
            raise self.fail("signals.tip_qx", "", "goes together with tip_x, tip_y, tip_z, which are missing")
        segments = sorted(int(name[1:]) for name in sources if re.fullmatch(r"q[0-9]+", name))
        if segments != list(range(1, len(segments) + 1)):
            raise self.fail(f"signals.q{segments[-1]}", "", "expected q1 … qn without a gap")
        if segments and "theta" in sources:
            raise self.fail("signals.theta", "", "give theta or q1 … qn, not both")
