"""Data that come with ljjax: the published measurements of OctRobot-I, as tables and as logs."""

from __future__ import annotations

from pathlib import Path

HERE = Path(__file__).parent
OCTROBOT = HERE / "octrobot"
"""Folder of the OctRobot-I tables (`*.csv`), logs (`*.mcap`) and starting model (`nominal.toml`)."""
