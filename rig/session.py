"""A run with its log: what `ljjax rig run` and `ljjax rig experiment` do once they know what to do."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from ljjax.errors import InputError
from ljjax.rig.clock import Clock
from ljjax.rig.config import Config
from ljjax.rig.loop import Outcome, run
from ljjax.rig.recorder import Recorder
from ljjax.rig.robot import Robot
from ljjax.rig.task import Task


class Session(NamedTuple):
    """A run that is over: how it ended, and its log."""

    outcome: Outcome
    path: Path


def record(task: Task, robot: Robot, config: Config, out: str | os.PathLike[str], *, law_sha256: str = "",
           attachments: Mapping[str, bytes] | None = None, vent: bool | None = None, stopped: Callable[[], str] = str,
           clock: Clock | None = None) -> Session:  # fmt: skip
    """Run a task once and log it into the folder `out`, under a name that begins with the time.

    Args:
        task, robot, config, vent, stopped, clock: as `ljjax.rig.loop.run` takes them.
        law_sha256: of the law, for the log's metadata.
        attachments: files to put into the log, beside the rig.toml.

    Raises:
        InputError: the folder or the log cannot be written, the hardware cannot be opened.
    """
    clock = clock or Clock()
    folder, start = Path(out), datetime.now(UTC)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror}); give a folder") from None
    run_id = f"{start:%Y%m%dT%H%M%S.%f}"[:-3] + f"-{task.name}"
    metadata = {
        "run_id": run_id,
        "robot_id": config.robot_id,
        "experiment": task.name,
        "p_atm_pa": repr(config.p_atm_pa),
        "start_utc": start.isoformat().replace("+00:00", "Z"),
        "law_sha256": law_sha256,
    }
    files = {"rig.toml": config.text.encode(), **(attachments or {})}
    path = folder / f"{run_id}.mcap"
    with Recorder(path, metadata, config.p_atm_pa, t=clock.now(), most_s=config.safety.log_s, attachments=files) as log:
        outcome = run(task, robot, config, log, clock=clock, vent=vent, stopped=stopped)
        if "log" not in outcome.faults:  # else it holds what had reached the disk, and reads as cut short
            log.end(outcome.end_reason)
    return Session(outcome, path)
