"""Effects that grow and shrink with load, vacuum, bend, rate, warmth, use, time and sense of motion: `varying`.

No real robot's effect has quite the form that a library gives it. The sizes of a varying effect are m times what they
say,

    m = (1 + Σ aᵢ gᵢ)₊,

each gᵢ from 0 (at rest and without load) towards 1; warmth and the sense of motion from −1 (cooler, straightening).
What is put on, moved or set (`Effect.sudden`) may change at a moment of the session, told by the slip S of the mean
joint since the first run began: m is times

    1 − b (1 − g),    g = (1 + tanh((S − S₁)/S₂))/2,

so that with b = 1 there is none of it before. Or it may be another in each run, where a robot is mounted, loaded or set
anew: m is times 1 + cᵣ in the run r, which is told by the slip at its start.
"""

from __future__ import annotations

import re
import types
from collections.abc import Callable, Collection
from functools import cache
from typing import Any, cast

import jax.numpy as jnp
from jaxtyping import Array

from ljjax.effect import Effect, Memory, Now, Vector, variation
from ljjax.effects.shapes import gone

LOAD_N, VACUUM_KPA, BEND_RAD, RATE_RAD_S, SENSE_RAD2_S = 10.0, 15.0, 0.4, 0.5, 0.005
"""Where what an effect varies with is halfway."""
HALFWAY = {"half_warm_k": 2.0, "half_use_rad": 10.0, "half_time_s": 5.0}
"""The same, H, for what goes on all session, or run, long and so may tell it; a search begins from these."""
WAYS = {
    "by_load": f"T/(T + {LOAD_N:g} N), T both tensions together; its own, for what acts on a tendon by itself",
    "by_vacuum": f"P/(P + {VACUUM_KPA:g} kPa)",
    "by_bend": f"q²/(q² + ({BEND_RAD:g} rad)²), q of the mean joint",
    "by_rate": f"v²/(v² + ({RATE_RAD_S:g} rad/s)²), v of the mean joint",
    "by_warmth": "W/(abs(W) + H), W the warming since the first run, `thermal_drift`'s if none is logged",
    "by_use": "S/(S + H), S the way gone by the mean joint since the first run began",
    "by_time": "t/(t + H), t since the run began",
    "by_sense": f"qv/(abs(qv) + {SENSE_RAD2_S:g} rad²/s), positive where the body bends further",
}
"""What an effect may vary with, and how."""
ONSET = {"by_onset": "b", "onset_rad": "S₁", "over_rad": "S₂"}
"""What says when a sudden effect changes, beside `WAYS`, and its sign; of no account where b is 0."""
PILOTS = (
    *((way, 8.0) for way in ("by_load", "by_vacuum", "by_bend", "by_rate", "by_warmth", "by_use", "by_time")),
    *((way, -1.0) for way in ("by_warmth", "by_use", "by_time")),  # what wears in, thins as it warms, or settles
    *(("by_sense", much) for much in (1.0, -1.0)),
)
"""Ways of varying much from which a search begins."""
EACH, UNTIL = "in_run{}", "until{}_rad"
"""cᵣ, and the slip at the start of a run from which on it is not this one [rad]; runs count from 1."""
BRIEFLY = 0.01
"""The share of a session's slip over which an effect begins from which a search does."""
AT_THE_SENSOR = ("by_bend", "by_rate", "by_warmth", "by_use", "by_time")
"""The ways in which an effect of sensing may vary: a camera sees the body, not its load nor its vacuum."""
LEAST = 0.02
"""The share of a slip that a varying effect leaves at least."""


