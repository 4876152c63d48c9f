"""One robot advanced step by step under inputs that come as time goes, its effects included: what a rig emulates."""

from __future__ import annotations

from collections import deque

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array

from ljjax.model import Model, astype
from ljjax.step import Drive, How, advance, at_rest, constants


class Live:
    """A robot in float64, straight and at rest to begin with. Compiles when it is made.

    Transport delays among the effects (`actuator_delay`, `sensor_delay`) are rounded to steps.

    Attributes:
        step_s: the step [s].
        half_length_m, lever_arm_m: of the model [m].
    """

    def __init__(self, model: Model, step_s: float = 0.0025):
        self.step_s = step_s
        self.half_length_m, self.lever_arm_m = float(model.chain.half_length_m), float(model.chain.lever_arm_m)
        model = astype(model, jnp.float64)
        late = sum(float(d) for e in model.effects if (d := e.delay_s()) is not None)
        latency = max(sum(float(d) for e in model.effects if (d := e.latency_s()) is not None), 0.0)
        n = model.n
        zero = jnp.zeros((), jnp.float64)
        first, unravel = ravel_pytree(at_rest(model, (zero,) * n, Drive(zero, zero, zero, t=zero)))

        def one_step(flat: Array, given: Array) -> tuple[Array, Array]:
            left, right, vacuum, t = (given[i] for i in range(4))
            drive = Drive(left, right, vacuum, t=t)
            new = advance(model, constants(model), unravel(flat), drive, step_s, How(3, loops=True))
            seen = new.q if new.sensed is None else new.sensed
            return ravel_pytree(new)[0], jnp.stack([*seen, sum(new.q)])

        self._step = jax.jit(one_step).lower(first, jnp.zeros(4, jnp.float64)).compile()
        self._state, self._count = first, 0
        self._pulls = deque([(0.0, 0.0)] * (round(late / step_s) + 1), maxlen=round(late / step_s) + 1)
        seen = np.asarray([0.0] * (n + 1))
        self._shapes = deque([seen] * (round(latency / step_s) + 1), maxlen=round(latency / step_s) + 1)
        self._now = seen

    @property
    def joints(self) -> tuple[float, ...]:
        """The joint angles as a sensor gives them [rad]."""
        return tuple(float(x) for x in self._shapes[0][:-1])

    @property
    def bend(self) -> float:
        """q_Σ as it is [rad]."""
        return float(self._now[-1])

    @property
    def t(self) -> float:
        """How far the robot is [s]."""
        return self._count * self.step_s

    def advance(self, left_n: float, right_n: float, vacuum_kpa: float) -> None:
        """One step under tensions [N] and the line's vacuum [kPa].

        Raises:
            FloatingPointError: the state is no longer finite.
        """
        self._pulls.append((left_n, right_n))
        given = np.array([*self._pulls[0], max(0.0, vacuum_kpa), self.t])
        self._state, seen = self._step(self._state, given)
        self._now = np.asarray(seen)
        if not np.all(np.isfinite(self._now)):
            raise FloatingPointError(f"the simulated robot has left what numbers can hold at {self.t:g} s")
        self._shapes.append(self._now)
        self._count += 1
