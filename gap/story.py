"""What the report of a moving diagnosis draws."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


class Story:
    """Everything the pictures need: refits, screens, predictions of unseen runs."""

    def __init__(self, work, base, given, screen, found, measured, evidence, chosen, seen, shares):
        self.work, self.base, self.given, self.screen, self.found = work, base, given, screen, found
        self.measured, self.evidence, self.chosen, self.seen, self.shares = measured, evidence, chosen, seen, shares

    def report(self, result: Any, data: Mapping[str, Any]) -> str:
        """The page."""
        from ljjax.gap.report import report

        return report(self, result, data)
