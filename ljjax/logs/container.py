"""An MCAP file walked from front to back, checked on the way: what a reader or a copier may rely on.

The walk goes on as long as everything holds. At the first thing that does not, it keeps what came before,
says where and why (`Damage`), and from there on only looks for the run's metadata.
"""

from __future__ import annotations

import hashlib
import os
import zlib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from ljjax.errors import InputError
from ljjax.logs import chunks, contract, records, summary
from ljjax.logs.records import Channel, Malformed, Message, Schema
from ljjax.logs.run import Damage

NO_CHECKSUM = "no checksums: silent damage cannot be excluded"


@dataclass
class Container:
    """What a log holds, as far as it could be verified.

    Attributes:
        path, sha256, library: of the file.
        channels, schemas: by id.
        messages: those of the topics asked for, in file order.
        counts: messages by channel id, all topics.
        metadata: (name, pairs) in file order; a record whose own sha256 fails is left out.
        attachments: name → (media type, content), where asked for.
        damage: the first thing that does not hold.
        notes: what the reader of the data should know.
    """

    path: str
    sha256: str = ""
    library: str = ""
    channels: dict[int, Channel] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    messages: list[Message] = field(default_factory=list)
    counts: Counter[int] = field(default_factory=Counter)
    metadata: list[tuple[str, dict[str, str]]] = field(default_factory=list)
    attachments: dict[str, tuple[str, bytes]] = field(default_factory=dict)
    damage: Damage | None = None
    notes: list[str] = field(default_factory=list)

    def record(self, name: str) -> dict[str, str] | None:
        """The last metadata record of that name."""
        return next((pairs for n, pairs in reversed(self.metadata) if n == name), None)

    def topics(self) -> dict[str, list[Channel]]:
        found: dict[str, list[Channel]] = {}
        for channel in self.channels.values():
            found.setdefault(channel.topic, []).append(channel)
        return found


def scan(path: str | os.PathLike[str], wanted: Callable[[str], bool], attachments: bool = False) -> Container:
    """Walk a file, keeping the messages of the wanted topics.

    Raises InputError where it is no MCAP file, or where nothing in it can be trusted.
    """
    name = os.fspath(path)
    try:
        with Path(path).open("rb") as stream:
            return Walk(name, stream, wanted, attachments).run()
    except FileNotFoundError:
        raise InputError(f"{name}: no such file") from None
    except IsADirectoryError:
        raise InputError(f"{name}: is a folder, expected an MCAP file") from None
    except OSError as error:
        raise InputError(f"{name}: cannot be read ({error.strerror or error})") from None
    except MemoryError:
        raise InputError(f"{name}: does not fit in memory") from None


