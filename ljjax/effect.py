"""What an unmodelled effect is: a few parameters and the places where it hooks into the solver's step.

An effect is a subclass of `Effect`. Every hook below does nothing unless the subclass says otherwise; hooks are plain
arithmetic on scalars, one a joint, as in `ljjax.step`, so that simulation, fit and diagnosis batch and differentiate
through them alike. In the order of one step:

    actuate → evacuate → alpha2, phi → slip, inertia, load (once a step) → torque (in each stage) → remember → sense

An effect may keep a memory (a tuple of scalars, `()` by default): `start` makes it, `actuate`, `evacuate`, `remember`
and `sense` hand back a new one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

Vector = tuple[Array, ...]
"""One scalar a joint."""
Memory = tuple[Any, ...]


class Now(NamedTuple):
    """What a hook may look at: the model, the step's start and length [s], the state at its start, the shape predicted
    for its middle [rad], the tensions (u₁, u₂) [N] and the vacuum [kPa] as known so far in the step, and the
    temperature's rise [K] and the slip of earlier runs [rad] since the first run began; sine and cosine of the links'
    directions ψ at the middle; and, from `load` on, α₂ [N·m/rad] and φ [N·m] of each joint."""

    model: Any
    t: Array
    h: Array
    q: Vector
    v: Vector
    z: Vector
    middle: Vector
    u: Vector
    vacuum: Array
    warm: Array
    worn: Array
    sin: Vector = ()
    cos: Vector = ()
    alpha2: Vector = ()
    phi: Vector = ()


def parameter(unit: str, null: float, low: float, high: float, scale: float) -> Any:
    """How large an effect is: the parameter's unit, the value at which the effect vanishes, bounds, a typical size."""
    return _field({"unit": unit, "null": null, "low": low, "high": high, "scale": scale, "pilots": (), "of": ""})


def shape(unit: str, default: float, low: float, high: float, pilots: tuple[float, ...], of: str = "") -> Any:
    """What form an effect has, of no account while it vanishes.

    Args:
        unit, default, low, high: as of any parameter.
        pilots: values from which a search begins, each on its own.
        of: what of the data the pilots are shares of: `"tension"` [N], `"angle"` of a joint [rad], `"slip"` of the
            mean joint over all runs [rad], `"warmth"`, what the temperature rises by [K] (the largest there are), or
            nothing; `"waves"` for waves over the body's whole bend [1/rad], and `"drift"`, `"reset_s"` and `"phase"`
            for a clock that is set now and then, which a diagnosis finds itself.
    """
    scale = 0.3 * (abs(default) or 1.0)
    return _field({"unit": unit, "null": default, "low": low, "high": high, "scale": scale, "pilots": pilots, "of": of})


def variation(low: float, high: float, unit: str = "1", null: float = 0.0) -> Any:
    """How an effect's action varies (`ljjax.effects.varying`), not at all where those of unit 1 are 0."""
    scale = 0.3 * (null or 1.0)
    return _field(
        {"unit": unit, "null": null, "low": low, "high": high, "scale": scale, "pilots": (), "of": "", "varies": True}
    )


def _field(metadata: dict[str, Any]) -> Any:
    return eqx.field(
        converter=lambda x: x if isinstance(x, jax.Array) else jnp.asarray(np.asarray(x), dtype=float),
        metadata=metadata,
        default=metadata["null"],
    )


