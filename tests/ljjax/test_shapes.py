"""The pieces effects are made of: what passes a play, a bound, a lag."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from ljjax.effects import REGISTRY
from ljjax.effects.shapes import bounded, lagged, play


def test_a_play_follows_at_its_half_width_and_holds_between():
    asked, held, memory = [0.0, 1.0, 3.0, 2.0, 1.0, -1.0, 0.5], [], (jnp.asarray(0.0), jnp.asarray(0.0))
    for x in asked:
        through, memory = play(jnp.asarray(x), jnp.asarray(1.0), memory)
        held.append(float(through))
    assert held == [0.0, 0.0, 2.0, 2.0, 2.0, 0.0, 0.0]


@pytest.mark.parametrize("edge", [2.0, 8.0])
def test_a_bound_passes_what_is_small_and_stops_what_is_large(edge):
    x = bounded(jnp.asarray([-1.0, 0.0, 0.3, 3.0, 3e3]), jnp.asarray(3.0), jnp.asarray(edge))
    np.testing.assert_allclose(x[:2], 0.0)
    np.testing.assert_allclose(x[2], 0.3, rtol=0.1**edge)
    np.testing.assert_allclose(x[3], 3.0 * 2 ** (-1 / edge))
    np.testing.assert_allclose(x[4], 3.0, rtol=1e-5)


def test_a_lag_is_exact_for_what_holds_over_a_step():
    mean, end = lagged(jnp.asarray(2.0), jnp.asarray(1.0), jnp.asarray(0.5), jnp.asarray(0.25))
    np.testing.assert_allclose(end, 2 - np.exp(-0.5))
    np.testing.assert_allclose(mean, 2 - 2 * (1 - np.exp(-0.5)))


@pytest.mark.parametrize("power, ratio", [(0.0, 1.0), (0.5, 2.0)])
def test_through_an_orifice_a_sheath_is_slower_the_further_it_has_to_go(power, ratio):
    """Shares of the way left after a short step, from 10 and from 40 kPa: τ goes with their ratio to `power`."""
    lag = REGISTRY["pressure_lag"](*map(jnp.asarray, (1.0, 1.0, power)))
    now: Any = SimpleNamespace(h=jnp.asarray(1e-3))
    gone = [float(-jnp.log(1 - lag.evacuate((0.0 * p,) * 4, p, now)[1][0] / p)) for p in map(jnp.asarray, (10.0, 40.0))]
    np.testing.assert_allclose(gone[0] / gone[1], ratio, rtol=1e-3)
