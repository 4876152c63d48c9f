"""A logged run beside its simulation: `/sim` and `/residual` signals at the log's own stamps."""

from __future__ import annotations

from typing import Literal

import jax.numpy as jnp
import numpy as np

from ljjax.logs import Run, Signal
from ljjax.logs.contract import POSE
from ljjax.model import Model
from ljjax.simulation import Trajectory, simulate


def replay(
    model: Model,
    run: Run,
    *,
    inputs: Literal["commands", "measured"] = "commands",
    method: Literal["fast", "reference"] = "fast",
    step_s: float = 0.0025,
) -> dict[str, dict[str, Signal]]:
    """Simulate a run from its initial rest, as signals ready for `ljjax.logs.copy_overlay`.

    Returns `{"/sim": …, "/residual": …}` with `shape` and, where the log has one, `tip`; residual = measured −
    simulated. Of a tip's two quaternions for one rotation, the simulated one is that nearer to the measured.

    Raises InputError as `simulate` does, and where the run has no shape to start from.
    """
    run.signal("shape")
    at = {name: run.signals[name].t for name in ("shape", "tip") if name in run.signals}
    everywhere = np.unique(np.concatenate(list(at.values())))
    motion = simulate(model, run, at=everywhere, inputs=inputs, method=method, step_s=step_s)
    sim = {name: _signal(name, motion, model, run, np.searchsorted(everywhere, t), t) for name, t in at.items()}
    residual = {}
    for name in at:
        measured = run.signals[name]
        difference = np.zeros_like(sim[name].value)  # 0 for the rotation of a tip logged without one
        known = measured.value.shape[1]
        difference[:, :known] = measured.value - sim[name].value[:, :known]
        residual[name] = Signal(measured.t, difference, sim[name].columns, sim[name].unit, "")
    return {"/sim": sim, "/residual": residual}


def _signal(name: str, motion: Trajectory, model: Model, run: Run, index: np.ndarray, t: np.ndarray) -> Signal:
    logged = run.signals[name]
    if name == "shape":
        q = np.asarray(motion.seen)[index]
        if logged.columns != ("theta",):
            return Signal(t, q, logged.columns, "rad", "")
        return Signal(t, q.mean(axis=1, keepdims=True), ("theta",), "rad", "")
    x, y, angle = jnp.moveaxis(motion.tip(model), -1, 0)
    zero = jnp.zeros_like(x)
    pose = jnp.stack([x, zero, y, zero, jnp.sin(angle / 2), zero, jnp.cos(angle / 2)], axis=1)
    value = np.array(pose)[index]
    if logged.value.shape[1] == len(POSE):
        value[np.sum(value[:, 3:] * logged.value[:, 3:], axis=1) < 0, 3:] *= -1
    return Signal(t, value, POSE, "m,m,m,1,1,1,1", "")
