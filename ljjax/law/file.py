"""`law.json` (schema ljjax.law/1): a law as one readable file that proves itself when it is loaded."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Mapping
from typing import Any

from ljjax.errors import InputError, read_file
from ljjax.law.golden import COLUMNS, Golden, mismatch, record
from ljjax.law.parts import KINDS, STATE_UNITS, UNITS, Gains, Law, Limits, Robot, State, Tables

SCHEMA = "ljjax.law/1"
GROUPS: Mapping[str, type] = {"gains": Gains, "robot": Robot, "limits": Limits, "tables": Tables}
_KEYS = ("schema", "law", "about", "rate_hz", "period_s", *GROUPS, "reach", "units", "provenance", "golden", "sha256")
PathLike = str | os.PathLike[str]


def content(law: Law, provenance: Mapping[str, Any], reach: Mapping[str, Any]) -> dict[str, Any]:
    """What `law.json` holds: the law, what it can reach, where it comes from, golden vectors, and its own sha256."""
    golden = record(law)
    data: dict[str, Any] = {
        "schema": SCHEMA,
        "law": law.kind,
        "about": KINDS[law.kind],
        "rate_hz": 1.0 / law.period_s,
        "period_s": law.period_s,
        **{name: {k: _plain(v) for k, v in getattr(law, name)._asdict().items()} for name in GROUPS},
        "reach": dict(reach),
        "units": {**UNITS, **{f"state.{name}": unit for name, unit in STATE_UNITS.items()}},
        "provenance": dict(provenance),
        "golden": {
            "columns": list(COLUMNS),
            "initial": golden.initial._asdict(),
            "rows": [list(row) for row in golden.rows],
        },
    }
    return {**data, "sha256": sha256(data)}


def sha256(data: Mapping[str, Any]) -> str:
    """Of everything in the file but this sum itself; not of spaces, line ends and the order of keys."""
    rest = {key: value for key, value in data.items() if key != "sha256"}
    text = json.dumps(rest, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    return hashlib.sha256(text.encode("ascii")).hexdigest()


def dumps(data: Mapping[str, Any]) -> str:
    """The file's text: a number, a table or a tick a line."""
    return _text(data, "") + "\n"


def _text(value: Any, indent: str) -> str:
    inner = indent + "  "
    if isinstance(value, Mapping):
        rows = [f"{inner}{json.dumps(key, ensure_ascii=False)}: {_text(x, inner)}" for key, x in value.items()]
        return "{\n" + ",\n".join(rows) + f"\n{indent}}}"
    if isinstance(value, list) and value and isinstance(value[0], list):
        return "[\n" + ",\n".join(inner + json.dumps(row, allow_nan=False) for row in value) + f"\n{indent}]"
    return json.dumps(value, ensure_ascii=False, allow_nan=False)


def _plain(value: Any) -> Any:
    return [float(x) for x in value] if hasattr(value, "__len__") else float(value)


def load(path: PathLike) -> Law:
    """The law of a law.json, after its sha256 and its golden vectors have been checked on this machine.

    Raises:
        InputError: no such file, not of this schema, a key or number that is missing, unknown or impossible, a sum that
            does not match, golden vectors that this machine does not reproduce.
    """
    return parse(read(path), str(path))


def read(path: PathLike) -> dict[str, Any]:
    """The contents of a law.json, unchecked but for being an object of JSON."""
    where = str(path)
    _, data = read_file(path, json.loads, "JSON", "make a law.json with ljjax export")
    if not isinstance(data, dict):
        raise InputError(f"{where}: holds no law; expected an object with schema {SCHEMA!r}")
    return data


def parse(data: Mapping[str, Any], where: str) -> Law:
    """The law in the contents of a law.json, checked as `load` says."""
    if data.get("schema") != SCHEMA:
        raise InputError(f"{where}: schema is {data.get('schema')!r}; expected {SCHEMA!r}")
    for key in _KEYS:
        if key not in data:
            raise InputError(f"{where}: missing key {key}; export the law again")
    for key in data:
        if key not in _KEYS:
            raise InputError(f"{where}: unknown key {key!r}; expected {', '.join(_KEYS)}")
    if not isinstance(data["law"], str) or data["law"] not in KINDS:
        raise InputError(f"{where}: law is {data['law']!r}; expected one of {', '.join(KINDS)}")
    groups = {name: _group(where, name, kind, data[name]) for name, kind in GROUPS.items()}
    law = Law(kind=data["law"], period_s=_number(where, "period_s", data["period_s"]), **groups)  # type: ignore[arg-type]
    possible(law, where)
    try:
        found = sha256(data)
    except ValueError:
        raise InputError(f"{where}: holds numbers that are not finite; export the law again") from None
    if found != data["sha256"]:
        raise InputError(
            f"{where}: sha256 is {str(data['sha256'])[:12]}…, its content's is {found[:12]}…: the file was changed "
            "after its export; export the law again"
        )
    golden = _golden(where, data["golden"])
    try:
        wrong = mismatch(law, golden)
    except (ArithmeticError, ValueError) as error:  # numbers that are possible one by one, and not together
        wrong = f"cannot be computed ({error})"
    if wrong:
        raise InputError(f"{where}: golden vectors: {wrong}; export the law again with this version of ljjax")
    return law