class _Varying(Effect):
    by_load: Array = variation(-1.0, 20.0)
    by_vacuum: Array = variation(-1.0, 20.0)
    by_bend: Array = variation(-1.0, 20.0)
    by_rate: Array = variation(-1.0, 20.0)
    by_warmth: Array = variation(-1.0, 20.0)
    by_use: Array = variation(-1.0, 20.0)
    by_time: Array = variation(-1.0, 20.0)
    by_sense: Array = variation(-1.0, 1.0)
    half_warm_k: Array = variation(0.05, 50.0, "K", HALFWAY["half_warm_k"])
    half_use_rad: Array = variation(0.1, 1e3, "rad", HALFWAY["half_use_rad"])
    half_time_s: Array = variation(0.05, 1e3, "s", HALFWAY["half_time_s"])

    def _amount(self, memory: Memory, now: Now, load: Array) -> Array:
        """m of a step under a load [N]; in memory the slip at the run's start, and so far [rad]."""
        n, load = len(now.q), jnp.maximum(load, 0.0)
        bend, rate = sum(now.q) / n, sum(now.v) / n
        turn, t = bend * rate, jnp.maximum(now.t, 0.0)
        share = (
            (self.by_load, load / (load + LOAD_N)),
            (self.by_vacuum, now.vacuum / (now.vacuum + VACUUM_KPA)),
            (self.by_bend, bend**2 / (bend**2 + BEND_RAD**2)),
            (self.by_rate, rate**2 / (rate**2 + RATE_RAD_S**2)),
            (self.by_warmth, now.warm / (jnp.abs(now.warm) + self.half_warm_k)),
            (self.by_use, memory[1] / (memory[1] + self.half_use_rad)),
            (self.by_time, t / (t + self.half_time_s)),
            (self.by_sense, turn / (jnp.abs(turn) + SENSE_RAD2_S)),
        )
        return jnp.maximum(1 + sum(a * g for a, g in share), 0.0) * self._begun(memory)

    def _begun(self, memory: Memory) -> Array | float:
        """The share of it that is there now, by the slip in memory."""
        return 1.0


class _Sudden(_Varying):
    by_onset: Array = variation(-20.0, 1.0)
    onset_rad: Array = variation(-1e3, 1e5, "rad", 10.0)
    over_rad: Array = variation(1e-3, 1e3, "rad", 0.1)

    def _begun(self, memory: Memory) -> Array:
        return 1 - 0.5 * self.by_onset * (1 - jnp.tanh((memory[1] - self.onset_rad) / self.over_rad))


@cache
def _each(until: tuple[float, ...]) -> type[_Varying]:
    def begun(self: Any, memory: Memory) -> Array:
        now, *later = (getattr(self, EACH.format(r + 1)) for r in range(len(until) + 1))
        for r, share in enumerate(later):
            now = jnp.where(memory[0] < getattr(self, UNTIL.format(r + 1)), now, share)
        return 1 + now

    fields = {EACH.format(r + 1): variation(-20.0, 20.0) for r in range(len(until) + 1)}
    fields |= {UNTIL.format(r + 1): variation(-1e3, 1e5, "rad", x) for r, x in enumerate(until)}
    made = {"__module__": __name__, "__annotations__": dict.fromkeys(fields, Array), "_begun": begun, **fields}
    return cast(type[_Varying], types.new_class("_Each", (_Varying,), exec_body=lambda n: n.update(made)))


@cache
def _late(kind: type[Effect]) -> Callable[..., Effect]:
    """The same delay, that may be more."""
    body = {"__module__": __name__, "__annotations__": {"more": Array}, "more": 0.0}
    return cast(Callable[..., Effect], types.new_class(kind.__name__, (kind,), exec_body=lambda n: n.update(body)))


