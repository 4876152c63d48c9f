"""What a laboratory hands over: logs in contract v1 and a nominal model, which say nothing of what was planted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.blind import sensing
from benchmarks.blind.plant import APART_S, Motion
from benchmarks.recovery.experiments import PERIOD_S, Array, Experiment
from benchmarks.recovery.robots import GEOMETRY, PRESSURES_KPA, Robot, admissible
from ljjax.logs import Writer

P_ATM_PA = 101_325.0
START_NS = 1_767_225_600 * 10**9  # 2026-01-01
TENSION_SD_N, PRESSURE_SD_PA, TEMPERATURE_SD_C = 0.1, 100.0, 0.05
ROOM_C = 22.0
MEASURED_EVERY, TEMPERATURE_EVERY = 2, 100  # periods: 100 Hz and 2 Hz


@dataclass(frozen=True)
class Sensors:
    """What a laboratory has beside its camera."""

    tension: bool
    pressure: bool
    temperature: bool


def write(
    path: Path, robot: Robot, place: int, run: Experiment, motion: Motion, shape: Array, sensors: Sensors
) -> None:
    """One run's log: commands, shape with noise, and what the sensors see.

    Args:
        place: in the session.
        shape: (T', columns) angles without noise [rad], as `sensing.shape` gives them.
    """
    rng = np.random.default_rng([int(robot.robot_id.split("-")[1]), place, 4])
    start = START_NS + round(place * APART_S * 1e9)
    shape = shape + rng.normal(0, sensing.noise_sd(robot.columns), shape.shape)
    tension = np.maximum(motion.tension + rng.normal(0, TENSION_SD_N, motion.tension.shape), 0)
    line = P_ATM_PA - 1e3 * motion.line_kpa + rng.normal(0, PRESSURE_SD_PA, len(motion.line_kpa))
    commanded = P_ATM_PA - 1e3 * run.pressure_kpa
    warm = ROOM_C + motion.warmth + rng.normal(0, TEMPERATURE_SD_C, len(motion.warmth))
    about = {
        "run_id": f"{robot.robot_id}-{place:02d}",
        "robot_id": robot.robot_id,
        "experiment": run.name,
        "p_atm_pa": str(P_ATM_PA),
        "start_utc": str(np.datetime64(start, "ns")) + "Z",
        "software_version": "bench-1",
    }
    columns = ("theta",) if robot.columns == 1 else None
    with Writer(path, about) as log:
        for k in range(len(commanded)):
            t = start + round(k * PERIOD_S * 1e9)
            log.write("cmd_tendons", t, run.tendons[k])
            log.write("cmd_pressure", t, commanded[k : k + 1])
            if k % sensing.SHAPE_EVERY == 0:
                log.write("shape", t, shape[k // sensing.SHAPE_EVERY], columns=columns)
            if k % MEASURED_EVERY == 0:
                if sensors.tension:
                    log.write("tendons", t, tension[k])
                if sensors.pressure:
                    log.write("pressure", t, line[k : k + 1])
            if sensors.temperature and k % TEMPERATURE_EVERY == 0:
                log.write("temperature", t, warm[k : k + 1])


def nominal(robot: Robot, rng: np.random.Generator, off: float) -> dict[str, float]:
    """The robot's parameters, each wrong by up to ± `off` of itself, drawn until they are possible.

    Geometry is known; the mass too where only θ is logged.
    """
    known = GEOMETRY if robot.columns == 1 else GEOMETRY[:3]
    while True:
        values = {
            path: x if path in known else x * float(1 + rng.choice([-1, 1]) * rng.uniform(0.25 * off, off))
            for path, x in robot.truth.items()
        }
        stiffness = sum(values[f"elastic.c{i}"] * PRESSURES_KPA ** (3 - i) for i in (1, 2, 3))
        if values["friction.mu_s"] >= values["friction.mu_c"] and np.all(stiffness > 0) and admissible(values):
            return values


def model_text(values: Mapping[str, float], known_mass: bool) -> str:
    """A model.toml, whose mass a fit is not to move where it is known."""
    lines = ['schema = "ljjax.model/1"']
    extra = {"chain": "segments = 6", "elastic": 'law = "polynomial"', "jamming": 'law = "sqrt"'}
    extra["friction"] = 'gauge = "sigma0=1"\nsigma0 = 1.0'
    for table in ("chain", "gravity", "elastic", "jamming", "friction"):
        lines += ["", f"[{table}]", *([extra[table]] if table in extra else [])]
        lines += [f"{path.split('.')[1]} = {x:.9g}" for path, x in values.items() if path.startswith(table + ".")]
    if known_mass:
        lines += ["", "[fit]", 'frozen = ["chain.segment_mass_kg"]']
    return "\n".join(lines) + "\n"
