"""Measured tension and line pressure beside their commands: where they disagree, a block of the model has spoken.

What stands between command and sensor shows here without the body. It is asked of every refit: an effect that explains
the shape must, as it was fitted to the shape, explain the measured tension too. The line's pressure cannot contradict
what happens in the sheath behind it; it can only confirm.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ljjax.effect import Effect, Now
from ljjax.fast import mean
from ljjax.fit.least_squares import solve
from ljjax.fit.windows import Motion, white_noise
from ljjax.gap.candidates import pilots
from ljjax.gap.data import span
from ljjax.gap.screening import beat, clock, rates, waves_in
from ljjax.model import Model
from ljjax.step import Unrolled, directions

STEP_S, ITERATIONS, STEP = 0.005, 20, 1e-4
SMOOTH = 5
"""Steps on either side over which the rate of the measured shape is taken."""
CLOCK = {"drift": 1.0, "reset_s": 1.0, "phase": 0.0}
"""Shares for a clock where none is heard."""
HELD = 2.0
"""How much of its mean a delay grows over a beat at which commands are read and then held: from none to twice of it."""
SPEAKS = 1.3
"""A channel speaks if its RMS distance from the command is so many times its noise, whether a command that changes at
a stamp counts there already or not yet, and an effect explains some."""
EXPLAINS = 0.3
MATTERS, UNTOLD, BESIDE = 0.5, 3.0, 0.02
"""A channel is heard if an effect that agrees with it leaves less than this share of the shape's gap; what does not
explain that channel then counts as if it left so many times more, and so much more at least."""
AGREES, CONTRADICTS, AGAINST = 0.5, 1.3, 0.3
"""A channel confirms an effect that leaves less than this share of its distance from the command, and contradicts one
that puts it further off by this factor; that counts as so much of the gap left."""
SHOWS, SURE, ALIKE = 0.3, 6.0, 1e-6
"""A channel contradicts, too, an effect of which it shows less than this share, by so many standard deviations. Least
squared length of what part of effects' predictions of length 1 is their own."""


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x**2)))


class Fitted(NamedTuple):
    """An effect as fitted to the shape, its free parameters (p names) and their covariance (p, p)."""

    effect: Effect
    free: Sequence[str]
    covariance: np.ndarray


