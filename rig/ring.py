"""Memory that the loop and the logging process share: rows of numbers and a few words, written without waiting.

The loop writes a row and then says how many there are; the logging process reads up to there and says how far it is,
and since when all before is on the disk. Neither waits for the other; a row that finds no room is counted as lost.
"""

from __future__ import annotations

import mmap
import os
import struct
import tempfile
from typing import NamedTuple

from ljjax.rig.robot import Reading
from ljjax.rig.shared import Shared

NUMBERS = ("t", "state", "late_s", "busy_s", "missed", "rejected", "left", "right", "vacuum")
READINGS = tuple(name for name in Reading._fields if name not in ("joints", "faults"))
JOINTS = 16
"""The most joints whose angles are logged."""
ROWS = 4096
TEXT = 400
STARTING, RUNNING, FAILED, DONE = range(4)

_ROW = struct.Struct(f"<{len(NUMBERS) + len(READINGS) + JOINTS}dIH{TEXT}s")
_WRITTEN, _READ, _LOST, _SYNCED, _STATE = range(5)  # numbers of eight bytes each
_WORDS, _ROWS = 40, 1024  # where each begins [bytes]


class Row(NamedTuple):
    """A tick as it is logged: numbers by name (`NUMBERS`), what was read, each joint, and new faults in words."""

    numbers: dict[str, float]
    reading: Reading
    text: str


class Ring:
    """The shared memory, by its file descriptor; without one it is made."""

    def __init__(self, fd: int | None = None):
        size = _ROWS + ROWS * _ROW.size
        if fd is None:
            fd = _anonymous()
            os.ftruncate(fd, size)
        self.fd = fd
        self._at = mmap.mmap(fd, size)
        self._head = Shared(self._at, 5)
        self._count = self._get(_WRITTEN)

    def close(self) -> None:
        """Let the memory go."""
        self._head.close()
        self._at.close()
        os.close(self.fd)

    def put(self, numbers: tuple[float, ...], reading: Reading, text: str = "") -> None:
        """Add a row: `NUMBERS` in their order, a reading and words; some microseconds, never waits."""
        if self._count - self._get(_READ) >= ROWS:
            self._set(_LOST, self._get(_LOST) + 1)
            return
        joints = reading.joints[:JOINTS]
        words = text.encode("utf-8", "replace")[:TEXT]
        _ROW.pack_into(
            self._at, _ROWS + self._count % ROWS * _ROW.size, *numbers, *reading[: len(READINGS)], *joints,
            *(0.0,) * (JOINTS - len(joints)), len(joints), len(words), words,
        )  # fmt: skip
        self._count += 1
        self._set(_WRITTEN, self._count)

    def take(self) -> list[Row]:
        """The rows that have come since the last time."""
        first, last = self._get(_READ), self._get(_WRITTEN)
        rows = [self._row(k) for k in range(first, last)]
        self._set(_READ, last)
        return rows

    def _row(self, k: int) -> Row:
        *values, joints, length, words = _ROW.unpack_from(self._at, _ROWS + k % ROWS * _ROW.size)
        middle, end = len(NUMBERS), len(NUMBERS) + len(READINGS)
        reading = Reading(*values[middle:end], joints=tuple(values[end : end + joints]))
        return Row(dict(zip(NUMBERS, values[:middle], strict=True)), reading, words[:length].decode("utf-8", "ignore"))

    def say(self, state: int, words: str = "") -> None:
        """The logging process's state, and why."""
        raw = words.encode("utf-8", "replace")[:TEXT]
        self._at[_WORDS : _WORDS + TEXT] = raw.ljust(TEXT, b"\0")
        self._set(_STATE, state)

    @property
    def state(self) -> int:
        return self._get(_STATE)

    @property
    def words(self) -> str:
        return self._at[_WORDS : _WORDS + TEXT].rstrip(b"\0").decode("utf-8", "ignore")

    @property
    def lost(self) -> int:
        """Rows that found no room."""
        return self._get(_LOST)

    @property
    def synced(self) -> float:
        """All rows that were there at this time [s, monotonic] are on the disk."""
        return self._head.real[_SYNCED]

    @synced.setter
    def synced(self, t: float) -> None:
        self._head.real[_SYNCED] = t

    def _get(self, place: int) -> int:
        return self._head.whole[place]

    def _set(self, place: int, value: int) -> None:
        self._head.whole[place] = value


def _anonymous() -> int:
    """The descriptor of a file that has no name and, where the system can, no disk."""
    if hasattr(os, "memfd_create"):
        return os.memfd_create("ljjax-rig")
    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())
