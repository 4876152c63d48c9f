"""Programs in C against the same under XLA, and what happens where they cannot be had."""

from __future__ import annotations

from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ljjax import effects
from ljjax.effects.shapes import bounded, saturated
from ljjax.fit import native
from ljjax.fit.coordinates import Coordinates
from ljjax.fit.dynamic import Search
from ljjax.fit.lowering import Part
from ljjax.fit.problem import Problem
from ljjax.fit.run import prepared
from ljjax.fit.shooting import together
from ljjax.fit.windows import cut
from ljjax.gap.candidates import universal
from ljjax.gap.search import QUICK
from ljjax.model import limits, replace
from tests.fit.test_dynamic import guess, logged, robot

needs_cc = pytest.mark.skipif(not native.available(), reason="no C compiler on this machine")
NAMES = ["elastic.c3", "friction.mu_c", "effects.actuator_lag.tau_s", "effects.sensor_filter.tau_s"]


def free_run(theta: bool, kinds: Any) -> tuple[np.ndarray, np.ndarray]:
    """Predictions and derivatives of two runs of a robot with effects of these kinds, each a little."""
    start = guess(robot())
    case = prepared(start, "nominal.toml", [logged(robot(), s, theta=theta) for s in (1, 2)], (), (), "commands")
    assert not isinstance(case, list)
    model = universal(start.model, kinds)
    within = limits(model)
    small = {
        p: float(np.clip(about["null"] + 0.3 * about["scale"], *within[p]))
        for k in kinds
        for n, about in k.fields().items()
        if (p := f"effects.{k.id}.{n}") in within
    }
    problem = Problem(
        Coordinates(replace(model, small), NAMES, case.problem.coordinates.pressure), case.problem.motions
    )
    search = Search(problem, cut(problem.motions, QUICK.step_s), QUICK)
    (found,) = together([search.look(problem.coordinates.start)])
    assert found is None and search.point is not None
    return search.point.answer.predicted, search.point.answer.jacobian


@needs_cc
@pytest.mark.parametrize("theta", [True, False])
def test_free_runs_with_effects_are_those_of_xla(monkeypatch, theta):
    """Half of the effects where θ is logged, the others where each joint is; those of `NAMES` in both."""
    asked = {n.split(".")[1] for n in NAMES}
    kinds = [k for i, k in enumerate(effects.REGISTRY.values()) if i % 2 == theta or k.id in asked]
    assert len(kinds) >= 31 // 2
    here, slopes = free_run(theta, kinds)
    assert native.available()  # every effect is arithmetic that C takes
    monkeypatch.setenv("LJJAX_CC", "")
    there, same = free_run(theta, kinds)
    assert here.std() > 0.02 and np.all(np.abs(same).max(axis=(0, 1)) > 0)
    assert np.abs(here - there).max() < 1e-5
    assert np.all(np.abs(slopes - same).max(axis=(0, 1)) < 2e-3 * np.abs(same).max(axis=(0, 1)))


def everything(x, y):
    """Of every operation that the lowering knows, something that feels it."""
    power = x**3 + jnp.abs(x) ** y + 1 / (1 + x**4) + jnp.sqrt(y) + jnp.cbrt(y) + x**-2
    round_ = jnp.sin(x) * jnp.cos(y) + jnp.tan(0.1 * x) + jnp.arctan2(x, y) + jnp.arcsin(x / 9) + jnp.arctan(x)
    grow = (
        jnp.exp(-y) + jnp.expm1(0.1 * x) + jnp.log(y) + jnp.log1p(y) + jnp.tanh(x) + jnp.sinh(x / 3) + jax.nn.sigmoid(x)
    )
    kink = jnp.where((x > 0) & ~(y < 1), x, -y) + jnp.clip(x, -0.5, 0.5) + jnp.maximum(x, y) - jnp.minimum(x, 0.3)
    step = jnp.sign(x) + jnp.floor(x) * jnp.where(y >= 1, 1.0, 2.0) + jnp.where(jnp.isinf(x / 0.0), 1.0, 2.0)
    step = step + ((x != y) | (x == y)).astype(x.dtype) + jnp.ceil(y)
    return power, round_, jnp.square(grow), kink, step


