"""A law, a robot and a clock for the rig: none of them needs JAX or waits for real time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from benchmarks.rig_parts import mock_law
from ljjax.law import Law
from ljjax.law.file import content, dumps
from ljjax.law.parts import Kind
from ljjax.rig import config
from ljjax.rig.clock import Clock
from ljjax.rig.mock import MockRobot

TOML = """
schema = "ljjax.rig/1"
robot_id = "mock-1"
driver = "mock"
p_atm_pa = 101325

[limits]
tension_max_n = 30.0
tension_slew_n_s = 200.0
vacuum_max_kpa = 40.0
vacuum_slew_kpa_s = 50.0
theta_max_rad = 0.6

[safety]
ramp_s = 0.5
release_n_s = 40.0
log_s = 60.0        # a loaded machine is no broken disk
{safety}
[mock]
{mock}
"""


class FakeClock(Clock):
    """A clock that stands still but for waiting, and for ticks that come late on purpose."""

    def __init__(self, late: Callable[[float], float] = lambda t: 0.0):
        self.t, self._late = 1000.0, late

    def now(self) -> float:
        return self.t

    def wait(self, until: float) -> None:
        self.t = max(self.t, until) + self._late(self.t - 1000.0)


def make_law(kind: Kind = "integral") -> Law:
    """A law of two segments for the mock's body."""
    return mock_law(kind)


@pytest.fixture(scope="session")
def law_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("law") / "law.json"
    path.write_text(dumps(content(make_law(), {}, {})), encoding="utf-8")
    return path


@pytest.fixture
def clock() -> FakeClock:
    return FakeClock()


def configured(safety: str = "", mock: str = "") -> config.Config:
    """The rig.toml above, with more lines in [safety] and [mock]."""
    import tomllib

    text = TOML.format(safety=safety, mock=mock)
    return config.parse(tomllib.loads(text), "rig.toml", text)


def mock_robot(about: config.Config, clock: FakeClock) -> MockRobot:
    return MockRobot(about.mock, clock.now)


@pytest.fixture
def rig_file(tmp_path: Path) -> Path:
    path = tmp_path / "rig.toml"
    path.write_text(TOML.format(safety="", mock=""), encoding="utf-8")
    return path
