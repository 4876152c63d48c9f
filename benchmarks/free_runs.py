"""Free runs and their derivatives, as a diagnosis asks for them: programs in C beside the same under XLA."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

from benchmarks.fit_speed import data
from benchmarks.sides import Row, interleaved, ratio
from ljjax.effects import REGISTRY
from ljjax.fit import native
from ljjax.fit.coordinates import Coordinates
from ljjax.fit.dynamic import Search
from ljjax.fit.problem import Problem
from ljjax.fit.run import prepared
from ljjax.fit.shooting import together
from ljjax.fit.windows import cut
from ljjax.gap.candidates import universal
from ljjax.gap.search import QUICK


def natively(say: Callable[[str], None]) -> list[Row]:
    """Eight runs of 15 s once through, by both, with no effect, one, and all of the library."""
    if not native.available():
        say("  no C compiler: nothing to compare")
        return []
    with tempfile.TemporaryDirectory() as folder:
        _, runs, start = data(Path(folder))
    case = prepared(start, "the guess", runs, (), start.frozen, "commands")
    assert not isinstance(case, list)
    base = case.problem.coordinates
    found = {}
    for name, kinds in (
        ("no effect", []),
        ("one effect", [REGISTRY["contact"]]),
        ("all effects", [*REGISTRY.values()]),
    ):
        coordinates = Coordinates(universal(base.model(base.start), kinds), list(base.names), base.pressure)
        problem = Problem(coordinates, case.problem.motions)
        windows = cut(problem.motions, QUICK.step_s)

        def once(compiler: str, problem: Any = problem, windows: Any = windows) -> None:
            with mock.patch.dict(os.environ, {"LJJAX_CC": compiler}):
                (failed,) = together([Search(problem, windows, QUICK).look(problem.coordinates.start)])
            assert failed is None

        times = interleaved({"C": lambda f=once: f("cc"), "XLA": lambda f=once: f("")}, rounds=5, least_s=0.3)
        found[name] = ratio(times, "C", "XLA")
        say(f"  {name}: {found[name]:.2g} of the time of XLA")
    note = f"8 runs of 15 s and their derivatives to {len(base.names)} parameters, with all that a fit does with them"
    return [
        Row(
            "free runs with derivatives in C ÷ under XLA, one effect",
            found.pop("one effect"),
            "",
            "",
            None,
            found,
            note,
        )
    ]
