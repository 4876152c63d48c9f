"""The control law: its design from a model, the simulated closed loop, its robustness study, its export.

    from ljjax import control
    made = control.design(model, "integral")              # a law, and what it reaches
    made = control.tune(model, "integral").made           # the same, its gains tuned
    study = control.robust(made.law, model)               # thousands of loops on robots as they may turn out
    loop = control.simulate(made.law, model, control.scenario(made.law, theta, stiffness, 5.0))
    control.export(made, "law.json", header_out="law.h")  # for the rig: `ljjax.law` runs it, without JAX

`docs/control.md` has the equations, and what is proven about them.
"""

from typing import TYPE_CHECKING, Any

__all__ = [
    "Design",
    "Hardware",
    "Loop",
    "Problem",
    "Robust",
    "Scenario",
    "Spec",
    "Tuned",
    "design",
    "export",
    "parity",
    "robust",
    "scenario",
    "simulate",
    "tune",
]

if TYPE_CHECKING:
    from ljjax.control.files import export
    from ljjax.control.loop import Loop, Scenario, scenario, simulate
    from ljjax.control.problem import Problem
    from ljjax.control.robust_result import Robust
    from ljjax.control.robustness import robust
    from ljjax.control.runtimes import parity
    from ljjax.control.spec import Spec
    from ljjax.control.statics import Hardware
    from ljjax.control.synthesis import Design, design
    from ljjax.control.tuning import Tuned, tune

_HOME = {
    "Design": "synthesis",
    "Hardware": "statics",
    "Loop": "loop",
    "Problem": "problem",
    "Robust": "robust_result",
    "Scenario": "loop",
    "Spec": "spec",
    "Tuned": "tuning",
    "design": "synthesis",
    "export": "files",
    "parity": "runtimes",
    "robust": "robustness",
    "scenario": "loop",
    "simulate": "loop",
    "tune": "tuning",
}


def __getattr__(name: str) -> Any:
    import importlib

    if name in _HOME:
        return getattr(importlib.import_module(f"ljjax.control.{_HOME[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
