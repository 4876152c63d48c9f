"""The few ROS 2 messages of the contract as CDR bytes: write and read, without a message compiler.

CDR aligns each number to its own size, counted from the end of the four-byte encapsulation header.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import NamedTuple

_LITTLE = b"\x00\x01\x00\x00"
_SLACK = 8  # bytes of padding that some middlewares leave at the end


class MalformedMessage(ValueError):
    """Bytes that are not the message they claim to be; `index` says which of several."""

    def __init__(self, why: str, index: int = 0):
        super().__init__(why)
        self.index = index


class JointState(NamedTuple):
    """One sensor_msgs/JointState: stamp in ns, and its lists."""

    t_ns: int
    frame_id: str
    name: tuple[str, ...]
    position: tuple[float, ...]
    velocity: tuple[float, ...]
    effort: tuple[float, ...]


class Scalars(NamedTuple):
    """A header and k doubles: FluidPressure (2), Temperature (2) or PoseStamped (7)."""

    t_ns: int
    frame_id: str
    value: tuple[float, ...]


def _aligned(out: bytearray, size: int) -> None:
    out.extend(bytes(-(len(out) - 4) % size))


def _put_string(out: bytearray, text: str) -> None:
    raw = text.encode() + b"\0"
    _aligned(out, 4)
    out += struct.pack("<I", len(raw)) + raw


def _put_header(t_ns: int, frame_id: str) -> bytearray:
    sec, nanosec = divmod(t_ns, 1_000_000_000)
    if not -(2**31) <= sec < 2**31:
        raise ValueError(f"stamp {t_ns} ns does not fit in a ROS 2 time")
    out = bytearray(_LITTLE + struct.pack("<iI", sec, nanosec))
    _put_string(out, frame_id)
    return out


def joint_state(
    t_ns: int,
    frame_id: str,
    name: Sequence[str],
    position: Sequence[float] = (),
    velocity: Sequence[float] = (),
    effort: Sequence[float] = (),
) -> bytes:
    """CDR of a sensor_msgs/JointState."""
    out = _put_header(t_ns, frame_id)
    _aligned(out, 4)
    out += struct.pack("<I", len(name))
    for item in name:
        _put_string(out, item)
    for values in (position, velocity, effort):
        _aligned(out, 4)
        out += struct.pack("<I", len(values))
        if len(values):
            _aligned(out, 8)
            out += struct.pack(f"<{len(values)}d", *values)
    return bytes(out)


def scalars(t_ns: int, frame_id: str, value: Sequence[float]) -> bytes:
    """CDR of a header followed by doubles: FluidPressure, Temperature, PoseStamped."""
    out = _put_header(t_ns, frame_id)
    _aligned(out, 8)
    out += struct.pack(f"<{len(value)}d", *value)
    return bytes(out)


def diagnostic_array(t_ns: int, status: Sequence[tuple[int, str, str, str, Sequence[tuple[str, str]]]]) -> bytes:
    """CDR of a diagnostic_msgs/DiagnosticArray; a status is (level, name, message, hardware_id, (key, value) pairs)."""
    out = _put_header(t_ns, "")
    _aligned(out, 4)
    out += struct.pack("<I", len(status))
    for level, name, message, hardware_id, values in status:
        out.append(level)
        for text in (name, message, hardware_id):
            _put_string(out, text)
        _aligned(out, 4)
        out += struct.pack("<I", len(values))
        for key, value in values:
            _put_string(out, key)
            _put_string(out, value)
    return bytes(out)


class _Cursor:
    """Reads CDR from a buffer; every length is checked against what is there."""

    def __init__(self, data: bytes):
        if len(data) < 4 or data[0] != 0 or data[1] > 1:
            raise MalformedMessage(f"no plain CDR header in {data[:4].hex(' ') or 'no bytes'}")
        self.data, self.at, self.order = data, 4, "<" if data[1] else ">"

    def take(self, code: str, size: int, count: int) -> tuple:
        if count == 0:
            return ()
        at = self.at + (-(self.at - 4) % size)
        if at + size * count > len(self.data):
            raise MalformedMessage(f"{count} values of {size} bytes do not fit in a message of {len(self.data)} bytes")
        self.at = at + size * count
        return struct.unpack_from(f"{self.order}{count}{code}", self.data, at)

    def string(self) -> str:
        (length,) = self.take("I", 4, 1)
        if self.at + length > len(self.data):
            raise MalformedMessage(f"a string of {length} bytes does not fit in a message of {len(self.data)} bytes")
        raw = self.data[self.at : self.at + length]
        self.at += length
        try:
            return raw.rstrip(b"\0").decode()
        except UnicodeDecodeError:
            raise MalformedMessage("a string is not UTF-8") from None

    def header(self) -> tuple[int, str]:
        (sec,) = self.take("i", 4, 1)
        (nanosec,) = self.take("I", 4, 1)
        if nanosec >= 1_000_000_000:
            raise MalformedMessage(f"a stamp with {nanosec} nanoseconds")
        return sec * 1_000_000_000 + nanosec, self.string()

    def end(self) -> None:
        if len(self.data) - self.at >= _SLACK:
            raise MalformedMessage(f"{len(self.data) - self.at} bytes are left over at the end")


def read_joint_states(messages: Sequence[bytes]) -> list[JointState]:
    """JointState messages; the layout of one makes the next of the same shape fast. Raises MalformedMessage."""
    found: list[JointState] = []
    stamp, counts = struct.Struct("<iI"), struct.Struct("<I")
    size, names, floats, last = -1, b"", [], None
    for i, data in enumerate(messages):
        if last is not None and len(data) == size and data[:4] == _LITTLE and data[12 : 12 + len(names)] == names:
            arrays = []
            for at, start, form in floats:
                if counts.unpack_from(data, at)[0] * 8 != form.size:
                    break
                arrays.append(form.unpack_from(data, start))
            sec, nanosec = stamp.unpack_from(data, 4)
            if len(arrays) == 3 and nanosec < 1_000_000_000:
                found.append(JointState(sec * 1_000_000_000 + nanosec, last.frame_id, last.name, *arrays))
                continue
        try:
            last, names_end, places = _joint_state(data)
        except MalformedMessage as error:
            raise MalformedMessage(str(error), i) from None
        size, names = len(data), data[12:names_end]
        floats = [(at, at + 4 + (-at % 8 if n else 0), struct.Struct(f"<{n}d")) for at, n in places]
        found.append(last)
    return found


def _joint_state(data: bytes) -> tuple[JointState, int, list[tuple[int, int]]]:
    """(message, where its names end, where the count of each array stands and what it is)."""
    cursor = _Cursor(data)
    t_ns, frame_id = cursor.header()
    (count,) = cursor.take("I", 4, 1)
    if count > len(data):
        raise MalformedMessage(f"{count} names do not fit in a message of {len(data)} bytes")
    name = tuple(cursor.string() for _ in range(count))
    names_end = cursor.at
    arrays, places = [], []
    for _ in range(3):
        (count,) = cursor.take("I", 4, 1)
        places.append((cursor.at - 4, count))
        arrays.append(cursor.take("d", 8, count))
    cursor.end()
    return JointState(t_ns, frame_id, name, *arrays), names_end, places


def read_scalars(messages: Sequence[bytes], count: int) -> list[Scalars]:
    """Messages of a header and `count` doubles, as above. Raises MalformedMessage."""
    found: list[Scalars] = []
    stamp, doubles = struct.Struct("<iI"), struct.Struct(f"<{count}d")
    size, frame, frame_id, start = -1, b"", "", 0
    for i, data in enumerate(messages):
        if len(data) == size and data[:4] == _LITTLE and data[12 : 12 + len(frame)] == frame:
            sec, nanosec = stamp.unpack_from(data, 4)
            if nanosec < 1_000_000_000:
                found.append(Scalars(sec * 1_000_000_000 + nanosec, frame_id, doubles.unpack_from(data, start)))
                continue
        try:
            cursor = _Cursor(data)
            t_ns, frame_id = cursor.header()
            size, frame = len(data), data[12 : cursor.at]
            value = cursor.take("d", 8, count)
            start = cursor.at - doubles.size
            cursor.end()
        except MalformedMessage as error:
            raise MalformedMessage(str(error), i) from None
        found.append(Scalars(t_ns, frame_id, value))
    return found
