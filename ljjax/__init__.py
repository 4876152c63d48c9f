"""ljjax: simulate, identify, diagnose and control layer-jamming continuum robots, in JAX.

    import ljjax
    robot = ljjax.load_model("model.toml").model
    run = ljjax.read("run.mcap")
    motion = ljjax.simulate(robot, run)
    result = ljjax.fit.fit(None, [run])

The rooms are `ljjax.fit`, `ljjax.gap`, `ljjax.control` and `ljjax.rig`. What a name needs is imported when it is first
used, so that `import ljjax` is cheap and `ljjax.rig` never loads JAX.
"""

from typing import TYPE_CHECKING, Any

__all__ = [
    "InputError",
    "Inputs",
    "Model",
    "ModelFile",
    "Run",
    "State",
    "Trajectory",
    "Writer",
    "dump_model",
    "energy_balance",
    "load_model",
    "read",
    "read_all",
    "simulate",
]

if TYPE_CHECKING:
    from ljjax.dynamics import State
    from ljjax.errors import InputError
    from ljjax.inputs import Inputs
    from ljjax.logs import Run, Writer, read, read_all
    from ljjax.model import Model
    from ljjax.modelfile import ModelFile
    from ljjax.modelfile import dumps as dump_model
    from ljjax.modelfile import load as load_model
    from ljjax.simulation import Trajectory, energy_balance, simulate

_HOME = {
    "InputError": ("ljjax.errors", "InputError"),
    "Inputs": ("ljjax.inputs", "Inputs"),
    "Model": ("ljjax.model", "Model"),
    "ModelFile": ("ljjax.modelfile", "ModelFile"),
    "Run": ("ljjax.logs", "Run"),
    "State": ("ljjax.dynamics", "State"),
    "Trajectory": ("ljjax.simulation", "Trajectory"),
    "Writer": ("ljjax.logs", "Writer"),
    "dump_model": ("ljjax.modelfile", "dumps"),
    "energy_balance": ("ljjax.simulation", "energy_balance"),
    "load_model": ("ljjax.modelfile", "load"),
    "read": ("ljjax.logs", "read"),
    "read_all": ("ljjax.logs", "read_all"),
    "simulate": ("ljjax.simulation", "simulate"),
}
_ROOMS = ("fit", "gap", "control", "rig")


def __getattr__(name: str) -> Any:
    import importlib

    if name in (*_ROOMS, "sweep"):
        return importlib.import_module(f"ljjax.{name}")
    if name in _HOME:
        module, attribute = _HOME[name]
        return getattr(importlib.import_module(module), attribute)
    raise AttributeError(f"module 'ljjax' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*__all__, *_ROOMS, "sweep"])
