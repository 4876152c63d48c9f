"""Logs: read, write and find MCAP files in contract v1, or other people's through a mapping. Never loads JAX."""

from ljjax.logs.find import find
from ljjax.logs.mapping import Mapping, load_mapping
from ljjax.logs.overlay import copy_overlay
from ljjax.logs.reader import read, read_all, read_attachment, started_ns
from ljjax.logs.run import Damage, Run, Signal
from ljjax.logs.writer import Writer

__all__ = [
    "Damage",
    "Mapping",
    "Run",
    "Signal",
    "Writer",
    "copy_overlay",
    "find",
    "load_mapping",
    "read",
    "read_all",
    "read_attachment",
    "started_ns",
]
