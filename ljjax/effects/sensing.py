"""Effects between the body and the log."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp

from ljjax.effect import Effect, parameter, shape
from ljjax.effects.shapes import along, gone, lagged, ringing, sawtooth, towards_base

BEND_RAD, AXIS_RAD = 0.15, 0.5
"""Bend of a joint, and direction of a link, at which what a view from aside and a lens distort is what their parameters
say."""
INVERSE = 4
"""Steps of Newton's method that undo it."""


class SensorScale(Effect):
    """The camera's scale is wrong, more so to one side where it looks from aside, and further out by its lens, with the
    angle or with the way off the axis: (1 + s + p b + r b² + l ψ²) y, b = y/0.15 rad, ψ the link's direction over
    0.5 rad. The picture may be wider than it is high, its pixels not square: a link at ψ then is seen at ψ′, tan ψ′ =
    (1 + w) tan ψ. A share g of what s says comes as the session goes on, as a zoom creeps: s (1 − g exp(−S/S₀)), S the
    way gone by the mean joint."""

    id, block, axes = "sensor_scale", "sensing", ("everywhere", "angle")
    sudden = True
    error: jax.Array = parameter("1", 0.0, -0.6, 1.5, 0.05)
    aside: jax.Array = parameter("1", 0.0, -0.3, 0.3, 0.02)
    lens: jax.Array = parameter("1", 0.0, -0.3, 0.3, 0.02)
    off_axis: jax.Array = parameter("1", 0.0, -0.6, 1.5, 0.05)
    wide: jax.Array = parameter("1", 0.0, -0.6, 1.5, 0.05)
    creeps: jax.Array = shape("1", 0.0, 0.0, 1.0, (1.0, 0.0))
    creeps_rad: jax.Array = shape("rad", 10.0, 0.1, 1e3, (0.7,), "slip")

    def _error(self, slip):
        return self.error * (1 - self.creeps * jnp.exp(-slip / self.creeps_rad))

    def start(self, now):
        return (now.worn,)

    def remember(self, memory, now, after):
        return (memory[0] + gone(now.q, after.q),)

    def sense(self, memory, y, now):
        out, psi, error = [], 0.0, self._error(memory[0])
        for x in _widened(y, self.wide):
            b, psi = x / BEND_RAD, psi + x
            out.append((1 + error + (self.aside + self.lens * b) * b + self.off_axis * (psi / AXIS_RAD) ** 2) * x)
        return tuple(out), memory

    def unsense(self, y, now=None):
        out, before, error = [], 0.0, self._error(0.0 if now is None else now.worn)
        for x in y:
            q = x / (1 + error)
            for _ in range(INVERSE):
                first, second = self.aside * q / BEND_RAD, self.lens * (q / BEND_RAD) ** 2
                psi = (before + q) / AXIS_RAD
                wrong = (1 + error + first + second + self.off_axis * psi**2) * q - x
                slope = 1 + error + 2 * first + 3 * second
                q = q - wrong / (slope + self.off_axis * psi * (psi + 2 * q / AXIS_RAD))
            out.append(q)
            before = before + q
        return tuple(_widened(out, -self.wide / (1 + self.wide)))


def _widened(angles: Sequence[jax.Array], more: jax.Array) -> list[jax.Array]:
    """Angles between links in a picture that is so much wider."""
    out, psi, turned = [], 0.0, 0.0
    for x in angles:
        psi = psi + x
        sine, before = jnp.sin(psi), turned
        turned = jnp.arctan(more * sine * jnp.cos(psi) / (1 + more * sine * sine))
        out.append(x + turned - before)
    return out


DRIFTS_S = 10.0
"""The time in a run after which an offset that drifts is what it says."""


