"""The `path` of a mapping: how to reach one number inside a message, such as `effort[name=tendon_left]`."""

from __future__ import annotations

import re
from typing import Any, NamedTuple

_PIECE = re.compile(r"(?P<attribute>[A-Za-z_]\w*)|\[(?P<index>\d+)\]|\[(?P<list>[A-Za-z_]\w*)=(?P<value>[^\]]+)\]")


class Step(NamedTuple):
    """One step: an attribute, an index, or where the sibling list `key` (or the items' own field) says `value`."""

    kind: str
    key: str
    value: str = ""


class NotThere(LookupError):
    """The message does not have what the path names."""


def parse_path(text: str) -> tuple[Step, ...]:
    """Steps of a path. Raises ValueError saying what cannot be read."""
    steps: list[Step] = []
    at = 0
    while at < len(text):
        if text[at] == "." and steps:
            at += 1
        elif steps and text[at] != "[":
            raise ValueError(f"{text!r} cannot be read at {text[at:]!r}")
        piece = _PIECE.match(text, at)
        if piece is None or (at and text[at - 1] == "." and piece["attribute"] is None):
            raise ValueError(
                f"{text!r} cannot be read at {text[at:]!r}; expected such as effort[name=left], data or pose.position.x"
            )
        if piece["attribute"]:
            steps.append(Step("attribute", piece["attribute"]))
        elif piece["index"]:
            steps.append(Step("index", piece["index"]))
        else:
            steps.append(Step("named", piece["list"], piece["value"].strip("\"' ")))
        at = piece.end()
    if not steps or steps[0].kind == "named":
        raise ValueError(f"{text!r} names no field of the message")
    return tuple(steps)


def member(obj: Any, key: str) -> Any:
    """An attribute of a message or an entry of a JSON object. Raises NotThere."""
    if isinstance(obj, dict):
        if key in obj:
            return obj[key]
        raise NotThere(f"has no {key}, only {', '.join(map(str, obj)) or 'nothing'}")
    try:
        return getattr(obj, key)
    except AttributeError:
        raise NotThere(f"has no {key}") from None


def number_at(message: Any, steps: tuple[Step, ...]) -> float:
    """The number that a path leads to. Raises NotThere."""
    here, parent = message, message
    for step in steps:
        if step.kind == "attribute":
            parent, here = here, member(here, step.key)
        elif step.kind == "index":
            parent, here = here, _item(here, int(step.key))
        else:
            parent, here = here, _named(parent, here, step)
    if isinstance(here, bool) or not isinstance(here, int | float):
        raise NotThere(f"is {type(here).__name__} where a number is expected")
    try:
        return float(here)
    except OverflowError:
        raise NotThere("is a number too large for anything") from None


def _item(sequence: Any, index: int) -> Any:
    try:
        return sequence[index]
    except (IndexError, KeyError, TypeError):
        raise NotThere(f"has no item {index}") from None


def _named(parent: Any, here: Any, step: Step) -> Any:
    """`effort[name=left]`: where `name`, beside `effort`, says `left`; or the item whose own `name` is `left`."""
    try:
        labels = [str(label) for label in member(parent, step.key)]
    except (NotThere, TypeError):
        try:
            labels = [str(member(item, step.key)) for item in here]
        except TypeError:
            raise NotThere(f"has no list to look up {step.key}={step.value} in") from None
    if labels.count(step.value) != 1:
        raise NotThere(
            f"has {step.value!r} {labels.count(step.value)} times in {step.key} ({', '.join(labels) or 'empty'})"
        )
    return _item(here, labels.index(step.value))
