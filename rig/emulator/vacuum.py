"""An emulated vacuum regulator and gauge: the line's vacuum follows what is set, less what leaks."""

from __future__ import annotations

import math

from ljjax.rig.emulator.lines import Line

TAU_S = 0.1
"""How fast the line follows the regulator [s]."""
HIGHEST_KPA = 95.0


class VacuumLine:
    """Regulator, line and gauge, in kPa below the atmosphere.

    Attributes:
        leak: share of the vacuum that the line loses; `stuck`, whether the gauge repeats its last value, `no_number`,
            whether it says none.
    """

    def __init__(self, line: Line):
        self.line = line
        self.leak, self.stuck, self.no_number = 0.0, False, False
        self.vacuum_kpa = 0.0
        self._wanted = self._shown = 0.0
        self._held = b""

    def advance(self, seconds: float) -> None:
        """Let time pass [s]."""
        share = 1 - math.exp(-seconds / TAU_S)
        self.vacuum_kpa += share * ((1 - self.leak) * self._wanted - self.vacuum_kpa)

    def serve(self) -> None:
        """Answer what came in."""
        *lines, self._held = (self._held + self.line.read()).split(b"\n")
        for line in lines:
            self.line.write(self._answer(line.decode(errors="replace").split()).encode() + b"\n")

    def _answer(self, words: list[str]) -> str:
        if words == ["P"]:
            if self.no_number:
                return "P nan"
            self._shown = self._shown if self.stuck else self.vacuum_kpa
            return f"P {self._shown:.4f}"
        try:
            name, value = words[0], float(words[1])
        except (IndexError, ValueError):
            return "ERR"
        if name != "V" or not 0 <= value <= HIGHEST_KPA:
            return "ERR"
        self._wanted = value
        return "OK"