@dataclass(frozen=True, eq=False)
class Channel:
    """One measured input.

    Attributes:
        name: `tension` [N] or `pressure` [kPa].
        rms, noise: of measured − commanded, and of its white part.
        left: by effect, the share of the mean square beyond noise that it leaves; `values` its parameters then. None
            where the channel is as its command.
        error: (m, N) predicted − measured through an effect of parameters (m, p), or none; `inside` (N,) where it
            counts.
    """

    name: str
    rms: float
    noise: float
    left: Mapping[str, float]
    values: Mapping[str, Mapping[str, float]]
    error: Callable[[type[Effect] | None, np.ndarray], np.ndarray]
    inside: np.ndarray

    @property
    def best(self) -> str:
        return min(self.left, key=lambda i: self.left[i])

    @property
    def speaks(self) -> bool:
        """Whether it differs from its command in a way that an effect explains."""
        return bool(self.left) and self.left[self.best] < 1 - EXPLAINS

    def rms_with(self, fitted: Sequence[Fitted]) -> float | None:
        """RMS of measured − predicted with the one of these effects that acts here and suits best; None for none. Its
        parameters may move as far as the shape leaves them uncertain."""
        return min((_rms(e) for e in self.suited(fitted)), default=None)

    def contradicts(self, suited: Sequence[np.ndarray]) -> bool:
        """Whether what is measured puts further off every effect that acts here, or hardly shows what they predict
        together or what one of them does beside the others, from `suited`."""
        if not suited:
            return False
        further = min(_rms(e) for e in suited) > CONTRADICTS * max(self.rms, self.noise)
        together = self._before + sum(e - self._before for e in suited)
        return further or self._denies(together) or self._denies(*suited)

    @cached_property
    def _before(self) -> np.ndarray:
        return self.error(None, np.zeros((1, 0)))[0, self.inside]

    def _denies(self, *errors: np.ndarray) -> bool:
        """Whether the measured way from the command has hardly any of what one of these effects predicts, from the
        errors (N,) with each: a regression on all of them; what looks alike in it is not denied."""
        predicted = np.stack(errors) - self._before
        size = np.linalg.norm(predicted, axis=1)
        predicted = predicted[size > 0] / size[size > 0, None]
        values, vectors = np.linalg.eigh(predicted @ predicted.T)
        values = np.maximum(values, ALIKE)
        shown = vectors @ (vectors.T @ (predicted @ -self._before) / values)
        doubt = self.noise * np.sqrt(np.sum(vectors**2 / values, axis=1))
        return bool(np.any(shown + SURE * doubt < SHOWS * size[size > 0]))

    def suited(self, fitted: Sequence[Fitted]) -> list[np.ndarray]:
        """(N,) errors with each of these effects that acts here."""
        hook = "actuate" if self.name == "tension" else "evacuate"
        return [self._suited(f) for f in fitted if _acts(type(f.effect), hook)]

    def _suited(self, fitted: Fitted) -> np.ndarray:
        kind, about = type(fitted.effect), fitted.effect.fields()
        x0 = np.array([float(getattr(fitted.effect, n)) for n in about])
        error = self.error(kind, x0[None])[0, self.inside]
        first = _rms(error)
        close = first <= CONTRADICTS * max(self.rms, self.noise) and not self._denies(error)
        if self.leaves(first) < AGREES or self.left.get(kind.id, 1.0) >= AGREES and close:
            return error
        known = np.diag([(0.02 * about[n]["scale"]) ** 2 for n in fitted.free])
        finite = np.all(np.isfinite(fitted.covariance))
        values, vectors = np.linalg.eigh(known + (fitted.covariance if finite else 0.0))
        ways = np.zeros((len(about), len(values)))
        ways[[list(about).index(n) for n in fitted.free]] = 3 * vectors * np.sqrt(np.maximum(values, 0.0))
        rms, x = self.fit(kind, x0, ways, -1.0, 1.0)
        return self.error(kind, x[None])[0, self.inside] if rms < first else error

    def fit(
        self, kind: type[Effect], x0: np.ndarray, ways: np.ndarray, low: float | np.ndarray, high: float | np.ndarray
    ) -> tuple[float, np.ndarray]:
        """The least RMS of an effect whose parameters are x0 (p,) and some of each of the ways (p, m) from there, so
        much of each as `low` and `high` (m,) allow, and those parameters."""
        least, most = (np.array([x[side] for x in kind.fields().values()]) for side in ("low", "high"))
        count = ways.shape[1]
        low, high = (np.broadcast_to(np.asarray(x, float), (count,)) for x in (low, high))

        def at(z: np.ndarray) -> np.ndarray:
            return np.clip(x0 + z @ ways.T, least, most)

        def residuals(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            steps = np.where(z < high - STEP, STEP, -STEP)
            r, *moved = self.error(kind, at(z + np.vstack([np.zeros(count), np.diag(steps)])))[:, self.inside]
            return r / self.noise, np.stack(
                [(m - r) / (s * self.noise) for m, s in zip(moved, steps, strict=True)], axis=1
            )

        try:
            found = solve(residuals, np.zeros(count), low, high, ITERATIONS)
        except (np.linalg.LinAlgError, FloatingPointError):
            return np.inf, x0
        return float(np.sqrt(np.mean(found.residual**2))) * self.noise, at(found.x)

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
            f"{c.best} explains {100 * (1 - c.left[c.best]):z.0f} % of it"
            for c in self.channels
            if c.name in self.heard
        ]

    @property
    def speaks(self) -> dict[str, Mapping[str, float]]:
        """Effects that explain a channel that speaks, the best of each first, with their parameters there."""
        out: dict[str, Mapping[str, float]] = {}
        for c in self.channels:
            if c.speaks:
                for i in sorted(c.left, key=lambda i: c.left[i]):
                    if c.left[i] < 1 - EXPLAINS:
                        out.setdefault(i, c.values[i])
        return out

    def listen(self, left: float, fitted: Sequence[Fitted]) -> None:
        """Note the channels that confirm effects which leave such a share of the shape's gap."""
        for c in self.channels:
            if c.speaks and left < MATTERS:
                rms = c.rms_with(fitted)
                if rms is not None and c.leaves(rms) < AGREES:
                    self.heard.add(c.name)

    def joined(self, left: float, fitted: Sequence[Fitted]) -> float:
        """The share left of the shape's gap, and what channels that are heard or contradicted add to it."""
        out = left
        for c in self.channels:
            if c.name not in self.heard and c.name != "tension":
                continue
            suited = c.suited(fitted)
            if c.name in self.heard:
                untold = min((c.leaves(_rms(e)) for e in suited), default=1.0)
                out += UNTOLD * min(untold, 1.0) * (max(left, 0.0) + BESIDE)
            if c.name == "tension" and c.contradicts(suited):
                out += AGAINST
        return out


