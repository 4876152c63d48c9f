"""What a fit found, as one value that knows how to save itself: fit.json, model.toml, report.html, result.mcap."""

from __future__ import annotations

import json
import os
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib.metadata import version
from typing import Any

import numpy as np
from scipy import stats

from ljjax import modelfile
from ljjax.fit.paper import PUBLISHED_FOR
from ljjax.fit.points import UNIT, beware_of
from ljjax.fit.static import Stage, StaticFit
from ljjax.logs import Run, Signal, copy_overlay
from ljjax.model import Model, get, units
from ljjax.modelfile import ModelFile
from ljjax.outputs import artefacts

NOMINAL = f"{PUBLISHED_FOR}'s geometry and assumed friction (nominal.toml)"
"""Where a fit without a model begins."""
UNSTABLE = 3.0
"""A parameter whose deviation over left-out pressure levels is this many times its standard deviation is flagged."""


@dataclass(frozen=True)
class Parameter:
    """One parameter as reported.

    Attributes:
        value, sd, ci95: in `unit`; sd and ci95 None where not fitted or held by a bound.
        sd_over_pressures: from leaving each pressure level out; None where there are too few levels.
        verdict: `identifiable`, `not identifiable`, `at bound`, `frozen` or `assumed`.
        reason: why, in words.
        source: `steady`, `probe` or `model`.
    """

    name: str
    value: float
    unit: str
    sd: float | None
    ci95: tuple[float, float] | None
    sd_over_pressures: float | None
    verdict: str
    reason: str
    source: str

    @property
    def unsettled(self) -> bool:
        """Whether it moves with the pressures used by more than its standard deviation can mean."""
        return bool(self.sd and self.sd_over_pressures and self.sd_over_pressures > UNSTABLE * self.sd)

    @property
    def judgement(self) -> str:
        """The verdict in words for people."""
        return self.verdict + (", moves with pressures" if self.unsettled and self.verdict == "identifiable" else "")

    @property
    def settled(self) -> bool:
        """Identifiable, and not moved by the choice of pressures."""
        return self.judgement == "identifiable"


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class FitResult(ABC):
    """The identified robot and the evidence. What is said of parameters, in whatever way they were found, is here.

    Attributes:
        start: the model file the fit began from; `start_from` says where that came from.
        runs: the logs used, `said` what each gave.
        options: what was asked for.
    """

    start: ModelFile
    start_from: str
    runs: Sequence[Run]
    said: Sequence[str]
    options: Mapping[str, Any]

    def __repr__(self) -> str:
        rows = "\n".join(
            f"  {p.name} = {p.value:.4g} ± {p.sd or float('nan'):.2g} {p.unit} ({p.judgement})" for p in self.fitted
        )
        return f"{type(self).__name__} of {len(self.runs)} runs:\n{rows}"

    @property
    @abstractmethod
    def model(self) -> Model:
        """The identified robot."""

    @cached_property
    def parameters(self) -> dict[str, Parameter]:
        """Every parameter of the model, by path."""
        return {name: self._parameter(name) for name in units(self.model)}

    @property
    def fitted(self) -> list[Parameter]:
        """Those the fit moved."""
        return [p for p in self.parameters.values() if p.source != "model"]

    def _unit(self, name: str) -> str:
        return units(self.model)[name]

    def _parameter(self, name: str) -> Parameter:
        """A parameter the fit did not move."""
        frozen = name in self.options["frozen"]
        reason = "held at the given model's value" if frozen else f"taken from {self.start_from}; not fitted here"
        value = float(get(self.model, name))
        return Parameter(
            name, value, self._unit(name), None, None, None, "frozen" if frozen else "assumed", reason, "model"
        )

    @property
    @abstractmethod
    def correlation(self) -> tuple[tuple[str, ...], np.ndarray]:
        """Names and (k, k) correlations of the fitted parameters; NaN where not known."""

    def _confounded(self, name: str) -> str:
        names, correlation = self.correlation
        i = names.index(name)
        others = [
            (abs(r), other, r)
            for other, r in zip(names, correlation[i], strict=True)
            if other != name and np.isfinite(r)
        ]
        if others and max(others)[0] > 0.8:
            _, other, r = max(others)
            return f"these data cannot part it from {other} (correlation {r:+.2f}); freeze it, or add data that can"
        return "its effect on these data is below their scatter"

    @property
    def warnings(self) -> list[str]:
        """What a user must know before using the values, one line each."""
        return self._about_logs()

    def _about_logs(self) -> list[str]:
        out = beware_of(self.runs, self.said)
        if self.start_from == NOMINAL and any(r.robot_id != PUBLISHED_FOR for r in self.runs):
            out.append(
                "no model given: geometry, mass, friction and all that was not fitted are OctRobot-I's, not this "
                "robot's; give yours with --model"
            )
        return out

    @abstractmethod
    def as_dict(self) -> dict[str, Any]:
        """The content of fit.json."""

    @abstractmethod
    def report(self, data: Mapping[str, Any]) -> str:
        """The page of report.html, given `as_dict()`."""

    def model_file(self) -> ModelFile:
        """The identified robot as a model.toml holds it."""
        sds = {p.name: p.sd for p in self.parameters.values() if p.sd is not None}
        return replace(self.start, model=self.model, uncertainty=sds)

    def save(self, out: str | os.PathLike[str]) -> None:
        """Write fit.json, model.toml, report.html and result.mcap into the folder `out`; all of them or none.

        Raises InputError where `out` cannot be written, or where that would replace one of the logs.
        """
        with artefacts(out, keep=[self.start_from, *(run.path for run in self.runs)]) as folder:
            data = self.as_dict()
            text = json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False)
            (folder / "fit.json").write_text(text + "\n", encoding="utf-8")
            (folder / "model.toml").write_text(modelfile.dumps(self.model_file(), self._comment()), encoding="utf-8")
            (folder / "report.html").write_text(self.report(data), encoding="utf-8")
            copy_overlay(self.runs, folder / "result.mcap", [self._overlay(i) for i in range(len(self.runs))])

    def _comment(self) -> str:
        fitted = ", ".join(p.name for p in self.fitted)
        assumed = ", ".join(p.name for p in self.parameters.values() if p.source == "model")
        logs = ", ".join(r.run_id for r in self.runs)
        return (
            f"Identified by ljjax {version('ljjax')} from {logs}.\nFitted: {fitted}.\n"
            f"Taken from {self.start_from}: {assumed}."
        )

    @abstractmethod
    def _overlay(self, index: int) -> dict[str, dict[str, Signal]]:
        """`/sim` and `/residual` of one run."""


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class StaticResult(FitResult):
    """A fit to steady points and probe stiffness: `static` holds its regressions."""

    static: StaticFit

    @property
    def model(self) -> Model:
        return self.static.model

    def _parameter(self, name: str) -> Parameter:
        for kind, stage in self.static.stages.items():
            if name in stage.names:
                return self._fitted(name, float(get(self.model, name)), kind, stage)
        return super()._parameter(name)

    def _fitted(self, name: str, value: float, kind: str, stage: Stage) -> Parameter:
        i = stage.names.index(name)
        jackknife = _finite(stage.jackknife_sd[i])
        if stage.solution.at_bound[i]:
            return Parameter(
                name,
                value,
                self._unit(name),
                None,
                None,
                jackknife,
                "at bound",
                "the data pull it past its bound",
                kind,
            )
        sd = self.static.sd(name)
        t = float(stats.t.ppf(0.975, stage.solution.degrees_of_freedom))
        ci = (value - t * sd, value + t * sd)
        if ci[0] <= 0 <= ci[1]:
            verdict, reason = "not identifiable", "its 95 % interval holds 0: " + self._confounded(name)
        else:
            verdict, reason = (
                "identifiable",
                f"known to {100 * sd / abs(value):.2g} % (1 sd) if the model's form holds",
            )
        return Parameter(name, value, self._unit(name), sd, ci, jackknife, verdict, reason, kind)

    @property
    def correlation(self) -> tuple[tuple[str, ...], np.ndarray]:
        """Names and (k, k) correlations of the fitted parameters; NaN at a bound."""
        c = self.static.covariance
        d = np.sqrt(np.diag(c))
        return self.static.names, c / np.outer(d, d)

    @property
    def warnings(self) -> list[str]:
        out = self._about_logs() + self.static.warnings
        if (steady := self.static.stages.get("steady")) and np.any(steady.points.hold):
            held = int(np.sum(steady.points.hold))
            out.append(
                f"{held} steady points are holds in moving runs: each carries friction left at rest, up to φμ_S over "
                "the lever arm; it averages out only if holds are approached from both sides"
            )
        for kind, stage in self.static.stages.items():
            loose = [p for p in map(self.parameters.get, stage.names) if p and p.unsettled]
            if loose:
                factor = max(p.sd_over_pressures / p.sd for p in loose if p.sd and p.sd_over_pressures)
                out.append(
                    f"{', '.join(p.name for p in loose)} move with the pressures used, up to {factor:.0f} × their "
                    f"standard deviation: the model's law over pressure does not fit the {kind} points; do not "
                    "extrapolate it"
                )
        for kind, stage in self.static.stages.items():
            noise = stage.points.scatter
            if noise and stage.rmse > 1.5 * noise:
                out.append(
                    f"{kind} error {stage.rmse:.3g} {UNIT[kind]} RMS is {stage.rmse / noise:.1f} × the measurements' "
                    "stated scatter: something unmodelled is left"
                )
            runs = np.unique(stage.points.run)
            bias = [stage.error[stage.points.run == i].mean() for i in runs]
            if len(runs) > 1 and max(bias) - min(bias) > 2 * stage.rmse:
                high, low = (self.runs[int(runs[int(f(bias))])].run_id for f in (np.argmax, np.argmin))
                out.append(
                    f"runs disagree: {kind} measurements of {high} lie {max(bias) - min(bias):.3g} {UNIT[kind]} above "
                    f"those of {low} at the model's values; consider fitting them apart"
                )
        return out

    def as_dict(self) -> dict[str, Any]:
        from ljjax.fit.record import record

        return record(self)

    def report(self, data: Mapping[str, Any]) -> str:
        from ljjax.fit.report import report

        return report(self, data)

    def _overlay(self, index: int) -> dict[str, dict[str, Signal]]:
        """What the model says in place of the measured tension and probe force."""
        sim: dict[str, Signal] = {}
        residual: dict[str, Signal] = {}
        run = self.runs[index]
        for kind, stage in self.static.stages.items():
            mine = stage.points.run == index
            if not np.any(mine):
                continue
            t, model, error = stage.points.t[mine], stage.predicted[mine], stage.error[mine]
            if kind == "steady":
                other = run.signal("tendons", "cmd_tendons")
                right = other.held_at(t)[:, 1]
                name, base = "tendons", np.stack([model + right, right], 1)
                difference = np.stack([error, np.zeros_like(error)], 1)
            else:
                other = run.signal("probe")
                x = other.held_at(t)[:, 0]
                name, base = "probe", np.stack([x, model * x], 1)
                difference = np.stack([np.zeros_like(x), error * x], 1)
            sim[name] = Signal(t, base, other.columns, other.unit, "")
            residual[name] = Signal(t, difference, other.columns, other.unit, "")
        return {"/sim": sim, "/residual": residual}


def _finite(x: Any) -> float | None:
    return float(x) if np.isfinite(x) else None
