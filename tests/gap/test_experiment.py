"""The next experiment: what parts two rivals best, though one of them may simulate on some protocols only."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from ljjax.effects import REGISTRY
from ljjax.gap.candidates import Trial, universal
from ljjax.gap.experiment import next_experiment
from ljjax.gap.search import Refit
from ljjax.model import replace
from tests.gap.test_stand_ins import study_of

LAG, SOFT = REGISTRY["pressure_lag"], REGISTRY["stiffness_hardening"]


@pytest.fixture(scope="module")
def study():
    return dataclasses.replace(study_of(LAG()), kinds=(LAG, SOFT))


@pytest.mark.parametrize("cubic, parted", [(-20.0, True), (-3000.0, False)])
def test_a_rival_that_falls_over_is_asked_where_it_stands(study, cubic, parted):
    """A body that softens: as much as runs may show, beyond which it gives way; and one that holds nothing."""
    base = study.base()

    def rival(kind, **values) -> Refit:
        model = replace(universal(base.model, study.kinds), {f"effects.{kind.id}.{n}": x for n, x in values.items()})
        return Refit(Trial((kind.id,)), dataclasses.replace(base.estimate, model=model), base.loss)

    rivals = [rival(SOFT, cubic=cubic), rival(LAG, fill_s=0.5, vent_s=0.5)]
    found = next_experiment(study, rivals, [SOFT.id, LAG.id])
    assert (found is not None) == parted
    if found:
        assert np.isfinite(found["expected_separation"]) and found["expected_separation"] > 1.0
