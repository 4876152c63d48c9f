"""Where the gap lies, along axes of few values and of many."""

from __future__ import annotations

import numpy as np
import pytest

from ljjax.gap.where import concentration, region


def place(at: np.ndarray, loud: np.ndarray, axis: str = "run") -> tuple[float, float]:
    return region("sensing", "theta", axis, at, np.where(loud, 1.0, 0.01)[:, None], 1.0, 0.9).range


@pytest.mark.parametrize("run", [0, 2, 7])
def test_a_gap_in_one_run_is_placed_in_that_run(run):
    at = np.repeat(np.arange(8.0), 50)
    assert place(at, at == run) == (run, run)


def test_of_few_pressures_that_is_named_which_has_the_gap():
    at = np.repeat([0.0, 10.0, 20.0], 100)
    assert place(at, at == 20, "pressure") == (20.0, 20.0)
    assert place(at, at >= 10, "pressure") == (10.0, 20.0)
    two = np.repeat([5.0, 25.0], [300, 100])
    assert place(two, two == 25, "pressure") == (25.0, 25.0)
    assert concentration(two, np.where(two == 25, 1.0, 0.0)[:, None]) == pytest.approx(1.0)


def test_at_rest_is_no_way_to_bend():
    way = np.tile([-1.0, 0.0, 1.0], 100)
    assert place(way, way == 0, "direction") == (0.0, 0.0)
    assert place(way, way == 1, "direction") == (1.0, 1.0)


def test_along_many_values_it_is_a_range():
    at = np.linspace(0.0, 40.0, 3000)
    assert place(at, (at > 10) & (at < 20), "pressure") == pytest.approx((10.0, 20.0), abs=1.5)
    assert place(np.full(300, 7.0), np.ones(300, bool), "pressure") == (7.0, 7.0)
