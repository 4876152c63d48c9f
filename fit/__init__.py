"""From logs to parameters: `fit(model, runs)` gives a `FitResult`, `fit_many` one for every robot.

Moving logs give everything; steady operating points and probe stiffness join them, or stand alone.
"""

from typing import TYPE_CHECKING, Any

__all__ = ["FitResult", "fit", "fit_many"]

if TYPE_CHECKING:
    from ljjax.fit.result import FitResult
    from ljjax.fit.run import fit, fit_many


def __getattr__(name: str) -> Any:
    if name in ("fit", "fit_many"):
        from ljjax.fit import run

        return getattr(run, name)
    if name == "FitResult":
        from ljjax.fit.result import FitResult

        return FitResult
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
