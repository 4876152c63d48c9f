"""Flexible stand-ins for what no listed effect is: one at each place of the model, of many small terms, none a cause.

How much of a gap a stand-in closes tells where the cause acts even where its form is none of those known: curves,
lags, relays and drifts at one place, the base refitted with them. They are never an answer of their own.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp

from ljjax.effect import Effect, parameter, shape
from ljjax.effects.shapes import gone, lagged, positive, turned, wave
from ljjax.gap.candidates import CAUTIOUS, cautious
from ljjax.gap.search import Refit, Study

BENT_RAD, KPA, LOAD_N, LONG_S, RATE = 0.15, 20.0, 10.0, 100.0, 0.05
"""Bend of a joint, vacuum, tension, time and rate [rad/s] at which terms are of the size of their parameters."""
TURN_RAD, TURN_N = 0.01, 0.5
"""Way in which directions turn round, of the bend [rad] and of a tension [N]."""


def _share(scale: float = 0.2, low: float = -0.9) -> jax.Array:
    return parameter("1", 0.0, low, 3.0 if low == 0.0 else 0.9, scale)


def _torque(low: float = -3.0) -> jax.Array:
    return parameter("N·m", 0.0, low, 3.0, 0.1)


def _slow(x, held, tau, h):
    """Value at a step's end of a lag of `tau` [s] behind x."""
    return lagged(x, held, jnp.asarray(tau, x.dtype), h)[1]


class AtTendons(Effect):
    """Tensions: curves, lags, and what depends on the way they or the body last went."""

    id, block = "stand_in_tendons", "actuation"
    curve: jax.Array = _share()
    uneven: jax.Array = _share()
    fast: jax.Array = _share()
    slow: jax.Array = _share()
    turning: jax.Array = _share(0.1)
    bending: jax.Array = _share(0.1)
    around: jax.Array = _share(0.1)
    held_n: jax.Array = parameter("N", 0.0, -20.0, 20.0, 0.3)

    def start(self, now):
        zero = 0.0 * now.u[0]
        return (*now.u, *now.u, zero, zero, zero)

    def actuate(self, memory, u, now):
        near, far, ways, way = memory[:2], memory[2:4], memory[4:6], memory[6]
        near = tuple(_slow(x, y, 0.05, now.h) for x, y in zip(u, near, strict=True))
        later = tuple(_slow(x, y, 0.5, now.h) for x, y in zip(u, far, strict=True))
        ways = tuple(turned(w, b - a, TURN_N) for w, a, b in zip(ways, far, u, strict=True))
        bend = sum(now.middle) / (len(now.q) * BENT_RAD)
        size = jnp.sqrt(bend * bend + 0.01)
        out = []
        for side, x, a, b, w in zip((1.0, -1.0), u, near, later, ways, strict=True):
            rubbed = self.turning * w + side * way * (self.bending + self.around * size)
            share = self.curve * x / LOAD_N + side * self.uneven - rubbed
            out.append(x * (1 + share) - self.fast * (x - a) - self.slow * (x - b) - 0.5 * side * way * self.held_n)
        return tuple(out), (*near, *later, *ways, way)

    def remember(self, memory, now, after):
        return (*memory[:6], turned(memory[6], sum(after.q) - sum(now.q), TURN_RAD))


class AtVacuum(Effect):
    """The vacuum in the sheath: a curve, lags, drift, and what the bend does to it."""

    id, block = "stand_in_vacuum", "jamming"
    bias: jax.Array = _share(0.1)
    curve: jax.Array = _share()
    root: jax.Array = _share()
    fast: jax.Array = _share()
    slow: jax.Array = _share()
    slower: jax.Array = _share()
    bent: jax.Array = _share()
    drift: jax.Array = _share()

    def start(self, now):
        return (now.vacuum,) * 3

    def evacuate(self, memory, vacuum, now):
        held = tuple(_slow(vacuum, x, tau, now.h) for x, tau in zip(memory, (0.1, 0.8, 6.0), strict=True))
        bend = sum(now.middle) / (len(now.q) * BENT_RAD)
        shares = self.curve * vacuum / KPA + self.bent * bend * bend + self.drift * now.t / LONG_S
        out = vacuum * (1 + shares) + KPA * self.bias + self.root * jnp.sqrt(KPA * jnp.abs(vacuum) + 1e-3)
        for share, x in zip((self.fast, self.slow, self.slower), held, strict=True):
            out = out - share * (vacuum - x)
        return positive(out), held


