"""From logs and a model to the cause of their disagreement: `diagnose(model, runs)`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ljjax.gap.result import Diagnosis
    from ljjax.gap.run import diagnose

__all__ = ["Diagnosis", "diagnose"]
_HOMES = {"diagnose": "ljjax.gap.run", "Diagnosis": "ljjax.gap.result"}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_HOMES[name]), name)