class SensorBias(Effect):
    """Markers sit off their places: y + b, and where joints have markers of their own an offset each, by modes along
    the body. A share g of it comes with the time t since a run began, as where gyroscopes are set to zero then: b (1 −
    g + g t/10 s)."""

    id, block, axes = "sensor_bias", "sensing", ("everywhere", "segment")
    sudden = True
    offset_rad: jax.Array = parameter("rad", 0.0, -0.5, 0.5, 0.01)
    mode1: jax.Array = parameter("rad", 0.0, -0.5, 0.5, 0.01)
    mode2: jax.Array = parameter("rad", 0.0, -0.5, 0.5, 0.01)
    mode3: jax.Array = parameter("rad", 0.0, -0.5, 0.5, 0.01)
    mode4: jax.Array = parameter("rad", 0.0, -0.5, 0.5, 0.01)
    mode5: jax.Array = parameter("rad", 0.0, -0.5, 0.5, 0.01)

    drifts: jax.Array = shape("1", 0.0, -5.0, 1.0, (1.0, 0.0))

    def _offsets(self, n, t):
        share = 1 + self.drifts * (t / DRIFTS_S - 1)
        return [share * (self.offset_rad + x) for x in along(self, n)]

    def sense(self, memory, y, now):
        return tuple(x + b for x, b in zip(y, self._offsets(len(y), now.t + now.h), strict=True)), memory

    def unsense(self, y, now=None):
        return tuple(x - b for x, b in zip(y, self._offsets(len(y), 0.0 if now is None else now.t), strict=True))


class SensorFilter(Effect):
    """Detections are averaged: τẏ = x − y and after it a filter of second order, of the time constants r τ (1 ± i o),
    exact for angles that move steadily in a step. r = 0 is a first-order filter; r = 1 without o a moving average over
    6τ, but for terms of third order; with o > 0 it overshoots, as Butterworth's filters do. Angles smoothed afterwards
    need not lag: of what the filter is late, τ + 2 r τ, a share u is taken back. Filters that smooth less
    what moves fast have τ/(1 + a |ẋ|)."""

    id, block, axes = "sensor_filter", "sensing", ("rate", "time")
    tau_s: jax.Array = parameter("s", 0.0, 0.0, 1.0, 0.03)
    later: jax.Array = shape("1", 0.5, 0.0, 4.0, (0.0, 1.0))
    overshoot: jax.Array = shape("1", 0.0, 0.0, 3.0, (1.0, 0.0))
    undone: jax.Array = shape("1", 0.0, 0.0, 1.0, (1.0, 0.0))
    adapts: jax.Array = shape("s/rad", 0.0, 0.0, 1e3, (10.0, 0.0))

    def latency_s(self):
        return -self.undone * (1 + 2 * self.later) * self.tau_s

    def start(self, now):
        return *(tuple(now.q),) * 3, tuple(0.0 * q for q in now.q)

    def sense(self, memory, y, now):
        out = []
        for x, before, first, second, rate in zip(y, *memory, strict=True):
            speed = (x - before) / now.h
            tau = self.tau_s / (1 + self.adapts * jnp.abs(speed))
            later = self.later * tau
            once = lagged(x - tau * speed, first + (x - before), tau, now.h)[1]
            speed = (once - first) / now.h  # what follows it steadily is late by 2 r τ, the rest decays
            held = second + (once - first)
            _, twice, rest = ringing(once - 2 * later * speed, held, rate - speed, later, self.overshoot, now.h)
            out.append((x, once, twice, rest + speed))
        memory = tuple(zip(*out, strict=True))
        return memory[2], memory


class SensorDelay(Effect):
    """The shape is stamped later than it was seen (camera latency, clock offset): y(t − d). Between two settings of its
    clock the stamps may drift: y(t − d) − d r s ẏ, s the sawtooth from −½ to ½ over the time T, at 0 at −φ T; to first
    order too what it is more, or less, in one run than in others, and for one joint than for others that are read after
    it, d (1 + g x), x from 1 at the base to −1 at the tip."""

    id, block, axes = "sensor_delay", "sensing", ("rate", "time")
    sudden = True
    delay_seconds: jax.Array = parameter("s", 0.0, 0.0, 0.4, 0.03)
    drift: jax.Array = shape("1", 0.0, -2.0, 2.0, (0.0, 1.0), "drift")
    reset_s: jax.Array = shape("s", 5.0, 0.5, 1e3, (1.0,), "reset_s")
    phase: jax.Array = shape("1", 0.0, -10.0, 10.0, (1.0,), "phase")
    to_base: jax.Array = shape("1", 0.0, -1.5, 1.5, (0.0,))

    def start(self, now):
        return tuple(now.q)

    def latency_s(self):
        return self.delay_seconds

    def sense(self, memory, y, now):
        share = self.more + self.drift * sawtooth((now.t + now.h) / self.reset_s + self.phase)
        late = [self.delay_seconds * (share + of - 1) for of in towards_base(self.to_base, len(y))]
        return tuple(x - d * (x - before) / now.h for x, d, before in zip(y, late, memory, strict=True)), tuple(y)
