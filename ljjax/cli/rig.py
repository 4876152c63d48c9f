"""`ljjax rig`: an exported law, or an experiment, on hardware. Never loads JAX."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from ljjax.cli.rig_emulate import command as emulate
from ljjax.errors import InputError

__all__ = ["check", "emulate", "experiment", "run"]

if TYPE_CHECKING:
    from ljjax.rig.session import Session

COMMANDS = {
    "run": "run a law on the robot",
    "experiment": "run a plan of experiments, or what ljjax gap asks for next",
    "check": "hold rig.toml against the hardware",
    "emulate": "a rig that is not there, for the drivers that are",
}


def run(
    law: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="LAW.json")],
    rig: Annotated[Path, tyro.conf.arg(metavar="RIG.toml")],
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    schedule: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    theta_deg: Annotated[float | None, tyro.conf.arg(metavar="DEG")] = None,
    stiffness: Annotated[float | None, tyro.conf.arg(metavar="N/M")] = None,
    seconds: float = 10.0,
    hold_vacuum: bool = False,
) -> None:
    """Run a law: check the hardware, ramp in, run, ramp out; a log of contract v1 in DIR. Enter or Ctrl-C stops.

    Args:
        law: The law.json that ljjax export or ljjax tune wrote.
        rig: The robot's rig.toml.
        out: Folder for the log.
        schedule: Angles and stiffnesses over time (TOML, ljjax.schedule/1), instead of the next three.
        theta_deg: Mean segment angle, in degrees.
        stiffness: Transverse stiffness of the tip, in N/m.
        seconds: How long to run.
        hold_vacuum: Keep the vacuum at the end and after a fault, whatever rig.toml says.
    """
    from ljjax.law import Command, load
    from ljjax.law.file import read
    from ljjax.rig import config, drivers, task
    from ljjax.rig.session import record
    from ljjax.rig.stop import Stop

    given, about = load(law), config.load(rig)
    if schedule is not None:
        if theta_deg is not None or stiffness is not None:
            raise InputError("--schedule says the angles already; leave out --theta-deg and --stiffness")
        points, seconds = task.load_schedule(schedule)
    elif theta_deg is None or stiffness is None:
        raise InputError("nothing to do: give --theta-deg and --stiffness, or --schedule")
    else:
        points = [task.Point(0.0, Command(math.radians(theta_deg), stiffness))]
    where = "command" if schedule is None else str(schedule)
    job = task.follow(given, points, seconds, about.safety.ramp_s, where)
    robot = drivers.open_robot(about)
    files = {"law.json": law.read_bytes()} | ({} if schedule is None else {"schedule.toml": schedule.read_bytes()})
    with Stop(about.safety) as stop:
        told = record(job, robot, about, out, law_sha256=read(law)["sha256"], attachments=files,
                      vent=False if hold_vacuum else None, stopped=stop)  # fmt: skip
    _tell(told)


def experiment(
    plan: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="PLAN.toml")],
    rig: Annotated[Path, tyro.conf.arg(metavar="RIG.toml")],
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")],
) -> None:
    """Run experiments, each with a log of contract v1 in DIR, as ljjax fit and gap take them. Enter or Ctrl-C stops.

    Args:
        plan: What to do (TOML, ljjax.plan/1), or a gap.json, whose next experiment is done.
        rig: The robot's rig.toml.
        out: Folder for the logs.
    """
    from ljjax.rig import config, drivers, experiments
    from ljjax.rig.session import record
    from ljjax.rig.stop import Stop

    about = config.load(rig)
    todo = experiments.load(plan, about.limits, about.safety.ramp_s)
    robot = drivers.open_robot(about)
    with Stop(about.safety) as stop:
        for job in todo.experiments:
            files = {plan.name: todo.text.encode()}
            _tell(record(job, robot, about, out, attachments=files, vent=todo.vent, stopped=stop))


def check(
    rig: Annotated[Path, tyro.conf.arg(metavar="RIG.toml")],
    seconds: float = 2.0,
    move: bool = False,
) -> None:
    """Hold rig.toml against the hardware, and say what is off; the exit code is 2 where something is.

    Args:
        rig: The robot's rig.toml.
        seconds: How long to listen to the sensors at rest.
        move: Also pull each tendon a little and draw a little vacuum. The robot must be free to move.
    """
    from ljjax.rig import config, drivers
    from ljjax.rig.check import check as examine
    from ljjax.rig.stop import Stop

    about = config.load(rig)
    with Stop(about.safety) as stop:
        findings = examine(drivers.open_robot(about), about, seconds=seconds, move=move, stopped=stop)
    for finding in findings:
        print(finding)
    if off := [finding.name for finding in findings if not finding.good]:
        raise InputError(f"{rig}: {', '.join(off)} off; see above")


def _tell(told: Session) -> None:
    outcome = told.outcome
    print(
        f"{told.path}: {outcome.end_reason}; {outcome.ticks} ticks, {outcome.missed} deadlines missed, at worst "
        f"{1e3 * outcome.worst_late_s:.3g} ms late, {1e3 * outcome.worst_busy_s:.3g} ms a tick"
    )
    if outcome.fault is not None:
        raise InputError(f"{told.path}: stopped by {outcome.fault}")
