"""What the tests of sweeps share: inputs, a log, a small sweep, and when two are the same."""

from __future__ import annotations

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
import pytest

from ljjax.inputs import Inputs
from ljjax.logs.run import Run, Signal
from ljjax.model import Model
from ljjax.sweep import Sweep, sweep

MU, C5 = [0.03, 0.045, 0.06], [0.5, 0.9]
VARY = {"friction.mu_s": MU, "jamming.c5": C5}
STEP, BATCH = 0.01, 4


def bend(end: float = 0.6, tension: float = 12.0) -> Inputs:
    """Pull, hold, let go, under a vacuum that comes and goes."""
    t = end * np.array([0.0, 0.4, 0.6, 1.0])
    tendons = tension * np.array([[0.0, 0], [1, 0], [1, 0], [0, 0]])
    return Inputs(jnp.asarray(t), jnp.asarray(tendons), jnp.asarray([5.0, 5, 20, 5]), hold=False)


def standing() -> Inputs:
    """The same stamps, but nothing happens."""
    quiet = bend()
    return Inputs(quiet.t, 0 * quiet.tendons, quiet.pressure_kpa, hold=True)


def logged(inputs: Inputs, theta: float, samples: int) -> Run:
    """A run with these inputs as commands, that shows a constant angle."""
    t = np.asarray(inputs.t)
    seen = np.linspace(t[0], t[-1], samples)
    signals = {
        "cmd_tendons": Signal(t, np.asarray(inputs.tendons), ("tendon_left", "tendon_right"), "N", ""),
        "cmd_pressure": Signal(t, 101325 - 1e3 * np.asarray(inputs.pressure_kpa)[:, None], ("",), "Pa", ""),
        "shape": Signal(seen, np.full((samples, 1), theta), ("theta",), "rad", "/real/shape"),
    }
    return Run(f"{samples}.mcap", "ab" * 32, 0, signals, {"run_id": f"run-{samples}", "p_atm_pa": "101325"})


def swept(model: Model, runs=None, vary=VARY, **options) -> Sweep:
    """A sweep in the step and batch that all tests share, and so their compiled programs."""
    return sweep(
        model, bend() if runs is None else runs, vary, **{"step_s": STEP, "batch": BATCH, "errors": False, **options}
    )


def assert_same(one: Sweep, two: Sweep, but: tuple[str, ...] = ()) -> None:
    assert list(one.variables) == list(two.variables)
    for name, (dims, data, about) in one.variables.items():
        assert two.variables[name].dims == dims
        assert data.dtype == two[name].dtype
        np.testing.assert_array_equal(data, two[name], err_msg=name)
        np.testing.assert_equal(dict(about), dict(two.variables[name].attributes), err_msg=name)
    assert {k: v for k, v in one.attributes.items() if k not in but} == {
        k: v for k, v in two.attributes.items() if k not in but
    }


@pytest.fixture(scope="module")
def model(robot: Callable[..., Model]) -> Model:
    return robot(1)


@pytest.fixture(scope="module")
def grid(model: Model) -> Sweep:
    return swept(model)