def look(motions: Sequence[Motion], kinds: Sequence[type[Effect]], model: Model) -> Measured:
    """What the measured inputs of these runs say of the effects that act on them, on a robot like the model."""
    channels = []
    for name, signal, hook in (("tension", "tendons", "actuate"), ("pressure", "pressure", "evacuate")):
        mine = [m for m in motions if m.source == "commands" and signal in m.run.signals]
        acting = [k for k in kinds if _acts(k, hook)]
        if mine and acting:
            channels.append(_channel(name, signal, mine, acting, model))
    return Measured(channels)


def _acts(kind: type[Effect], hook: str) -> bool:
    delays = hook == "actuate" and kind.delay_s is not Effect.delay_s
    beyond = kind.id == "tendon_slack"  # between the sensor and the body
    return (delays or getattr(kind, hook) is not getattr(Effect, hook)) and not beyond


def _channel(name: str, signal: str, motions: Sequence[Motion], kinds: Sequence[type[Effect]], model: Model) -> Channel:
    inputs, none = _Inputs(motions, signal, model), np.zeros((1, 0))
    noise, base = inputs.noise, inputs.error(None, none)[0]
    limit = 6 * 1.4826 * np.median(np.abs(base - np.median(base))) + 20 * noise
    inside = np.abs(base) < max(limit, np.quantile(np.abs(base), 0.99))
    rms = _rms(base[inside])
    channel = Channel(name, rms, noise, {}, {}, inputs.error, inside)
    stamped = (inputs.error(None, none, late)[0, inside] for late in (-0.5 * STEP_S, 0.0, 0.5 * STEP_S))
    if min(map(_rms, stamped)) > SPEAKS * noise:
        scale = {**span(motions), "angle": 1.0, "slip": 1.0, **CLOCK, **inputs.clock(base)}
        waves = inputs.waves(base)
        found = {k.id: _explained(k, channel, pilots(k, scale, waves)) for k in kinds}
        left = {i: channel.leaves(rms) for i, (rms, _) in found.items()}
        channel = replace(channel, left=left, values={i: values for i, (_, values) in found.items()})
    return channel


def _explained(
    kind: type[Effect], channel: Channel, forms: Sequence[Mapping[str, float]]
) -> tuple[float, dict[str, float]]:
    """RMS that an effect leaves at best, begun from some forms, and its parameters then."""
    about = kind.fields()
    lower, upper, scales = (np.array([x[what] for x in about.values()]) for what in ("low", "high", "scale"))
    found = []
    for f in forms:
        x = np.clip([f.get(n, y["null"] + 0.5 * y["scale"]) for n, y in about.items()], lower, upper)
        found.append(channel.fit(kind, x, np.diag(scales), (lower - x) / scales, (upper - x) / scales))
    rms, x = min(found, key=lambda f: f[0])
    return min(rms, channel.rms), dict(zip(about, map(float, x), strict=True))


