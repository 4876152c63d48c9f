"""What the report of a moving diagnosis draws: its refits and screens, run by run and step by step."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ljjax.effect import Effect
from ljjax.fit.problem import Estimate
from ljjax.gap import where
from ljjax.gap.candidates import in_words
from ljjax.gap.inquiry import Inquiry
from ljjax.gap.result import Diagnosis
from ljjax.gap.search import Refit
from ljjax.gap.show import WORDS
from ljjax.gap.static_figures import plain
from ljjax.page import number


@dataclass(frozen=True, eq=False)
class Course:
    """One run as measured and as three models predict it, freely from its start.

    Attributes:
        run_id: the run; `held_out` whether no fit has seen it.
        t: (N,) stamps [s] from the first.
        measured, given, base: (N, c) θ or joint angles [rad]: measured, of the given model, of the base refitted.
        extended: (N, c) of base and selected effects [rad], or None where none is selected.
        noise: (c,) standard deviation of the measurement's white noise [rad].
        pressure: (N,) vacuum [kPa]; `angle` (N,) mean angle [rad]; `direction` (N,) 1 away from straight, −1 back, 0
            at rest.
    """

    run_id: str
    held_out: bool
    t: np.ndarray
    measured: np.ndarray
    given: np.ndarray
    base: np.ndarray
    extended: np.ndarray | None
    noise: np.ndarray
    pressure: np.ndarray
    angle: np.ndarray
    direction: np.ndarray

    def error(self, model: str) -> np.ndarray:
        """(N, c) measured − `given`, `base` or `extended` [rad]; `extended` is the base where nothing was added."""
        predicted = getattr(self, model)
        return self.measured - (self.base if predicted is None else predicted)

    @cached_property
    def worst(self) -> int:
        """The joint in which the base errs most."""
        return int(np.argmax(np.sum(self.error("base") ** 2, axis=0)))


@dataclass(frozen=True)
class Step:
    """A step on the way to the selected model: what was done, RMS errors [rad] of the runs fitted and not fitted."""

    what: str
    train: float
    test: float


class Story:
    """Everything the pictures need: refits, screens, predictions of unseen runs."""

    def __init__(self, inquiry: Inquiry, chosen: Refit, seen: Sequence[Estimate]):
        self.setting, self.base, self.given, self.screen = inquiry.setting, inquiry.base, inquiry.given, inquiry.screen
        self.found, self.measured, self.evidence = inquiry.found, inquiry.measured, inquiry.evidence
        self.chosen, self.seen = chosen, seen
        self.steps = self._steps()

    def report(self, result: Any, data: Mapping[str, Any]) -> str:
        """The page."""
        from ljjax.gap.report import report

        return report(self, result, data)

    @property
    def extended(self) -> Refit | None:
        """The base with the selected effects, or None where none is selected."""
        return None if self.chosen is self.base else self.chosen

    @cached_property
    def kinds(self) -> dict[str, type[Effect]]:
        """The effects on trial by id."""
        return {k.id: k for k in self.setting.study.kinds}

    @cached_property
    def courses(self) -> list[Course]:
        """Every run: first those that no fit has seen, then by how much the base errs."""
        test = (self.seen[-1], self.seen[0], self.seen[1] if self.extended else None)
        train = (self.given.estimate, self.base.estimate, self.extended.estimate if self.extended else None)
        out = [*_courses(*test, held_out=True), *_courses(*train, held_out=False)]
        return sorted(out, key=lambda c: (not c.held_out, -np.mean(c.error("base") ** 2)))

    def _steps(self) -> list[Step]:
        """From the given model over the base refitted to each effect added, in the order in which they were found."""
        out = [_step("given model", self.given.estimate, self.seen[-1])]
        out += [_step("base refitted", self.base.estimate, self.seen[0])]
        if self.extended is None:
            return out
        ids = self.extended.ids
        known = {**{(i,): r for i, r in self.found.single.items()}, **self.found.joint}
        ways = [(k, known.get(tuple(sorted(ids[:k])))) for k in range(1, len(ids))]
        between = [(k, r) for k, r in ways if r is not None]
        seen = self.setting.study.predict([r for _, r in between], self.setting.test) if between else []
        before = 0
        for (k, refit), unseen in zip(between, seen, strict=True):
            out.append(_step(_added(ids[before:k]), refit.estimate, unseen))
            before = k
        return [*out, _step(_added(ids[before:]), self.extended.estimate, self.seen[1])]

    def models(self, result: Diagnosis) -> list[str]:
        """The models to draw: the last two on the way, or the base alone where what it leaves has no name."""
        if self.extended is not None:
            return ["base", "extended"]
        return ["base"] if result.verdict == "unlisted_effect" else ["given", "base"]

    def leaders(self, ids: Iterable[str], most: int) -> list[str]:
        """The first of some effects that have been refitted alone."""
        return [i for i in ids if i in self.found.single][:most]

    def likeness(self, ids: Sequence[str]) -> np.ndarray:
        """(k, k) cosine of the least angle between the traces of effects, the base's own taken out of both."""
        keys = [self.screen.best(i) for i in ids]
        return np.array([[1.0 if a == b else self.screen.alike(a, b) for b in keys] for a in keys])