class AtBody(Effect):
    """Torques of each joint's shape: curves of its bend, with the vacuum or without, and branches that relax."""

    id, block = "stand_in_body", "structure"
    constant: jax.Array = _torque()
    square: jax.Array = _torque()
    bent: jax.Array = _torque()
    cube: jax.Array = _torque()
    root: jax.Array = _torque()
    relaxing: jax.Array = _torque(0.0)
    slower: jax.Array = _torque(0.0)
    drift: jax.Array = _torque()

    def start(self, now):
        return tuple(now.q), tuple(now.q)

    def load(self, memory, load, now):
        root = jnp.sqrt(jnp.abs(now.vacuum) / KPA + 1e-3)
        out = []
        for i, q in enumerate(now.middle):
            x, size = q / BENT_RAD, jnp.sqrt((q / BENT_RAD) ** 2 + 0.01)
            more = self.constant + self.square * x * x + self.bent * x * size + self.cube * x * x * x
            more = more + x * (self.root * root + self.drift * now.t / LONG_S)
            for k, held in zip((self.relaxing, self.slower), memory, strict=True):
                more = more + k * (q - held[i]) / BENT_RAD
            out.append(load[i] - more)
        return tuple(out)

    def remember(self, memory, now, after):
        return tuple(
            tuple(_slow(0.5 * (a + b), x, tau, now.h) for a, b, x in zip(now.q, after.q, held, strict=True))
            for tau, held in zip((0.3, 4.0), memory, strict=True)
        )


class InWaves(Effect):
    """Torques in waves over each joint's bend: detents, layers that catch and snap."""

    id, block = "stand_in_body_in_waves", "structure"
    sine: jax.Array = _torque()
    cosine: jax.Array = _torque()
    sine2: jax.Array = _torque()
    cosine2: jax.Array = _torque()
    waves: jax.Array = shape("1/rad", 15.0, 2.0, 200.0, (5.0, 8.0, 12.0, 18.0, 27.0, 40.0), "waves")

    def load(self, memory, load, now):
        terms = self.sine, self.cosine, self.sine2, self.cosine2
        bends = (self.waves * len(now.middle) * q for q in now.middle)
        return tuple(x - wave(bend, *terms) for x, bend in zip(load, bends, strict=True))


class AtOnce(Effect):
    """What changes once and for all at one moment of the session, told by the slip of the mean joint so far: a layer
    that comes loose, a tendon off its way, a marker that has moved."""

    id, block = "stand_in_body_all_at_once", "structure"
    elastic: jax.Array = _share()
    friction: jax.Array = _share()
    held: jax.Array = _torque()
    uneven: jax.Array = _share()
    moved: jax.Array = _share(0.05)
    slip_rad: jax.Array = shape("rad", 10.0, 1e-3, 1e5, tuple((k + 0.5) / 30 for k in range(30)), "slip")
    width_rad: jax.Array = shape("rad", 0.1, 1e-4, 1e4, (0.01,), "slip")

    def start(self, now):
        return (now.worn,)

    def _over(self, memory):
        return 0.5 + 0.5 * jnp.tanh((memory[0] - self.slip_rad) / self.width_rad)

    def actuate(self, memory, u, now):
        more = self.uneven * self._over(memory)
        return (u[0] * (1 + more), u[1] * (1 - more)), memory

    def alpha2(self, memory, alpha2, now):
        return tuple(a * (1 + self.elastic * self._over(memory)) for a in alpha2)

    def phi(self, memory, phi, now):
        return tuple(p * (1 + self.friction * self._over(memory)) for p in phi)

    def load(self, memory, load, now):
        return tuple(x + self.held * self._over(memory) for x in load)

    def remember(self, memory, now, after):
        return (memory[0] + gone(now.q, after.q),)

    def sense(self, memory, y, now):
        return tuple(x + BENT_RAD * self.moved * self._over(memory) for x in y), memory


