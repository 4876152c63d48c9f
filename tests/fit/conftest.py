"""Problems for the tests of the fit: OctRobot-I as fitted, synthetic points by formulas of their own, runs by hand."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ljjax.data import OCTROBOT
from ljjax.fit import fit
from ljjax.fit.points import Points
from ljjax.fit.result import StaticResult
from ljjax.logs import Run, Signal, read_all
from ljjax.model import Model, replace
from ljjax.modelfile import load

HALF_LENGTH_M, LEVER_M, P_ATM = 0.021, 0.02, 101_325.0
FITTED = ("gravity.alpha1", "elastic.c1", "elastic.c2", "elastic.c3", "jamming.c4", "jamming.c5")
COLUMNS = {
    "cmd_tendons": (("tendon_left", "tendon_right"), "N"),
    "tendons": (("tendon_left", "tendon_right"), "N"),
    "cmd_pressure": (("pressure",), "Pa"),
    "pressure": (("pressure",), "Pa"),
    "shape": (("theta",), "rad"),
    "probe": (("position", "force"), "m,N"),
}


@dataclasses.dataclass(frozen=True)
class Fitted:
    """A fit of OctRobot-I, saved: the result, its folder, and its fit.json."""

    result: StaticResult
    folder: Path
    json: dict[str, Any]


@pytest.fixture(scope="session")
def octrobot(tmp_path_factory: pytest.TempPathFactory) -> Fitted:
    """The fit of `make demo`."""
    folder = tmp_path_factory.mktemp("octrobot") / "new" / "fit"
    result = fit(None, read_all([OCTROBOT / "identification.mcap", OCTROBOT / "open_loop_stiffness.mcap"]))
    assert isinstance(result, StaticResult)
    result.save(folder)
    return Fitted(result, folder, json.loads((folder / "fit.json").read_text(encoding="utf-8")))


@dataclasses.dataclass(frozen=True)
class Truth:
    """A robot's statics, with formulas of its own (NumPy; model sections 2, 3, 6)."""

    n: int
    alpha1: float
    c1: float
    c2: float
    c3: float
    c4: float
    c5: float

    def alpha2(self, p: np.ndarray) -> np.ndarray:
        return self.c1 * p**2 + self.c2 * p + self.c3

    def tension(self, theta: np.ndarray, p: np.ndarray) -> np.ndarray:
        return (self.alpha1 * np.sin(self.n * theta) + self.alpha2(p) * theta) / LEVER_M

    def stiffness(self, p: np.ndarray) -> np.ndarray:
        a = HALF_LENGTH_M * (2 * np.arange(self.n, 0, -1) - 1)
        joint = self.alpha2(p) + self.c4 + self.c5 * np.sqrt(p)
        k = [self.alpha1 * np.ones((self.n, self.n)) + j * np.eye(self.n) for j in joint]
        return np.array([1 / (a @ np.linalg.inv(matrix) @ a) for matrix in k])

    def model(self, **change: float) -> Model:
        """The model to start a fit from: the right geometry, every value to fit wrong but for those in `change`."""
        start = {"alpha1": 0.1, "c1": 0.0, "c2": 0.0, "c3": 1.0, "c4": 10.0, "c5": 1.0, **change}
        nominal = load(OCTROBOT / "nominal.toml").model
        assert (float(nominal.chain.half_length_m), float(nominal.chain.lever_arm_m)) == (HALF_LENGTH_M, LEVER_M)
        sized = dataclasses.replace(nominal, chain=dataclasses.replace(nominal.chain, segments=self.n))
        return replace(sized, {path: start[path.split(".")[1]] for path in FITTED})

    @property
    def values(self) -> np.ndarray:
        """α₁, c₁, c₂, c₃, c₄, c₅."""
        return np.array([self.alpha1, self.c1, self.c2, self.c3, self.c4, self.c5])


def make_truth(seed: int = 0, n: int = 6, **change: float) -> Truth:
    """Random statics with α₂ > 0 and φ > 0 up to 40 kPa."""
    rng = np.random.default_rng(seed)
    c1, c2 = -rng.uniform(5e-4, 1.5e-3), rng.uniform(0.06, 0.1)
    known = {"alpha1": rng.uniform(0.1, 0.6), "c1": c1, "c2": c2, "c3": rng.uniform(1, 2)}
    known |= {"c4": rng.uniform(8, 15), "c5": rng.uniform(2, 4)}
    return Truth(n, **{**known, **change})


def make_points(kind: str, value: Any, p: Any, theta: Any = 0.0, sd: Any = np.nan) -> Points:
    value = np.asarray(value, float)
    sd, p, theta = (np.broadcast_to(np.asarray(x, float), value.shape).copy() for x in (sd, p, theta))
    count = np.arange(len(value))
    return Points(kind, value, sd, p, theta, count.astype(float), 0 * count, np.zeros(len(value), bool))


def make_measured(
    truth: Truth, seed: int | None = 0, steady_n: float = 0.3, probe_n_per_m: float = 2.0
) -> tuple[Points, Points]:
    """Steady points at 5 pressures × 12 angles up to 20° and probe points at 9 pressures; no noise for seed None."""
    rng = np.random.default_rng(seed)
    noise = (lambda size: np.zeros(size)) if seed is None else rng.normal
    p, theta = (
        x.ravel() for x in np.meshgrid(np.linspace(0, 40, 5), np.radians(np.linspace(2, 20, 12)), indexing="ij")
    )
    u = truth.tension(theta, p)
    levels = np.linspace(0, 40, 9)
    k = truth.stiffness(levels)
    return (
        make_points("steady", u + steady_n * noise(size=u.shape), p, theta, steady_n),
        make_points("probe", k + probe_n_per_m * noise(size=k.shape), levels, 0.0, probe_n_per_m),
    )


def make_run(experiment: str = "bend", path: str = "a.mcap", **signals: tuple[Any, Any]) -> Run:
    """A run of signals given as (t, value) or (t, value, sd)."""
    made = {}
    for name, (t, value, *sd) in signals.items():
        t = np.asarray(t, float).reshape(-1)
        shaped = [np.asarray(x, float).reshape(len(t), -1) for x in (value, *sd)]
        columns, unit = COLUMNS[name]
        if shaped[0].shape[1] != len(columns):
            columns = tuple(f"q{i + 1}" for i in range(shaped[0].shape[1]))
        made[name] = Signal(t, shaped[0], columns, unit, f"/real/{name}", *shaped[1:])
    metadata = {"run_id": path, "robot_id": "r", "experiment": experiment, "p_atm_pa": str(P_ATM)}
    return Run(path, hashlib.sha256(path.encode()).hexdigest(), 10**18, made, metadata)


@pytest.fixture(scope="session")
def truth() -> Callable[..., Truth]:
    """`truth(seed=0, n=6, **values)`: a robot's statics."""
    return make_truth


@pytest.fixture(scope="session")
def points() -> Callable[..., Points]:
    """`points(kind, value, p, theta=0, sd=nan)`."""
    return make_points


@pytest.fixture(scope="session")
def measured() -> Callable[..., tuple[Points, Points]]:
    """`measured(truth, seed=0, steady_n=0.3, probe_n_per_m=2.0)`: steady and probe points."""
    return make_measured


@pytest.fixture(scope="session")
def run_of() -> Callable[..., Run]:
    """`run_of(experiment, path, name=(t, value), …)`."""
    return make_run