def _added(ids: Sequence[str]) -> str:
    return "+ " + " and ".join(plain(i) for i in ids)


def _step(what: str, train: Estimate, test: Estimate) -> Step:
    return Step(what, *(float(np.sqrt(np.mean(e.error**2))) for e in (train, test)))


def _courses(given: Estimate, base: Estimate, extended: Estimate | None, held_out: bool) -> list[Course]:
    along = where.coordinates(base)
    out = []
    for i, m in enumerate(base.problem.motions):
        mine = base.windows.sample_run == i
        t = base.windows.sample_t[mine]
        before, after, more = (
            e.windows.shape(e.predicted)[e.windows.sample_run == i] for e in (given, base, extended or base)
        )
        pressure, angle, direction = (along[axis][mine] for axis in ("pressure", "angle", "direction"))
        models = (before, after, None if extended is None else more)
        measured = base.windows.shape(base.windows.y)[mine]
        run = m.run.run_id, held_out, t - t[0], measured
        out.append(Course(*run, *models, m.noise, pressure, angle, direction))
    return out


# --- in words


def headline(story: Story, result: Diagnosis) -> str:
    """The answer in a sentence or two."""
    gap = result.gap
    runs = f"{len(gap.held_out_runs)} run{'s' if len(gap.held_out_runs) > 1 else ''} that no fit has seen"
    before, floor, given = (degrees(x) for x in (gap.before, gap.noise_floor, gap.given))
    if result.verdict == "listed_effect":
        what = " and ".join(f"{plain(i)} ({in_words(story.kinds[i])})" for i in result.selected)
        falls = f"{_falls(gap.before, gap.after)} (noise {floor})"
        return (
            f"The model lacks {what}. With {'it' if len(result.selected) == 1 else 'them'} the error on {runs} {falls}."
        )
    if result.verdict == "no_gap":
        said = f"the given model errs by {given} on {runs}, against a noise of {floor}"
        return f"No gap: {said}. Nothing needs to be added."
    if result.verdict == "parameters_only":
        said = "No effect is missing: refitting the model’s own parameters closes the gap"
        return f"{said}. The error on {runs} {_falls(gap.given, gap.before)} (noise {floor})."
    least = min(story.evidence.left.values(), default=1.0)
    return (
        f"Something real is left that no listed effect explains: the refitted base errs by {before} on {runs}, against "
        f"a noise of {floor}, and the best listed effect would leave {100 * min(max(least, 0.0), 1.0):.0f} % of the "
        "gap. Nothing was added; the maps below show where to look."
    )


def _falls(a: float | None, b: float) -> str:
    return f"{'falls' if a is None or b < a else 'goes'} from {degrees(a)} to {degrees(b)}"


def cards(result: Diagnosis) -> list[tuple[str, str]]:
    """Headline numbers: (number, what it is)."""
    gap, first = result.gap, result.effects[0]
    cause = " + ".join(plain(i) for i in result.selected) or plain(result.verdict)
    words = WORDS[result.verdict].split(": ")[-1] if len(result.selected) < 2 else "effects the model lacks"
    steps = (gap.before, gap.after) if result.selected else (gap.given, gap.before)
    which = "base refitted → with effects" if result.selected else "given model → base refitted"
    out = [
        (cause[:1].upper() + cause[1:], words),
        (percent(first.probability), f"probability that the main cause is: {plain(first.id)}"),
        (" → ".join(degrees(x) for x in steps), f"RMS error on unseen runs, {which}"),
        (degrees(gap.noise_floor), "noise floor: white noise of the measured shape"),
    ]
    if gap.closed_fraction is None:
        out.append(("–", "share closed: the base is within a tenth of the noise, nothing to close"))
    elif result.selected:
        ci = gap.closed_fraction_ci95
        sure = f" (95 %: {100 * ci[0]:z.0f} to {100 * ci[1]:z.0f} %)" if ci else ""
        out.append((f"{100 * gap.closed_fraction:z.0f} %", f"of the gap closed on unseen runs{sure}"))
    return out


def percent(p: float) -> str:
    """A probability for people; no closer to 0 or 1 than a tenth of a percent."""
    return "< 0.1 %" if p < 1e-3 else ("> 99.9 %" if p > 0.999 else f"{100 * p:.3g} %")


def degrees(rad: float | None) -> str:
    """An angle for people."""
    return "–" if rad is None else f"{number(float(np.degrees(rad)))}°"


def assumed(result: Diagnosis) -> list[str]:
    """What the answer takes for granted."""
    o = result.options
    driven = "measured tension and pressure" if o.get("inputs") == "measured" else "commands"
    without = ", ".join(plain(i) for i in o.get("without", ())) or "none"
    return [
        f"Model: {o.get('model', 'given')}, driven by {driven}. Candidates left out by request: {without}. Seed "
        f"{result.seed}.",
        "Every effect is tried in the form its own page gives; another form of the same cause may fit better still.",
        "The base parameters are refitted with every candidate, so a wrong parameter does not pass for an effect. "
        "Temperature and wear carry on from run to run in the order in which they were recorded.",
        "The error is measured on whole runs that no fit has seen; its interval draws runs anew, all of them, fitted "
        "ones included.",
        "The noise floor is the white part of the measured shape; slow drift of the sensor counts as gap.",
    ]
