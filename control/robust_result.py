"""What a robustness study found, as a value."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ljjax.control.chance import Difference, Index, differences, wilson
from ljjax.control.robust_loop import OneLoop, Told
from ljjax.control.spec import MEASURES
from ljjax.control.worst import Worst


class Chance(NamedTuple):
    """How often a requirement is met: by `met` of so many draws, with Wilson's 95 % interval of the probability."""

    name: str
    limit: float | None
    met: int
    draws: int

    @property
    def share(self) -> float:
        return self.met / self.draws

    @property
    def ci95(self) -> tuple[float, float]:
        return wilson(self.met, self.draws)


@dataclass(frozen=True, eq=False)
class Robust:
    """A robustness study. N draws, T targets, m measures (`MEASURES`), d coordinates.

    Attributes:
        one: the law, the model with its effects, the specification and what is drawn (`one.given`).
        assumed: what was assumed, in words.
        xi, courses: (N, d) standard normal numbers and (N,) the noise's courses; `columns` the quantities by name (N,).
        redrawn: robots that were impossible and drawn anew.
        told: measures (N, T, m), costs (N, T), whether the loops are finite (N, T), their angles (N, T, P).
        sensitivity: measure (or `cost`), of the worst target → group → Sobol's indices; `sobol_rows` used, of how many.
        worst: the worst case nearby.
        options, identity: of the call, and what makes it this study and no other.
        fresh, seconds: closed loops simulated by this call, worst case apart, and how long these took [s].
    """

    one: OneLoop
    assumed: tuple[str, ...]
    xi: np.ndarray
    courses: np.ndarray
    columns: Mapping[str, np.ndarray]
    redrawn: int
    told: Told
    sensitivity: Mapping[str, Mapping[str, Index]]
    sobol_rows: tuple[int, int]
    sobol_told: Told
    worst: Worst
    options: Mapping[str, Any]
    identity: Mapping[str, Any]
    fresh: int
    seconds: float

    @property
    def required(self) -> dict[str, float]:
        """Limits by measure, of those that count."""
        return {k: r.limit for k, r in self.one.spec.require.items() if r.weight > 0}

    @property
    def good(self) -> np.ndarray:
        """(N, T, m) whether a loop meets the limit of a measure; one that failed meets none. True where none is set."""
        limits = np.array([self.required.get(k, math.inf) for k in MEASURES])
        finite = np.asarray(self.told.ok)[..., None]
        return np.where(np.isinf(limits), True, (np.asarray(self.told.plain) <= limits) & finite)

    @property
    def chances(self) -> list[Chance]:
        """Of each requirement at every target, then of all together (`all`), a draw one trial."""
        good, count = np.all(self.good, axis=1), len(self.xi)
        rows = [Chance(k, x, int(good[:, list(MEASURES).index(k)].sum()), count) for k, x in self.required.items()]
        return [*rows, Chance("all", None, int(np.all(good, axis=1).sum()), count)]

    @property
    def by_target(self) -> list[Chance]:
        """Of all requirements together, target by target."""
        return [Chance(f"targets[{t}]", None, int(x.sum()), len(x)) for t, x in enumerate(np.all(self.good, axis=2).T)]

    @property
    def failed(self) -> list[tuple[int, int]]:
        """Draw and target of every loop whose numbers are not finite."""
        return [(int(i), int(t)) for i, t in np.argwhere(~np.asarray(self.told.ok))]

    @property
    def missed(self) -> np.ndarray:
        """(N,) whether a draw misses a requirement at some target."""
        return ~np.all(self.good, axis=(1, 2))

    @property
    def in_common(self) -> dict[str, list[Difference]]:
        """What draws that miss a requirement have in common, by requirement; `all` for those that miss any."""
        missed = {k: ~np.all(self.good[..., list(MEASURES).index(k)], axis=1) for k in self.required}
        return {k: differences(self.columns, x) for k, x in {**missed, "all": self.missed}.items()}
