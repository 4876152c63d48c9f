"""From the messages of a log that follows contract v1 to samples by signal name."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from ljjax.errors import InputError
from ljjax.logs import cdr, contract, samples
from ljjax.logs.container import Container
from ljjax.logs.decode import decoder
from ljjax.logs.records import Channel, Message
from ljjax.logs.samples import Samples

Decoded = tuple[list[Message], list[Any]]


def topics(prefix: str) -> frozenset[str]:
    """The topics that carry signals under a prefix such as `/real`, with those of their standard deviations."""
    plain = [prefix + entry.topic for entry in contract.ENTRIES]
    return frozenset(plain + [topic + contract.SD for topic in plain])


def read(box: Container, prefix: str, notes: list[str]) -> dict[str, Samples]:
    """Samples of every signal there is, as recorded. Raises InputError."""
    decoded: dict[str, Decoded] = {}
    kinds = {prefix + e.topic + end: e.type for e in contract.ENTRIES for end in ("", contract.SD)}
    for topic in box.topics():
        if topic in kinds:
            decoded[topic] = _decoded(box, topic, kinds[topic])
    found = {}
    for entry in contract.ENTRIES:
        topic = prefix + entry.topic
        got = _samples(box.path, entry, topic, decoded, notes)
        if got is None:
            continue
        sd = _samples(box.path, entry, topic + contract.SD, decoded, notes)
        if sd is not None:
            got = samples.with_sd(got, sd, box.path, notes)
        found[entry.signal] = got
    return found


def _decoded(box: Container, topic: str, kind: str) -> Decoded:
    messages: list[Message] = []
    values: list[Any] = []
    for channel in box.topics()[topic]:
        if box.counts[channel.id]:
            mine = [m for m in box.messages if m.channel_id == channel.id]
            messages += mine
            values += _values(box, channel, kind, mine)
    if len(box.topics()[topic]) > 1:  # several publishers: back into the order of the log
        order = sorted(range(len(messages)), key=lambda i: messages[i].log_ns)
        messages, values = [messages[i] for i in order], [values[i] for i in order]
    return messages, values


def _values(box: Container, channel: Channel, kind: str, messages: list[Message]) -> list[Any]:
    """Our own fast decoder where the schema is the standard one, else the one that the log's schema describes."""
    place = f"{box.path}: topic {channel.topic}"
    schema = box.schemas.get(channel.schema_id)
    name = contract.full_type(schema.name) if schema else "(no schema)"
    if schema is None or name != kind or channel.encoding != "cdr":
        raise InputError(
            f"{place}: is {name} in {channel.encoding}, expected {kind} in cdr; read other people's logs with a "
            "mapping file (docs/logs.md)"
        )
    data = [m.data for m in messages]
    text = schema.data.decode("utf-8", "replace")
    standard = contract.is_standard(kind, text) if schema.encoding == "ros2msg" else schema.encoding == "ros2idl"
    try:
        if standard and kind == contract.JOINT_STATE:
            return list(cdr.read_joint_states(data))
        if standard:
            return list(cdr.read_scalars(data, 7 if kind == contract.POSE_STAMPED else 2))
    except cdr.MalformedMessage as error:
        when = samples.stamp_text(messages[error.index].log_ns)
        raise InputError(
            f"{place}: message {error.index} (log time {when}) is no {kind}: {error}; check the publisher's message "
            "type"
        ) from None
    decode = decoder(box, channel)
    try:
        return [_from_object(decode(item), kind) for item in data]
    except (AttributeError, TypeError) as error:
        raise InputError(
            f"{place}: its {kind} is not the standard one ({error}); read it with a mapping file"
        ) from None


def _from_object(msg: Any, kind: str) -> cdr.JointState | cdr.Scalars:
    t_ns, frame = msg.header.stamp.sec * 10**9 + msg.header.stamp.nanosec, msg.header.frame_id
    if kind == contract.JOINT_STATE:
        return cdr.JointState(t_ns, frame, tuple(msg.name), tuple(msg.position), tuple(msg.velocity), tuple(msg.effort))
    if kind == contract.FLUID_PRESSURE:
        return cdr.Scalars(t_ns, frame, (msg.fluid_pressure, msg.variance))
    if kind == contract.TEMPERATURE:
        return cdr.Scalars(t_ns, frame, (msg.temperature, msg.variance))
    p, q = msg.pose.position, msg.pose.orientation
    return cdr.Scalars(t_ns, frame, (p.x, p.y, p.z, q.x, q.y, q.z, q.w))