class Effect(eqx.Module):
    """Base class of the effects; see the module's text for the order of the hooks.

    Class attributes: `id`, `block` (actuation, jamming, structure, friction or sensing), and `axes`, along which of
    pressure, angle, rate, direction, load, time, run, segment or everywhere its traces lie, the plainest first.
    """

    id: ClassVar[str] = ""
    block: ClassVar[str] = ""
    axes: ClassVar[tuple[str, ...]] = ("everywhere",)
    modes_of_theta: ClassVar[int] = 0
    """How many of the parameters `mode1`, `mode2` … show where the mean angle alone is logged."""
    sudden: ClassVar[bool] = False
    """Whether it may begin at a moment, or be another in each run: what is put on, moved, set or torn."""
    more: ClassVar[Any] = 0.0
    """What a delay is more at the moment, as a share of itself (`ljjax.effects.varying`)."""
    file: ClassVar[str] = ""
    """Where the class was loaded from, if it is not one of the package's."""

    @classmethod
    def fields(cls) -> dict[str, Any]:
        """The parameters' metadata by name: unit, null, low, high, scale, pilots, of."""
        return {name: f.metadata for name, f in cls.__dataclass_fields__.items() if "null" in f.metadata}

    @classmethod
    def sizes(cls) -> tuple[str, ...]:
        """The names of those that say how large the effect is; the others say what form it has."""
        return tuple(n for n, about in cls.fields().items() if not about["pilots"] and "varies" not in about)

    def start(self, now: Now) -> Memory:
        """The memory at rest under the first inputs."""
        return ()

    def delay_s(self) -> Array | None:
        """Transport delay of the commanded tensions [s], or None."""
        return None

    def latency_s(self) -> Array | None:
        """How much later the shape is stamped than it was seen [s], or None."""
        return None

    def actuate(self, memory: Memory, u: Vector, now: Now) -> tuple[Vector, Memory]:
        """The mean tensions at the body over the step, from those commanded [N]."""
        return u, memory

    def evacuate(self, memory: Memory, vacuum: Array, now: Now) -> tuple[Array, Memory]:
        """The mean vacuum in the sheath over the step, from that commanded [kPa]."""
        return vacuum, memory

    def alpha2(self, memory: Memory, alpha2: Vector, now: Now) -> Vector:
        """Elastic coefficients, one a joint [N·m/rad]."""
        return alpha2

    def phi(self, memory: Memory, phi: Vector, now: Now) -> Vector:
        """Friction scales, one a joint [N·m]."""
        return phi

    def slip(self, memory: Memory, slip: Vector, now: Now) -> Vector:
        """Factors on the bristles' bend g(v) at which they slip, one a joint."""
        return slip

    def inertia(self, memory: Memory, m: tuple[Vector, ...], now: Now) -> tuple[Vector, ...]:
        """The lower rows of M [kg·m²], frozen over the step."""
        return m

    def load(self, memory: Memory, load: Vector, now: Now) -> Vector:
        """Torques that push the joints [N·m], frozen over the step at `now.middle`."""
        return load

    def torque(self, memory: Memory, i: int, q: Array, v: Array, stage: Any) -> Array | None:
        """Torque that resists joint i [N·m], solved for with the joint's rate: a function of that joint alone.

        `stage.time` is the time since the step began [s]; `stage.alpha2[i]`, `stage.phi[i]` are this step's,
        `stage.bare` is α₂ without a vacuum, `stage.friction` has σ₀, σ₁, σ₂ and the rest of LuGre's parameters.
        """
        return None

    def remember(self, memory: Memory, now: Now, after: Any) -> Memory:
        """The memory after a step that ended in `after` (q, v, z)."""
        return memory

    def sense(self, memory: Memory, y: Vector, now: Now) -> tuple[Vector, Memory]:
        """The joint angles that are logged [rad], from those that are, at the end of a step (`now` its beginning)."""
        return y, memory

    @classmethod
    def likewise(cls, values: dict[str, float]) -> list[dict[str, float]]:
        """Other parameters that do much the same, to which a search does not find its way from these: waves an octave
        up, say."""
        return []

    def unsense(self, y: Vector, now: Now | None = None) -> Vector:
        """The joint angles that are [rad], from those that are logged at rest, where a run starts from its log; `now`
        has the logged ones for the state, if the inputs are known."""
        return y


def acting(effects: Sequence[Effect], hook: str) -> list[tuple[int, Callable[..., Any]]]:
    """Of the effects that have a hook of their own their places, and that hook: without equinox's bound methods, each
    of which is a tree made anew, and takes longer than most hooks."""
    own = [(k, getattr(type(e), hook), e) for k, e in enumerate(effects)]
    return [(k, partial(function, e)) for k, function, e in own if function is not getattr(Effect, hook)]
