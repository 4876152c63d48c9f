"""A logged run beside its simulation: `/sim` and `/residual` signals at the log's own stamps."""

from __future__ import annotations

from typing import Literal

import jax.numpy as jnp
import numpy as np

from ljjax.logs import Run, Signal
from ljjax.model import Model
from ljjax.simulate import Trajectory, simulate


def replay(
    model: Model, run: Run, *, inputs: Literal["commands", "measured"] = "commands", rtol: float = 1e-6
) -> dict[str, dict[str, Signal]]:
    """Simulate a run from its initial rest, as signals ready for `ljjax.logs.copy_overlay`.

    Returns `{"/sim": …, "/residual": …}` with `shape` and, where the log has one, `tip`; residual = measured −
    simulated. A run without a shape is simulated at its command stamps.

    Raises InputError as `simulate` does.
    """
    at = {name: run.signals[name].t for name in ("shape", "tip") if name in run.signals}
    if "shape" not in at:
        at["shape"] = run.signal("cmd_tendons", "tendons").t
    everywhere = np.unique(np.concatenate(list(at.values())))
    motion = simulate(model, run, at=everywhere, inputs=inputs, rtol=rtol)
    sim = {name: _signal(name, motion, model, run, np.searchsorted(everywhere, t), t) for name, t in at.items()}
    residual = {}
    for name in at:
        if name in run.signals:
            measured = run.signals[name]
            difference = measured.value - sim[name].value
            residual[name] = Signal(measured.t, difference, measured.columns, measured.unit, "")
    return {"/sim": sim, "/residual": residual}


def _signal(name: str, motion: Trajectory, model: Model, run: Run, index: np.ndarray, t: np.ndarray) -> Signal:
    logged = run.signals.get(name)
    if name == "shape":
        q = np.asarray(motion.state.q)[index]
        if logged is not None and logged.columns != ("theta",):
            return Signal(t, q, logged.columns, "rad", "")
        return Signal(t, q.mean(axis=1, keepdims=True), ("theta",), "rad", "")
    assert logged is not None
    x, y, angle = jnp.moveaxis(motion.tip(model), -1, 0)
    zero = jnp.zeros_like(x)
    pose = jnp.stack([x, zero, y, zero, jnp.sin(angle / 2), zero, jnp.cos(angle / 2)], axis=1)
    return Signal(t, np.asarray(pose)[index], logged.columns, logged.unit, "")
