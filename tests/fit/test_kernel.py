"""How the kernels share a machine with what else runs on it."""

from __future__ import annotations

from typing import Any

import pytest
from threadpoolctl import threadpool_info

from ljjax.errors import InputError
from ljjax.fit.run import fit_many
from ljjax.gap.run import diagnose


@pytest.mark.parametrize("verb, room", [(lambda: fit_many(None, {"": []}), "fit"), (lambda: diagnose(None, []), "gap")])
def test_linear_algebra_keeps_to_one_thread_while_a_verb_runs(monkeypatch, verb, room):
    def threads() -> set[int]:
        return {each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"}

    seen: list[set[int]] = []

    def prepared(*_: Any) -> Any:
        seen.append(threads())
        raise InputError("enough")

    monkeypatch.setattr(f"ljjax.{room}.run.prepared", prepared)
    before = threads()
    try:
        verb()
    except InputError:
        pass
    assert seen == [{1}] and threads() == before
