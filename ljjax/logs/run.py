"""One run of one robot, as data: what a log says once it has been read, in SI, without JAX."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from ljjax.errors import InputError


@dataclass(frozen=True, eq=False)
class Signal:
    """Samples of one quantity.

    Attributes:
        t: (N,) seconds since `Run.t0_ns`, non-decreasing, from the clock the contract or the mapping names.
        value: (N, k) samples in `unit`.
        columns: the k names, e.g. `("tendon_left", "tendon_right")` or `("theta",)`.
        unit: SI unit of `value` (`"N"`, `"Pa"`, `"rad"`, `"m"`, `"degC"`; one per column when they differ,
            separated by commas).
        topic: where it came from.
        sd: (N, k) standard deviations that the log states for the samples, or None.
        log_t, publish_t: (N,) the other two clocks, seconds since `Run.t0_ns`.
    """

    t: np.ndarray
    value: np.ndarray
    columns: tuple[str, ...]
    unit: str
    topic: str
    sd: np.ndarray | None = None
    log_t: np.ndarray | None = None
    publish_t: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.t)

    def column(self, name: str) -> np.ndarray:
        """(N,) one column by name. Raises KeyError."""
        if name not in self.columns:
            raise KeyError(f"{self.topic} has no column {name!r}, only {', '.join(self.columns)}")
        return self.value[:, self.columns.index(name)]

    def held_at(self, t: np.ndarray) -> np.ndarray:
        """(len(t), k) the value in force at each time: a sample holds until the next; the first also before it."""
        index = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self.t) - 1)
        return self.value[index]

    def interpolated_at(self, t: np.ndarray) -> np.ndarray:
        """(len(t), k) linear between samples, constant outside them."""
        return np.stack([np.interp(t, self.t, self.value[:, j]) for j in range(self.value.shape[1])], axis=1)


@dataclass(frozen=True)
class Damage:
    """Why a log is only partly read.

    Attributes:
        where: the place, e.g. `"byte 117394 (after t = 3.21 s)"`.
        why: what is wrong there, in plain words.
    """

    where: str
    why: str


@dataclass(frozen=True, eq=False)
class Run:
    """One run: signals by name, and where they come from.

    Signal names, shapes and units (contract v1): `cmd_tendons` (N, 2) N, `tendons` (N, 2) N, `spool` (N, 2) m,
    `cmd_pressure` (N, 1) Pa absolute, `pressure` (N, 1) Pa absolute, `shape` (N, 1 or n) rad, `tip` (N, 7)
    position m and quaternion xyzw, `probe` (N, 2) position m and force N, `temperature` (N, 1) °C.

    `notes` say what a reader should know; those among them in `doubts` say that values cannot be what the contract
    says they are (degrees for radians, kPa for Pa, a wrong sign), and nothing should be computed from them.
    """

    path: str
    sha256: str
    t0_ns: int
    signals: Mapping[str, Signal]
    metadata: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    damage: Damage | None = None
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()

    @property
    def run_id(self) -> str:
        return self.metadata.get("run_id", "") or self.path

    @property
    def robot_id(self) -> str:
        return self.metadata.get("robot_id", "")

    @property
    def experiment(self) -> str:
        return self.metadata.get("experiment", "")

    @property
    def p_atm_pa(self) -> float:
        """Atmospheric pressure of the run [Pa]. Raises InputError where the log does not state it."""
        text = self.metadata.get("p_atm_pa", "")
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not 2e4 < value < 1.2e5:
            raise InputError(
                f"{self.path}: metadata ljjax.run: p_atm_pa is {text!r}; expected the atmospheric pressure in Pa, "
                "such as '101325'; a mapping file with [run] p_atm_pa states it for a log that does not"
            )
        return value

    def trusted(self) -> None:
        """Raises InputError where the run's values cannot be in the contract's units."""
        if self.doubts:
            raise InputError(f"{self.path}: {self.doubts[0]}")

    def signal(self, *names: str) -> Signal:
        """The first of `names` that the run has. Raises InputError naming what is missing."""
        for name in names:
            if name in self.signals:
                return self.signals[name]
        raise InputError(f"{self.path}: no signal {' or '.join(names)}; it has {', '.join(self.signals) or 'none'}")

    def vacuum_kpa(self, *names: str) -> Signal:
        """Pressure as the model takes it, u_P = (p_atm − p)/1000 [kPa], from the first of `names` there is."""
        s = self.signal(*(names or ("pressure", "cmd_pressure")))
        sd = None if s.sd is None else s.sd / 1e3
        return Signal(s.t, (self.p_atm_pa - s.value) / 1e3, s.columns, "kPa", s.topic, sd, s.log_t, s.publish_t)
