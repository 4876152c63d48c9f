"""Packets of the Dynamixel protocol 2.0, as a servo reads and writes them."""

from __future__ import annotations

from typing import NamedTuple

HEADER = b"\xff\xff\xfd"
BROADCAST = 0xFE
PING, READ, WRITE, STATUS = 0x01, 0x02, 0x03, 0x55
SYNC_READ, SYNC_WRITE = 0x82, 0x83
LONGEST = 256


def _crc_table() -> list[int]:
    table = []
    for byte in range(256):
        value = byte << 8
        for _ in range(8):
            value = (value << 1) ^ (0x8005 if value & 0x8000 else 0)
        table.append(value & 0xFFFF)
    return table


_TABLE = _crc_table()


def crc16(data: bytes) -> int:
    """CRC-16 with polynomial 0x8005, from 0, highest bit first."""
    value = 0
    for byte in data:
        value = (value << 8 & 0xFFFF) ^ _TABLE[value >> 8 ^ byte]
    return value


class Packet(NamedTuple):
    """An instruction: whom it is for, what to do, and with what."""

    servo: int
    instruction: int
    data: bytes


def build(servo: int, instruction: int, data: bytes) -> bytes:
    """A packet's bytes; a header inside the data gets a byte 0xFD more, so that it is not taken for one."""
    inside = bytes([instruction]) + data
    inside = inside.replace(HEADER, HEADER + b"\xfd")
    head = HEADER + bytes([0, servo]) + (len(inside) + 2).to_bytes(2, "little") + inside
    return head + crc16(head).to_bytes(2, "little")


def status(servo: int, error: int, data: bytes = b"") -> bytes:
    """What a servo answers."""
    return build(servo, STATUS, bytes([error]) + data)


class Reader:
    """Packets out of a stream of bytes; damaged ones are passed over, as a servo does."""

    def __init__(self) -> None:
        self._held = b""

    def forget(self) -> None:
        """Drop the beginning of a packet whose rest did not come in time."""
        self._held = b""

    def feed(self, data: bytes) -> list[Packet]:
        """The packets completed by more bytes."""
        self._held += data
        found = []
        while (at := self._held.find(HEADER)) >= 0:
            rest = self._held[at:]
            if len(rest) < 7:
                self._held = rest
                return found
            length = int.from_bytes(rest[5:7], "little")
            if rest[3] != 0 or not 3 <= length <= LONGEST:
                self._held = rest[3:]
                continue
            if len(rest) < 7 + length:
                self._held = rest
                return found
            whole = rest[: 7 + length]
            if crc16(whole[:-2]) != int.from_bytes(whole[-2:], "little"):
                self._held = rest[3:]
                continue
            inside = whole[7:-2].replace(HEADER + b"\xfd", HEADER)
            found.append(Packet(whole[4], inside[0], inside[1:]))
            self._held = rest[7 + length :]
        self._held = self._held[-2:]
        return found
