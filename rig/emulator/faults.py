"""What can be made to go wrong in an emulated rig."""

from __future__ import annotations

import math
from typing import NamedTuple

from ljjax.errors import InputError
from ljjax.rig import xm430

KINDS = {
    "servo_unplugged": "left, right, or bus (the adapter itself)",
    "servo_error": "a bit of the hardware error register of the left servo, such as 5 (overload)",
    "packet_loss": "share of packets lost, each way",
    "packet_corrupt": "share of packets damaged, each way",
    "camera_frozen": "the camera repeats its last picture",
    "tag_lost": "the tag is out of sight",
    "tag_jump": "angle by which the tag is seen turned [rad]",
    "gauge_stuck": "the gauge repeats its last value",
    "gauge_nan": "the gauge answers without a number",
    "vacuum_leak": "share of the vacuum that the line loses",
}
_DEFAULT = {"servo_unplugged": "right", "servo_error": "5", "tag_jump": "0.5"}
_SHARES = {"packet_loss": "0.1", "packet_corrupt": "0.1", "vacuum_leak": "0.5"}


class Fault(NamedTuple):
    """A kind of fault, its value, and from when on since the emulator's start [s]."""

    kind: str
    value: str = ""
    at_s: float = 0.0

    @property
    def number(self) -> float:
        return float(self.value)


def parse(text: str) -> Fault:
    """A fault from KIND[=VALUE][@SECONDS], such as packet_loss=0.1@5. Raises InputError."""
    head, _, at = text.partition("@")
    kind, _, value = head.partition("=")
    if kind not in KINDS:
        raise InputError(f"fault {text!r}: no fault {kind!r}; expected one of {', '.join(KINDS)}")
    value = value or {**_DEFAULT, **_SHARES}.get(kind, "")
    try:
        at_s = float(at or 0.0)
        number = float(value) if kind in _SHARES or kind in ("servo_error", "tag_jump") else 0.0
        ok = math.isfinite(at_s) and math.isfinite(number)
    except ValueError:
        ok, at_s, number = False, 0.0, 0.0
    if kind in _SHARES:
        ok = ok and 0 <= number <= 1
    if kind == "servo_error":
        ok = ok and number in xm430.ERRORS
    if kind == "servo_unplugged":
        ok = ok and value in ("left", "right", "bus")
    if not ok:
        raise InputError(f"fault {text!r}: expected {kind}[=VALUE][@SECONDS], VALUE {KINDS[kind]}")
    return Fault(kind, value, at_s)


class Faults:
    """The faults of a run: some from a time on, and any that are put in and taken out meanwhile."""

    def __init__(self, planned: tuple[Fault, ...] = ()):
        self._all = {fault.kind: fault for fault in planned}

    def put(self, text: str) -> None:
        """A fault from now on. Raises InputError."""
        fault = parse(text)
        self._all[fault.kind] = fault._replace(at_s=0.0)

    def clear(self, kind: str) -> None:
        """No such fault any more."""
        self._all.pop(kind, None)

    def active(self, kind: str, since_s: float) -> Fault | None:
        """The fault of a kind if there is one at a time since the start."""
        fault = self._all.get(kind)
        return fault if fault is not None and since_s >= fault.at_s else None

    def share(self, kind: str, since_s: float) -> float:
        """A fault's number, 0 where there is none."""
        fault = self.active(kind, since_s)
        return 0.0 if fault is None else fault.number
