"""MCAP records, parsed strictly: lengths must fit, strings must be UTF-8, nothing may be left over.

A file may be damaged anywhere, so every parser raises `Malformed` and nothing else.
"""

from __future__ import annotations

import hashlib
import json
import struct
import zlib
from collections.abc import Mapping, Sequence
from typing import NamedTuple

MAGIC = b"\x89MCAP0\r\n"
(HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX, ATTACHMENT, ATTACHMENT_INDEX, STATISTICS,
 METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END) = range(1, 16)  # fmt: skip
PRIVATE = 0x80  # opcodes from here on are the writer's own

_U16, _U32, _U64 = struct.Struct("<H"), struct.Struct("<I"), struct.Struct("<Q")
_MESSAGE = struct.Struct("<HIQQ")


class Malformed(ValueError):
    """These bytes are not the record they claim to be."""


class Schema(NamedTuple):
    id: int
    name: str
    encoding: str
    data: bytes


class Channel(NamedTuple):
    id: int
    schema_id: int
    topic: str
    encoding: str
    metadata: tuple[tuple[str, str], ...]


class Message(NamedTuple):
    channel_id: int
    sequence: int
    log_ns: int
    publish_ns: int
    data: bytes


class Chunk(NamedTuple):
    compression: str
    size: int
    crc: int
    data: bytes


class _Fields:
    def __init__(self, data: bytes):
        self.data, self.at = data, 0

    def number(self, form: struct.Struct) -> int:
        if self.at + form.size > len(self.data):
            raise Malformed("it ends too early")
        (value,) = form.unpack_from(self.data, self.at)
        self.at += form.size
        return value

    def raw(self, length: int) -> bytes:
        if length > len(self.data) - self.at:
            raise Malformed(f"a field claims {length} bytes where {len(self.data) - self.at} are left")
        self.at += length
        return self.data[self.at - length : self.at]

    def text(self) -> str:
        try:
            return self.raw(self.number(_U32)).decode()
        except UnicodeDecodeError:
            raise Malformed("a string is not UTF-8") from None

    def pairs(self) -> tuple[tuple[str, str], ...]:
        inner = _Fields(self.raw(self.number(_U32)))
        found = []
        while inner.at < len(inner.data):
            found.append((inner.text(), inner.text()))
        return tuple(found)

    def end(self) -> None:
        if self.at != len(self.data):
            raise Malformed(f"{len(self.data) - self.at} bytes are left over")


def header(data: bytes) -> tuple[str, str]:
    """(profile, library)."""
    f = _Fields(data)
    found = f.text(), f.text()
    f.end()
    return found


def schema(data: bytes) -> Schema:
    f = _Fields(data)
    found = Schema(f.number(_U16), f.text(), f.text(), f.raw(f.number(_U32)))
    f.end()
    if found.id == 0:
        raise Malformed("a schema has the id 0")
    return found


def channel(data: bytes) -> Channel:
    f = _Fields(data)
    found = Channel(f.number(_U16), f.number(_U16), f.text(), f.text(), f.pairs())
    f.end()
    return found


def message(data: bytes) -> Message:
    return messages([data])[0]


def messages(contents: Sequence[bytes]) -> list[Message]:
    """Many at once, since a log has many."""
    found = []
    for data in contents:
        if len(data) < _MESSAGE.size:
            raise Malformed("a message ends too early")
        channel_id, sequence, log_ns, publish_ns = _MESSAGE.unpack_from(data)
        if log_ns >> 63 or publish_ns >> 63:
            raise Malformed("a message has a time beyond the year 2262")
        found.append(Message(channel_id, sequence, log_ns, publish_ns, data[_MESSAGE.size :]))
    return found


def chunk(data: bytes) -> Chunk:
    found, length = chunk_head(data)
    if length != len(found.data):
        raise Malformed(f"a chunk claims {length} bytes of content and has {len(found.data)}")
    return found


