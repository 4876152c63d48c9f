"""Batches in tiles over threads: the same motion as one robot at a time, and one failure stays one."""

from __future__ import annotations

import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ljjax import batch, fast
from ljjax.dynamics import State

SIZE = 7
AT = np.linspace(0.0, 0.4, 5)


@pytest.fixture(scope="module")
def simulated(random_robot, random_inputs):
    """The function of one robot, and the arguments of seven."""
    inputs = random_inputs(0, end=0.4)
    models = jax.tree.map(lambda *x: jnp.stack(x), *(random_robot(seed, n=2) for seed in range(SIZE)))
    shapes = jnp.broadcast_to(jnp.linspace(-0.1, 0.1, SIZE)[:, None], (SIZE, 2))

    def one(model, q):
        at, still = jnp.asarray(AT), jnp.zeros(2)
        return fast.run(model, inputs, State(q, still, still), at, at[0], jnp.asarray(0.01), 40, 2)

    return one, models, shapes


@pytest.mark.parametrize(("least", "most"), [(1, 2), (3, 3), (32, 512)])
def test_a_batch_is_its_elements(simulated, monkeypatch, least, most):
    """Tiles of two and three with a filled-up last one, and one tile for all."""
    monkeypatch.setattr(batch, "LEAST", least)
    monkeypatch.setattr(batch, "MOST", most)
    one, models, shapes = simulated
    together = batch.over(one, threads=2)(models, shapes)
    alone = jax.jit(one)
    assert together.q.shape == (SIZE, len(AT), 2)
    for i in range(SIZE):
        expected = alone(jax.tree.map(lambda x, i=i: x[i], models), shapes[i])
        for got, x in zip(together, expected, strict=True):
            np.testing.assert_allclose(got[i], x, atol=1e-12)


def test_a_failure_stays_one(simulated, monkeypatch):
    monkeypatch.setattr(batch, "MOST", 4)
    one, models, shapes = simulated
    run = batch.over(one, threads=2)
    good, hurt = run(models, shapes).q, run(models, shapes.at[2].set(jnp.nan)).q
    others = np.arange(SIZE) != 2
    assert np.isnan(hurt[2]).all() and np.isfinite(hurt[others]).all()
    np.testing.assert_array_equal(hurt[others], good[others])


def test_on_the_processor_only_as_long_as_asked(monkeypatch):
    """Where JAX would take a graphics card, programs run on the processor, in other threads too, and afterwards on the
    card again."""
    said = []
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert batch.platform() == "gpu" and batch.options() == {}
    with batch.on_processor():
        thread = threading.Thread(target=lambda: said.append((batch.platform(), jnp.sin(1.0).devices())))
        thread.start()
        thread.join()
    assert said == [("cpu", {jax.devices("cpu")[0]})]
    assert batch.platform() == "gpu" and batch.CONFIG.jax_default_device is None