class Walk:
    def __init__(self, name: str, stream: BinaryIO, wanted: Callable[[str], bool], attachments: bool):
        self.out = Container(name)
        self.stream, self.wanted, self.keep_attachments = stream, wanted, attachments
        self.size = os.fstat(stream.fileno()).st_size
        self.at, self.crc, self.sha = 0, 0, hashlib.sha256()
        self.keep: set[int] = set()
        self.sealed_ids: set[int] = set()  # channels and schemas (+ 1 << 16) that a chunk's checksum vouches for
        self.first_ns = self.last_ns = -1
        self.bare = 0  # messages that no checksum of their own covers
        self.n_chunks = self.n_metadata = 0
        self.unsealed_run = False
        self.found_metadata: set[tuple[int, str]] = set()
        self.data_crc = 0
        self.expected_attachments: dict[str, str] = {}
        self.attachment_sha: dict[str, tuple[str, str]] = {}

    def take(self, length: int) -> bytes:
        data = self.stream.read(length)
        self.at += len(data)
        self.crc = zlib.crc32(data, self.crc)
        self.sha.update(data)
        return data

    def damaged(self, at: int, why: str) -> None:
        if self.out.damage is None:
            after = "before the first sample"
            if self.last_ns >= 0:
                after = f"after t = {(self.last_ns - self.first_ns) / 1e9:.3f} s of log time"
            self.out.damage = Damage(f"byte {at} of {self.size} ({after})", why)

    def run(self) -> Container:
        if self.take(len(records.MAGIC)) != records.MAGIC:
            raise InputError(f"{self.out.path}: is not an MCAP file (it does not begin with the MCAP signature)")
        if self.data_section():
            summary.check(self)
        while self.take(1 << 20):
            pass
        self.out.sha256 = self.sha.hexdigest()
        self.check_attachments()
        if not self.data_crc:
            if self.bare:
                self.out.notes.append(f"{self.bare} messages have {NO_CHECKSUM}")
            if self.unsealed_run:
                self.out.notes.append(f"metadata {contract.RUN_RECORD} has no checksum")
        return self.out

    def next_record(self) -> tuple[int, int, bytes] | None:
        """(offset, opcode, content), or None where the file is cut or a length is absurd (that is noted)."""
        start = self.at
        if start == self.size:
            self.damaged(start, "the file ends here without its closing records: it was cut, or its writer stopped")
            return None
        prefix = self.take(9)
        length = int.from_bytes(prefix[1:], "little")
        if len(prefix) < 9 or length > self.size - self.at:
            self.cut(start, prefix)
            return None
        content = self.take(length)
        if len(content) != length:
            self.damaged(start, "the file became shorter while it was read")
            return None
        return start, prefix[0], content

    def cut(self, start: int, prefix: bytes) -> None:
        """The file ends inside a record; of a chunk, what can still be had counts, and is said to be unchecked."""
        why = "the file is cut inside a record, or the record's length is wrong"
        left = self.size - self.at
        rest = (
            chunks.salvaged(self.take(left)) if prefix[:1] == bytes([records.CHUNK]) and self.out.damage is None else []
        )
        before = self.bare
        try:
            self.contents(rest, sealed=False)
        except Malformed:
            pass
        if self.bare > before:
            why += f"; the last {self.bare - before} messages are from the cut chunk, and could not be checked"
        self.damaged(start, why)

    def data_section(self) -> bool:
        """Walk up to the end of the data; True where that end was reached soundly."""
        expect_header = True
        while True:
            crc_before = self.crc
            record = self.next_record()
            if record is None:
                return False
            start, opcode, content = record
            try:
                if expect_header != (opcode == records.HEADER):
                    raise Malformed("the header record is missing or there is a second one")
                expect_header = False
                if opcode == records.DATA_END:
                    self.data_crc = records.data_end(content)
                    if self.data_crc and self.data_crc != crc_before:
                        self.data_crc_fails(start)
                    return True
                self.data_record(start, opcode, content)
            except Malformed as error:
                self.damaged(start, f"{error}; what follows is left out")

    def data_crc_fails(self, at: int) -> None:
        if self.out.damage is None and self.bare:
            raise InputError(
                f"{self.out.path}: the checksum of the data section (byte {at}) fails and {self.bare} messages have "
                "none of their own, so no sample can be trusted; take an undamaged copy of the file, or record in "
                "chunks"
            )
        why = "the checksum of the data section fails though each chunk holds: something beside the chunks is altered"
        self.damaged(at, why + (f" (perhaps metadata {contract.RUN_RECORD})" if self.unsealed_run else ""))

    def data_record(self, start: int, opcode: int, content: bytes) -> None:
        if opcode == records.HEADER:
            self.out.library = records.header(content)[1]
        elif opcode == records.METADATA:
            self.metadata(start, *records.metadata(content))
        elif opcode == records.CHUNK:
            if self.out.damage is None:
                self.chunk(records.chunk(content))
        elif opcode == records.ATTACHMENT:
            name, media, data = records.attachment(content)
            self.attachment_sha[name] = hashlib.sha256(data).hexdigest(), f"byte {start}"
            if self.keep_attachments:
                self.out.attachments[name] = media, data
        elif opcode == records.MESSAGE_INDEX:
            records.message_index(content)
        elif opcode in (records.SCHEMA, records.CHANNEL, records.MESSAGE):
            if self.out.damage is None:
                self.contents([(opcode, content)], sealed=False)
        elif opcode < records.PRIVATE:
            raise Malformed(f"a record of the unknown or misplaced kind {opcode}")
        elif records.looks_like_a_record(content, opcode - records.PRIVATE):
            raise Malformed(
                f"a record of kind {opcode} reads as one of kind {opcode - records.PRIVATE}: a bit is wrong"
            )

    def chunk(self, box: records.Chunk) -> None:
        """All of a chunk or, where it is wrong, nothing of it."""
        data = chunks.unpacked(box)
        parsed = []
        for opcode, content in chunks.inner(data):
            if opcode in (records.SCHEMA, records.CHANNEL, records.MESSAGE):
                parsed.append((opcode, content))
            elif opcode < records.PRIVATE:
                raise Malformed(f"a chunk holds a record of kind {opcode}")
        self.contents(parsed, sealed=box.crc != 0)
        self.n_chunks += 1

    def contents(self, found: list[tuple[int, bytes]], sealed: bool) -> None:
        """Take schemas, channels and messages, in their order. `sealed`: a checksum of their own covers them."""
        start = 0
        for i, (opcode, content) in enumerate(found):
            if opcode != records.MESSAGE:
                self.messages([data for _, data in found[start:i]], sealed)
                self.definition(opcode, content, sealed)
                start = i + 1
        self.messages([data for _, data in found[start:]], sealed)

    def messages(self, contents: list[bytes], sealed: bool) -> None:
        out = self.out
        for message in records.messages(contents):
            if message.channel_id not in out.channels:
                raise Malformed(f"a message of channel {message.channel_id}, which nothing describes")
            out.counts[message.channel_id] += 1
            self.bare += not sealed
            if self.first_ns < 0:
                self.first_ns = message.log_ns
            if message.log_ns > self.last_ns:
                self.last_ns = message.log_ns
            if message.channel_id in self.keep:
                out.messages.append(message)

    def definition(self, opcode: int, content: bytes, sealed: bool) -> None:
        if opcode == records.SCHEMA:
            schema = records.schema(content)
            self.define(self.out.schemas, schema.id, schema, schema.id + (1 << 16), sealed)
        else:
            channel = records.channel(content)
            self.define(self.out.channels, channel.id, channel, channel.id, sealed)
            (self.keep.add if self.wanted(channel.topic) else self.keep.discard)(channel.id)

    def define(self, table: dict, key: int, value: Schema | Channel, seal: int, sealed: bool) -> None:
        """Take a definition; where two differ, the one that a checksum covers holds, and the file is damaged."""
        known = table.get(key)
        if known is not None and known != value:
            if seal in self.sealed_ids or not sealed or self.out.counts[key]:
                raise Malformed(f"{type(value).__name__.lower()} {key} is defined twice and differently")
            self.damaged(self.at, f"{type(value).__name__.lower()} {key} differs outside and inside the chunks")
        table[key] = value
        if sealed:
            self.sealed_ids.add(seal)

    def metadata(self, start: int, name: str, pairs: dict[str, str]) -> None:
        self.n_metadata += 1
        self.found_metadata.add((start, name))
        if "sha256" in pairs and name in (contract.RUN_RECORD, contract.ATTACHMENT_RECORD):
            if pairs["sha256"] != records.own_sha256(pairs):
                raise Malformed(f"metadata {name} does not have the sha256 it states")
        elif name == contract.RUN_RECORD:
            self.unsealed_run = True
        if name == contract.ATTACHMENT_RECORD:
            self.expected_attachments.update({k[7:]: v for k, v in pairs.items() if k.startswith("sha256:")})
        self.out.metadata.append((name, pairs))

    def check_attachments(self) -> None:
        for name, (sha, place) in self.attachment_sha.items():
            if self.expected_attachments.get(name, sha) != sha:
                self.damaged(int(place.split()[1]), f"attachment {name!r} does not have the sha256 the log states")
                self.out.attachments.pop(name, None)
