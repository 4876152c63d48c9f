"""An MCAP file being written: checksums everywhere, small chunks, nothing kept back for long."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from ljjax.errors import InputError
from ljjax.logs import contract, records

CHUNK_BYTES = 64 * 1024
FLUSH_NS = 1_000_000_000
_NO_METADATA: dict[str, str] = {}


class Sink:
    """An MCAP file being written: schemas and channels on first use, messages in small chunks with checksums.

    The bytes depend on nothing but what is written. A chunk is closed, and handed to the operating system,
    when it is full or when a second of log time has passed since the last.
    """

    def __init__(self, path: str | os.PathLike[str], library: str):
        from mcap.writer import CompressionType
        from mcap.writer import Writer as McapWriter

        self.path = os.fspath(path)
        try:
            self._file = Path(path).open("wb")
        except OSError as error:
            raise InputError(f"{self.path}: cannot be written ({error.strerror or error})") from None
        self._mcap = McapWriter(
            self._file,
            chunk_size=CHUNK_BYTES,
            compression=CompressionType.ZSTD,
            enable_crcs=True,
            enable_data_crcs=True,
        )
        self._mcap.start(profile="ros2", library=library)
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        self._channels: dict[tuple, int] = {}
        self._flushed_ns: int | None = None

    def channel(self, topic: str, type_name: str, encoding: str, text: bytes, message_encoding: str = "cdr",
                metadata: Mapping[str, str] = _NO_METADATA) -> int:  # fmt: skip
        """The id of a channel, made on first use."""
        schema_key = (type_name, encoding, text)
        if schema_key not in self._schemas:
            self._schemas[schema_key] = self._mcap.register_schema(type_name, encoding, text)
        return self._channel((topic, self._schemas[schema_key], message_encoding, tuple(metadata.items())))

    def channel_without_schema(
        self, topic: str, message_encoding: str, metadata: Mapping[str, str] = _NO_METADATA
    ) -> int:
        return self._channel((topic, 0, message_encoding, tuple(metadata.items())))

    def _channel(self, key: tuple) -> int:
        if key not in self._channels:
            topic, schema_id, message_encoding, metadata = key
            self._channels[key] = self._mcap.register_channel(topic, message_encoding, schema_id, dict(metadata))
        return self._channels[key]

    def contract_channel(self, topic: str, type_name: str) -> int:
        return self.channel(topic, type_name, "ros2msg", contract.SCHEMAS[type_name].encode())

    def message(self, channel_id: int, log_ns: int, publish_ns: int, data: bytes, sequence: int = 0) -> None:
        self._mcap.add_message(channel_id, log_ns, data, publish_ns, sequence)
        if self._flushed_ns is None:
            self._flushed_ns = log_ns
        elif log_ns - self._flushed_ns >= FLUSH_NS:
            self.flush()
            self._flushed_ns = log_ns

    def metadata(self, name: str, pairs: Mapping[str, str], seal: bool = True) -> None:
        """A metadata record; sealed, it also states its own sha256."""
        record = dict(pairs)
        if seal:
            record["sha256"] = records.own_sha256(record)
        self._mcap.add_metadata(name, record)
        self._file.flush()

    def attachment(self, t_ns: int, name: str, media_type: str, data: bytes) -> None:
        self._mcap.add_attachment(t_ns, t_ns, name, media_type, data)

    def flush(self, sync: bool = False) -> None:
        """Close the chunk and hand everything to the operating system; with `sync`, wait until it is on the disk."""
        self._mcap.flush()
        if sync:
            os.fsync(self._file.fileno())

    def close(self) -> None:
        if not self._file.closed:
            self._mcap.finish()
            self._file.close()

    def abandon(self) -> None:
        """Close the file without finishing it."""
        self._file.close()
