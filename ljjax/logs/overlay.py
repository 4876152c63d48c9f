"""A result as one MCAP file: the measured messages as they were, with `/sim/*` and `/residual/*` beside them."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from ljjax.errors import InputError
from ljjax.logs import contract
from ljjax.logs.container import Container, scan
from ljjax.logs.run import Run, Signal
from ljjax.logs.sink import Sink
from ljjax.logs.writer import packer

Extra = Mapping[str, Mapping[str, Signal]]
_Row = tuple[int, int, int, bytes, int]  # log time, channel, publish time, message, sequence


def copy_overlay(runs: Sequence[Run], out_path: str | os.PathLike[str], extra: Sequence[Extra]) -> None:
    """Copy the runs' measured messages unchanged and put signals beside them.

    Bytes, schemas, channels, sequence numbers and times of every `/real/*` message (and of what the runs read
    through a mapping) stay as they are. Each extra signal is written in the contract's type under its prefix,
    with its own stamps `t` (seconds since the run's `t0_ns`) in the header; log and publish times are the
    signal's own where it has them, else the stamps. The file appears whole or not at all.

    Args:
        runs: as `read` gave them; their files must still be there, unaltered.
        out_path: the MCAP file to write.
        extra: for each run, prefix (`"/sim"`, `"/residual"`) → signal name → signal, in the units of `Run`. A
            residual of a
            pressure is written as a difference, not as an absolute pressure.

    Raises InputError where a source changed since it was read, or where the file cannot be written.
    """
    if len(runs) != len(extra):
        raise ValueError(f"{len(runs)} runs and {len(extra)} sets of extra signals")
    out = os.fspath(out_path)
    part = f"{out}.part"
    sink = Sink(part, contract.RESULT_LIBRARY)
    try:
        for run, added in zip(runs, extra, strict=True):
            box = _source(run)
            for name, pairs in box.metadata:
                if name == contract.RUN_RECORD:
                    sink.metadata(name, {k: v for k, v in pairs.items() if k != "sha256"}, seal="sha256" in pairs)
            rows = [*_copied(sink, box), *_added(sink, run, added)]
            for log_ns, channel, publish_ns, data, sequence in sorted(rows, key=lambda row: row[0]):
                sink.message(channel, log_ns, publish_ns, data, sequence)
            sink.flush()
        sink.metadata(contract.RESULT_RECORD, _summary(runs))
        sink.close()
        os.replace(part, out)
    except BaseException:
        sink.abandon()
        if os.path.exists(part):
            os.unlink(part)
        raise


def _source(run: Run) -> Container:
    mapped = {topic for signal in run.signals.values() for topic in signal.topic.split(", ")}
    box = scan(run.path, lambda topic: topic.startswith("/real/") or topic in mapped)
    if box.sha256 != run.sha256:
        raise InputError(f"{run.path}: changed since it was read; run the command again")
    return box


def _copied(sink: Sink, box: Container) -> Iterator[_Row]:
    ids: dict[int, int] = {}
    for m in box.messages:
        if m.channel_id not in ids:
            channel = box.channels[m.channel_id]
            schema = box.schemas.get(channel.schema_id)
            pairs = dict(channel.metadata)
            if schema is None:
                ids[m.channel_id] = sink.channel_without_schema(channel.topic, channel.encoding, pairs)
            else:
                ids[m.channel_id] = sink.channel(
                    channel.topic, schema.name, schema.encoding, schema.data, channel.encoding, pairs
                )
        yield m.log_ns, ids[m.channel_id], m.publish_ns, m.data, m.sequence


def _added(sink: Sink, run: Run, extra: Extra) -> Iterator[_Row]:
    def absolute(seconds: np.ndarray) -> list[int]:
        return (np.rint(np.asarray(seconds, float) * 1e9).astype(np.int64) + run.t0_ns).tolist()

    for prefix, signals in extra.items():
        prefix = "/" + prefix.strip("/")
        for name, signal in signals.items():
            entry = contract.BY_SIGNAL.get(name)
            if entry is None or name == "spool":
                raise ValueError(f"no signal {name!r} to write beside {run.path}")
            if not np.isfinite(signal.value).all():
                raise ValueError(f"{prefix}/{name} beside {run.path} is not finite")
            channel = sink.contract_channel(prefix + entry.topic, entry.type)
            pack = packer(entry, signal.columns if name == "shape" else entry.columns)
            t_ns = absolute(signal.t)
            log_ns = t_ns if signal.log_t is None else absolute(signal.log_t)
            publish_ns = t_ns if signal.publish_t is None else absolute(signal.publish_t)
            for i, value in enumerate(signal.value.tolist()):
                yield log_ns[i], channel, publish_ns[i], pack(t_ns[i], value, None)[0], i


def _summary(runs: Sequence[Run]) -> dict[str, str]:
    found = {"runs": str(len(runs))}
    for i, run in enumerate(runs):
        found |= {
            f"run{i}.file": os.path.basename(run.path),
            f"run{i}.run_id": run.run_id,
            f"run{i}.sha256": run.sha256,
        }
    return found
