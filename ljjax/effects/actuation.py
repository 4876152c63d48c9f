"""Effects between the command and the body: motors, spools, tendons."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from ljjax.effect import Effect, parameter, shape
from ljjax.effects.shapes import arm, bounded, lagged, play, turned


class ActuatorDelay(Effect):
    """The tensions follow their commands after a transport delay: T(t) = T_cmd(t − d)."""

    id, block, axes = "actuator_delay", "actuation", ("rate", "load", "time")
    delay_seconds: jax.Array = parameter("s", 0.0, 0.0, 0.4, 0.03)

    def delay_s(self):
        return self.delay_seconds


class ActuatorDeadband(Effect):
    """Stiction of gearbox and spool eats a share s of each tension's first d newtons: T − s T (1 + (T/d)^p)^(−1/p),
    (T − d)₊ for s = 1 and a sharp edge, p → ∞."""

    id, block, axes = "actuator_deadband", "actuation", ("load", "everywhere", "angle")
    share: jax.Array = parameter("1", 0.0, 0.0, 1.0, 0.5)
    band_n: jax.Array = shape("N", 1.0, 0.01, 50.0, (0.02, 0.05, 0.12), "tension")
    edge: jax.Array = shape("1", 8.0, 1.0, 8.0, (2.0, 8.0))

    def actuate(self, memory, u, now):
        return tuple(t - self.share * bounded(t, self.band_n, self.edge) for t in u), memory


class ActuatorGain(Effect):
    """The torque constant or the spool's radius is wrong: (1 + e ± d) T_cmd, each tendon with a motor of its own."""

    id, block, axes = "actuator_gain", "actuation", ("load", "everywhere", "angle")
    error: jax.Array = parameter("1", 0.0, -0.6, 1.5, 0.1)
    difference: jax.Array = parameter("1", 0.0, -0.4, 0.4, 0.05)

    def actuate(self, memory, u, now):
        gains = 1 + self.error + self.difference, 1 + self.error - self.difference
        return tuple(g * t for g, t in zip(gains, u, strict=True)), memory


class ActuatorSaturation(Effect):
    """A share s of each tension stays below a limit L, its edge sharp or smooth: T − s T (1 − (1 + (T/L)^p)^(−1/p))."""

    id, block, axes = "actuator_saturation", "actuation", ("load", "angle")
    share: jax.Array = parameter("1", 0.0, 0.0, 1.0, 0.5)
    limit_n: jax.Array = shape("N", 10.0, 0.05, 1e3, (0.45, 0.65, 0.85), "tension")
    edge: jax.Array = shape("1", 8.0, 1.0, 16.0, (2.0, 8.0))

    def actuate(self, memory, u, now):
        return tuple(t - self.share * (t - bounded(t, self.limit_n, self.edge)) for t in u), memory


class ActuatorLag(Effect):
    """The current or tension loop lags: τ Ṫ = T_cmd − T, and after it a second lag of τ₂ (filter, tendon). Exact for
    commands that hold over a step."""

    id, block, axes = "actuator_lag", "actuation", ("rate", "load", "time")
    tau_s: jax.Array = parameter("s", 0.0, 0.0, 1.0, 0.05)
    second_s: jax.Array = parameter("s", 0.0, 0.0, 1.0, 0.03)

    def start(self, now):
        return *now.u, *now.u

    def actuate(self, memory, u, now):
        once = [lagged(x, held, self.tau_s, now.h) for x, held in zip(u, memory[:2], strict=True)]
        twice = [lagged(x, held, self.second_s, now.h) for (x, _), held in zip(once, memory[2:], strict=True)]
        return tuple(mean for mean, _ in twice), tuple(end for _, end in (*once, *twice))


