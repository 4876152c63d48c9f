"""Flexible stand-ins: nothing at their nulls, and the place of a cause is where they close its gap."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from ljjax import modelfile
from ljjax.fit.run import prepared
from ljjax.gap.answer import _pointed
from ljjax.gap.data import span
from ljjax.gap.judge import Evidence
from ljjax.gap.search import Study
from ljjax.gap.stand_ins import BLOCKS, PLACES, STAND_INS, stand_in
from ljjax.logs import find, read_all
from tests.gap.test_diagnose import record
from tests.ljjax.conftest import make_robot
from tests.ljjax.test_effects import drive, seen


def test_at_their_nulls_nothing_changes():
    model = dataclasses.replace(make_robot(), effects=tuple(kind() for kind in STAND_INS))
    np.testing.assert_allclose(seen(model, drive()), seen(make_robot(), drive()), rtol=0, atol=1e-13)


def test_the_place_of_a_slow_sheath_is_the_vacuum(tmp_path):
    folder = record(tmp_path / "robot", tau=0.35)
    start = modelfile.load(folder / "nominal.toml")
    case = prepared(start, "nominal.toml", read_all(find([str(folder / "train")])), (), start.frozen, "commands")
    assert not isinstance(case, list)
    runs, c = case.problem.motions, case.problem.coordinates
    study = Study(start.model, c.names, STAND_INS, runs, c.pressure, span(runs), start.bounds, start.priors)
    base = study.base()
    floor = study.floor(sum(len(m.t) for m in runs))
    left = {place: (r.total - floor) / (base.total - floor) for place, r in stand_in(study, base).items()}
    assert min(left, key=lambda p: left[p]) == "vacuum" and left["vacuum"] < 0.3
    assert set(left) <= set(PLACES.values()) == set(BLOCKS)


@pytest.mark.parametrize(
    "flexible, said",
    [({}, ""), ({"body": 0.95}, ""), ({"body": 0.95, "tendons": 0.12, "sensor": 0.3}, "the tendons 12 %, sensor 30 %")],
)
def test_a_reader_is_told_where_a_stand_in_closes_most(flexible, said):
    told = _pointed(Evidence(1.0, {}, {}, 1e-4, 0.5, False, {}, flexible))
    assert told.endswith(said) and ("Flexible" in told) == bool(said)
