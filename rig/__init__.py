"""An exported law on hardware, without JAX: the loop, drivers, safety and logging of a real rig.

    from ljjax import law, rig
    about = rig.load_config("rig.toml")
    robot_law = law.load("law.json")
    task = rig.follow(robot_law, [rig.Point(0.0, law.Command(0.15, 200.0))], seconds=10.0, ramp_s=1.0)
    told = rig.record(task, rig.open_robot(about), about, "runs")

Imports the law, the logs part of ljjax and numpy, and never JAX. Names are found when they are asked for.
"""

from typing import TYPE_CHECKING, Any

__all__ = [
    "Config",
    "Outcome",
    "Point",
    "Reading",
    "RigError",
    "Robot",
    "check",
    "follow",
    "load_config",
    "load_plan",
    "open_robot",
    "record",
    "run",
]

if TYPE_CHECKING:
    from ljjax.rig.check import check
    from ljjax.rig.config import Config
    from ljjax.rig.config import load as load_config
    from ljjax.rig.drivers import open_robot
    from ljjax.rig.experiments import load as load_plan
    from ljjax.rig.loop import Outcome, run
    from ljjax.rig.robot import Reading, RigError, Robot
    from ljjax.rig.session import record
    from ljjax.rig.task import Point, follow

_HOME = {
    "Config": ("config", "Config"),
    "Outcome": ("loop", "Outcome"),
    "Point": ("task", "Point"),
    "Reading": ("robot", "Reading"),
    "RigError": ("robot", "RigError"),
    "Robot": ("robot", "Robot"),
    "check": ("check", "check"),
    "follow": ("task", "follow"),
    "load_config": ("config", "load"),
    "load_plan": ("experiments", "load"),
    "open_robot": ("drivers", "open_robot"),
    "record": ("session", "record"),
    "run": ("loop", "run"),
}


def __getattr__(name: str) -> Any:
    import importlib

    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, attribute = _HOME[name]
    return getattr(importlib.import_module(f"{__name__}.{module}"), attribute)
