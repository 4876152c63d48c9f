"""report.html of a moving diagnosis."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ljjax import page


def report(story: Any, result: Any, data: Mapping[str, Any]) -> str:
    """The page, from the result and its gap.json content."""
    return page.page("Sim-to-real gap", data["verdict"], [])
