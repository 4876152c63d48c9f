"""What a fit to moving logs found: parameters with their uncertainty, errors run by run, noise, warnings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from typing import Any

import numpy as np
from scipy import stats

from ljjax.fit.folds import left_out
from ljjax.fit.points import UNIT
from ljjax.fit.problem import Estimate
from ljjax.fit.record import SCHEMA, about_run, plain
from ljjax.fit.result import FitResult, Parameter
from ljjax.logs import Run, Signal
from ljjax.model import Model, get, limits
from ljjax.simulation import SENSITIVE_RAD

LOOSE = 0.5
"""A parameter known no better than to this share of its value is not identified."""
COLOURED = 3.0
"""Residuals whose colour widens the standard deviations by this factor are said to be structure, not noise."""
UNEXPLAINED = 1.5
"""Residuals this many times the white noise are said to be structure too."""
HELPS = {
    "chain.segment_mass_kg": "fast motions: triangles or multisines up to 5 Hz and more",
    "chain.lever_arm_m": "probe presses, which measure force and not tension",
    "gravity.alpha1": "bends to large angles, at several pressures",
    "elastic.c1": "holds at three pressures or more, over the whole range",
    "elastic.c2": "holds at three pressures or more, over the whole range",
    "elastic.c3": "bends without vacuum",
    "jamming.c4": "reversals without vacuum, small enough that the sheets stick",
    "jamming.c5": "reversals at three pressures or more, small enough that the sheets stick",
    "friction.sigma1": "small, fast oscillations about a held shape",
    "friction.sigma2": "fast sliding: wide triangles at several speeds",
    "friction.sigma3": "slow sliding at speeds from a fifth of v_s to five times v_s",
    "friction.mu_c": "wide, moderately fast triangles at several pressures",
    "friction.mu_s": "very slow pulls out of rest, at several pressures",
    "friction.v_s": "slow sliding at speeds from a fifth of v_s to five times v_s",
}
"""The experiment that shows a parameter."""


@dataclass(frozen=True)
class RunError:
    """How one run was explained.

    Attributes:
        run_id: the run; `role` `train` or `held_out`.
        rms, largest: of measured − simulated θ over the free run [rad].
        left_out: RMS [rad] where the run's own data are left out of the fit (to first order); None if held out.
        step_error: the largest change of an angle from halving the solver's step [rad]; None if not known.
    """

    run_id: str
    role: str
    samples: int
    rms: float
    largest: float
    left_out: float | None
    step_error: float | None

    @property
    def sensitive(self) -> bool:
        return self.step_error is not None and self.step_error > SENSITIVE_RAD


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class DynamicResult(FitResult):
    """A fit to moving logs.

    Attributes:
        estimate: what the search found; its motions are in the order of `moving`.
        moving: index into `runs` of each motion.
        held_out: what the model says of runs that were not fitted.
        held_out_runs: those runs.
        profiles: by path, values and χ² − χ²_min of the best fit with that value.
        restarts: RMS error in standard deviations that each start ended at, where several were tried.
    """

    estimate: Estimate
    moving: Sequence[int]
    held_out: Estimate | None = None
    held_out_runs: Sequence[Run] = ()
    profiles: Mapping[str, tuple[np.ndarray, np.ndarray]]
    restarts: Sequence[float] = ()

    @property
    def model(self) -> Model:
        return self.estimate.model

    @property
    def names(self) -> tuple[str, ...]:
        """The fitted parameters, by path."""
        return self.estimate.problem.coordinates.names

    @cached_property
    def covariance(self) -> np.ndarray:
        """(k, k) of the fitted parameters, in their units; the residuals' colour is counted."""
        slope = self.estimate.problem.coordinates.jacobian(self.estimate.x)
        return slope @ self.estimate.covariance @ slope.T

    @property
    def correlation(self) -> tuple[tuple[str, ...], np.ndarray]:
        d = np.sqrt(np.diag(self.covariance))
        return self.names, self.covariance / np.outer(d, d)

    def _parameter(self, name: str) -> Parameter:
        if name not in self.names:
            return super()._parameter(name)
        i = self.names.index(name)
        value, sd = float(get(self.model, name)), float(np.sqrt(self.covariance[i, i]))
        signed = ("gravity.alpha1", "elastic.c1", "elastic.c2", "jamming.c5")
        positive = value > 0 and name not in signed and not name.startswith("effects.")
        share = sd / abs(value) if value else np.inf
        width = 1.96 * min(share, 10.0)
        ci = (value * np.exp(-width), value * np.exp(width)) if positive else (value - 1.96 * sd, value + 1.96 * sd)
        bounds = self.estimate.problem.bounds.get(name) or limits(self.model).get(name)
        if bounds and min(value - bounds[0], bounds[1] - value) < 1e-3 * (bounds[1] - bounds[0]):
            near = min(bounds, key=lambda b: abs(b - value))
            reason = f"the data pull it past its bound {near:g}"
            return Parameter(name, float(near), self._unit(name), None, None, None, "at bound", reason, "dynamic")
        if share > LOOSE or (not positive and ci[0] <= 0 <= ci[1]):
            verdict, reason = "not identifiable", f"{self._confounded(name)}; what would help: {HELPS.get(name, '')}"
        else:
            verdict, reason = "identifiable", f"known to {100 * share:.2g} % (1 sd) if the model's form holds"
        return Parameter(
            name, value, self._unit(name), sd, (float(ci[0]), float(ci[1])), None, verdict, reason, "dynamic"
        )

    @cached_property
    def run_errors(self) -> list[RunError]:
        """How each run was explained, those held out last."""
        out = []
        for estimate, role in ((self.estimate, "train"), (self.held_out, "held_out")):
            if estimate is None:
                continue
            error = estimate.error.mean(axis=1)
            kept_out = _left_out(estimate) if role == "train" else None
            for i, motion in enumerate(estimate.problem.motions):
                mine = estimate.windows.sample_run == i
                e = error[mine]
                out.append(
                    RunError(
                        motion.run.run_id,
                        role,
                        len(e),
                        float(np.sqrt(np.mean(e**2))),
                        float(np.max(np.abs(e))),
                        None if kept_out is None else kept_out[i],
                        None if estimate.step_error is None else float(estimate.step_error[i]),
                    )
                )
        return out

    @property
    def colour(self) -> float:
        """How much wider the residuals' colour makes the standard deviations, median over the parameters."""
        return float(np.median(np.sqrt(np.diag(self.estimate.covariance) / np.diag(self.estimate.white))))

    @property
    def noise(self) -> np.ndarray:
        """(c,) standard deviation of the white part of the measurements [rad]."""
        return np.sqrt(np.mean([m.noise**2 for m in self.estimate.problem.motions], axis=0))

    @property
    def unexplained(self) -> float:
        """What is left over in units of the measurements' white noise."""
        return float(np.max(self.estimate.sigma / np.maximum(self.noise, 1e-12)))

    @property
    def structured(self) -> bool:
        """Whether what is left over is more than noise."""
        return self.unexplained > UNEXPLAINED or self.colour > COLOURED

    @property
    def warnings(self) -> list[str]:
        out = self._about_logs()
        if not self.estimate.converged:
            out.append("the search stopped before it converged: take the values with care, or try --restarts 8")
        for p in self.fitted:
            if p.verdict == "not identifiable":
                out.append(f"{p.name} is not identified: {p.reason}")
            elif p.verdict == "at bound":
                out.append(f"{p.name} is at its bound: {p.reason}")
        if sensitive := [e.run_id for e in self.run_errors if e.sensitive]:
            out.append(
                f"{', '.join(sensitive)}: the simulated motion hangs on the solver's step (stick-slip); such stretches "
                "say little about the parameters, and are one of many motions the model allows"
            )
        if self.structured:
            out.append(
                f"what is left over is {self.unexplained:.1f} × the measurements' white noise and {self.colour:.1f} × "
                "as wide in effect: the model lacks something these runs show; the values are biased by more than "
                "their standard deviations"
            )
        if self.restarts and max(self.restarts) > 1.02 * min(self.restarts):
            worse = sum(r > 1.02 * min(self.restarts) for r in self.restarts)
            out.append(f"{worse} of {len(self.restarts)} starts ended in a worse fit; the best was taken")
        return out

    def as_dict(self) -> dict[str, Any]:
        e = self.estimate
        names, correlation = self.correlation
        robots = sorted({r.robot_id for r in self.runs})
        trained = {self.moving[i]: i for i in range(len(self.moving))}
        errors = {r.run_id: r for r in self.run_errors}
        return plain(
            {
                "schema": SCHEMA,
                "version": version("ljjax"),
                "robot_id": robots[0] if len(robots) == 1 else robots,
                "options": dict(self.options),
                "start": self.start_from,
                "inputs": [
                    {**about_run(r, "train"), "samples": errors[r.run_id].samples if i in trained else 0}
                    for i, r in enumerate(self.runs)
                ]
                + [about_run(r, "held_out") for r in self.held_out_runs],
                "said": list(self.said),
                "gauge": "sigma0 = 1 1/rad: c4, c5 are bristle stiffness",
                "lever_arm_m": float(self.model.chain.lever_arm_m),
                "parameters": {
                    p.name: {k: v for k, v in vars(p).items() if k != "name"} for p in self.parameters.values()
                },
                "correlation": {"names": names, "matrix": correlation},
                "covariance": {"names": names, "matrix": self.covariance},
                "runs": [{**vars(r), "sensitive": r.sensitive} for r in self.run_errors],
                "noise": {
                    "unit": "rad",
                    "white": self.noise,
                    "residual": e.sigma,
                    "colour": self.colour,
                    "weighted_down": float(np.mean(e.weight < 1)),
                },
                "points": {
                    p.kind: {"count": len(p), "rmse": s, "unit": UNIT[p.kind]}
                    for p, (_, s) in zip(e.problem.points, e.statics, strict=True)
                },
                "held_out_rms": _rms([r.rms for r in self.run_errors if r.role == "held_out"]),
                "profiles": {
                    name: {"value": x, "chi2_above_least": y, "ci95": profile_interval(x, y)}
                    for name, (x, y) in self.profiles.items()
                },
                "search": {
                    "converged": e.converged,
                    "chi2": e.chi2,
                    "evaluations": [{"round": h[0], "passes": h[1], "rms_rad": h[2]} for h in e.history],
                    "restarts": list(self.restarts),
                },
                "warnings": self.warnings,
            }
        )

    def report(self, data: Mapping[str, Any]) -> str:
        from ljjax.fit.moving_report import report

        return report(self, data)

    def _overlay(self, index: int) -> dict[str, dict[str, Signal]]:
        if index not in self.moving:
            return {"/sim": {}, "/residual": {}}
        mine = self.estimate.windows.sample_run == self.moving.index(index)
        shape = self.runs[index].signal("shape")
        t = self.estimate.windows.sample_t[mine]
        predicted, error = self.estimate.predicted[mine], self.estimate.error[mine]
        return {
            "/sim": {"shape": Signal(t, predicted, shape.columns, "rad", "")},
            "/residual": {"shape": Signal(t, error, shape.columns, "rad", "")},
        }


def _left_out(estimate: Estimate) -> list[float]:
    """RMS error of θ of each run where its own data are left out of the fit [rad]."""
    error = left_out(estimate, np.arange(len(estimate.problem.motions))).mean(axis=1)
    own = [error[estimate.windows.sample_run == i] for i in range(len(estimate.problem.motions))]
    return [float(np.sqrt(np.mean(e**2))) for e in own]


def profile_interval(value: np.ndarray, chi2: np.ndarray) -> tuple[float | None, float | None]:
    """Where a profile crosses the 95 % limit of χ² with one degree of freedom, below and above; None where it does
    not."""
    limit = float(stats.chi2.ppf(0.95, 1))
    least = int(np.argmin(chi2))

    def crossing(x: np.ndarray, y: np.ndarray) -> float | None:
        above = np.flatnonzero(y > limit)
        if not len(above):
            return None
        i = int(above[0])
        share = (limit - y[i - 1]) / (y[i] - y[i - 1])
        return float(x[i - 1] + share * (x[i] - x[i - 1]))

    return crossing(value[least::-1], chi2[least::-1]), crossing(value[least:], chi2[least:])


def _rms(x: Sequence[float]) -> float | None:
    return float(np.sqrt(np.mean(np.square(x)))) if len(x) else None
