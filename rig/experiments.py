"""Experiments: plans (TOML, schema ljjax.plan/1) of runs without a law, and the protocols they name."""

from __future__ import annotations

import json
import math
import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ljjax.errors import InputError, read_file
from ljjax.rig.config import Limits
from ljjax.rig.gate import Sent
from ljjax.rig.protocols import PROTOCOLS, Protocol
from ljjax.rig.safety import Seen

SCHEMA, GAP_SCHEMA = "ljjax.plan/1", "ljjax.gap/1"
_RUN = ("protocol", "name", "repeat")


class Experiment:
    """A task of the loop: a protocol's net tension on top of a pretension, and its vacuum."""

    def __init__(self, name: str, protocol: Protocol, rate_hz: float, pretension_n: float, ramp_s: float):
        self.name, self.period_s, self.seconds = name, 1.0 / rate_hz, protocol.seconds
        self._protocol, self._pretension, self._ramp_s = protocol, pretension_n, ramp_s

    def tick(self, t: float, seen: Seen, sent: Sent) -> tuple[float, float, float]:
        """Tensions and vacuum at t [s]; before 0 the first ones are approached."""
        share = 1.0 if t >= 0 or self._ramp_s <= 0 else 1 + max(t / self._ramp_s, -1.0)
        net, vacuum = self._protocol.at(max(t, 0.0), seen.theta)
        left, right = self._pretension + max(net, 0.0), self._pretension + max(-net, 0.0)
        return share * left, share * right, sent.vacuum + share * (vacuum - sent.vacuum)

    def refuse_beyond(self, limits: Limits, where: str) -> None:
        """Raises InputError where the protocol asks for more than the limits allow, before anything moves."""
        most = self._protocol.most_n + self._pretension
        if most > limits.tension_max_n:
            raise InputError(
                f"{where}: asks for {most:.4g} N; limits.tension_max_n is {limits.tension_max_n:g} N: lower the "
                "plan's tension"
            )
        if self._protocol.most_kpa > limits.vacuum_max_kpa:
            raise InputError(
                f"{where}: asks for {self._protocol.most_kpa:.4g} kPa; limits.vacuum_max_kpa is "
                f"{limits.vacuum_max_kpa:g} kPa: lower the plan's vacuum"
            )
        if abs(self._protocol.most_rad) > limits.theta_max_rad:
            raise InputError(
                f"{where}: asks for {math.degrees(self._protocol.most_rad):.3g}°; limits.theta_max_rad is "
                f"{math.degrees(limits.theta_max_rad):.3g}°: lower the plan's angles"
            )


@dataclass(frozen=True)
class Plan:
    """What to do: experiments in their order, and whether the vacuum is vented after each (None: as rig.toml says)."""

    experiments: tuple[Experiment, ...]
    vent: bool | None
    text: str


def load(path: str | os.PathLike[str], limits: Limits, ramp_s: float = 1.0) -> Plan:
    """The plan in a plan.toml, or the `next_experiment` of a gap.json, checked against a rig's limits.

    Raises:
        InputError: no such file, neither a plan nor a diagnosis, a key that is missing, unknown or impossible, a
            diagnosis that leaves nothing to do, an experiment beyond the limits.
    """
    where = os.fspath(path)
    text, data = read_file(path, _either, "TOML or JSON", "give a plan.toml or a gap.json")
    if data.get("schema") == GAP_SCHEMA:
        data = _of_gap(data, where)
    return parse(data, where, limits, ramp_s, text)


def _either(text: str) -> Any:
    return json.loads(text) if text.lstrip().startswith("{") else tomllib.loads(text)


def _of_gap(data: Mapping[str, Any], where: str) -> dict[str, Any]:
    following = data.get("next_experiment")
    if not following:
        raise InputError(f"{where}: next_experiment is empty: nothing is left to part; make a plan.toml")
    runs = following.get("plan")
    if not runs:
        raise InputError(f"{where}: next_experiment has no plan; run ljjax gap again with this version")
    return {"schema": SCHEMA, "runs": runs}