def chunk_head(data: bytes) -> tuple[Chunk, int]:
    """A chunk of which the end may be missing, and how many bytes of content it claims."""
    f = _Fields(data)
    f.raw(16)  # earliest and latest log time
    size, crc, compression, length = f.number(_U64), f.number(_U32), f.text(), f.number(_U64)
    if compression not in ("", "zstd", "lz4"):
        raise Malformed(f"a chunk has the unknown compression {compression!r}")
    return Chunk(compression, size, crc, data[f.at :]), length


def metadata(data: bytes) -> tuple[str, dict[str, str]]:
    """(name, pairs)."""
    f = _Fields(data)
    name, pairs = f.text(), f.pairs()
    f.end()
    if len(dict(pairs)) != len(pairs):
        raise Malformed("a metadata record has a key twice")
    return name, dict(pairs)


def attachment(data: bytes) -> tuple[str, str, bytes]:
    """(name, media type, content); its checksum is checked where there is one."""
    f = _Fields(data)
    f.raw(16)  # log time, time of creation
    name, media, content = f.text(), f.text(), f.raw(f.number(_U64))
    at, crc = f.at, f.number(_U32)
    f.end()
    if crc and zlib.crc32(memoryview(data)[:at]) != crc:
        raise Malformed(f"the checksum of the attachment {name!r} fails")
    return name, media, content


def message_index(data: bytes) -> int:
    """The channel id."""
    f = _Fields(data)
    channel_id, entries = f.number(_U16), f.raw(f.number(_U32))
    f.end()
    if len(entries) % 16:
        raise Malformed("a message index has an odd length")
    return channel_id


def data_end(data: bytes) -> int:
    """The checksum of the data section, 0 for none."""
    f = _Fields(data)
    crc = f.number(_U32)
    f.end()
    return crc


def footer(data: bytes) -> tuple[int, int]:
    """(start of the summary or 0, its checksum or 0)."""
    f = _Fields(data)
    start, _, crc = f.number(_U64), f.number(_U64), f.number(_U32)
    f.end()
    return start, crc


def statistics(data: bytes) -> tuple[int, int, dict[int, int]]:
    """(metadata records, chunks, messages by channel id)."""
    f = _Fields(data)
    f.raw(18)  # numbers of messages, schemas, channels, attachments
    n_metadata, n_chunks = f.number(_U32), f.number(_U32)
    f.raw(16)  # earliest and latest log time
    inner = _Fields(f.raw(f.number(_U32)))
    f.end()
    counts = {}
    while inner.at < len(inner.data):
        channel_id = inner.number(_U16)
        counts[channel_id] = inner.number(_U64)
    return n_metadata, n_chunks, counts


def metadata_index(data: bytes) -> tuple[int, str]:
    """(offset, name)."""
    f = _Fields(data)
    offset, _, name = f.number(_U64), f.number(_U64), f.text()
    f.end()
    return offset, name


PARSERS = {HEADER: header, FOOTER: footer, SCHEMA: schema, CHANNEL: channel, MESSAGE: message, CHUNK: chunk,
           MESSAGE_INDEX: message_index, ATTACHMENT: attachment, METADATA: metadata, DATA_END: data_end}  # fmt: skip


def looks_like_a_record(data: bytes, opcode: int) -> bool:
    """Whether content of an unknown opcode reads as a record of a known one (a flipped bit hides it)."""
    known = PARSERS.get(opcode)
    if known is None:
        return False
    try:
        known(data)
    except Malformed:
        return False
    return True


def own_sha256(pairs: Mapping[str, str]) -> str:
    """SHA-256 of a metadata record without its `sha256` entry: compact JSON, keys sorted, UTF-8."""
    text = json.dumps({k: v for k, v in pairs.items() if k != "sha256"}, sort_keys=True, separators=(",", ":"),
                      ensure_ascii=False)  # fmt: skip
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()
