"""Read and write `model.toml` (schema ljjax.model/1)."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ljjax.effect import Effect
from ljjax.errors import InputError, read_file
from ljjax.model import TABLES, UNITS, Model, check, get, in_gauge, units

SCHEMA = "ljjax.model/1"
LAWS = {"elastic": "polynomial", "jamming": "sqrt"}
GAUGE = "sigma0=1"
_EXTRA = {"elastic": {"law"}, "jamming": {"law"}, "friction": {"gauge"}, "chain": {"segments"}}


@dataclass(frozen=True)
class ModelFile:
    """A model and what its file says about it.

    Attributes:
        model: the parameters.
        uncertainty: standard deviation by path, in the parameter's unit.
        frozen: paths that a fit is not to move; `free`, those that it is to move although it would not by itself.
        bounds: lowest and highest value by path that a fit may give, in the parameter's unit.
        priors: mean and standard deviation by path of what was known before the fit, in the parameter's unit.
    """

    model: Model
    uncertainty: Mapping[str, float] = field(default_factory=dict)
    frozen: tuple[str, ...] = ()
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    priors: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    free: tuple[str, ...] = ()


def load(path: str | os.PathLike[str]) -> ModelFile:
    """Read a model.toml. Raises InputError naming file, key, what was found and what is expected."""
    where = str(path)
    _, data = read_file(path, tomllib.loads, "TOML", "give a model.toml")
    if data.get("schema") != SCHEMA:
        raise InputError(f'{where}: schema is {data.get("schema")!r}; expected schema = "{SCHEMA}"')
    _only(where, "", data, {"schema", *TABLES, "effects", "uncertainty", "fit"})
    parts: dict[str, Any] = {}
    for table, kind in TABLES.items():
        if table not in data:
            raise InputError(f"{where}: missing table [{table}]")
        entries = _table(where, table, data[table])
        names = {p.split(".")[1] for p in UNITS if p.startswith(table + ".")}
        _only(where, table, entries, names | _EXTRA.get(table, set()))
        if table in LAWS and entries.get("law") != LAWS[table]:
            raise InputError(f'{where}: {table}.law is {entries.get("law")!r}; expected law = "{LAWS[table]}"')
        values = {}
        for name in sorted(names):
            if name not in entries:
                raise InputError(f"{where}: missing key {table}.{name} [{UNITS[f'{table}.{name}']}]")
            values[name] = _number(where, f"{table}.{name}", entries[name])
        if table == "chain":
            n = entries.get("segments")
            if not isinstance(n, int) or isinstance(n, bool) or n < 1:
                raise InputError(f"{where}: chain.segments is {n!r}; expected a whole number ≥ 1")
            values["segments"] = n
        if table == "friction":
            if entries.get("gauge") != GAUGE:
                raise InputError(f'{where}: friction.gauge is {entries.get("gauge")!r}; expected gauge = "{GAUGE}"')
            if values["sigma0"] != 1.0:
                raise InputError(
                    f"{where}: friction.sigma0 is {values['sigma0']:g}; the gauge {GAUGE} fixes it at 1: multiply c4 "
                    "and c5 by sigma0, divide sigma1, sigma2, mu_c and mu_s by it"
                )
        parts[table] = kind(**values)
    model = Model(**parts, effects=_effects(where, data.get("effects", []), Path(path).parent))
    check(model, where=where)
    known = units(model)

    uncertainty = {}
    for key, value in _flat(where, _table(where, "uncertainty", data.get("uncertainty", {}))).items():
        if key not in known:
            raise InputError(f"{where}: uncertainty.{key}: unknown key; expected one of {', '.join(known)}")
        sd = _number(where, f"uncertainty.{key}", value)
        if sd < 0:
            raise InputError(f"{where}: uncertainty.{key} = {sd:g}: a standard deviation must be ≥ 0")
        uncertainty[key] = sd
    entries = _table(where, "fit", data.get("fit", {}))
    _only(where, "fit", entries, {"frozen", "free", "bounds", "priors"})
    bounds = _pairs(where, "bounds", entries, known, "low", "high")
    for path, (low, high) in bounds.items():
        if not low < high:
            raise InputError(f"{where}: fit.bounds.{path} is [{low:g}, {high:g}]; expected the lower first")
    priors = _pairs(where, "priors", entries, known, "mean", "sd")
    for path, (_, sd) in priors.items():
        if not sd > 0:
            raise InputError(f"{where}: fit.priors.{path}: sd is {sd:g}; expected a standard deviation > 0")
    frozen, free = _paths(where, "frozen", entries, known), _paths(where, "free", entries, known)
    if both := set(frozen) & set(free):
        raise InputError(f"{where}: fit.free and fit.frozen both hold {', '.join(sorted(both))}; keep one")
    return ModelFile(model, uncertainty, frozen, bounds, priors, free)


def _effects(where: str, given: Any, folder: Path) -> tuple[Effect, ...]:
    """The effects of [[effects]]: `id`, their parameters (those left out are at the values at which they vanish, or
    start), and for a user's own `file`, the Python file that defines it, beside the model's."""
    from ljjax import effects
    from ljjax.effects.varying import having, varying

    if not isinstance(given, list):
        raise InputError(f"{where}: effects is {given!r}; expected tables [[effects]], each with an id")
    found: list[Effect] = []
    for i, table in enumerate(given):
        place = f"effects[{i}]"
        entries = dict(_table(where, place, table))
        name, file = entries.pop("id", None), entries.pop("file", None)
        if file is not None:
            effects.load(folder / str(file))
        if name not in effects.REGISTRY:
            raise InputError(f"{where}: {place}.id is {name!r}; expected one of {', '.join(effects.REGISTRY)}")
        if any(e.id == name for e in found):
            raise InputError(f"{where}: {place}.id: {name} is there twice; keep one")
        kind = effects.REGISTRY[name]
        _only(where, place, entries, {*varying(kind).fields(), *having(kind, entries).fields(), "id", "file"})
        values = {key: _number(where, f"{place}.{key}", value) for key, value in entries.items()}
        found.append(effects.build(name, values))
    order = list(effects.REGISTRY)
    return tuple(sorted(found, key=lambda e: order.index(e.id)))


def _flat(where: str, tables: dict[str, Any], above: str = "") -> dict[str, Any]:
    """Values by path, of tables in tables."""
    out: dict[str, Any] = {}
    for name, value in tables.items():
        path = f"{above}{name}"
        out |= _flat(where, value, path + ".") if isinstance(value, dict) else {path: value}
    return out


def _pairs(
    where: str, name: str, entries: dict[str, Any], known: Mapping[str, str], first: str, second: str
) -> dict[str, tuple[float, float]]:
    """A table of path = [first, second]."""
    out = {}
    for path, pair in _flat(where, _table(where, f"fit.{name}", entries.get(name, {}))).items():
        key = f"fit.{name}.{path}"
        if path not in known:
            raise InputError(f"{where}: {key}: no such parameter; expected one of {', '.join(known)}")
        if not isinstance(pair, list) or len(pair) != 2:
            raise InputError(f"{where}: {key} is {pair!r}; expected [{first}, {second}] in {known[path]}")
        out[path] = (_number(where, key, pair[0]), _number(where, key, pair[1]))
    return out


def _paths(where: str, name: str, entries: dict[str, Any], known: Mapping[str, str]) -> tuple[str, ...]:
    given = entries.get(name, [])
    if not isinstance(given, list):
        raise InputError(f'{where}: fit.{name} is {given!r}; expected a list such as ["gravity.alpha1"]')
    for path in given:
        if not isinstance(path, str) or path not in known:
            raise InputError(f"{where}: fit.{name}: {path!r} is no parameter; expected one of {', '.join(known)}")
    return tuple(given)


def _table(where: str, key: str, value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise InputError(f"{where}: {key} is {value!r}; expected a table [{key}]")
    return value


def _only(where: str, table: str, entries: dict[str, Any], known: Iterable[str]) -> None:
    for key in entries:
        if key not in known:
            full = f"{table}.{key}" if table else key
            raise InputError(f"{where}: unknown key {full}; expected {', '.join(sorted(known))}")


def _number(where: str, key: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{where}: {key} is {value!r}; expected a number [{UNITS.get(key, '')}]")
    try:
        number = float(value)
    except OverflowError:  # TOML's whole numbers have no largest
        number = float("inf")
    if not float("-inf") < number < float("inf"):
        raise InputError(f"{where}: {key} is {number}; expected a finite number")
    return number


def dumps(file: ModelFile, comment: str = "") -> str:
    """The text of a model.toml; numbers keep every digit. `comment` goes on top, a line each.

    A model in another gauge is written in the file's, σ₀ = 1. The options `constant_mass` and `lever` are not the
    robot's, and not in the file.
    """
    file = replace(file, model=in_gauge(file.model))
    lines = [f"# {line}" for line in comment.splitlines()] + [f'schema = "{SCHEMA}"']
    for table in TABLES:
        lines += ["", f"[{table}]"]
        if table in LAWS:
            lines.append(f'law = "{LAWS[table]}"')
        if table == "friction":
            lines.append(f'gauge = "{GAUGE}"')
        if table == "chain":
            lines.append(f"segments = {file.model.n}")
        for path, unit in UNITS.items():
            if path.startswith(table + "."):
                value = float(get(file.model, path))
                lines.append(f"{path.split('.')[1]} = {value!r}".ljust(40) + f"  # {unit}")
    for effect in file.model.effects:
        lines += ["", "[[effects]]", f'id = "{effect.id}"', *([f'file = "{effect.file}"'] if effect.file else [])]
        for name, about in effect.fields().items():
            lines.append(f"{name} = {float(getattr(effect, name))!r}".ljust(40) + f"  # {about['unit']}")
    for table in (*TABLES, *(f"effects.{effect.id}" for effect in file.model.effects)):
        own = {p.removeprefix(table + "."): sd for p, sd in file.uncertainty.items() if p.startswith(table + ".")}
        if own:
            lines += ["", f"[uncertainty.{table}]  # standard deviations"]
            lines += [f"{name} = {float(sd)!r}" for name, sd in own.items()]
    if file.frozen or file.free:
        lines += ["", "[fit]"]
    for name, paths in (("frozen", file.frozen), ("free", file.free)):
        if paths:
            lines.append(f"{name} = [" + ", ".join(f'"{p}"' for p in paths) + "]")
    for name, pairs in (("bounds", file.bounds), ("priors", file.priors)):
        if pairs:
            lines += ["", f"[fit.{name}]"] + [f'"{p}" = [{float(a)!r}, {float(b)!r}]' for p, (a, b) in pairs.items()]
    return "\n".join(lines) + "\n"