def possible(law: Law, where: str) -> None:
    """Refuse numbers with which a tick would divide by 0 or overstep its own limits.

    Raises:
        InputError: naming the number, what was found and what is expected.
    """
    gains, robot, limits, tables = law.gains, law.robot, law.limits, law.tables

    def expect(holds: bool, path: str, value: float, what: str) -> None:
        if not holds:
            raise InputError(f"{where}: {path} = {value:g}: must be {what}")

    expect(law.period_s > 0, "period_s", law.period_s, "> 0")
    for name in ("gamma", "still_rad_s"):
        expect(getattr(gains, name) > 0, f"gains.{name}", getattr(gains, name), "> 0")
    for name in ("damping", "filter_s", "integral", "leak_per_s", "dead_zone_rad"):
        expect(getattr(gains, name) >= 0, f"gains.{name}", getattr(gains, name), "≥ 0")
    expect(0 <= gains.compensation <= 1, "gains.compensation", gains.compensation, "between 0 and 1")
    expect(gains.leak_per_s * law.period_s <= 1, "gains.leak_per_s", gains.leak_per_s, "at most one over period_s")
    expect(robot.segments >= 1 and robot.segments == int(robot.segments), "robot.segments", robot.segments, "1, 2, …")
    widest = 1.0 / robot.segments  # of sin e there is no more
    expect(gains.dead_zone_rad < widest, "gains.dead_zone_rad", gains.dead_zone_rad, f"< {widest:.4g}")
    for name in ("lever_arm_m", "sigma0", "mu_c", "v_s"):
        expect(getattr(robot, name) > 0, f"robot.{name}", getattr(robot, name), "> 0")
    expect(robot.mu_s >= robot.mu_c, "robot.mu_s", robot.mu_s, "at least robot.mu_c")
    expect(1 <= robot.sigma3 <= 100, "robot.sigma3", robot.sigma3, "between 1 and 100")
    least, most, level = limits.tension_min_n, limits.tension_max_n, limits.co_contraction_n
    expect(least >= 0, "limits.tension_min_n", least, "≥ 0")
    expect(most > least, "limits.tension_max_n", most, f"> tension_min_n = {least:g}")
    expect(
        least <= level <= 0.5 * (least + most),
        "limits.co_contraction_n",
        level,
        f"between tension_min_n = {least:g} and the middle of the tensions, {0.5 * (least + most):g}",
    )
    for name in ("tension_slew_n_s", "vacuum_max_kpa", "vacuum_slew_kpa_s", "theta_max_rad"):
        expect(getattr(limits, name) > 0, f"limits.{name}", getattr(limits, name), "> 0")
    low, high = limits.stiffness_min_n_m, limits.stiffness_max_n_m
    expect(high > low > 0, "limits.stiffness_max_n_m", high, f"> stiffness_min_n_m = {low:g} > 0")
    if len(tables.phi) != len(tables.alpha2):
        raise InputError(f"{where}: tables.phi has {len(tables.phi)} entries, tables.alpha2 {len(tables.alpha2)}")
    for name in ("alpha2", "phi"):
        worst = min(getattr(tables, name))
        expect(worst > 0, f"tables.{name}", worst, "> 0 everywhere")
    expect(
        all(b > a for a, b in zip(tables.root, tables.root[1:], strict=False)), "tables.root", tables.root[0], "rising"
    )


def _group(where: str, name: str, kind: type, given: Any) -> Any:
    if not isinstance(given, dict):
        raise InputError(f"{where}: {name} is {type(given).__name__}; expected an object")
    fields: tuple[str, ...] = kind._fields  # type: ignore[attr-defined]
    for key in fields:
        if key not in given:
            raise InputError(f"{where}: missing key {name}.{key} [{UNITS[f'{name}.{key}']}]")
    for key in given:
        if key not in fields:
            raise InputError(f"{where}: {name}: unknown key {key!r}; expected {', '.join(fields)}")
    if kind is not Tables:
        return kind(**{key: _number(where, f"{name}.{key}", value) for key, value in given.items()})
    for key, value in given.items():
        if not isinstance(value, list) or len(value) < 2:
            raise InputError(f"{where}: {name}.{key}: expected a list of two numbers or more")
    return kind(**{k: tuple(_number(where, f"{name}.{k}[{i}]", x) for i, x in enumerate(v)) for k, v in given.items()})


def _golden(where: str, given: Any) -> Golden:
    if not isinstance(given, dict) or given.get("columns") != list(COLUMNS):
        raise InputError(f"{where}: golden.columns: expected {', '.join(COLUMNS)}; export the law again")
    initial, rows = given.get("initial"), given.get("rows")
    if not isinstance(initial, dict) or set(initial) != set(State._fields):
        raise InputError(f"{where}: golden.initial: expected {', '.join(State._fields)}")
    if not isinstance(rows, list) or not all(isinstance(r, list) and len(r) == len(COLUMNS) for r in rows):
        raise InputError(f"{where}: golden.rows: expected rows of {len(COLUMNS)} numbers")
    return Golden(
        State(**{key: _number(where, f"golden.initial.{key}", value) for key, value in initial.items()}),
        tuple(tuple(_number(where, f"golden.rows[{k}][{i}]", x) for i, x in enumerate(r)) for k, r in enumerate(rows)),
    )


def _number(where: str, path: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{where}: {path} is {value!r}; expected a number [{UNITS.get(path, '')}]")
    try:
        number = float(value)
    except OverflowError:  # JSON's whole numbers have no largest
        number = math.inf
    if not math.isfinite(number):
        raise InputError(f"{where}: {path} is {number}; expected a finite number")
    return number
