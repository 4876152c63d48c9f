"""Measured tension and line pressure beside their commands: where they disagree, a block of the model has spoken.

What stands between command and sensor shows here without the body. It is asked of every refit: an effect that explains
the shape must, as it was fitted to the shape, explain the measured tension too. The line's pressure cannot contradict
what happens in the sheath behind it; it can only confirm.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ljjax.effect import Effect, Now
from ljjax.fast import mean
from ljjax.fit.least_squares import solve
from ljjax.fit.windows import Motion, white_noise

STEP_S = 0.0025
SPEAKS = 1.3
"""A channel speaks if its RMS distance from the command is so many times its noise, and an effect explains some."""
EXPLAINS = 0.3
WEIGHT = 0.5
"""How much a channel that confirms an effect counts beside the shape."""
AGREES, CONTRADICTS, AGAINST = 0.5, 1.3, 0.3
"""A channel confirms an effect that leaves less than this share of its distance from the command, and contradicts one
that puts it further off by this factor; that counts as so much of the gap left."""


@dataclass(frozen=True, eq=False)
class Channel:
    """One measured input.

    Attributes:
        name: `tension` [N] or `pressure` [kPa].
        rms, noise: of measured − commanded, and of its white part.
        left: by effect, the share of the mean square beyond noise that it leaves.
        error: predicted − measured through an effect with such parameters, or none; `inside` where it counts.
    """

    name: str
    rms: float
    noise: float
    left: Mapping[str, float]
    error: Callable[[type[Effect] | None, Any], np.ndarray]
    inside: np.ndarray

    @property
    def best(self) -> str:
        return min(self.left, key=lambda i: self.left[i])

    @property
    def speaks(self) -> bool:
        """Whether it differs from its command in a way that an effect explains."""
        return bool(self.left) and self.rms > SPEAKS * self.noise and self.left[self.best] < 1 - EXPLAINS

    def rms_with(self, effects: Sequence[Effect]) -> float | None:
        """RMS of measured − predicted with the one of these effects that acts here and suits best; None for none."""
        hook = "actuate" if self.name == "tension" else "evacuate"
        out = []
        for e in effects:
            if _acts(type(e), hook):
                r = self.error(type(e), [float(getattr(e, n)) for n in e.fields()])
                out.append(float(np.sqrt(np.mean(r[self.inside] ** 2))))
        return min(out, default=None)

    def leaves(self, rms: float) -> float:
        """The share of its mean square beyond noise that an RMS stands for."""
        return max(rms**2 - self.noise**2, 0.0) / max(self.rms**2 - self.noise**2, 1e-12)


@dataclass(eq=False)
class Measured:
    """All measured inputs, and what they say; `heard`, the channels that confirm an effect fitted to the shape."""

    channels: Sequence[Channel] = ()
    heard: set[str] = field(default_factory=set)

    @property
    def notes(self) -> list[str]:
        """What the channels that are heard say."""
        return [
            f"measured {c.name} differs from its command by {c.rms:.3g} RMS, {c.rms / c.noise:.1f} × its noise; "
            f"{c.best} explains {100 * (1 - c.left[c.best]):.0f} % of it"
            for c in self.channels
            if c.name in self.heard
        ]

    @property
    def speaks(self) -> list[str]:
        """Effects that explain a channel that speaks, the best of each first."""
        out: list[str] = []
        for c in self.channels:
            if c.speaks:
                out += [i for i in sorted(c.left, key=lambda i: c.left[i]) if c.left[i] < 1 - EXPLAINS]
        return list(dict.fromkeys(out))

    def listen(self, left: float, effects: Sequence[Effect]) -> None:
        """Note the channels that confirm effects which leave such a share of the shape's gap."""
        for c in self.channels:
            rms = c.rms_with(effects)
            if c.speaks and rms is not None and c.leaves(rms) < AGREES and left < 0.9:
                self.heard.add(c.name)

    def joined(self, left: float, effects: Sequence[Effect]) -> float:
        """The share left of the shape's gap and of those of the channels that are heard, together."""
        out = left
        for c in self.channels:
            rms = c.rms_with(effects)
            if c.name in self.heard:
                out = (1 - WEIGHT) * out + WEIGHT * (1.0 if rms is None else min(c.leaves(rms), 1.0))
            if c.name == "tension" and rms is not None and rms > CONTRADICTS * max(c.rms, c.noise):
                out += AGAINST
        return out


def look(motions: Sequence[Motion], kinds: Sequence[type[Effect]]) -> Measured:
    """What the measured inputs of these runs say of the effects that act on them."""
    channels = []
    for name, signal, hook in (("tension", "tendons", "actuate"), ("pressure", "pressure", "evacuate")):
        mine = [m for m in motions if m.source == "commands" and signal in m.run.signals]
        acting = [k for k in kinds if _acts(k, hook)]
        if mine and acting:
            channels.append(_channel(name, signal, mine, acting))
    return Measured(channels)


def _acts(kind: type[Effect], hook: str) -> bool:
    delays = hook == "actuate" and kind.delay_s is not Effect.delay_s
    beyond = kind.id == "tendon_slack"  # between the sensor and the body
    return (delays or getattr(kind, hook) is not getattr(Effect, hook)) and not beyond


