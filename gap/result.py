"""What a diagnosis found, as one value that knows how to save itself: gap.json, model.toml, base.toml, report.html,
result.mcap."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import Any

from ljjax import modelfile
from ljjax.fit.record import plain
from ljjax.gap.judge import Evidence
from ljjax.gap.layout import layout
from ljjax.logs import Run, Signal, copy_overlay
from ljjax.modelfile import ModelFile
from ljjax.outputs import artefacts

SCHEMA = "ljjax.gap/1"
LAST = ("no_gap", "parameters_only", "unlisted_effect")
"""The answers that are no effect, under their ids in gap.json."""


@dataclass(frozen=True)
class Gap:
    """How large the gap is and how far it closes: errors [`unit`] of runs that no fit has seen.

    Attributes:
        channel: what is compared: `theta`, `joints`, `tension`, `stiffness`.
        before, after: RMS error of the refitted base, and of base and selected effects refitted together.
        noise_floor: RMS of the measurements' white noise.
        closed_fraction: 1 − (after² − floor²)/(before² − floor²); None where `before` is within a tenth of the floor.
        closed_fraction_ci95: its 95 % interval.
        held_out_runs: ids of the runs it is measured on.
        given: RMS error of the given model on the same runs, or None.
    """

    channel: str
    unit: str
    before: float
    after: float
    noise_floor: float
    closed_fraction: float | None
    closed_fraction_ci95: tuple[float, float] | None
    held_out_runs: tuple[str, ...]
    given: float | None = None


@dataclass(frozen=True)
class Fold:
    """A condition left out of the fits: `by` pressure or run, its runs' ids and mean vacuum [kPa], and the share of its
    gap that the selected effects then close (to first order), None where it shows none."""

    by: str
    runs: tuple[str, ...]
    pressure_kpa: float
    closed_fraction: float | None


@dataclass(frozen=True)
class Region:
    """A place where the gap lies: block of the model, channel, axis and range along it (segments count from the base,
    runs by their start, both from 1; direction −1 is back to straight, 0 at rest), share of what the selected effects
    change or, where there are none, of the squared residuals."""

    block: str
    channel: str
    axis: str
    range: tuple[float, float]
    unit: str
    share: float


@dataclass(frozen=True)
class Finding:
    """One candidate (an effect, or one of `LAST`).

    Attributes:
        id: the effect.
        probability: that it is the cause (the main one of several).
        closed_fraction: share of the training runs' gap that it closes by itself, the base refitted with it.
        p_value: of its gain, against the largest gain of any candidate in data without an effect.
        parameters: name → value, sd, unit.
    """

    id: str
    probability: float
    closed_fraction: float | None = None
    p_value: float | None = None
    parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False, kw_only=True)
class Diagnosis:
    """The answer, and what it rests on.

    Attributes:
        verdict: `listed_effect`, `no_gap`, `parameters_only` or `unlisted_effect`.
        gap: how large it is, and how far it closes.
        folds: how far each condition's gap closes where it is left out of the fits; empty without selected effects.
        where: places, the largest share first.
        effects: every candidate and the three of `LAST`, the most probable first.
        selected: effects in the model, in the order in which they were found.
        equivalent: sets that these data cannot tell apart.
        minimum_detectable: effect → parameter, value, unit: the smallest these data could show.
        next_experiment: protocol, separates, expected_separation, why; None where nothing is left to part.
        base, model: the base refitted, without and with the selected effects.
        runs, roles: the logs, and for each `train`, if it was fitted, or `held_out`.
        said, warnings: what each log gave; what a reader must know.
        evidence: what the probabilities of moving runs rest on; None for steady ones.
        seed, options: what was asked for.
        story: what the report draws, by name; its pictures look for what they know.
    """

    verdict: str
    gap: Gap
    where: Sequence[Region]
    effects: Sequence[Finding]
    selected: Sequence[str]
    equivalent: Sequence[Sequence[str]]
    minimum_detectable: Mapping[str, Mapping[str, Any]]
    next_experiment: Mapping[str, Any] | None
    base: ModelFile
    model: ModelFile
    runs: Sequence[Run]
    roles: Sequence[str]
    said: Sequence[str]
    warnings: Sequence[str]
    seed: int
    options: Mapping[str, Any]
    story: Any
    overlays: Sequence[Mapping[str, Mapping[str, Signal]]]
    evidence: Evidence | None = None
    folds: Sequence[Fold] = ()

    def as_dict(self) -> dict[str, Any]:
        """The content of gap.json."""
        gap = {k: v for k, v in vars(self.gap).items()}
        return plain(
            {
                "schema": SCHEMA,
                "verdict": self.verdict,
                "gap": gap,
                "left_out": [vars(f) for f in self.folds],
                "where": [vars(r) for r in self.where],
                "effects": [vars(f) for f in self.effects],
                "selected": list(self.selected),
                "equivalent": [list(x) for x in self.equivalent],
                "minimum_detectable": dict(self.minimum_detectable),
                "next_experiment": self.next_experiment,
                "inputs": [
                    {"file": r.path, "sha256": r.sha256, "role": role, "run_id": r.run_id}
                    for r, role in zip(self.runs, self.roles, strict=True)
                ],
                "version": version("ljjax"),
                "seed": self.seed,
                "evidence": None if self.evidence is None else vars(self.evidence),
                "options": dict(self.options),
                "said": list(self.said),
                "warnings": list(self.warnings),
            }
        )

    def save(self, out: Any) -> None:
        """Write gap.json, model.toml, base.toml, report.html, result.mcap and foxglove.json into the folder `out`, all
        of them or none."""
        data = self.as_dict()
        found = ", ".join(self.selected) or "no effect"
        with artefacts(out, keep=[run.path for run in self.runs]) as made:
            text = json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
            (made / "gap.json").write_text(text, encoding="utf-8")
            note = f"by ljjax gap {data['version']}, from {len(self.runs)} logs"
            model = modelfile.dumps(self.model, f"base refitted, {found} added, {note}")
            (made / "model.toml").write_text(model, encoding="utf-8")
            (made / "base.toml").write_text(modelfile.dumps(self.base, f"base refitted, {note}"), encoding="utf-8")
            (made / "report.html").write_text(self.report(data), encoding="utf-8")
            copy_overlay(self.runs, made / "result.mcap", self.overlays)
            (made / "foxglove.json").write_text(
                json.dumps(layout(self.runs, self.overlays), indent=1) + "\n", encoding="utf-8"
            )

    def report(self, data: Mapping[str, Any]) -> str:
        """The page, from the result and its gap.json content."""
        return self.story.report(self, data)
