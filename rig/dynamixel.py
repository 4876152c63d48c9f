"""Two Dynamixel XM430-W350 in current mode on one bus, one a tendon.

A thread owns the bus. It waits for a command, and then in one go writes both goal currents and reads both servos back;
without a command it sends nothing at all. Any packet feeds the servos' bus watchdog, so this is what makes the
watchdog watch the controller: when commands end, for whatever reason, packets end, and the servos stop by themselves.
Before the first command torque is off, and the thread just reads.

Tension and current: I = T r/K_t + I₀, r the radius of the spool, K_t the torque constant, I₀ what gearbox and spool rub
away.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Mapping
from typing import Any, NamedTuple

from ljjax.rig import xm430
from ljjax.rig.keys import Keys
from ljjax.rig.robot import NAN, RigError
from ljjax.rig.servo_port import load_sdk, open_port
from ljjax.rig.spools import Spools
from ljjax.rig.xm430 import Register

SIDES = ("left", "right")
Pair = tuple[float, float]
UNARMED_S = 0.02
"""How often the servos are read before the first command [s]."""


class Tendons(NamedTuple):
    """What the servos last said, left and right: stamp [s], currents [mA, + pulls], tensions by current [N], travel
    since `connect` [m, + pulls in], the warmer one's temperature [°C], and what is wrong."""

    t: float = -float("inf")
    ma: Pair = (NAN, NAN)
    n: Pair = (NAN, NAN)
    m: Pair = (NAN, NAN)
    temperature_c: float = NAN
    faults: tuple[str, ...] = ()


