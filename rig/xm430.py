"""The servo XM430-W350 as its maker documents it: registers, units, and its error register in words."""

from __future__ import annotations

import math
from typing import NamedTuple


class Register(NamedTuple):
    """Where a value stands in the control table, and its bytes (little-endian, two's complement)."""

    address: int
    size: int


MODEL_NUMBER = 1020
CURRENT_MA = 2.69
"""A unit of current [mA]."""
TURN = 4096
"""Units of position in a turn of the spool."""
RAD = 2 * math.pi / TURN
"""A unit of position [rad]."""
WATCHDOG_S = 0.02
"""A unit of the bus watchdog [s]."""
WATCHDOG_EXPIRED = 0xFF
CURRENT_MODE = 0

MODEL = Register(0, 2)
RETURN_DELAY = Register(9, 1)
OPERATING_MODE = Register(11, 1)
CURRENT_LIMIT = Register(38, 2)
TORQUE = Register(64, 1)
HARDWARE_ERROR = Register(70, 1)
WATCHDOG = Register(98, 1)
GOAL_CURRENT = Register(102, 2)
PRESENT_CURRENT = Register(126, 2)
PRESENT_POSITION = Register(132, 4)
PRESENT_TEMPERATURE = Register(146, 1)
INDIRECT_ADDRESS = 168
INDIRECT_DATA = 224
INDIRECT_COUNT = 28

BLOCK = (PRESENT_CURRENT, PRESENT_POSITION, PRESENT_TEMPERATURE, HARDWARE_ERROR, WATCHDOG, TORQUE)
"""What is read every tick, side by side through the servo's indirect addresses so that one short read gets it all."""
BLOCK_SIZE = sum(register.size for register in BLOCK)

ERRORS = {
    0: "input voltage out of its limits (check the supply)",
    2: "overheating (let it cool, and lower the tensions)",
    3: "motor encoder (send it to its maker)",
    4: "electrical shock or too little power (check supply and wiring)",
    5: "overload (free the tendon, and lower the tensions)",
}
"""The bits of the hardware error register."""
STATUS = {
    1: "it failed to do so",
    2: "it does not know the instruction",
    3: "the packet came in damaged",
    4: "the value is out of range, or its bus watchdog has expired",
    5: "too few bytes",
    6: "the value is beyond its limit",
    7: "it may not be written now (torque is on), or not at all",
}
"""What a status packet's error number says."""


def errors(bits: int) -> list[str]:
    """The hardware error register in words."""
    known = [text for bit, text in ERRORS.items() if bits >> bit & 1]
    rest = bits & ~sum(1 << bit for bit in ERRORS)
    return known + ([f"hardware error bits {rest:#04x}"] if rest else [])


def signed(value: int, size: int) -> int:
    """Two's complement of so many bytes, which the SDK hands out without a sign."""
    top = 1 << (8 * size - 1)
    return (value & (top - 1)) - (value & top)


def unpack(block: bytes) -> list[int]:
    """The values of `BLOCK`, signed where the register is; the last three are bit fields and stay unsigned."""
    values, at = [], 0
    for register in BLOCK:
        raw = int.from_bytes(block[at : at + register.size], "little")
        values.append(signed(raw, register.size) if register.size > 1 else raw)
        at += register.size
    return values
