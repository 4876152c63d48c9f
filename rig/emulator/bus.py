"""The servos' bus: answers the Dynamixel protocol 2.0 on a line, with whatever faults there are on it."""

from __future__ import annotations

import random
from collections.abc import Sequence

from ljjax.rig.emulator import packets, servo
from ljjax.rig.emulator.lines import Line
from ljjax.rig.emulator.packets import BROADCAST, Packet
from ljjax.rig.emulator.servo import Servo

GAP_S = 0.05
"""A packet whose rest takes longer than this is forgotten [s]."""


class Bus:
    """Servos on a line.

    Attributes:
        loss, corrupt: shares of packets lost and damaged on their way, each way.
    """

    def __init__(self, line: Line, servos: Sequence[Servo], seed: int = 0):
        self.line, self.servos = line, list(servos)
        self.loss = self.corrupt = 0.0
        self._random = random.Random(seed)
        self._reader = packets.Reader()
        self._heard = 0.0

    def serve(self, now: float) -> None:
        """Answer what came in by a time [s]."""
        data = self.line.read()
        if not data:
            return
        if now - self._heard > GAP_S:
            self._reader.forget()
        self._heard = now
        for packet in self._reader.feed(self._travel(data)):
            for one in self.servos:
                one.hear(now)
            answer = b"".join(self._travel(reply) for reply in self._replies(packet))
            if answer:
                self.line.write(answer)

    def _travel(self, data: bytes) -> bytes:
        """What arrives of a packet."""
        if self._random.random() < self.loss:
            return b""
        if self._random.random() < self.corrupt:
            at = self._random.randrange(len(data))
            return data[:at] + bytes([data[at] ^ (1 << self._random.randrange(8))]) + data[at + 1 :]
        return data

    def _replies(self, packet: Packet) -> list[bytes]:
        alive = [one for one in self.servos if one.powered]
        data = packet.data
        if packet.instruction == packets.SYNC_WRITE:
            address, size = _words(data)
            rest = data[4:]
            for at in range(0, len(rest) - size, size + 1):
                for one in alive:
                    if one.id == rest[at]:
                        one.write(address, rest[at + 1 : at + 1 + size])
            return []
        if packet.instruction == packets.SYNC_READ:
            address, size = _words(data)
            asked = [one for number in data[4:] for one in alive if one.id == number]
            return [self._read(one, address, size) for one in asked]
        chosen = [one for one in alive if packet.servo in (one.id, BROADCAST)]
        replies = [self._reply(one, packet) for one in chosen]
        return replies if packet.servo != BROADCAST or packet.instruction == packets.PING else []

    def _reply(self, one: Servo, packet: Packet) -> bytes:
        data = packet.data
        if packet.instruction == packets.PING:
            return packets.status(one.id, one.alert, one.read(0, 2)[1] + one.read(6, 1)[1])
        if packet.instruction == packets.READ and len(data) == 4:
            return self._read(one, *_words(data))
        if packet.instruction == packets.WRITE and len(data) > 2:
            error = one.write(int.from_bytes(data[:2], "little"), data[2:])
            return packets.status(one.id, error | one.alert)
        return packets.status(one.id, servo.INSTRUCTION | one.alert)

    def _read(self, one: Servo, address: int, size: int) -> bytes:
        error, data = one.read(address, size)
        return packets.status(one.id, error | one.alert, data)


def _words(data: bytes) -> tuple[int, int]:
    """Address and size at the beginning of an instruction's data."""
    return int.from_bytes(data[:2], "little"), int.from_bytes(data[2:4], "little")
