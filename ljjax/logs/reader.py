"""Read a log into a `Run`: checked on the way, silent about nothing."""

from __future__ import annotations

import os
from collections.abc import Sequence
from datetime import UTC, datetime
from types import MappingProxyType

from ljjax.errors import InputError
from ljjax.logs import contract, contract_signals, samples
from ljjax.logs.container import Container, scan
from ljjax.logs.mapping import Mapping, load_mapping
from ljjax.logs.run import Run

PathLike = str | os.PathLike[str]


def read(path: PathLike, mapping: Mapping | PathLike | None = None, *, prefix: str = "/real") -> Run:
    """One log as a `Run`, in SI.

    A cut or damaged file gives the part before the damage, and `Run.damage` says where and why.

    Args:
        path: an MCAP file.
        mapping: how to read a log that does not follow the contract; then only what it names is read. One without
            signals states metadata alone, for a log whose topics follow the contract.
        prefix: `/real`, or `/sim` and `/residual` in a result. Ignored with a mapping.

    Raises InputError where there is no such file, it is no MCAP file, it follows another contract, a used
    value is not finite, or no signal is left.
    """
    if mapping is not None and not isinstance(mapping, Mapping):
        mapping = load_mapping(mapping)
    mapped = mapping is not None and bool(mapping.sources)
    topics = mapping.topics if mapping is not None and mapped else contract_signals.topics(prefix)
    box = scan(path, topics.__contains__)
    notes = list(box.notes)
    metadata = _metadata(box, mapping, notes)
    if mapping is not None and mapped:
        from ljjax.logs.mapped_signals import read as read_mapped

        found = read_mapped(box, mapping, metadata, notes)
    else:
        found = contract_signals.read(box, prefix, notes)
    found = {name: s for name, s in found.items() if len(s)}
    if not found:
        raise InputError(_nothing(box, mapping if mapped else None, prefix))
    for name, s in found.items():
        samples.check_clock(s, box.path)
        samples.check_finite(s, box.path)
        found[name] = samples.in_order(s, notes)
    doubts = contract_signals.doubts(found, metadata.get("p_atm_pa", ""))
    notes += doubts
    t0_ns, signals = samples.as_signals(found)
    return Run(
        path=box.path,
        sha256=box.sha256,
        t0_ns=t0_ns,
        signals=MappingProxyType(signals),
        metadata=MappingProxyType(metadata),
        damage=box.damage,
        notes=tuple(dict.fromkeys(notes)),
        doubts=tuple(doubts),
    )


def read_all(paths: Sequence[PathLike], mapping: Mapping | PathLike | None = None) -> list[Run]:
    """Several logs, sorted by robot and then by start: runs of one robot are in the order in which they were made."""
    if mapping is not None and not isinstance(mapping, Mapping):
        mapping = load_mapping(mapping)
    return sorted((read(path, mapping) for path in paths), key=lambda run: (run.robot_id, started_ns(run), run.path))


def started_ns(run: Run) -> int:
    """When a run began, in ns since 1970: `start_utc`, or its first stamp where that is missing or unreadable."""
    try:
        start = datetime.fromisoformat(run.metadata.get("start_utc", ""))
    except ValueError:
        return run.t0_ns
    start = start if start.tzinfo else start.replace(tzinfo=UTC)
    seconds = start - datetime(1970, 1, 1, tzinfo=UTC)
    return (seconds.days * 86400 + seconds.seconds) * 10**9 + seconds.microseconds * 1000


def read_attachment(path: PathLike, name: str) -> bytes:
    """The content of an attachment, checked. Raises InputError where it is missing or altered."""
    box = scan(path, lambda topic: False, attachments=True)
    if name not in box.attachments:
        why = f" ({box.damage.where}: {box.damage.why})" if box.damage else ""
        has = ", ".join(sorted(box.attachments)) or "none"
        raise InputError(f"{box.path}: no sound attachment {name!r}; it has {has}{why}")
    return box.attachments[name][1]


def _metadata(box: Container, mapping: Mapping | None, notes: list[str]) -> dict[str, str]:
    result = box.record(contract.RESULT_RECORD)
    if result is not None and result.get("runs", "1") != "1":
        raise InputError(
            f"{box.path}: is a result that overlays {result['runs']} runs, not the log of one run; give the logs it "
            "was made from"
        )
    record = box.record(contract.RUN_RECORD)
    found = {k: v for k, v in (record or {}).items() if k != "sha256"}
    if mapping is not None:
        return {**found, **mapping.run}
    if record is None:
        notes.append(
            f"no metadata {contract.RUN_RECORD}: robot, atmospheric pressure and order of the runs are not known"
        )
        return found
    version = found.get("contract_version")
    if version != contract.VERSION:
        stated = "none" if version is None else repr(version)
        raise InputError(
            f"{box.path}: metadata {contract.RUN_RECORD}: contract_version is {stated}, expected "
            f"{contract.VERSION!r}; read other people's logs with a mapping file (docs/logs.md)"
        )
    if "end_reason" not in found:
        notes.append("the run was cut short: its metadata has no end_reason")
    lacking = [key for key in contract.RUN_KEYS if key not in found and key != "end_reason"]
    if lacking:
        notes.append(f"metadata {contract.RUN_RECORD} lacks {', '.join(lacking)}")
    return found


def _nothing(box: Container, mapping: Mapping | None, prefix: str) -> str:
    if box.damage is not None:
        return f"{box.path}: no usable signal before {box.damage.where}: {box.damage.why}; take an undamaged copy"
    has = ", ".join(sorted(box.topics())) or "none"
    if mapping is not None:
        return f"{box.path}: none of the topics in {mapping.path} has a message; the log has {has}"
    return (
        f"{box.path}: no usable signal: no message on a topic of the contract such as {prefix}/shape; the log has "
        f"{has}; read other people's logs with a mapping file (docs/logs.md)"
    )
