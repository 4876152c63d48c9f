"""The summary at the end of an MCAP file, held against what the walk through the data found."""

from __future__ import annotations

import zlib
from typing import TYPE_CHECKING

from ljjax.logs import records
from ljjax.logs.records import Channel, Malformed, Schema

if TYPE_CHECKING:
    from ljjax.logs.container import Walk


def check(walk: Walk) -> None:
    """The index at the end, held against what the walk found: it shows what a flipped bit has hidden."""
    begin, walk.crc = walk.at, 0
    listed: set[tuple[int, str]] = set()
    repeated: list[Schema | Channel] = []
    stated: tuple[int, int, dict[int, int]] | None = None
    while True:
        crc_before = walk.crc
        record = walk.next_record()
        if record is None:
            return
        start, opcode, content = record
        try:
            if opcode == records.FOOTER:
                summary_start, summary_crc = records.footer(content)
                break
            if opcode == records.STATISTICS:
                stated = records.statistics(content)
            elif opcode == records.METADATA_INDEX:
                listed.add(records.metadata_index(content))
            elif opcode in (records.SCHEMA, records.CHANNEL):
                repeated.append(records.schema(content) if opcode == records.SCHEMA else records.channel(content))
            elif opcode < records.PRIVATE and not records.SCHEMA <= opcode <= records.SUMMARY_OFFSET:
                raise Malformed(f"a record of the unknown kind {opcode}")
        except Malformed as error:
            walk.damaged(start, f"in the index at the end, {error}; no sample is touched")
            return
    prefix = bytes([records.FOOTER]) + len(content).to_bytes(8, "little") + content[:16]
    if summary_crc and zlib.crc32(prefix, crc_before) != summary_crc:
        walk.damaged(start, "the checksum of the index at the end fails; no sample is touched")
    elif summary_start not in (0, begin):
        walk.damaged(start, f"the index should begin at byte {summary_start} and begins at {begin}")
    elif walk.take(len(records.MAGIC)) != records.MAGIC:
        walk.damaged(start, "the closing signature is missing; no sample is touched")
    elif walk.at != walk.size:
        walk.damaged(walk.at, "there are bytes after the closing signature; no sample is touched")
    elif walk.out.damage is None:
        _compare(walk, start, listed, repeated, stated)


def _compare(
    walk: Walk,
    at: int,
    listed: set[tuple[int, str]],
    repeated: list[Schema | Channel],
    stated: tuple[int, int, dict[int, int]] | None,
) -> None:
    for item in repeated:
        found = (walk.out.schemas if isinstance(item, Schema) else walk.out.channels).get(item.id, item)
        if found != item:
            walk.damaged(
                at,
                f"{type(item).__name__.lower()} {item.id} reads differently in the index and in the data",
            )
    for offset, name in sorted(listed - walk.found_metadata):
        walk.damaged(at, f"the index lists metadata {name!r} at byte {offset}, where there is none")
    if stated is None:
        return
    n_metadata, n_chunks, counts = stated
    if (n_metadata, n_chunks) != (walk.n_metadata, walk.n_chunks):
        walk.damaged(at, f"the index counts {n_chunks} chunks and {n_metadata} metadata records, but there are "
                         f"{walk.n_chunks} and {walk.n_metadata}")  # fmt: skip
    for channel_id, count in counts.items():
        if count != walk.out.counts[channel_id]:
            topic = walk.out.channels[channel_id].topic if channel_id in walk.out.channels else f"channel {channel_id}"
            walk.damaged(
                at,
                f"the index counts {count} messages of {topic}, but there are {walk.out.counts[channel_id]}",
            )
