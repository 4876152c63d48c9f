"""What a run inherits from those before it."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np

from ljjax.fit.session import in_order
from ljjax.fit.windows import Motion
from ljjax.gap.data import unseen


def run(start_s: float, seconds: float, start_utc: str = "", **signals: Any) -> Motion:
    """A run in which the shape goes from 0 to 0.5 rad, whose first stamp is at so many seconds."""
    t = np.linspace(0.0, seconds, 301)
    log: Any = SimpleNamespace(
        t0_ns=round(start_s * 1e9), signals=signals, metadata={"start_utc": start_utc}, path=f"{start_utc}.mcap"
    )
    given = {name: np.zeros(1) for name in ("noise", "q0", "v0", "input_t", "vacuum", "worn", "warm")}
    motion: Any = Motion(
        **{**given, "noise": np.full(1, 1e-6)},
        **{"run": log, "source": "commands", "t": t, "y": np.linspace(0.0, 0.5, 301)[:, None]},
        **{"q0_sd": 0.0, "tendons": np.zeros((1, 2)), "hold": False},
    )
    return motion


def test_without_a_thermometer_a_robot_warms_while_it_runs_and_cools_in_between():
    """Towards 10 K within 600 s, and back; in runs that follow each other at once as in one run."""
    alone = in_order([run(5.0, 60.0)])[0]
    np.testing.assert_allclose(alone.warm, 10 * (1 - np.exp(-alone.t / 600)), rtol=1e-9)
    second, first = in_order([run(65.0, 60.0), run(5.0, 60.0)])[::-1]
    np.testing.assert_allclose([first.warm[-1], second.warm[-1]], 10 * (1 - np.exp(-np.array([60, 120]) / 600)))
    rested = in_order([run(0.0, 60.0), run(360.0, 60.0)])[1]
    np.testing.assert_allclose(rested.warm[0], alone.warm[-1] * np.exp(-300 / 600), rtol=1e-9)


def test_a_temperature_that_is_logged_counts_from_the_first_run_on():
    def warmed(kelvin: float) -> Any:
        return SimpleNamespace(t=np.array([0.0, 60.0]), value=np.array([[20.0 + kelvin], [21.0 + kelvin]]))

    first, second = in_order([run(0.0, 60.0, temperature=warmed(0.0)), run(90.0, 60.0, temperature=warmed(3.0))])
    np.testing.assert_allclose([first.warm[-1], second.warm[0]], [1.0, 3.0])
    np.testing.assert_allclose([second.worn[0], second.worn[-1]], [0.5, 1.0], atol=0.01)  # slip carries over too
    dark = in_order(
        [run(0.0, 60.0, temperature=warmed(0.0)), run(90.0, 60.0), run(180.0, 60.0, temperature=warmed(3.0))]
    )
    np.testing.assert_allclose(dark[1].warm[[0, -1]], [1.5, 2.5])  # between its neighbours where it is not logged


def test_runs_are_in_the_order_in_which_they_were_made_whatever_clock_stamps_them():
    """Each stamped from 0 by a simulation's clock: `start_utc` says which came first, and how long it rested."""
    later, first = run(0.0, 60.0, "2026-03-01T10:06:00+00:00"), run(0.0, 60.0, "2026-03-01T10:00:00+00:00")
    ordered = in_order([later, first])
    assert [m.run.path for m in ordered] == [first.run.path, later.run.path]
    np.testing.assert_allclose(ordered[1].warm[0], ordered[0].warm[-1] * np.exp(-300 / 600), rtol=1e-9)


def test_runs_kept_unseen_do_not_cover_one_another():
    """Two of eight are at the highest pressure, where one is told from the other only while one is fitted."""
    levels = [0.0, 10.0, 40.0, 20.0, 0.0, 10.0, 40.0, 20.0]
    runs = [dataclasses.replace(run(k, 15.0), vacuum=np.array([0.0, p])) for k, p in enumerate(levels)]
    kept = unseen(runs)
    assert len(kept) == 2 and 40.0 in {p for k, p in enumerate(levels) if k not in kept}
    alone = [dataclasses.replace(r, vacuum=np.minimum(r.vacuum, 40.0 if k == 2 else 30.0)) for k, r in enumerate(runs)]
    assert 2 not in unseen(alone)