def _channel(name: str, signal: str, motions: Sequence[Motion], kinds: Sequence[type[Effect]]) -> Channel:
    longest = max(float(m.run.signals[signal].t[-1] - m.input_t[0]) for m in motions)
    runs = [_Sampled(m, signal, int(np.ceil(longest / STEP_S)) + 1) for m in motions]
    noise = np.sqrt(np.mean([r.noise**2 for r in runs]))
    y = np.concatenate([r.y.ravel() for r in runs])
    weight = 1 / max(float(noise), 1e-6)

    def error(kind: type[Effect] | None, x: np.ndarray) -> np.ndarray:
        return np.concatenate([r.predicted(kind, x).ravel() for r in runs]) - y

    base = error(None, np.zeros(0))
    limit = 6 * 1.4826 * np.median(np.abs(base - np.median(base))) + 20 * noise
    inside = np.abs(base) < max(limit, np.quantile(np.abs(base), 0.99))
    rms = float(np.sqrt(np.mean(base[inside] ** 2)))
    left: dict[str, float] = {}
    if rms > SPEAKS * noise:
        for kind in kinds:
            best = _explained(kind, error, inside, weight, max(float(m.tendons.max()) for m in motions))
            left[kind.id] = float(max(best**2 - noise**2, 0.0) / (rms**2 - noise**2))
    return Channel(name, rms, float(noise), left, error, inside)


def _explained(kind: type[Effect], error: Any, inside: np.ndarray, weight: float, top: float) -> float:
    """RMS that an effect leaves at best."""
    about = kind.fields()
    lower = np.array([x["low"] for x in about.values()])
    upper = np.array([x["high"] for x in about.values()])
    best = np.inf
    forms = [n for n, x in about.items() if x["pilots"]]
    starts = [
        [
            (p * (top if x["of"] == "tension" else 1.0) if n in forms else x["null"] + 0.5 * x["scale"])
            for n, x in about.items()
        ]
        for p in (about[forms[0]]["pilots"] if forms else (0.0,))
    ]
    for start in starts:
        x0 = np.clip(start, lower, upper)

        def residuals(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            r = error(kind, x)
            steps = 1e-4 * np.maximum(np.abs(x), [a["scale"] for a in about.values()])
            j = np.stack([(error(kind, x + d) - r) / s for d, s in zip(np.diag(steps), steps, strict=True)], axis=1)
            return (r * weight)[inside], (j * weight)[inside]

        try:
            found = solve(residuals, x0, lower, upper)
        except (np.linalg.LinAlgError, FloatingPointError):
            continue
        rms = float(np.sqrt(np.mean(error(kind, found.x)[inside] ** 2)))
        best = min(best, rms)
    return best


class _Sampled:
    """One run's measured input at its stamps, and what its command and an effect make of it."""

    def __init__(self, m: Motion, signal: str, count: int):
        s = m.run.signals["tendons"] if signal == "tendons" else m.run.vacuum_kpa("pressure")
        self.signal, self.m = signal, m
        begin = max(float(m.input_t[0]), float(s.t[0]))
        keep = s.t >= begin
        self.t, self.y = s.t[keep], s.value[keep]
        self.noise = np.maximum(np.sqrt(np.mean(white_noise(self.y) ** 2)), 1e-6)
        self.edges = begin + STEP_S * np.arange(count + 1)
        theta = np.stack([np.interp(self.edges[:-1], m.t, c) for c in m.y.T], axis=1)
        n = len(m.q0)
        self.q = np.broadcast_to(theta, (count, n)) if theta.shape[1] != n else theta
        self.vacuum = mean(m.input_t, m.vacuum[:, None], self.edges, m.hold, np)[:, 0]

    def predicted(self, kind: type[Effect] | None, x: np.ndarray) -> np.ndarray:
        """(N, c) the input at the stamps, by linear interpolation between the middles of steps."""
        delay = 0.0
        effect = None
        if kind is not None:
            effect = kind(*x)
            delay = float(d) if (d := effect.delay_s()) is not None else 0.0
        tendons = mean(self.m.input_t, self.m.tendons, self.edges - delay, self.m.hold, np)
        if effect is not None and delay == 0.0:
            out = _through(effect, tendons, self.vacuum, self.q, self.signal == "tendons")
            series = np.asarray(out)
        else:
            series = tendons if self.signal == "tendons" else self.vacuum[:, None]
        middle = self.edges[:-1] + 0.5 * STEP_S
        return np.stack([np.interp(self.t, middle, c) for c in series.T], axis=1)


@eqx.filter_jit
def _through(effect: Effect, tendons: Any, vacuum: Any, q: Any, tension: bool) -> jax.Array:
    """(T, 2) tensions or (T, 1) vacuum after an effect."""
    tendons, vacuum, q = jnp.asarray(tendons), jnp.asarray(vacuum), jnp.asarray(q)
    zero = jnp.zeros(())

    def now(u: jax.Array, p: jax.Array, shape: jax.Array) -> Now:
        joints = tuple(shape)
        still = tuple(zero for _ in joints)
        return Now(None, zero, zero + STEP_S, joints, still, still, joints, (u[0], u[1]), p, zero, zero)

    def step(memory: Any, given: Any) -> tuple[Any, jax.Array]:
        here = now(*given)
        if tension:
            u, memory = effect.actuate(memory, here.u, here)
            return memory, jnp.stack(u)
        p, memory = effect.evacuate(memory, here.vacuum, here)
        return memory, jnp.stack([p])

    first = effect.start(now(tendons[0], vacuum[0], q[0]))
    return jax.lax.scan(step, first, (tendons, vacuum, q))[1]
