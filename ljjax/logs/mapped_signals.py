"""From the messages of other people's logs, through a mapping, to samples by signal name."""

from __future__ import annotations

from typing import Any

import numpy as np

from ljjax.errors import InputError
from ljjax.logs import contract, units
from ljjax.logs.container import Container
from ljjax.logs.decode import decoder
from ljjax.logs.mapping import Mapping, Source
from ljjax.logs.path import NotThere, member, number_at
from ljjax.logs.records import Message
from ljjax.logs.samples import Samples, check_clock, in_order, stamp_text

PAIRS = {
    "cmd_tendons": ("cmd_tendon_left", "cmd_tendon_right"),
    "tendons": ("tendon_left", "tendon_right"),
    "spool": ("spool_left", "spool_right"),
    "probe": ("probe_position", "probe_force"),
}
TIP = ("tip_x", "tip_y", "tip_z", "tip_qx", "tip_qy", "tip_qz", "tip_qw")


def read(box: Container, mapping: Mapping, metadata: dict[str, str], notes: list[str]) -> dict[str, Samples]:
    """Samples of every mapped signal whose topic has messages. Raises InputError."""
    decoded = {topic: _decoded(box, topic) for topic in sorted(mapping.topics)}
    single: dict[str, Samples] = {}
    for name, source in mapping.sources.items():
        messages = decoded[source.topic]
        if messages:
            single[name] = _single(box.path, mapping, source, messages, metadata, notes)
        else:
            notes.append(f"{source.topic}: no message, so no {name}")
    groups = {
        **PAIRS,
        "cmd_pressure": ("cmd_pressure",),
        "pressure": ("pressure",),
        "temperature": ("temperature",),
        "shape": tuple(sorted((n for n in mapping.sources if n[0] == "q"), key=lambda n: int(n[1:]))) or ("theta",),
        "tip": TIP if "tip_qx" in mapping.sources else TIP[:3],
    }
    found = {}
    for signal, names in groups.items():
        have = [single[n] for n in names if n in single]
        if len(have) == len(names):
            found[signal] = _held(signal, names, have, mapping, notes)
        elif have:
            notes.append(f"{signal}: not all of {', '.join(names)} have messages; left out")
    return found


def _decoded(box: Container, topic: str) -> list[tuple[Message, Any]]:
    ids = {c.id: decoder(box, c) for c in box.topics().get(topic, []) if box.counts[c.id]}
    return [(m, ids[m.channel_id](m.data)) for m in box.messages if m.channel_id in ids]


def _single(
    path: str,
    mapping: Mapping,
    source: Source,
    messages: list[tuple[Message, Any]],
    metadata: dict[str, str],
    notes: list[str],
) -> Samples:
    """One column, in SI."""
    times, values = [], []
    for message, decoded in messages:
        try:
            raw = number_at(decoded, source.steps)
            stamp = _header_ns(decoded) if source.time == "header" else message.log_ns
        except NotThere as error:
            raise InputError(
                f"{path}: {source.topic}: message {len(values)} (log time {stamp_text(message.log_ns)}): {error}; "
                f"{mapping.path} wants {source.path} of it for {source.name}"
            ) from None
        values.append(source.si(raw))
        times.append((message.publish_ns if source.time == "publish" else stamp, message.log_ns, message.publish_ns))
    table = np.array(values, float)[:, None]
    if source.reference in ("vacuum", "gauge"):
        p_atm = _p_atm(path, mapping, source, metadata)
        table = p_atm - table if source.reference == "vacuum" else p_atm + table
    si = units.SI[source.quantity]
    t_ns, log_ns, publish_ns = np.array(times, np.int64).T
    samples = Samples(t_ns, log_ns, publish_ns, table, (source.name,), si, source.topic)
    check_clock(samples, path)
    return in_order(samples, notes)


def _header_ns(decoded: Any) -> int:
    """header.stamp of a ROS message, or that, `stamp` or `timestamp` of JSON and protobuf. Raises NotThere."""
    for names in (("header", "stamp"), ("stamp",), ("timestamp",)):
        here = decoded
        try:
            for name in names:
                here = member(here, name)
            return _ns(here)
        except NotThere:
            continue
    raise NotThere('has no header.stamp; say time = "log" or "publish" in the mapping')


def _ns(stamp: Any) -> int:
    for seconds in ("sec", "secs", "seconds"):
        for fraction in ("nanosec", "nsec", "nsecs", "nanos"):
            try:
                t_ns = int(member(stamp, seconds)) * 10**9 + int(member(stamp, fraction))
            except (NotThere, TypeError, ValueError, OverflowError):
                continue
            if not 0 <= t_ns < 2**63:
                raise NotThere(f"has the stamp {t_ns} ns, which is no time")
            return t_ns
    raise NotThere("has a stamp without seconds and nanoseconds")


def _p_atm(path: str, mapping: Mapping, source: Source, metadata: dict[str, str]) -> float:
    try:
        value = float(metadata["p_atm_pa"])
    except (KeyError, ValueError):
        value = float("nan")
    if not 2e4 < value < 1.2e5:
        raise InputError(
            f"{path}: {source.name} is relative ({source.reference}) and the atmospheric pressure is "
            f"{metadata.get('p_atm_pa', 'not known')}; state it in Pa in {mapping.path}: [run] p_atm_pa = 101325"
        )
    return value


def _held(signal: str, names: tuple[str, ...], have: list[Samples], mapping: Mapping, notes: list[str]) -> Samples:
    """One signal of k columns at every stamp of any of them, each column held; from where all are known."""
    first = have[0]
    columns, unit = _columns(signal, names)
    topic = ", ".join(dict.fromkeys(mapping.sources[n].topic for n in names))
    if all(np.array_equal(s.t_ns, first.t_ns) for s in have):
        value = np.concatenate([s.value for s in have], axis=1)
        return Samples(first.t_ns, first.log_ns, first.publish_ns, value, columns, unit, topic)
    t_ns = np.unique(np.concatenate([s.t_ns for s in have]))
    t_ns = t_ns[t_ns >= max(s.t_ns[0] for s in have)]
    index = [np.searchsorted(s.t_ns, t_ns, side="right") - 1 for s in have]
    value = np.concatenate([s.value[i] for s, i in zip(have, index, strict=True)], axis=1)
    newest = np.argmax([s.t_ns[i] for s, i in zip(have, index, strict=True)], axis=0)
    every = np.arange(len(t_ns))
    log_ns = np.stack([s.log_ns[i] for s, i in zip(have, index, strict=True)])[newest, every]
    publish_ns = np.stack([s.publish_ns[i] for s, i in zip(have, index, strict=True)])[newest, every]
    notes.append(f"{signal}: {', '.join(names)} have their own stamps; each is held until its next")
    return Samples(t_ns, log_ns, publish_ns, value, columns, unit, topic)


def _columns(signal: str, names: tuple[str, ...]) -> tuple[tuple[str, ...], str]:
    if signal == "shape":
        return names, "rad"
    entry = contract.BY_SIGNAL[signal]
    if signal == "tip":
        return entry.columns[: len(names)], ",".join(entry.units[: len(names)])
    return entry.columns, ",".join(entry.units)
