"""Chunks of an MCAP file: unpacked and checked, or what can still be had of one that the end of the file cuts."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator

from ljjax.logs import records
from ljjax.logs.records import Chunk, Malformed

LARGEST_CHUNK = 1 << 30
_PREFIX = struct.Struct("<BQ")


def unpacked(box: Chunk) -> bytes:
    """The records in a chunk, checked against its size and, where it has one, its checksum."""
    if box.size > LARGEST_CHUNK:
        raise Malformed(f"a chunk claims {box.size} bytes, more than any writer makes")
    try:
        data = _decompressed(box)
    except (Malformed, MemoryError):
        raise
    except Exception as error:  # zstandard and lz4 have no common exception
        raise Malformed(f"a chunk cannot be decompressed ({type(error).__name__}: {error})") from None
    if len(data) != box.size:
        raise Malformed(f"a chunk holds {len(data)} bytes and claims {box.size}")
    if box.crc and zlib.crc32(data) != box.crc:
        raise Malformed("the checksum of a chunk fails")
    return data


def _decompressed(box: Chunk) -> bytes:
    if box.compression == "zstd":
        import zstandard

        stated = zstandard.frame_content_size(box.data)  # type: ignore[attr-defined]
        if stated not in (-1, box.size):
            raise Malformed(f"a chunk claims {box.size} bytes and its content {stated}")
        return zstandard.ZstdDecompressor().decompress(box.data, max_output_size=box.size)
    if box.compression == "lz4":
        import lz4.frame

        return lz4.frame.LZ4FrameDecompressor().decompress(box.data, max_length=box.size)
    return box.data


def inner(data: bytes) -> Iterator[tuple[int, bytes]]:
    """(opcode, content) of each record of an unpacked chunk."""
    at = 0
    while at < len(data):
        if at + 9 > len(data):
            raise Malformed("a chunk ends inside a record")
        opcode, length = _PREFIX.unpack_from(data, at)
        at += 9
        if length > len(data) - at:
            raise Malformed("a record in a chunk is longer than the chunk")
        yield opcode, data[at : at + length]
        at += length


def salvaged(content: bytes) -> list[tuple[int, bytes]]:
    """Whole records at the head of a chunk that the end of the file cuts; its checksum cannot be checked any more.

    Empty where a flipped bit, not a cut, may be the reason.
    """
    try:
        box, stated = records.chunk_head(content)
        if box.size > LARGEST_CHUNK or stated <= len(box.data):
            return []
        return list(_whole(_head(box)))
    except Exception:  # whatever is wrong with it, there is nothing to be had
        return []


def _head(box: Chunk) -> bytes:
    if box.compression == "zstd":
        import zstandard

        if zstandard.frame_content_size(box.data) != box.size:  # type: ignore[attr-defined]
            return b""
        return zstandard.ZstdDecompressor().decompressobj().decompress(box.data)
    if box.compression == "lz4":
        import lz4.frame

        return lz4.frame.LZ4FrameDecompressor().decompress(box.data, max_length=box.size)
    return box.data


def _whole(data: bytes) -> Iterator[tuple[int, bytes]]:
    try:
        for opcode, content in inner(data):
            if opcode not in (records.SCHEMA, records.CHANNEL, records.MESSAGE):
                return
            yield opcode, content
    except Malformed:
        return
