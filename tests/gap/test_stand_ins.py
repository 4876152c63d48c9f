"""Flexible stand-ins: nothing at their nulls, and the place of a cause is where they close its gap."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from ljjax.effect import Effect
from ljjax.effects.jamming import PressureLag
from ljjax.fit.run import prepared
from ljjax.fit.session import in_order
from ljjax.gap.answer import _pointed
from ljjax.gap.data import span
from ljjax.gap.judge import Evidence
from ljjax.gap.search import Refit, Study
from ljjax.gap.stand_ins import BLOCKS, PLACES, QUICK, STAND_INS, stand_in
from tests.fit.test_dynamic import guess, logged, robot
from tests.ljjax.conftest import make_robot
from tests.ljjax.motion import drive, seen


def test_at_their_nulls_nothing_changes():
    model = dataclasses.replace(make_robot(), effects=tuple(kind() for kind in (*STAND_INS, *QUICK)))
    np.testing.assert_allclose(seen(model, drive()), seen(make_robot(), drive()), rtol=0, atol=1e-13)


class Snapping(Effect):
    """A body whose layers catch and snap every 5° of a joint's bend."""

    id, block = "snapping", "structure"

    def load(self, memory, load, now):
        phase = [2 * jnp.pi * q / np.radians(5.0) for q in now.middle]
        return tuple(x - 0.01 * jnp.sin(p) / (1.4 - jnp.cos(p)) for x, p in zip(load, phase, strict=True))


class Loosened(Effect):
    """Less elastic than it was."""

    id, block = "loosened", "structure"

    def alpha2(self, memory, alpha2, now):
        return tuple(0.6 * a for a in alpha2)


def study_of(*effects: Effect | None) -> Study:
    """Of three runs of a robot with an effect, or of one that each run begins with."""
    models = [dataclasses.replace(robot(), effects=() if e is None else (e,)) for e in effects]
    start = guess(robot())
    logs = [logged(models[s % len(models)], s) for s in range(3)]
    case = prepared(start, "nominal.toml", logs, (), start.frozen, "commands")
    assert not isinstance(case, list)
    runs, c = in_order(case.problem.motions), case.problem.coordinates
    return Study(start.model, c.names, STAND_INS, runs, c.pressure, span(runs), start.bounds, start.priors)


def leftovers(study: Study, base: Refit, found: Mapping[str, Refit]) -> dict[str, float]:
    floor = float(study.floor(study.motions).sum())
    return {place: (r.total - floor) / (base.total - floor) for place, r in found.items()}


def test_the_place_of_a_slow_sheath_is_the_vacuum():
    lag: Any = PressureLag
    study = study_of(lag(fill_s=0.35, vent_s=0.35))
    base = study.base()
    found = stand_in(study, base, STAND_INS)
    left = leftovers(study, base, found)
    assert min(left, key=lambda p: left[p]) == "vacuum" and left["vacuum"] < 0.3
    assert set(left) <= set(PLACES.values()) == set(BLOCKS)
    # what has stopped short goes on, though it says that it is at rest; what is at rest stays
    trial = found["vacuum"].trial
    (short,) = study._refit([study._begun(base.model, trial)], [trial], {}, 1, "one step")
    resting = dataclasses.replace(short, estimate=dataclasses.replace(short.estimate, converged=True))
    (further,) = study.polished([resting])
    (end,) = study.polished([further])
    assert further.total < 0.5 * short.total and further.total >= end.total > 0.98 * further.total


def test_a_body_that_snaps_is_met_by_waves_of_its_own_bend():
    study = study_of(Snapping())
    base = study.base()
    left = leftovers(study, base, stand_in(study, base, QUICK))
    assert left["body in waves"] < 0.3


def test_a_layer_that_comes_loose_is_met_by_a_change_all_at_once():
    study = study_of(None, Loosened(), Loosened())
    base = study.base()
    left = leftovers(study, base, stand_in(study, base, QUICK))
    assert left["body all at once"] < 0.1 < left["body in waves"]


@pytest.mark.parametrize(
    "flexible, said",
    [({}, ""), ({"body": 0.95}, ""), ({"body": 0.95, "tendons": 0.12, "sensor": 0.3}, "the tendons 12 %, sensor 30 %")],
)
def test_a_reader_is_told_where_a_stand_in_closes_most(flexible, said):
    told = _pointed(Evidence(1.0, {}, {}, 1e-4, 0.5, False, {}, flexible))
    assert told.endswith(said) and ("Flexible" in told) == bool(said)