class Servos:
    """The two servos behind connect, read, command and stop.

    Args:
        table: [servos] of rig.toml: port, baud, ids, direction (+1 where a positive current pulls, else −1),
            spool_radius_m, torque_constant_nm_a, friction_ma, current_max_ma, watchdog_ms, reply_ms (how long a reply
            may take beyond its bytes), lost_ticks (ticks without a reply after which a servo counts as lost).
        most_n: tension beyond which rounding to a unit of current is never upwards [N].

    Raises:
        InputError: a key that is missing, unknown or wrong.
    """

    def __init__(self, table: Mapping[str, Any], most_n: float = math.inf):
        keys = Keys("servos", table)
        self.port_name = keys.text("port", expected="the bus's serial port, such as /dev/ttyUSB0")
        self.baud = keys.whole("baud", 1_000_000, 9600, 4_000_000)
        self.ids: tuple[int, int] = keys.pair("ids", (1, 2), whole=True, low=0, high=252)
        self.spools = Spools(keys)
        self._most_units = int(self.spools.current_ma(most_n) / xm430.CURRENT_MA)
        self.watchdog = round(keys.number("watchdog_ms", 100.0, "ms", 20.0, 2540.0) / 1000 / xm430.WATCHDOG_S)
        self.reply_s = keys.number("reply_ms", 4.0, "ms", 0.1, 1000.0) / 1000
        self.lost_ticks = keys.whole("lost_ticks", 10, 1, 10_000)
        keys.done()
        self._port: Any = None
        self._thread: threading.Thread | None = None
        self._changed = threading.Condition()
        self._goal: tuple[int, int] | None = None
        self._ending = self._armed = False
        self._last = Tendons()
        self._faults: dict[str, None] = {}
        self._missed = [0, 0]
        self._zero = [0, 0]

    def connect(self) -> None:
        """Open the bus, check both servos and set them to current mode with torque off. Raises RigError."""
        sdk = load_sdk()
        self._faults, self._missed, self._last = {}, [0, 0], Tendons()
        self._goal, self._ending, self._armed = None, False, False
        try:
            self._port = open_port(sdk, self.port_name, self.baud, self.reply_s)
            self._packets: Any = sdk.PacketHandler(2.0)
            self._write_goals = sdk.GroupSyncWrite(self._port, self._packets, *xm430.GOAL_CURRENT)
            self._read_blocks = sdk.GroupSyncRead(self._port, self._packets, xm430.INDIRECT_DATA, xm430.BLOCK_SIZE)
            for side, servo in enumerate(self.ids):
                self._prepare(side)
                self._read_blocks.addParam(servo)
            values = [xm430.unpack(self._one(side)) for side in (0, 1)]
            self._zero = [found[1] for found in values]
            self._publish(values)
        except RigError:
            self._close()
            raise
        except Exception as error:  # pyserial and termios raise kinds of their own
            self._close()
            raise RigError(f"servos.port {self.port_name}: {error}; check adapter, power and permissions") from None
        self._thread = threading.Thread(target=self._serve, name="servo bus", daemon=True)
        self._thread.start()

    def read(self) -> Tendons:
        """What the servos said in the tick of the last command; before the first, lately."""
        return self._last._replace(faults=tuple(self._faults))

    def command(self, left_n: float, right_n: float) -> Pair:
        """Tensions wanted [N]; returns at once those of the nearest units of current. The first one takes torque on and
        arms the watchdog.

        Raises:
            RigError: not connected, or the bus is gone.
        """
        if self._thread is None:
            raise RigError("servos: not connected; call connect first")
        if not self._thread.is_alive():
            raise RigError(next(iter(self._faults), "servos: the bus thread has ended; connect again"))
        left, right = self._units(left_n), self._units(right_n)
        with self._changed:
            self._goal = left, right
            self._changed.notify()
        return self.spools.tension_n(left * xm430.CURRENT_MA), self.spools.tension_n(right * xm430.CURRENT_MA)

    def _units(self, tension_n: float) -> int:
        """The current for a tension, in units."""
        return min(round(self.spools.current_ma(tension_n) / xm430.CURRENT_MA), self._most_units)

    def stop(self) -> None:
        """Goal currents 0, torque off, bus closed. What the bus no longer carries, the watchdog does. Never raises."""
        with self._changed:
            self._ending = True
            self._changed.notify()
        if self._thread is not None:
            self._thread.join(10.0)
            self._thread = None
        if self._port is None:
            return
        with contextlib.suppress(Exception):
            self._send((0, 0))
        for side in (0, 1):
            with contextlib.suppress(Exception):
                self._write(side, xm430.TORQUE, 0)
            with contextlib.suppress(Exception):
                self._write(side, xm430.WATCHDOG, 0)
        self._close()

    def _close(self) -> None:
        with contextlib.suppress(Exception):
            self._port.closePort()
        self._port = None

    def _serve(self) -> None:
        try:
            while True:
                with self._changed:
                    told = self._changed.wait_for(
                        lambda: self._goal is not None or self._ending, None if self._armed else UNARMED_S
                    )
                    if self._ending:
                        return
                    goal, self._goal = self._goal, None
                if told and goal is not None:
                    if not self._armed:
                        self._arm()
                    self._send(goal)
                self._publish(self._blocks())
        except RigError as error:
            self._faults[str(error)] = None
        except Exception as error:  # an adapter pulled out of its socket: OSError, termios.error, SerialException …
            self._faults[f"servos: the bus {self.port_name} is gone ({error}); check the adapter and connect again"] = (
                None
            )

    def _prepare(self, side: int) -> None:
        """Check one servo and set it up; its torque is off afterwards, which its settings need."""
        name = self._name(side)
        for _ in range(8):
            model, result, _ = self._packets.ping(self._port, self.ids[side])
            if result == 0:
                break
        else:
            raise RigError(
                f"{name}: no answer on {self.port_name} at {self.baud} baud; check power, cable, id and baud"
            )
        if model != xm430.MODEL_NUMBER:
            raise RigError(f"{name}: model number {model}; expected {xm430.MODEL_NUMBER}, an XM430-W350")
        self._write(side, xm430.TORQUE, 0)
        self._write(side, xm430.WATCHDOG, 0)
        for register, value in ((xm430.RETURN_DELAY, 0), (xm430.OPERATING_MODE, xm430.CURRENT_MODE)):
            if self._one(side, register.address, register.size) != bytes([value]):
                self._write(side, register, value)  # kept without power, in memory that wears by writing
        at = xm430.INDIRECT_ADDRESS
        for register in xm430.BLOCK:
            for offset in range(register.size):
                self._write(side, Register(at, 2), register.address + offset)
                at += 2
        if wrong := xm430.errors(xm430.unpack(self._one(side))[3]):
            raise RigError(f"{name}: {'; '.join(wrong)}; then switch its power off and on")

    def _arm(self) -> None:
        for side in (0, 1):
            self._write(side, xm430.WATCHDOG, 0)
            self._write(side, xm430.GOAL_CURRENT, 0)
            self._write(side, xm430.TORQUE, 1)
            self._write(side, xm430.WATCHDOG, self.watchdog)
        self._armed = True

    def _write(self, side: int, register: Register, value: int, attempts: int = 8) -> None:
        """Write a register and see it confirmed. Raises RigError."""
        said = "no answer; check power and cable"
        data = list((value & (1 << 8 * register.size) - 1).to_bytes(register.size, "little"))
        for _ in range(attempts):
            result, error = self._packets.writeTxRx(self._port, self.ids[side], register.address, register.size, data)
            if result == 0 and not error & 0x7F:
                return
            if result == 0:
                said = f"register {register.address} refused {value}: {xm430.STATUS.get(error & 0x7F, error)}"
        raise RigError(f"{self._name(side)}: {said}")

    def _send(self, goal: tuple[int, int]) -> None:
        """Both goal currents in one packet, which no servo answers: one that is lost, the next tick replaces."""
        self._write_goals.clearParam()
        for side, pull in enumerate(goal):
            units = pull * self.spools.direction[side]
            self._write_goals.addParam(self.ids[side], list((units & 0xFFFF).to_bytes(2, "little")))
        self._write_goals.txPacket()

    def _blocks(self) -> list[list[int] | None]:
        """Both blocks by one read; servos that this did not get are asked once more, each on its own."""
        for servo in self.ids:
            self._read_blocks.data_dict[servo] = []  # the SDK keeps the last answer where a new one fails
        self._read_blocks.txRxPacket()
        found: list[list[int] | None] = []
        for side, servo in enumerate(self.ids):
            data = bytes(self._read_blocks.data_dict[servo])
            if len(data) != xm430.BLOCK_SIZE:
                data = self._ask(side, xm430.INDIRECT_DATA, xm430.BLOCK_SIZE)
            found.append(None if data is None else xm430.unpack(data))
        return found

    def _ask(self, side: int, address: int, size: int) -> bytes | None:
        data, result, _ = self._packets.readTxRx(self._port, self.ids[side], address, size)
        return bytes(data) if result == 0 and len(data) == size else None

    def _one(self, side: int, address: int = xm430.INDIRECT_DATA, size: int = xm430.BLOCK_SIZE) -> bytes:
        for _ in range(8):
            if (found := self._ask(side, address, size)) is not None:
                return found
        raise RigError(f"{self._name(side)}: no answer; check power and cable")

    def _publish(self, blocks: list[Any]) -> None:
        last, spools = self._last, self.spools
        ma, m, warm = list(last.ma), list(last.m), []
        for side, block in enumerate(blocks):
            self._missed[side] = 0 if block is not None else self._missed[side] + 1
            if self._missed[side] >= self.lost_ticks:
                self._fault(
                    side, f"no answer for {self.lost_ticks} ticks; check its cable and power, and connect again"
                )
            if block is None:
                continue
            current, position, temperature, error, watchdog, torque = block
            ma[side] = current * xm430.CURRENT_MA * spools.direction[side]
            m[side] = (position - self._zero[side]) * xm430.RAD * spools.radius_m * spools.direction[side]
            warm.append(float(temperature))
            for text in xm430.errors(error):
                self._fault(side, text)
            if watchdog == xm430.WATCHDOG_EXPIRED:
                told = self.watchdog * xm430.WATCHDOG_S
                self._fault(side, f"its bus watchdog stopped it, no command came for {told:g} s; connect again")
            elif self._armed and not torque:
                self._fault(side, "its torque went off, as after a restart; check its power, and connect again")
        if all(block is not None for block in blocks):
            n = tuple(spools.tension_n(x) for x in ma)
            self._last = Tendons(time.monotonic(), (ma[0], ma[1]), (n[0], n[1]), (m[0], m[1]), max(warm))

    def _fault(self, side: int, text: str) -> None:
        """A fault lasts until `connect`: what a servo lost with its power does not come back with it."""
        self._faults[f"{self._name(side)}: {text}"] = None

    def _name(self, side: int) -> str:
        return f"{SIDES[side]} servo (id {self.ids[side]})"
