"""An XM430-W350 that is not there: its control table, its bus watchdog, and the current it drives."""

from __future__ import annotations

from ljjax.rig import xm430
from ljjax.rig.xm430 import Register

RESULT_FAIL, INSTRUCTION, DATA_RANGE, DATA_LENGTH, ACCESS = 1, 2, 4, 5, 7
ALERT = 0x80
EEPROM_END = 64
SIZE = 256
GOALS = range(100, 120)
READ_ONLY = (range(0, 7), range(70, 71), range(120, 147))


class Servo:
    """One servo's control table and what follows from it."""

    def __init__(self, number: int):
        self.id = number
        self.travel_rad = 0.0
        self.powered = True
        self._heard = 0.0
        self._table = bytearray(SIZE)
        for register, value in (
            (xm430.MODEL, xm430.MODEL_NUMBER),
            (Register(6, 1), 46),
            (Register(7, 1), number),
            (xm430.RETURN_DELAY, 250),
            (xm430.OPERATING_MODE, 3),
            (xm430.CURRENT_LIMIT, 1193),
            (xm430.PRESENT_TEMPERATURE, 31),
            *(
                (Register(xm430.INDIRECT_ADDRESS + 2 * i, 2), xm430.INDIRECT_DATA + i)
                for i in range(xm430.INDIRECT_COUNT)
            ),
        ):
            self.put(register, value)

    def put(self, register: Register, value: int) -> None:
        """Set a register from inside, whatever guards it."""
        raw = (value & (1 << 8 * register.size) - 1).to_bytes(register.size, "little")
        self._table[register.address : register.address + register.size] = raw

    def get(self, register: Register) -> int:
        """A register's value, signed where it has more than a byte."""
        raw = int.from_bytes(self._table[register.address : register.address + register.size], "little")
        return xm430.signed(raw, register.size) if register.size > 1 else raw

    @property
    def alert(self) -> int:
        """The bit that every status packet carries while there is a hardware error."""
        return ALERT if self.get(xm430.HARDWARE_ERROR) else 0

    def read(self, address: int, size: int) -> tuple[int, bytes]:
        """Error number and bytes."""
        if address + size > SIZE:
            return ACCESS, b""
        return 0, bytes(self._table[self._where(address + i)] for i in range(size))

    def write(self, address: int, data: bytes) -> int:
        """The error number, 0 for none."""
        torque = self.get(xm430.TORQUE)
        at = [self._where(address + i) for i in range(len(data))] if address + len(data) <= SIZE else []
        if not data or not at:
            return DATA_LENGTH
        guarded = [a < EEPROM_END or xm430.INDIRECT_ADDRESS <= a < xm430.INDIRECT_DATA for a in at]
        if any(a in part for a in at for part in READ_ONLY) or (torque and any(guarded)):
            return ACCESS
        if any(a in GOALS for a in at) and self.get(xm430.WATCHDOG) == xm430.WATCHDOG_EXPIRED:
            return DATA_RANGE
        if address == xm430.GOAL_CURRENT.address and len(data) == 2:
            if abs(xm430.signed(int.from_bytes(data, "little"), 2)) > self.get(xm430.CURRENT_LIMIT):
                return DATA_RANGE
        if address == xm430.WATCHDOG.address and data[0] > 127:
            return DATA_RANGE
        if address == xm430.TORQUE.address and data[0] and self.get(xm430.HARDWARE_ERROR):
            return RESULT_FAIL
        for a, byte in zip(at, data, strict=True):
            self._table[a] = byte
        if address == xm430.TORQUE.address:
            self.put(xm430.GOAL_CURRENT, 0)
        return 0

    def _where(self, address: int) -> int:
        """Where the indirect data at an address are."""
        i = address - xm430.INDIRECT_DATA
        if not 0 <= i < xm430.INDIRECT_COUNT:
            return address
        at = self.get(Register(xm430.INDIRECT_ADDRESS + 2 * i, 2)) & 0xFFFF
        return at if at < SIZE else address

    def hear(self, now: float) -> None:
        """A packet went over the bus, for whomever: what the watchdog waits for."""
        self._heard = now

    def update(self, now: float) -> float:
        """The current driven at a time [s], in units; present values and the watchdog follow."""
        watchdog = self.get(xm430.WATCHDOG)
        torque = self.get(xm430.TORQUE) and not self.get(xm430.HARDWARE_ERROR)
        if torque and 0 < watchdog < 128 and now - self._heard > watchdog * xm430.WATCHDOG_S:
            self.put(xm430.WATCHDOG, xm430.WATCHDOG_EXPIRED)
            self.put(xm430.GOAL_CURRENT, 0)
        driven = self.get(xm430.GOAL_CURRENT) if torque and self.powered else 0
        if self.get(xm430.OPERATING_MODE) != xm430.CURRENT_MODE:
            driven = 0
        self.put(xm430.PRESENT_CURRENT, driven)
        self.put(xm430.PRESENT_POSITION, 2048 + round(self.travel_rad / xm430.RAD))
        return float(driven)

    def power(self, on: bool) -> None:
        """Take power away or give it back; what is not kept without power starts anew."""
        if on and not self.powered:
            kept = bytes(self._table[:EEPROM_END])
            self.__init__(self.id)
            self._table[:EEPROM_END] = kept
        self.powered = on

    def fail(self, bits: int) -> None:
        """A hardware error: torque goes off by itself."""
        self.put(xm430.HARDWARE_ERROR, bits)
        self.put(xm430.TORQUE, 0)
        self.put(xm430.GOAL_CURRENT, 0)