def parse(data: Mapping[str, Any], where: str, limits: Limits, ramp_s: float = 1.0, text: str = "") -> Plan:
    """The plan in the contents of a plan.toml, checked as `load` says."""
    if data.get("schema") != SCHEMA:
        raise InputError(f"{where}: schema is {data.get('schema')!r}; expected {SCHEMA!r} (or a gap.json)")
    known = {"schema": None, "rate_hz": 200.0, "pretension_n": 0.2, "vacuum_after": None, "runs": None}
    for key in data:
        if key not in known:
            raise InputError(f"{where}: unknown key {key!r}; expected {', '.join(known)}")
    rate = _number(data.get("rate_hz", 200.0), f"{where}: rate_hz")
    pretension = _number(data.get("pretension_n", 0.2), f"{where}: pretension_n")
    if not 10 <= rate <= 2000:
        raise InputError(f"{where}: rate_hz = {rate:g}; expected 10 to 2000")
    if pretension < 0:
        raise InputError(f"{where}: pretension_n = {pretension:g}; must be ≥ 0")
    after = data.get("vacuum_after")
    if after not in (None, "vent", "hold"):
        raise InputError(f"{where}: vacuum_after is {after!r}; expected 'vent' or 'hold'")
    runs = data.get("runs")
    if not isinstance(runs, list) or not runs or not all(isinstance(run, dict) for run in runs):
        raise InputError(f"{where}: runs: expected one [[runs]] or more")
    made = []
    for k, run in enumerate(runs):
        place = f"{where}: runs[{k}]"
        protocol = _protocol(run, place)
        name = run.get("name", run["protocol"])
        repeat = run.get("repeat", 1)
        if not isinstance(name, str) or not name or not name.replace("_", "").replace("-", "").isalnum():
            raise InputError(f"{place}: name is {name!r}; expected letters, digits, - and _")
        if isinstance(repeat, bool) or not isinstance(repeat, int) or not 1 <= repeat <= 1000:
            raise InputError(f"{place}: repeat is {repeat!r}; expected 1 to 1000")
        for _ in range(repeat):
            experiment = Experiment(name, protocol(), rate, pretension, ramp_s)
            experiment.refuse_beyond(limits, place)
            made.append(experiment)
    return Plan(tuple(made), None if after is None else after == "vent", text)


def _protocol(run: Mapping[str, Any], place: str) -> Any:
    name = run.get("protocol")
    if name not in PROTOCOLS:
        raise InputError(f"{place}: protocol is {name!r}; expected one of {', '.join(PROTOCOLS)}")
    make, needed = PROTOCOLS[name]
    values: dict[str, Any] = {}
    for key, value in run.items():
        if key in _RUN:
            continue
        if key not in needed:
            raise InputError(f"{place}: {name}: unknown key {key!r}; expected {', '.join(needed)}")
        if isinstance(needed[key], tuple):
            if not isinstance(value, list) or not value:
                raise InputError(f"{place}: {name}: {key} is {value!r}; expected a list of numbers")
            values[key] = tuple(_number(x, f"{place}: {name}: {key}[{i}]") for i, x in enumerate(value))
        else:
            values[key] = _number(value, f"{place}: {name}: {key}")
            if (values[key] < 0 and key != "angle_deg") or (values[key] == 0 and key.endswith(("_s", "_hz"))):
                raise InputError(f"{place}: {name}: {key} = {values[key]:g}; must be > 0")
    for key, default in needed.items():
        if default in (None, ()) and key not in values:
            raise InputError(f"{place}: {name}: {key} is missing; it needs {', '.join(needed)}")
    filled = {key: values.get(key, default) for key, default in needed.items()}
    return lambda: make(**filled)


def _number(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"{where} is {value!r}; expected a finite number")
    return float(value)
