"""What may be the cause: every effect at its null in one model, and trials that set some of them free."""

from __future__ import annotations

import dataclasses
import itertools
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

from ljjax.effect import Effect
from ljjax.effects.varying import EACH, HALFWAY, ways
from ljjax.fit.coordinates import without_effects
from ljjax.model import Model


@dataclass(frozen=True, eq=False)
class Trial:
    """Effects set free together.

    Attributes:
        ids: the effects; none for the base alone.
        start: value by path of their parameters where a search begins; its keys are what is free.
    """

    ids: tuple[str, ...] = ()
    start: Mapping[str, float] = field(default_factory=dict)

    @property
    def size(self) -> int:
        return len(self.start)


CAUTIOUS = 0.3
"""The share of a step of first order that is still taken where the whole one has gone astray."""


def cautious(trial: Trial, kinds: Sequence[type[Effect]]) -> Trial:
    """The same trial begun nearer to where its effects vanish; their forms as they were."""
    nulls = {path(k, n): float(k.fields()[n]["null"]) for k in kinds for n in k.sizes()}
    return Trial(
        trial.ids, {p: nulls[p] + CAUTIOUS * (x - nulls[p]) if p in nulls else x for p, x in trial.start.items()}
    )


def either_side(trial: Trial, kinds: Sequence[type[Effect]]) -> list[Trial]:
    """The same trial begun with its effects as large as usual, the largest of their sizes by its own scale, and as far
    to the other side of where they vanish; sizes that have but one side on that, and once if all have."""
    about = {path(k, n): k.fields()[n] for k in kinds for n in k.sizes()}
    own = {p: (x - about[p]["null"], about[p]["scale"]) for p, x in trial.start.items() if p in about}
    most = max((abs(x) / scale for x, scale in own.values()), default=0.0)
    out: list[Trial] = []
    for turn in (1.0, -1.0):
        start = dict(trial.start)
        for p, (x, scale) in own.items():
            low, null, high = (float(about[p][n]) for n in ("low", "null", "high"))
            step = turn * (x / most if most > 0 else scale)
            start[p] = null + (abs(step) if low >= null else -abs(step) if high <= null else step)
        if all(start != t.start for t in out):
            out.append(Trial(trial.ids, start))
    return out


def still(kind: type[Effect], beside: Collection[str] = ()) -> dict[str, float]:
    """By path how an effect that may vary does, where it does not; `beside` other parameters, by path: what begins at a
    moment or is another in each run does not wear in too, which could hardly be told from that."""
    sudden = any(p.startswith((path(kind, "by_onset"), path(kind, EACH.format("")))) for p in beside)
    return {path(kind, n): x for n, x in (dict.fromkeys(ways(kind), 0.0) | ({} if sudden else HALFWAY)).items()}


def universal(model: Model, kinds: Sequence[type[Effect]]) -> Model:
    """The model with every effect of `kinds` at its null: one program simulates all candidates."""
    return dataclasses.replace(without_effects(model), effects=tuple(map(_null, kinds)))


@cache
def _null(kind: type[Effect]) -> Effect:
    return kind()


def sizes(kind: type[Effect], joints: int, logged: int) -> list[str]:
    """Names of the parameters that say how large an effect is, those left out that nothing logged could show: modes
    along the body where `logged` is θ alone, or the body has too few joints for them."""
    modes = max(min(logged, joints) - 1, min(kind.modes_of_theta, joints - 1))
    return [n for n in kind.sizes() if not re.fullmatch(r"mode\d+", n) or int(n[4:]) <= modes]


def pilots(kind: type[Effect], span: Mapping[str, float], waves: Sequence[float] = ()) -> list[dict[str, float]]:
    """Forms from which a search begins: name → value, one form varied at a time; where they are of `waves` [1/rad],
    each wave with each of the other forms, as a search does not find its way from one wave to another."""
    forms = {n: about for n, about in kind.fields().items() if about["pilots"]}
    if not forms:
        return [{}]

    def of(about: Mapping[str, Any]) -> list[float]:
        if about["of"] == "waves":
            return list(waves or about["pilots"])
        return [p * span[about["of"]] for p in about["pilots"]]

    values = {n: [min(max(x, about["low"]), about["high"]) for x in of(about)] for n, about in forms.items()}
    if any(about["of"] == "waves" for about in forms.values()):
        return [dict(zip(values, form, strict=True)) for form in itertools.product(*values.values())]
    middle = {n: v[len(v) // 2] for n, v in values.items()}
    out = [{**middle, n: x} for n, v in values.items() for x in v]
    return [form for i, form in enumerate(out) if form not in out[:i]]


def in_words(kind: type[Effect]) -> str:
    """The first clause of an effect's own description, to stand in brackets beside its name."""
    text = re.split(r"[,:;.](?:\s|$)|\s\(", " ".join((kind.__doc__ or "").split()))[0]
    return text[:1].lower() + text[1:]


def path(kind: type[Effect], name: str) -> str:
    """The path of an effect's parameter."""
    return f"effects.{kind.id}.{name}"