def _samples(
    path: str, entry: contract.Entry, topic: str, decoded: dict[str, Decoded], notes: list[str]
) -> Samples | None:
    messages, values = decoded.get(topic, ([], []))
    if not messages:
        return None
    times = np.array([(v.t_ns, m.log_ns, m.publish_ns) for v, m in zip(values, messages, strict=True)], np.int64).T
    if entry.type == contract.JOINT_STATE:
        return _joint_samples(path, entry, topic, times, values, notes)
    table = np.array([v.value for v in values], float)
    sd = None
    if entry.type != contract.POSE_STAMPED:
        variance = table[:, 1:]
        if (variance < 0).any() or np.isnan(variance).any():
            row = int(np.argmin(np.where(np.isnan(variance[:, 0]), -np.inf, variance[:, 0])))
            raise InputError(
                f"{path}: {topic}: sample {row} (stamp {samples.stamp_text(times[0, row])}): variance "
                f"{variance[row, 0]}; expected ≥ 0, with 0 for unknown"
            )
        if (variance > 0).any():
            sd = np.sqrt(np.where(variance > 0, variance, np.nan))
            unknown = int((variance == 0).sum())
            if unknown:
                notes.append(f"{topic}: {unknown} of {len(table)} samples have no variance (NaN)")
        table = table[:, :1]
    units = ",".join(entry.units)
    return Samples(times[0], times[1], times[2], table, entry.columns, units, topic, sd)


def _joint_samples(
    path: str,
    entry: contract.Entry,
    topic: str,
    times: np.ndarray,
    values: Sequence[cdr.JointState],
    notes: list[str],
) -> Samples | None:
    """Columns picked by name; messages that leave the array empty do not count for this signal."""
    wanted = _names(path, entry, topic, values[0].name)
    joints = ("probe",) if entry.signal == "probe" else wanted
    fields = entry.fields * len(wanted) if len(entry.fields) == 1 else entry.fields
    picks: dict[tuple[str, ...], list[int]] = {}
    rows, kept = [], []
    for i, v in enumerate(values):
        if any(not getattr(v, field) for field in fields):
            continue
        where = picks.get(v.name)
        if where is None:
            if any(v.name.count(joint) != 1 for joint in joints) or _names(path, entry, topic, v.name) != wanted:
                raise InputError(
                    f"{path}: {topic}: message {i} (stamp {samples.stamp_text(v.t_ns)}) names "
                    f"{', '.join(v.name) or 'nothing'}; expected each of {', '.join(joints)} once; name the joints by "
                    "the contract or use a mapping file"
                )
            where = picks[v.name] = [v.name.index(joint) for joint in joints] * (len(wanted) // len(joints))
        for field in fields:
            if len(getattr(v, field)) != len(v.name):
                raise InputError(
                    f"{path}: {topic}: message {i} (stamp {samples.stamp_text(v.t_ns)}) has {len(getattr(v, field))} "
                    f"values of {field} for {len(v.name)} names; expected as many, or none"
                )
        rows.append([getattr(v, field)[k] for field, k in zip(fields, where, strict=True)])
        kept.append(i)
    if not rows:
        return None
    if len(rows) < len(values):
        notes.append(
            f"{topic}: {len(values) - len(rows)} of {len(values)} messages have no {' or '.join(entry.fields)}"
        )
    table = np.array(rows, float)
    if entry.signal == "spool" and np.isnan(table).all():
        return None  # the contract wants spool travel "if known"
    t_ns, log_ns, publish_ns = times[:, kept]
    return Samples(t_ns, log_ns, publish_ns, table, wanted, ",".join(entry.units), topic)


def _names(path: str, entry: contract.Entry, topic: str, name: tuple[str, ...]) -> tuple[str, ...]:
    """The columns of a signal; for a shape `theta`, or `q1 … qn` in the order of the body, not of the log."""
    if entry.columns:
        return entry.columns
    segments = sorted((int(n[1:]), n) for n in set(name) if re.fullmatch(r"q[1-9][0-9]*", n))
    if segments and [k for k, _ in segments] == list(range(1, len(segments) + 1)):
        return tuple(n for _, n in segments)
    if "theta" in name and not segments:
        return ("theta",)
    raise InputError(
        f"{path}: {topic}: names {', '.join(name) or 'nothing'}; expected theta, or q1 … qn without a gap; name the "
        "angles by the contract or use a mapping file"
    )


def doubts(found: dict[str, Samples], p_atm: str) -> list[str]:
    """Values that cannot be in the contract's units, a line each; `p_atm` is the run's atmospheric pressure [Pa]."""
    out = []
    mend = "mend it with a mapping file (docs/logs.md)"
    for name in ("cmd_pressure", "pressure"):
        s = found.get(name)
        if s is None:
            continue
        low, high = float(s.value.min()), float(s.value.max())
        if not (low > -2e3 and 2e3 < high < 5e5):
            out.append(f"{s.topic}: {low:.6g} to {high:.6g} is no absolute pressure in Pa; is it gauge or kPa? {mend}")
        elif _is_number(p_atm) and high > float(p_atm) + 5e3:
            out.append(
                f"{s.topic}: up to {high:.6g} Pa, above the atmosphere's {p_atm} Pa; is a sign or reference wrong? "
                f"{mend}"
            )
    s = found.get("cmd_tendons")
    if s is not None and s.value.min() < -0.01:
        out.append(f"{s.topic}: commanded tension down to {s.value.min():.6g} N, and tendons only pull; {mend}")
    s = found.get("shape")
    if s is not None and np.abs(s.value).max() > np.pi:
        high = float(np.abs(s.value).max())
        out.append(f"{s.topic}: {high:.4g} rad is over half a turn in one segment; is it in degrees? {mend}")
    return out


def _is_number(text: str) -> bool:
    try:
        return np.isfinite(float(text))
    except ValueError:
        return False