class ActuatorRipple(Effect):
    """Ripple over each spool's angle φ, which goes with the bend and with the stretch c of the tendon, ±q_Σ + c T:
    T + A Σₖ aₖ sin(k w φ) + bₖ cos(k w φ), k = 1, 2, each tendon with a phase of its own; A = T/(1 + T/T₀) is the
    tension itself (ripple of the torque) below T₀ and stays there beyond it (cogging)."""

    id, block, axes = "actuator_ripple", "actuation", ("angle", "load")
    left_sine: jax.Array = parameter("1", 0.0, -0.9, 0.9, 0.05)
    left_cosine: jax.Array = parameter("1", 0.0, -0.9, 0.9, 0.05)
    left_sine2: jax.Array = parameter("1", 0.0, -0.9, 0.9, 0.03)
    left_cosine2: jax.Array = parameter("1", 0.0, -0.9, 0.9, 0.03)
    right_sine: jax.Array = parameter("1", 0.0, -0.9, 0.9, 0.05)
    right_cosine: jax.Array = parameter("1", 0.0, -0.9, 0.9, 0.05)
    right_sine2: jax.Array = parameter("1", 0.0, -0.9, 0.9, 0.03)
    right_cosine2: jax.Array = parameter("1", 0.0, -0.9, 0.9, 0.03)
    waves: jax.Array = shape("1/rad", 15.0, 2.0, 200.0, (5.0, 8.0, 12.0, 18.0, 27.0, 40.0), "waves")
    stretch: jax.Array = shape("rad/N", 0.01, 1e-4, 0.3, (0.002, 0.015))
    knee_n: jax.Array = shape("N", 10.0, 0.1, 1e3, (0.1, 5.0), "tension")

    def actuate(self, memory, u, now):
        bend = sum(now.middle)
        left = self.left_sine, self.left_cosine, self.left_sine2, self.left_cosine2
        right = self.right_sine, self.right_cosine, self.right_sine2, self.right_cosine2
        out = []
        for t, angle, (a1, b1, a2, b2) in zip(u, (bend, -bend), (left, right), strict=True):
            phase = self.waves * (angle + self.stretch * t)
            s, c = jnp.sin(phase), jnp.cos(phase)
            wave = a1 * s + b1 * c + 2 * a2 * s * c + b2 * (c * c - s * s)
            out.append(t + wave * t / (1 + t / self.knee_n))
        return tuple(out), memory


class TendonSlack(Effect):
    """Backlash between spool and body: each tendon's tension passes a play of half-width w, and their difference one of
    half-width w_d."""

    id, block, axes = "tendon_slack", "actuation", ("direction", "load", "rate")
    width_n: jax.Array = parameter("N", 0.0, 0.0, 20.0, 0.5)
    net_n: jax.Array = parameter("N", 0.0, 0.0, 20.0, 0.5)

    def start(self, now):
        return tuple((x, 0.0 * x) for x in (*now.u, now.u[0] - now.u[1]))

    def actuate(self, memory, u, now):
        (one, first), (two, second) = (play(x, self.width_n, m) for x, m in zip(u, memory[:2], strict=True))
        net, third = play(one - two, self.net_n, memory[2])
        half = 0.5 * (net - (one - two))
        return (one + half, two - half), (first, second, third)


TURN_RAD = 0.01
"""Tip rotation within which capstan friction turns round [rad]."""


class TendonFriction(Effect):
    """Friction along the routing: joint k feels T exp(∓(ε + μ Σ_{j ≤ k}|q_j| + ν k)), less in the tendon pulled in,
    more in the one paid out, from the entry, from bends (capstan), from guides; and a drag whatever the load.
    At rest it fades, in TURN_RAD over the rate that counts as rest."""

    id, block, axes = "tendon_friction", "actuation", ("direction", "angle", "load")
    mu: jax.Array = parameter("1/rad", 0.0, 0.0, 6.0, 0.2)
    guide: jax.Array = parameter("1", 0.0, 0.0, 0.5, 0.02)
    entry: jax.Array = parameter("1", 0.0, 0.0, 0.9, 0.03)
    drag_n: jax.Array = parameter("N", 0.0, 0.0, 20.0, 0.3)
    still_rad_s: jax.Array = shape("rad/s", 0.02, 1e-4, 10.0, (1e-3, 0.03, 0.3))

    def start(self, now):
        return (0.0 * now.q[0],)

    def load(self, memory, load, now):
        (way,) = memory
        out, wrapped = [], 0.0 * now.q[0]
        for i, q in enumerate(now.middle):
            wrapped = wrapped + jnp.abs(q)
            e = (self.entry + self.mu * wrapped + self.guide * (i + 1.0)) * way
            lost = now.u[0] * jnp.expm1(-e) - now.u[1] * jnp.expm1(e) - self.drag_n * way
            out.append(load[i] + arm(now) * lost)
        return tuple(out)

    def remember(self, memory, now, after):
        moved = sum(b - a for a, b in zip(now.q, after.q, strict=True))
        return (turned(memory[0], moved, TURN_RAD, self.still_rad_s * now.h),)