class AtFriction(Effect):
    """The friction's scale over bend, direction, vacuum, load and time, and torques of the rate beside it."""

    id, block = "stand_in_friction", "friction"
    bent: jax.Array = _share()
    further: jax.Array = _share()
    vacuum: jax.Array = _share()
    root: jax.Array = _share()
    loaded: jax.Array = _share()
    drift: jax.Array = _share()
    viscous: jax.Array = _torque(0.0)
    dry: jax.Array = _torque(0.0)

    def start(self, now):
        return tuple(0.0 * q for q in now.q)

    def phi(self, memory, phi, now):
        p = now.vacuum / KPA
        common = self.vacuum * p + self.root * jnp.sqrt(jnp.abs(p) + 1e-3) + self.drift * now.t / LONG_S
        common = common + self.loaded * (now.u[0] + now.u[1]) / LOAD_N
        out = []
        for f, q, way in zip(phi, now.q, memory, strict=True):
            x = q / BENT_RAD
            out.append(f * jnp.exp(common + self.bent * x * x + self.further * way * x / jnp.sqrt(x * x + 0.01)))
        return tuple(out)

    def torque(self, memory, i, q, v, stage):
        return self.viscous * v / RATE + self.dry * v / jnp.sqrt(v * v + (0.1 * RATE) ** 2)

    def remember(self, memory, now, after):
        return tuple(turned(way, b - a, TURN_RAD) for way, a, b in zip(memory, now.q, after.q, strict=True))


class AtSensor(Effect):
    """What is logged of the shape: curves, lags, drift."""

    id, block = "stand_in_sensor", "sensing"
    scale: jax.Array = _share(0.05)
    square: jax.Array = _share(0.05)
    cube: jax.Array = _share(0.05)
    fast: jax.Array = _share()
    slow: jax.Array = _share()
    drift: jax.Array = _share(0.05)

    def start(self, now):
        return tuple(now.q), tuple(now.q)

    def sense(self, memory, y, now):
        held = tuple(
            tuple(_slow(x, z, tau, now.h) for x, z in zip(y, own, strict=True))
            for tau, own in zip((0.03, 0.3), memory, strict=True)
        )
        out = []
        for x, near, later in zip(y, *held, strict=True):
            b = x / BENT_RAD
            share = self.scale + self.cube * b * b
            more = self.square * b * b + self.drift * now.t / LONG_S
            out.append(x * (1 + share) + BENT_RAD * more - self.fast * (x - near) - self.slow * (x - later))
        return tuple(out), held


STAND_INS: tuple[type[Effect], ...] = (AtTendons, AtVacuum, AtBody, AtFriction, AtSensor)
QUICK: tuple[type[Effect], ...] = (InWaves, AtOnce)
"""Of few terms: asked even where the effects found leave little."""
PLACES = {k.id: k.id.removeprefix("stand_in_").replace("_", " ") for k in (*STAND_INS, *QUICK)}
BLOCKS = {PLACES[k.id]: k.block for k in (*STAND_INS, *QUICK)}
FINISH = 3
"""How many of them are refitted to their end."""


def stand_in(study: Study, base: Refit, kinds: Sequence[type[Effect]] = STAND_INS) -> dict[str, Refit]:
    """The base of a study refitted with each stand-in of `kinds`, by its place in `PLACES`; those of `QUICK` begun at
    the given model too, as the base may have gone where they cannot bring it back from. Those that fail are left out.
    """
    flexible = dataclasses.replace(study, kinds=kinds)
    screen = flexible.screen(base)
    trials, steps = [], {}
    for key in map(screen.best, screen.ids):
        trial, step = flexible.trial(screen, key)
        trial = cautious(trial, kinds)  # many terms at once carry the first step far beyond where it holds
        trials.append(trial)
        steps[trial] = CAUTIOUS * step
    found = flexible.refit(base.model, trials, screen, steps, "stand-ins", finish=FINISH)
    quick = [t for t in trials if t.ids[0] in {k.id for k in QUICK}]
    found += flexible.refit(study.start, quick, None, stage="stand-ins from the given model", finish=FINISH)
    return {PLACES[r.ids[0]]: r for r in sorted(found, key=lambda r: -r.total)}
