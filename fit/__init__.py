"""From logs to parameters: `fit(model, runs)` gives a `FitResult`.

Now: what steady operating points and probe stiffness show. Identification from dynamic logs will join it here.
"""

from typing import TYPE_CHECKING, Any

__all__ = ["FitResult", "fit"]

if TYPE_CHECKING:
    from ljjax.fit.result import FitResult
    from ljjax.fit.run import fit


def __getattr__(name: str) -> Any:
    if name == "fit":
        from ljjax.fit.run import fit

        return fit
    if name == "FitResult":
        from ljjax.fit.result import FitResult

        return FitResult
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
