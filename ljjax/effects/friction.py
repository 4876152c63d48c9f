"""Effects of friction that the vacuum does not cause."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from ljjax.effect import Effect, parameter, shape
from ljjax.effects.shapes import lagged, positive, power, towards_base, turned

LOAD_N, RUBS_NM = 10.0, 10.0
"""Load at which a friction is the same by any power of it, and φ at which it is whether it goes with φ or not; such a
load on one tendon warms layers by k."""
HARDLY_NM = 0.1
"""A friction that hardly is one: φ₁ of `LoadDependentFriction`."""
BEND_RAD, EVEN_RAD = 0.1, 1e-4
"""Bend at which a tendon presses as much where it is bent as elsewhere, and below which that counts as even [rad]."""


class FrictionAsymmetry(Effect):
    """Loading and unloading rub differently. Where a joint bends further the bristles slip at 1 + a of their bend, and
    their whole torque is 1 + b of what it would be; where it straightens, at 1 − a and 1 − b. Both a and b are times
    |q|/√(q² + w²), so that for a large w they grow with the bend, and turn round within the rotation x₀ (Dahl's); and
    times 1 + r q/√(q² + w²), to one side more than to the other."""

    id, block, axes = "friction_asymmetry", "friction", ("direction", "angle")
    share: jax.Array = parameter("1", 0.0, -0.9, 0.9, 0.15)
    whole: jax.Array = parameter("1", 0.0, -0.9, 0.9, 0.15)
    bent_rad: jax.Array = shape("rad", 0.015, 0.002, 1.0, (0.08, 0.015))
    turn_rad: jax.Array = shape("rad", 0.004, 5e-4, 0.2, (0.02, 0.004))
    one_sided: jax.Array = shape("1", 0.0, -1.0, 1.0, (0.8, 0.0, -0.8))

    def start(self, now):
        return tuple(0.0 * q for q in now.q)

    def slip(self, memory, slip, now):
        return tuple(x * (1 + self.share * further) for x, further in zip(slip, memory, strict=True))

    def phi(self, memory, phi, now):
        return tuple(p * (1 + self.whole * further) for p, further in zip(phi, memory, strict=True))

    def remember(self, memory, now, after):
        """From 1 where a joint bends further to −1 where it straightens."""
        bent = [q / jnp.sqrt(q * q + self.bent_rad * self.bent_rad) for q in after.q]
        return tuple(
            turned(further, b - a, self.turn_rad, goal=x * (1 + self.one_sided * x))
            for further, a, b, x in zip(memory, now.q, after.q, bent, strict=True)
        )


class LoadDependentFriction(Effect):
    """Tendon load presses the layers: φ + (k N(u₁ + u₂) + k_d N(u₁ − u₂)) (1 + g x) (1 − b + b |q|/q₀), N(u) = w
    (w/u₀)^(p − 1), w = (|u| − T₀)₊, u₀ = 10 N, T₀ from where tendons press at all; x from 1 at the base, where the
    loads of all joints add up, to −1 at the tip; a share b presses where a tendon goes round a bend, q₀ = 0.1 rad; and
    times 1 − s + s φ/φ₀, φ₀ = 10 N·m, where load and vacuum press the same layers. Where load presses as more vacuum
    would, whose root friction goes with, a share v of it is √(φ² + φ₁² + 2 φ₀ k N) − √(φ² + φ₁²) instead, φ₁ = 0.1 N·m.
    What is pressed together may come to N with a time constant, and part with another."""

    id, block, axes = "load_dependent_friction", "friction", ("load", "direction", "angle")
    gain: jax.Array = parameter("N·m/N", 0.0, 0.0, 20.0, 0.1)
    of_net: jax.Array = parameter("N·m/N", 0.0, 0.0, 20.0, 0.1)
    power: jax.Array = shape("1", 1.0, 0.2, 3.0, (0.5, 1.0))
    to_base: jax.Array = shape("1", 0.0, -1.0, 1.0, (0.0,))
    bent: jax.Array = shape("1", 0.0, 0.0, 1.0, (1.0, 0.0))
    joins_s: jax.Array = shape("s", 0.0, 0.0, 60.0, (0.3, 0.0))
    parts_s: jax.Array = shape("s", 0.0, 0.0, 60.0, (2.0, 0.0))
    of_layers: jax.Array = shape("1", 0.0, 0.0, 1.0, (1.0, 0.0))
    from_n: jax.Array = shape("N", 0.0, 0.0, 100.0, (0.2, 0.0), "tension")
    as_vacuum: jax.Array = shape("1", 0.0, 0.0, 1.0, (1.0, 0.0))

    def _presses(self, now):
        left, right = now.u
        beyond = [positive(jnp.abs(u) - self.from_n) for u in (left + right, left - right)]
        return [u * power(u, LOAD_N, self.power - 1) for u in beyond]

    def _lagging(self, memory, now):
        """Means over a step of what presses, and what does at its end."""
        goals = zip(self._presses(now), memory, strict=True)
        return [lagged(x, held, jnp.where(x > held, self.joins_s, self.parts_s), now.h) for x, held in goals]

    def start(self, now):
        return tuple(self._presses(now))

    def remember(self, memory, now, after):
        return tuple(end for _, end in self._lagging(memory, now))

    def phi(self, memory, phi, now):
        presses = [mean for mean, _ in self._lagging(memory, now)]
        more = self.gain * presses[0] + self.of_net * presses[1]
        bends = [1 - self.bent + self.bent * jnp.sqrt(q * q + EVEN_RAD**2) / BEND_RAD for q in now.q]
        along = towards_base(self.to_base, len(phi))
        out = []
        for p, s, b in zip(phi, along, bends, strict=True):
            x = more * s * b
            root = jnp.sqrt(p * p + HARDLY_NM**2 + 2 * RUBS_NM * x) - jnp.sqrt(p * p + HARDLY_NM**2)
            plain = x * (1 + self.of_layers * (p / RUBS_NM - 1))
            out.append(p + plain + self.as_vacuum * (root - plain))
        return tuple(out)


SMALL = 1e-5
"""A curve that is none [1/K]."""


class ThermalDrift(Effect):
    """Friction and stiffness drift as the robot warms: times 1 + b W, W = (1 − exp(−c x))/c of x, what ΔT exceeds T₀ by
    (below 0, ΔT), which is x for c = 0 and soon at its end for a large c, as where layers soften at some warmth, T₀;
    W exp(−f x₊) for friction, the most 1/f past T₀ where layers rub most when they are lukewarm. Where no temperature
    is logged ΔT is that of a robot that warms while it runs and cools in between, towards 10 K and back within 600 s,
    10 K (1 − exp(−t/600 s)) in a first run, and c says how much faster it is, or slower. What lies inside may follow
    with a time constant τ, from i ΔT at a run's start. Joints near what warms them may feel more of it: b (1 + g x) for
    friction, x from 1 at the base to −1 at the tip. Of what is viscous in friction, σ₂, as grease thins, by W too. Work
    warms it from a run's start on, more than a temperature that is logged shows: by k c, τ_w ċ = Σ (T/10 N)² − c."""

    id, block, axes = "thermal_drift", "friction", ("run", "time", "direction")
    friction_per_k: jax.Array = parameter("1/K", 0.0, -2.0, 2.0, 0.01)
    stiffness_per_k: jax.Array = parameter("1/K", 0.0, -2.0, 2.0, 0.01)
    viscous_per_k: jax.Array = parameter("1/K", 0.0, -2.0, 2.0, 0.02)
    curve_per_k: jax.Array = shape("1/K", 0.0, -0.3, 3.0, (0.6, 0.0))
    falls_per_k: jax.Array = shape("1/K", 0.0, 0.0, 3.0, (0.2, 0.0))
    from_k: jax.Array = shape("K", 0.0, 0.0, 100.0, (0.4, 0.0), "warmth")
    inside_s: jax.Array = shape("s", 0.0, 0.0, 1e3, (60.0, 0.0))
    kept: jax.Array = shape("1", 1.0, 0.0, 5.0, (1.0,))
    to_base: jax.Array = shape("1", 0.0, -1.0, 1.0, (0.0,))
    worked_k: jax.Array = shape("K", 0.0, 0.0, 1e3, (10.0, 0.0))
    worked_s: jax.Array = shape("s", 30.0, 0.5, 1e3, (30.0,))

    def start(self, now):
        return self.kept * now.warm, 0.0 * now.warm

    def _inside(self, memory, now):
        """What is warm inside, on average over a step [K], and the memory at its end."""
        mean, warm = lagged(now.warm, memory[0], self.inside_s, now.h)
        work = (now.u[0] / LOAD_N) ** 2 + (now.u[1] / LOAD_N) ** 2
        worked, carried = lagged(work, memory[1], self.worked_s, now.h)
        return mean + self.worked_k * worked, (warm, carried)

    def remember(self, memory, now, after):
        return self._inside(memory, now)[1]

    def _past(self, warm):
        return positive(warm - self.from_k) - positive(-warm)

    def _warmed(self, warm):
        c = self.curve_per_k
        c = jnp.where(jnp.abs(c) > SMALL, c, SMALL + c)  # so that its derivative is there at 0
        return -jnp.expm1(-c * self._past(warm)) / c

    def alpha2(self, memory, alpha2, now):
        return tuple(a * (1 + self.stiffness_per_k * self._warmed(self._inside(memory, now)[0])) for a in alpha2)

    def phi(self, memory, phi, now):
        warm = self._inside(memory, now)[0]
        warmed = self._warmed(warm) * jnp.exp(-self.falls_per_k * positive(self._past(warm)))
        return tuple(
            p * (1 + self.friction_per_k * place * warmed)
            for p, place in zip(phi, towards_base(self.to_base, len(phi)), strict=True)
        )

    def torque(self, memory, i, q, v, stage):
        warm = self._warmed(memory[0] + self.worked_k * memory[1])
        return stage.phi[i] * stage.friction.sigma2 * v * self.viscous_per_k * warm