@needs_cc
def test_every_operation_and_its_derivative_is_that_of_xla():
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=16).astype(np.float32) * 2, rng.uniform(0.2, 3.0, 16).astype(np.float32)
    dx, dy = rng.normal(size=(2, 3, 16)).astype(np.float32)

    def pushed(x, y, dx, dy):
        values, slopes = jax.vmap(lambda a, b: jax.jvp(everything, (x, y), (a, b)), out_axes=(None, 0))(dx, dy)
        return (), (), values, slopes

    program = native.Program(pushed, ("value", "value", "slope", "slope"), (0.0, 0.0, 0.0, 0.0))
    none = np.zeros((0, 16), np.float32)
    found = program.run(native.rows(x, y), native.rows(dx, dy), np.zeros((1, 1, 16), np.float32), none, none)
    expected = jax.vmap(pushed, in_axes=(0, 0, 1, 1), out_axes=(0, 0, 0, 1))(x, y, dx, dy)[2:]
    for a, b in zip((row for rows in found for row in rows), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(a[..., 0, :], b, rtol=2e-5, atol=2e-5)


@needs_cc
def test_what_an_absent_part_would_do_is_not_computed():
    """A part of size s that remembers m: nothing comes of it where s and its slope are 0, not even of what is no number
    there, and its memory is left alone; eight robots beside one that has it compute it."""

    def pushed(s, x, ds, dx, m, dm):
        def f(s, x, m):
            old = 2.0 * m
            return m + x, jnp.where(s > 0.0, old, x) + s * jnp.sqrt(x)

        (new, y), (dnew, dy) = jax.vmap(lambda *t: jax.jvp(f, (s, x, m), t), out_axes=(None, 0))(ds, dx, dm)
        return (new,), (dnew,), (y,), (dy,)

    def part(s, x, ds, dx, m, dm):
        return [Part({s: 0.0}, [ds], [m, dm])]

    kinds = "value", "value", "slope", "slope", "state", "state slope"
    program = native.Program(pushed, kinds, (0.0,) * 6, part)
    s = np.zeros(24, np.float32)
    s[3], x = 0.5, np.full(24, -1.0, np.float32)
    x[:8] = 4.0
    ds, dx = np.zeros((1, 24), np.float32), np.ones((1, 24), np.float32)
    ds[0, 20] = 1.0
    m, dm, drive = np.full((1, 24), 3.0, np.float32), np.zeros((1, 1, 24), np.float32), np.zeros((1, 1, 24), np.float32)
    (y,), (dy,) = (v[..., 0, :] for v in program.run(native.rows(s, x), native.rows(ds, dx), drive, m, dm))
    np.testing.assert_allclose(y[[0, 3, 8]], [4.0, 6.0 + 0.5 * 2.0, -1.0])
    np.testing.assert_allclose(dy[0, [0, 3, 8]], [1.0, 0.5 * 0.5 / 2.0, 1.0])
    assert np.isnan(y[20])  # there its slope is asked for
    np.testing.assert_allclose(m[0, :8], 7.0)
    assert program.needs == [1]


@needs_cc
def test_a_memory_that_is_read_without_its_part_is_kept():
    def pushed(s, ds, m, dm):
        (new, y), (dnew, dy) = jax.vmap(
            lambda *t: jax.jvp(lambda s, m: (m + 1.0, m + s), (s, m), t), out_axes=(None, 0)
        )(ds, dm)
        return (new,), (dnew,), (y,), (dy,)

    kinds = "value", "slope", "state", "state slope"
    program = native.Program(pushed, kinds, (0.0,) * 4, lambda s, ds, m, dm: [Part({s: 0.0}, [ds], [m, dm])])
    none, m, dm = np.zeros((1, 1, 8), np.float32), np.zeros((1, 8), np.float32), np.zeros((1, 1, 8), np.float32)
    (y,), _ = program.run(np.zeros((1, 8), np.float32), none, np.zeros((1, 3, 8), np.float32), m, dm)
    np.testing.assert_allclose(y[:, 0], [0.0, 1.0, 2.0])


@needs_cc
def test_what_a_lag_has_all_but_vented_has_a_slope():
    """C keeps numbers so small that their inverse is infinite, which XLA takes for 0."""
    x = np.array([1e-40, 1e-39, 1e-38, 1e-30, 1e-20, 1e-12, 0.0, 1.0], np.float32)

    knee, order, edge = cast(Any, (8.0, 1.0, 2.0))

    def pushed(x, dx):
        def both(x):
            return saturated(x, knee, order, order), bounded(x, knee, edge)

        values, slopes = jax.vmap(lambda a: jax.jvp(both, (x,), (a,)), out_axes=(None, 0))(dx)
        return (), (), values, slopes

    program = native.Program(pushed, ("value", "slope"), (0.0, 0.0))
    dx, none, step = np.ones((1, 8), np.float32), np.zeros((0, 8), np.float32), np.zeros((1, 1, 8), np.float32)
    values, slopes = program.run(native.rows(x), native.rows(dx), step, none, none)
    np.testing.assert_allclose(np.squeeze(values), [x / (8 + x), x / np.sqrt(1 + (x / 8) ** 2)], rtol=1e-5, atol=1e-12)
    assert np.all(np.isfinite(slopes))
    np.testing.assert_allclose(np.squeeze(slopes)[:, -1], [8 / 81, (1 + 1 / 64) ** -1.5], rtol=1e-5)


@needs_cc
@pytest.mark.parametrize("broken", ["step", "compiler"])
def test_where_a_step_cannot_be_had_in_c_xla_does_it_all(monkeypatch, broken):
    monkeypatch.setattr(native, "_programs", {})
    if broken == "compiler":
        monkeypatch.setenv("LJJAX_CC", "false")
    given = jax.tree.map(np.float32, (1.0, 1.0))

    def function(x, dx):
        y = jax.lax.lgamma(x) if broken == "step" else 2 * x
        return (), (), (y,), (dx,)

    assert native.available()
    assert native.program("lgamma", function, ("value", "slope"), given) is None
    assert not native.available()


def test_no_compiler_named_means_none(monkeypatch):
    monkeypatch.setenv("LJJAX_CC", "")
    assert not native.available()
