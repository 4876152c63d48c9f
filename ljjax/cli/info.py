"""`ljjax info`: what logs hold, and whether they meet the contract."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from ljjax.errors import InputError


def command(
    logs: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="LOG…")],
    mapping: Annotated[str | None, tyro.conf.arg(metavar="FILE")] = None,
) -> None:
    """Show what logs hold and whether they meet the contract.

    For each log: metadata of the run, signals with rates and gaps, the offsets between the clocks, damage,
    and what is missing for replay, for dynamic and steady fits, and for stiffness.

    Args:
        logs: MCAP files, folders (searched for *.mcap) or globs.
        mapping: a mapping file (TOML) for logs that do not follow the contract.
    """
    from rich.console import Console

    from ljjax.logs import find, load_mapping, read
    from ljjax.logs.container import scan
    from ljjax.logs.info import show

    console = Console()
    if not console.is_terminal:
        console.width = 160
    how = load_mapping(mapping) if mapping is not None else None
    bad: list[InputError] = []
    paths: dict[Path, None] = {}
    for arg in logs:
        try:
            paths |= dict.fromkeys(find([arg]))
        except InputError as error:
            bad.append(error)
    for path in paths:
        try:
            run = read(path, how)
            box = scan(path, lambda topic: False)
        except InputError as error:
            bad.append(error)
            continue
        used = {topic + end for s in run.signals.values() for topic in s.topic.split(", ") for end in ("", "/sd")}
        others: dict[str, int] = {}
        for channel in box.channels.values():
            if channel.topic not in used:
                others[channel.topic] = others.get(channel.topic, 0) + box.counts[channel.id]
        show(run, console, others)
        console.print()
    if not logs:
        raise InputError("no log given; expected files, folders or globs of *.mcap")
    if len(bad) == 1:
        raise bad[0]
    if bad:
        raise InputError(f"{len(bad)} logs cannot be used: " + " | ".join(map(str, bad)))