@cache
def varying(kind: type[Effect], until: tuple[float, ...] | None = None) -> type[Effect]:
    """The effect of the same id that varies; at the null values of `WAYS` it is `kind`. A transport delay is m times
    what it says to first order in m − 1.

    Args:
        until: slip [rad] that parts the starts of runs, where it is another in each; of any number of runs.
    """
    base = _each(until) if until is not None else _Sudden if kind.sudden else _Varying
    has = {name for name in vars(Effect) if getattr(kind, name) is not getattr(Effect, name)}

    def at(self: Any, m: Array) -> Effect:
        """The effect of a step; sizes that have but one sign keep it where a run has the other."""
        values = {n: getattr(self, n) for n in kind.fields()}
        if _delays(kind):
            return _late(kind)(**values, more=m - 1)
        for n in kind.sizes():
            null, low = kind.fields()[n]["null"], kind.fields()[n]["low"]
            moved = null + m * (values[n] - null) if null else m * values[n]
            values[n] = jnp.maximum(moved, null) if until is not None and low >= null else moved
        return kind(**values)

    def first(self: Any, now: Now) -> tuple[Array, Memory]:
        """m at a run's start, and the slip to remember."""
        slip = now.worn, now.worn
        return self._amount(slip, now, now.u[0] + now.u[1]), slip

    def start(self: Any, now: Now) -> Memory:
        m, slip = first(self, now)
        return at(self, m).start(now), m, *slip

    def actuate(self: Any, memory: Memory, u: Vector, now: Now) -> tuple[Vector, Memory]:
        inner, _, *slip = memory
        m = self._amount(slip, now, u[0] + u[1])
        if "start" in has or "actuate" not in has:
            u, inner = at(self, m).actuate(inner, u, now)
        else:  # each tendon by its own load
            u = tuple(at(self, self._amount(slip, now, x)).actuate(inner, u, now)[0][i] for i, x in enumerate(u))
        return tuple(jnp.maximum(x, 0.0) for x in u), (inner, m, *slip)

    def evacuate(self: Any, memory: Memory, vacuum: Array, now: Now) -> tuple[Array, Memory]:
        vacuum, inner = at(self, memory[1]).evacuate(memory[0], vacuum, now)
        return jnp.maximum(vacuum, 0.0), (inner, *memory[1:])

    def scaled(name: str) -> Callable:
        def hook(self: Any, memory: Memory, x: Vector, now: Now) -> Vector:
            return getattr(at(self, memory[1]), name)(memory[0], x, now)

        return hook

    def slip(self: Any, memory: Memory, slip: Vector, now: Now) -> Vector:
        new = at(self, memory[1]).slip(memory[0], slip, now)
        return tuple(jnp.maximum(b, LEAST * a) for a, b in zip(slip, new, strict=True))

    def inertia(self: Any, memory: Memory, m: tuple[Vector, ...], now: Now) -> tuple[Vector, ...]:
        return at(self, memory[1]).inertia(memory[0], m, now)

    def load(self: Any, memory: Memory, load: Vector, now: Now) -> Vector:
        return at(self, memory[1]).load(memory[0], load, now)

    def torque(self: Any, memory: Memory, i: int, q: Array, v: Array, stage: Any) -> Array | None:
        return at(self, memory[1]).torque(memory[0], i, q, v, stage)

    def remember(self: Any, memory: Memory, now: Now, after: Any) -> Memory:
        inner, m, began, slip = memory
        return at(self, m).remember(inner, now, after), m, began, slip + gone(now.q, after.q)

    def sense(self: Any, memory: Memory, y: Vector, now: Now) -> tuple[Vector, Memory]:
        y, inner = at(self, memory[1]).sense(memory[0], y, now)
        return y, (inner, *memory[1:])

    def unsense(self: Any, y: Vector, now: Now | None = None) -> Vector:
        if now is None:
            return kind.unsense(self, y)
        return at(self, first(self, now)[0]).unsense(y, now)

    own = {"evacuate": evacuate, "load": load, "torque": torque, "sense": sense}
    own |= {"unsense": unsense, "inertia": inertia, "slip": slip, "alpha2": scaled("alpha2"), "phi": scaled("phi")}
    hooks = {
        "start": start,
        "actuate": actuate,
        "remember": remember,
        **{name: hook for name, hook in own.items() if name in has},
    }
    said = {"__module__": kind.__module__, "__doc__": kind.__doc__}
    return cast(
        type[Effect],
        types.new_class(kind.__name__, (base, kind), exec_body=lambda n: n.update(said | hooks)),
    )


def ways(kind: type[Effect]) -> tuple[str, ...]:
    """What an effect may vary with, but for its onset."""
    return AT_THE_SENSOR if kind.block == "sensing" else tuple(WAYS)


def having(kind: type[Effect], names: Collection[str]) -> type[Effect]:
    """The effect as it has parameters of these names, whether it varies or not."""
    runs = [int(n) for name in names for n in re.findall(r"^in_run([1-9]\d?)$", name)]
    if runs:
        return varying(kind, (0.0,) * (max(runs) - 1))
    return varying(kind) if {*WAYS, *HALFWAY, *ONSET} & {*names} else kind


def by_run(effect: Effect) -> bool:
    """Whether an effect is another in some run."""
    return any(float(getattr(effect, n)) != 0 for n in effect.fields() if n.startswith(EACH.format("")))


def onsets(slip_rad: float, count: int) -> list[dict[str, float]]:
    """Beginnings from which a search begins, over a session of so much slip."""
    return [
        {"by_onset": 1.0, "onset_rad": (k + 0.5) / count * slip_rad, "over_rad": BRIEFLY * slip_rad}
        for k in range(count)
    ]


def varies(kind: type[Effect]) -> bool:
    """Whether anything that an effect does may vary with what acts on it, and does not yet: no delay can."""
    if not steady(kind) or _delays(kind):
        return False
    hooks = ("actuate", "evacuate", "alpha2", "phi", "slip", "load", "torque", "sense")
    return any(getattr(kind, name) is not getattr(Effect, name) for name in hooks)


def steady(kind: type[Effect]) -> bool:
    """Whether an effect does not vary yet."""
    return not issubclass(kind, _Varying)


def _delays(kind: type[Effect]) -> bool:
    return "delay_seconds" in kind.fields()
