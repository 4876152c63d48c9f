"""A robot in this process, for tests and for trying the rig with nothing connected: a bend and a vacuum that follow.

    θ̇ = (θ∞ − θ)/τ,  θ∞ = lever·(u₁ − u₂)/(k₀ + k₁u_P);   u̇_P = (u_P* − u_P)/τ_P

No model of a robot: nothing is to be learned from it but whether the loop, the watch and the logs work.
"""

from __future__ import annotations

import dataclasses
import math
import random
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from ljjax.rig.robot import NAN, Reading, RigError, Robot

FAULTS = (
    "camera_frozen", "camera_stuck", "tag_lost", "tag_jump", "gauge_frozen", "gauge_stuck", "gauge_nan", "leak",
    "servo_error", "unplugged", "tendon_cut", "hot", "overcurrent",
)  # fmt: skip
"""What can be made to go wrong."""


@dataclass(frozen=True)
class Body:
    """The mock's numbers, each a key of [mock] in rig.toml.

    Attributes:
        lever_m, k0, k1: lever arm [m], stiffness of the mean segment [N·m/rad], and its rise [N·m/rad/kPa].
        tau_s, tau_vacuum_s: time constants of bend and vacuum [s].
        noise_rad, noise_kpa, noise_n: standard deviations of what is read.
        camera_hz, gauge_hz: how often the sensors have something new.
        fault, fault_s: one of `FAULTS`, or nothing, and how long after connecting it begins [s].
        seed: of the noise.
    """

    lever_m: float = 0.02
    k0: float = 2.0
    k1: float = 0.08
    tau_s: float = 0.08
    tau_vacuum_s: float = 0.05
    noise_rad: float = 2e-4
    noise_kpa: float = 0.05
    noise_n: float = 0.05
    camera_hz: float = 90.0
    gauge_hz: float = 100.0
    fault: str = ""
    fault_s: float = 1.0
    seed: int = 0


class MockRobot(Robot):
    """The robot; `now` is the clock it moves by."""

    def __init__(self, given: Mapping[str, Any] | None = None, now: Callable[[], float] = time.monotonic):
        fields = [f.name for f in dataclasses.fields(Body)]
        for key in given or {}:
            if key not in fields:
                raise RigError(f"mock: unknown key {key!r}; expected {', '.join(fields)}")
        self.body = Body(**(given or {}))
        if self.body.fault and self.body.fault not in FAULTS:
            raise RigError(f"mock: fault {self.body.fault!r}; expected {', '.join(FAULTS)}")
        self._now, self._random = now, random.Random(self.body.seed)
        self.connected = False
        self.wanted = (0.0, 0.0, 0.0)
        self.theta = self.vacuum = 0.0
        self._t = self._since = 0.0
        self._reading = Reading()

    def connect(self) -> None:
        """Begin at rest with an empty line."""
        self._t = self._since = self._now()
        self._reading, self.connected = Reading(), True

    def _wrong(self, fault: str) -> bool:
        return self.body.fault == fault and self._t - self._since >= self.body.fault_s

    def read(self) -> Reading:
        """Move up to now, and measure what is due."""
        if not self.connected:
            raise RigError("mock: not connected; connect first")
        body, now = self.body, self._now()
        dt, self._t = now - self._t, now
        left, right, vacuum = self.wanted
        if self._wrong("tendon_cut"):
            left = 0.0
        rest = body.lever_m * (left - right) / (body.k0 + body.k1 * self.vacuum)
        self.theta += (rest - self.theta) * -math.expm1(-dt / body.tau_s)
        vacuum = 0.2 * vacuum if self._wrong("leak") else vacuum
        self.vacuum += (vacuum - self.vacuum) * -math.expm1(-dt / body.tau_vacuum_s)
        if self._wrong("unplugged"):
            raise RigError("mock: servo 1 does not answer; check its cable")
        noise, last = self._random.gauss, self._reading
        new: dict[str, Any] = {
            "t_tendons": now,
            "left_n": left + noise(0.0, body.noise_n),
            "right_n": right + noise(0.0, body.noise_n),
            "left_m": body.lever_m * self.theta,
            "right_m": -body.lever_m * self.theta,
            "left_ma": 20.0 * left + (5000.0 if self._wrong("overcurrent") else 0.0),
            "right_ma": 20.0 * right,
            "temperature_c": 95.0 if self._wrong("hot") else 30.0,
            "faults": ("servo 1: overload",) if self._wrong("servo_error") else (),
        }
        if now - last.t_shape >= 1.0 / body.camera_hz and not self._wrong("camera_frozen"):
            theta = self.theta + noise(0.0, body.noise_rad)
            if self._wrong("tag_lost"):
                theta = NAN
            elif self._wrong("tag_jump"):
                theta += 0.3
            elif self._wrong("camera_stuck"):
                theta = last.theta
            new |= {"t_shape": now, "theta": theta}
        if now - last.t_pressure >= 1.0 / body.gauge_hz and not self._wrong("gauge_frozen"):
            kpa = self.vacuum + noise(0.0, body.noise_kpa)
            if self._wrong("gauge_nan"):
                kpa = NAN
            elif self._wrong("gauge_stuck"):
                kpa = last.vacuum_kpa
            new |= {"t_pressure": now, "vacuum_kpa": kpa}
        self._reading = last._replace(**new)
        return self._reading

    def command(self, left_n: float, right_n: float, vacuum_kpa: float) -> tuple[float, float] | None:
        """Tensions and vacuum from now on."""
        if self._wrong("unplugged"):
            raise RigError("mock: servo 1 does not answer; check its cable")
        self.wanted = (left_n, right_n, vacuum_kpa)

    def stop(self, vent: bool = False) -> None:
        """Slack tendons; the vacuum is kept, or vented."""
        self.wanted = (0.0, 0.0, 0.0 if vent else self.wanted[2])
        self.connected = False
