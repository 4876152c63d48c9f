"""A law, a robot and a clock for the rig: none of them needs JAX or waits for real time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ljjax.law import Gains, Law, Limits, Robot, Tables
from ljjax.law.file import content, dumps
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


def make_law(kind: Any = "integral") -> Law:
    """A law of two segments for the mock's body: k₀ + k₁u_P, no gravity, friction that hardly matters."""
    root = 40.0 / (40.0 + 1e-4) ** 0.5
    return Law(
        kind,
        0.005,
        Gains(0.3, 20.0, 0.02, 1.0, 0.0, 0.002, 0.5, 0.02),
        Robot(2.0, 0.02, 0.0, 1.0, 1.6, 0.0025, 0.003, 0.045),
        Limits(0.5, 30.0, 2.0, 200.0, 40.0, 50.0, 0.25, 3000.0, 9000.0),
        Tables(
            tuple(2.0 + 0.08 * 40.0 * (k / 20.0) ** 2 for k in range(21)),
            tuple(12.0 + 20.0 * k / 20.0 for k in range(21)),
            (0.0, 0.5 * root, root),
        ),
    )


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
