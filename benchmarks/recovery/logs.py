"""Simulated robots' logs in contract v1: FOLDER/robot-000/train/*.mcap, FOLDER/robot-000/held_out/*.mcap."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from benchmarks.recovery.experiments import PERIOD_S, Experiment, plan
from benchmarks.recovery.plant import STEP_S, Array, Plant
from benchmarks.recovery.robots import Robot
from ljjax.logs import Writer

P_ATM_PA = 101_325.0
START_NS = 1_767_225_600 * 10**9  # 2026-01-01
JOINT_SD_RAD = np.radians(0.047)
THETA_SD_RAD = np.radians(0.0195)
RESOLUTION_RAD = np.radians(0.01)
TENSION_SD_N, PRESSURE_SD_PA = 0.1, 100.0
STEADY_SD_N, PROBE_SD, PROBE_M = 0.05, 0.01, 0.001
SHAPE_EVERY, MEASURED_EVERY = 2, 8  # periods: 100 Hz and 25 Hz


def make(robots: Sequence[Robot], folder: Path, seconds: float, seed: int, workers: int = 1) -> Iterator[int]:
    """Write the logs of all robots, those left out that are there already; yields how many robots are done.

    Robots of one worker are simulated together. A robot's folder appears when it is whole.
    """
    missing = [r for r in robots if not _is_made(r, folder, seconds, seed)]
    yield (done := len(robots) - len(missing))
    if not missing:
        return
    parts = [missing[i::workers] for i in range(min(workers, len(missing)))]
    if len(parts) == 1:
        write(parts[0], folder, seconds, seed)
        yield len(robots)
        return
    with ProcessPoolExecutor(len(parts), get_context("spawn")) as pool:
        for future in as_completed([pool.submit(write, part, folder, seconds, seed) for part in parts]):
            yield (done := done + future.result())


def write(robots: Sequence[Robot], folder: Path, seconds: float, seed: int) -> int:
    """Simulate these robots and write their logs; returns how many."""
    plans = [plan(robot, seconds, seed) for robot in robots]
    motions = simulate(robots, plans)
    for robot, experiments, q in zip(robots, plans, motions, strict=True):
        new, final = folder / f".{robot.robot_id}.new", folder / robot.robot_id
        shutil.rmtree(new, ignore_errors=True)
        for part in ("train", "held_out"):
            (new / part).mkdir(parents=True)
        for i, experiment in enumerate(experiments):
            part = "held_out" if experiment.held_out else "train"
            with Writer(new / part / f"run_{i:02d}.mcap", metadata(robot, i, experiment.name)) as log:
                _moving(log, robot, i, experiment, q[i], np.random.default_rng([seed, _number(robot), 2, i]))
        if robot.static:
            rng = np.random.default_rng([seed, _number(robot), 3])
            for i, (name, samples) in enumerate(STATIC.items(), len(experiments)):
                with Writer(new / "train" / f"run_{i:02d}.mcap", metadata(robot, i, name)) as log:
                    samples(log, robot, i, rng)
        about = {"key": _key(robot, seconds, seed), **asdict(robot)}
        (new / "robot.json").write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
        shutil.rmtree(final, ignore_errors=True)
        os.replace(new, final)
    return len(robots)


def simulate(robots: Sequence[Robot], plans: Sequence[Sequence[Experiment]], step_s: float = STEP_S) -> list[Array]:
    """For each robot (runs, T, n): q [rad] at each period of its runs."""
    each = [len(experiments) for experiments in plans]
    plant = Plant({path: np.repeat([r.truth[path] for r in robots], each) for path in robots[0].truth})
    runs = [experiment for experiments in plans for experiment in experiments]
    tendons, pressure = (np.stack([getattr(e, name) for e in runs], axis=-1) for name in ("tendons", "pressure_kpa"))
    q = np.moveaxis(plant.run(tendons, pressure, PERIOD_S, step_s), -1, 0)
    return np.split(q, np.cumsum(each)[:-1])


def _moving(log: Writer, robot: Robot, i: int, experiment: Experiment, q: Array, rng: np.random.Generator) -> None:
    """Commands where they change; shape, and tension and pressure as measured, with noise."""
    shape = q if robot.columns > 1 else q.mean(axis=1, keepdims=True)
    sd = JOINT_SD_RAD if robot.columns > 1 else THETA_SD_RAD
    shape = RESOLUTION_RAD * np.round((shape + rng.normal(0, sd, shape.shape)) / RESOLUTION_RAD)
    tension = np.maximum(experiment.tendons + rng.normal(0, TENSION_SD_N, experiment.tendons.shape), 0)
    commanded = P_ATM_PA - 1e3 * experiment.pressure_kpa
    pressure = commanded + rng.normal(0, PRESSURE_SD_PA, len(commanded))
    for k, (u, p) in enumerate(zip(experiment.tendons, commanded, strict=True)):
        t = _start_ns(i) + round(k * PERIOD_S * 1e9)
        if k == 0 or np.any(u != experiment.tendons[k - 1]):
            log.write("cmd_tendons", t, u)
        if k == 0 or p != commanded[k - 1]:
            log.write("cmd_pressure", t, [p])
        if k % SHAPE_EVERY == 0:
            log.write("shape", t, shape[k], columns=("theta",) if robot.columns == 1 else None)
        if k % MEASURED_EVERY == 0:
            log.write("tendons", t, tension[k])
            log.write("pressure", t, [pressure[k]])


def _steady(log: Writer, robot: Robot, i: int, rng: np.random.Generator) -> None:
    """Net tensions that hold θ, as if friction had been averaged out; stamps are places in the table."""
    angles = np.radians([-12, -9, -6, -3, 3, 6, 9, 12])
    table = [(p, theta) for p in (0.0, 10.0, 20.0, 30.0, 40.0) for theta in angles]
    for k, (p, theta) in enumerate(table):
        net = _alone(robot).net_tension(theta, p).item() + rng.normal(0, STEADY_SD_N)
        t = _start_ns(i) + k * 10**9
        log.write("pressure", t, [P_ATM_PA - 1e3 * p])
        log.write("shape", t, [theta])
        log.write("tendons", t, [max(net, 0.0), max(-net, 0.0)], sd=[STEADY_SD_N, 0.0])


def _probe(log: Writer, robot: Robot, i: int, rng: np.random.Generator) -> None:
    """Tip stiffness at rest, straight, by presses of one depth; stamps are places in the table."""
    for k, p in enumerate(np.repeat([0.0, 5.0, 10.0, 20.0, 30.0, 40.0], 3)):
        force = _alone(robot).tip_stiffness(p).item() * PROBE_M
        t = _start_ns(i) + k * 10**9
        log.write("pressure", t, [P_ATM_PA - 1e3 * p])
        log.write("shape", t, [0.0])
        log.write("probe", t, [PROBE_M, force * (1 + PROBE_SD * rng.standard_normal())], sd=[0.0, force * PROBE_SD])


STATIC = {"steady points": _steady, "probe points": _probe}


def _alone(robot: Robot) -> Plant:
    return Plant({path: np.array([value]) for path, value in robot.truth.items()})


def _number(robot: Robot) -> int:
    return int(robot.robot_id.split("-")[1])


def _start_ns(i: int) -> int:
    """Runs begin a minute apart."""
    return START_NS + i * 60 * 10**9


def metadata(robot: Robot, i: int, experiment: str) -> dict[str, str]:
    """What a log says of itself."""
    return {
        "run_id": f"{robot.robot_id}-{i:02d}",
        "robot_id": robot.robot_id,
        "experiment": experiment,
        "p_atm_pa": str(P_ATM_PA),
        "start_utc": str(np.datetime64(_start_ns(i), "ns")) + "Z",
        "software_version": "benchmarks.recovery",
    }


def _key(robot: Robot, seconds: float, seed: int) -> str:
    """Changes with the robot, the study's options, and the programs that made the logs."""
    programs = [(Path(__file__).parent / f"{n}.py").read_text("utf-8") for n in ("plant", "experiments", "logs")]
    return hashlib.sha256(repr((asdict(robot), seconds, seed, programs)).encode()).hexdigest()


def _is_made(robot: Robot, folder: Path, seconds: float, seed: int) -> bool:
    try:
        about = json.loads((folder / robot.robot_id / "robot.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return about["key"] == _key(robot, seconds, seed)