class _Inputs:
    """Measured inputs of all runs at their stamps, and what their commands and an effect make of them."""

    def __init__(self, motions: Sequence[Motion], signal: str, model: Model):
        self.motions, self.tension, self.model = motions, signal == "tendons", model
        given = [m.run.signals[signal] if self.tension else m.run.vacuum_kpa(signal) for m in motions]
        longest = max(float(s.t[-1] - m.input_t[0]) for s, m in zip(given, motions, strict=True))
        count = int(np.ceil(longest / STEP_S)) + 1
        self.t, self.edges, y, paths = [], [], [], []
        for s, m in zip(given, motions, strict=True):
            begin = max(float(m.input_t[0]), float(s.t[0]))
            self.t.append(s.t[s.t >= begin])
            y.append(s.value[s.t >= begin])
            edges = begin + STEP_S * np.arange(count + 1)
            self.edges.append(edges)
            theta = np.stack([np.interp(edges, m.t, c) for c in m.y.T], axis=1)
            q = np.broadcast_to(theta, (count + 1, len(m.q0)))
            beside = np.pad(q, ((SMOOTH, SMOOTH - 1), (0, 0)), mode="edge")
            v = (beside[2 * SMOOTH - 1 :] - beside[: -2 * SMOOTH + 1])[:count] / ((2 * SMOOTH - 1) * STEP_S)
            warm, worn = np.interp(edges[:-1], m.t, m.warm), np.full(count, m.worn[0])
            vacuum = mean(m.input_t, m.vacuum[:, None], edges, m.hold, np)[:, 0]
            paths.append((vacuum, q[:-1], q[1:], v, warm, worn))
        self.y = np.concatenate([x.ravel() for x in y])
        self.noise = max(float(np.sqrt(np.mean([np.mean(white_noise(x) ** 2) for x in y]))), 1e-6)
        self.begins = np.stack([e[:-1] for e in self.edges])
        self.drive = self._commanded(0.0), *(np.stack(x) for x in zip(*paths, strict=True))

    def _commanded(self, delay: float) -> np.ndarray:
        """(R, T, 2) mean commanded tensions of the steps, so much later."""
        edges = zip(self.motions, self.edges, strict=True)
        return np.stack([mean(m.input_t, m.tendons, e - delay, m.hold, np) for m, e in edges])

    def clock(self, error: np.ndarray) -> dict[str, float]:
        """How the delay of the tensions would change between two settings of a clock: by the beat at which they change,
        where they are held in between as their commands are not, else by their error (N,)."""
        if not self.tension:
            return {}
        t, run = np.concatenate(self.t), np.repeat(np.arange(len(self.t)), [len(t) for t in self.t])
        e, y = error.reshape(-1, 2), self.y.reshape(-1, 2)
        if heard := beat(t, y, e + y, run):
            hz, phase = heard
            return {"drift": HELD, "reset_s": 1 / hz, "phase": phase}
        return clock(t, e, rates(t, e + y, run))

    def waves(self, error: np.ndarray) -> list[float]:
        """The waves over the body's bend [1/rad] that the net tension's error (N,) has most of."""
        if not self.tension:
            return []
        net = error.reshape(-1, 2) @ [1.0, -1.0]
        runs = np.split(net, np.cumsum([len(t) for t in self.t])[:-1])
        bends = self.drive[2].sum(axis=2)
        pieces = zip(self.t, self.edges, bends, runs, strict=True)
        return waves_in([(np.interp(t, e[:-1], bend), own) for t, e, bend, own in pieces])

    def error(self, kind: type[Effect] | None, x: np.ndarray, late_s: float = 0.0) -> np.ndarray:
        """(m, N) predicted − measured through an effect of the parameters x (m, p), or none; at the stamps by linear
        interpolation between the middles of steps, or so much later."""
        commanded, vacuum, *_ = self.drive
        if kind is None:
            series = (commanded if self.tension else vacuum[..., None])[None]
        elif kind.delay_s is not Effect.delay_s:
            series = np.concatenate([self._delayed(kind, row) for row in x])
        else:
            series = np.asarray(_through(self.model, kind(*x.T), self.begins, *self.drive, self.tension))
        out = []
        for row in series:
            at = [
                np.interp(t - late_s, e[:-1] + 0.5 * STEP_S, c)
                for t, e, own in zip(self.t, self.edges, row, strict=True)
                for c in own.T
            ]
            columns = row.shape[-1]
            runs = [np.stack(at[i : i + columns], axis=1).ravel() for i in range(0, len(at), columns)]
            out.append(np.concatenate(runs) - self.y)
        return np.stack(out)

    def _delayed(self, kind: type[Effect], x: np.ndarray) -> np.ndarray:
        """(1, R, T, 2) tensions after a transport delay and what else an effect of these parameters (p,) does."""
        delay = kind(*x).delay_s()
        commanded = self._commanded(0.0 if delay is None else float(delay))
        effects = kind(*x[:, None])
        return np.asarray(_through(self.model, effects, self.begins, commanded, *self.drive[1:], self.tension))


@eqx.filter_jit
def _through(model: Model, effects: Effect, t: Any, tendons: Any, *paths: Any) -> jax.Array:
    """(m, R, T, 2) tensions or (m, R, T, 1) vacuum after effects of (m,) parameters, along what was measured: vacuum, q
    before and after a step, v, warmth and wear; last whether tensions are asked for."""
    *measured, tension = paths
    drive = tuple(jnp.asarray(x) for x in (t, tendons, *measured))
    zero = jnp.zeros(())

    def now(given: Any) -> Now:
        t, u, p, q, _, v, warm, worn = given
        joints = tuple(q)
        still = tuple(zero for _ in joints)
        return Now(
            *(model, t, zero + STEP_S, joints, tuple(v), still, joints, (u[0], u[1]), p, warm, worn),
            *directions(joints),
        )

    def one(effect: Effect, drive: Any) -> jax.Array:
        def step(memory: Any, given: Any) -> tuple[Any, jax.Array]:
            here = now(given)
            u, memory = effect.actuate(memory, here.u, here)
            p, memory = effect.evacuate(memory, here.vacuum, here)
            after = Unrolled(tuple(given[4]), here.v, here.z)
            return effect.remember(memory, here, after), jnp.stack(u) if tension else jnp.stack([p])

        first = effect.start(now(tuple(x[0] for x in drive)))
        return jax.lax.scan(step, first, drive)[1]

    runs = jax.vmap(one, in_axes=(None, 0))
    return jax.vmap(runs, in_axes=(0, None))(effects, drive)
