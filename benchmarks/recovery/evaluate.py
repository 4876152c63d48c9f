"""From fits and truths to the study's figures. Knows nothing of how a fit works but its parameters and verdicts."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Protocol

import numpy as np

from benchmarks.recovery.robots import Robot

COVERAGE = (0.90, 0.98)
MEDIAN_ERROR = 0.03
RATIO = 1.05
"""The goals: share of estimates within 2 sd; median relative error; free-run error over that of the truth."""


class Parameter(Protocol):
    """What the study reads of an identified parameter."""

    @property
    def value(self) -> float: ...
    @property
    def sd(self) -> float | None: ...
    @property
    def verdict(self) -> str: ...


@dataclass(frozen=True)
class Estimate:
    """One parameter of one robot: `z` = error/sd, `error` = |error/truth|; `z` None without a standard deviation."""

    robot_id: str
    path: str
    truth: float
    value: float
    sd: float | None
    verdict: str
    z: float | None
    error: float

    @property
    def counts(self) -> bool:
        """Whether the goals are about it."""
        return self.verdict == "identifiable" and self.z is not None


@dataclass(frozen=True)
class Failure:
    """A robot whose fit gave nothing to judge."""

    robot_id: str
    why: str


@dataclass(frozen=True)
class HeldOut:
    """Free-run errors of θ on one robot's held-out runs [rad]: RMS over all their samples."""

    robot_id: str
    of_estimate: float
    of_truth: float

    @property
    def ratio(self) -> float:
        return self.of_estimate / self.of_truth


def estimates(robot: Robot, parameters: Mapping[str, Parameter]) -> list[Estimate]:
    """The fitted parameters beside the truth (both in the gauge σ₀ = 1).

    Raises ValueError where a value or a standard deviation is not a finite number.
    """
    rows = []
    for path, truth in robot.truth.items():
        p = parameters[path]
        if p.verdict in ("frozen", "assumed"):
            continue
        value, sd = float(p.value), None if p.sd is None else float(p.sd)
        if not math.isfinite(value) or (sd is not None and not (math.isfinite(sd) and sd > 0)):
            raise ValueError(f"{path} = {value} ± {sd}")
        z = None if sd is None else (value - truth) / sd
        rows.append(Estimate(robot.robot_id, path, truth, value, sd, p.verdict, z, abs(value / truth - 1)))
    if not rows:
        raise ValueError("no parameter was fitted")
    return rows


def describe(rows: Iterable[Estimate]) -> dict[str, Any]:
    """Figures of some estimates: how many there are of each verdict, and of the identifiable ones the share within
    2 sd, the median relative error and sd, the mean of z and its spread by quartiles (1 where sds are right)."""
    rows = list(rows)
    counted = [r for r in rows if r.counts]
    z, error = np.array([r.z for r in counted], float), np.array([r.error for r in counted])
    verdicts = sorted({r.verdict for r in rows})
    out: dict[str, Any] = {
        "estimates": len(rows),
        "identifiable": len(counted),
        "verdicts": {v: sum(r.verdict == v for r in rows) for v in verdicts},
    }
    if counted:
        out |= {
            "within_2_sd": float(np.mean(np.abs(z) <= 2)),
            "median_error": float(np.median(error)),
            "median_sd": float(np.median([(r.sd or 0.0) / abs(r.truth) for r in counted])),
            "spread_of_z": float(np.subtract(*np.percentile(z, [75, 25])) / 1.349),
            "mean_z": float(np.mean(z)),
        }
    return out


def summary(
    robots: Sequence[Robot],
    rows: Sequence[Estimate],
    failures: Sequence[Failure],
    held_out: Sequence[HeldOut],
) -> dict[str, Any]:
    """The study as plain data: goals with what was found, figures overall, by parameter and by kind of robot, and every
    estimate."""
    overall = describe(rows)
    ratios = np.array([h.ratio for h in held_out])
    good = float(np.mean(ratios <= RATIO)) if len(ratios) else None
    found = (overall.get("within_2_sd"), overall.get("median_error"), float(np.median(ratios)) if len(ratios) else None)
    goals = {
        "within_2_sd": {"goal": list(COVERAGE), "found": found[0], "met": _within(found[0], *COVERAGE)},
        "median_error": {"goal": MEDIAN_ERROR, "found": found[1], "met": _within(found[1], 0, MEDIAN_ERROR)},
        "free_run_ratio": {
            "goal": RATIO,
            "found": found[2],
            "robots_within": good,
            "worst": float(ratios.max()) if len(ratios) else None,
            "met": good == 1.0 and not failures,
        },
    }
    of_robot = {r.robot_id: r for r in robots}
    paths = dict.fromkeys(r.path for r in rows)
    kinds: dict[str, list[Estimate]] = {}
    for row in rows:
        for kind in kinds_of(of_robot[row.robot_id]):
            kinds.setdefault(kind, []).append(row)
    return {
        "schema": "ljjax.recovery/1",
        "robots": len(robots),
        "failures": [asdict(f) for f in failures],
        "goals": goals,
        "overall": overall,
        "parameters": {path: describe(r for r in rows if r.path == path) for path in paths},
        "kinds": {kind: describe(kinds[kind]) for kind in sorted(kinds)},
        "held_out": [{**asdict(h), "ratio": h.ratio} for h in held_out],
        "estimates": [asdict(r) for r in rows],
    }


def kinds_of(robot: Robot) -> tuple[str, ...]:
    """The variants a robot belongs to."""
    unknown = [name for name in ("segment_mass_kg", "lever_arm_m") if f"chain.{name}" not in robot.known]
    return (
        "joint angles logged" if robot.columns > 1 else "theta logged",
        f"{unknown[0]} unknown" if unknown else "geometry and mass known",
        "with static logs" if robot.static else "moving logs only",
    )


def _within(x: float | None, low: float, high: float) -> bool:
    return x is not None and low <= x <= high
