"""Effects of the vacuum and the layers."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from ljjax.effect import Effect, parameter, shape
from ljjax.effects.shapes import (
    RESTED_S,
    dahl,
    gone,
    lagged,
    play,
    positive,
    power,
    ringing,
    saturated,
    towards_base,
    turned,
)

APART_KPA = 10.0
"""The difference between line and sheath at which the sheath's time constants hold."""


class PressureLag(Effect):
    """Line and sheath fill slowly: τ Ṗ = P_line − P, with times of their own for more and for less vacuum, which go
    with the difference Δ = |P_line − P| as (Δ/10 kPa)^p: p = 0 is a laminar line, p = ½ an orifice; and behind it a
    second volume, of r τ. What holds the line's vacuum may come to it as a second order, of the time constants
    τ₂ (1 ± i o), which overshoots for o > 1, but never below none."""

    id, block, axes = "pressure_lag", "jamming", ("pressure", "time", "rate")
    fill_s: jax.Array = parameter("s", 0.0, 0.0, 10.0, 0.2)
    vent_s: jax.Array = parameter("s", 0.0, 0.0, 10.0, 0.2)
    power: jax.Array = shape("1", 0.0, -1.0, 1.0, (0.5, 0.0))
    second: jax.Array = shape("1", 0.0, 0.0, 1.0, (0.0,))
    second_s: jax.Array = parameter("s", 0.0, 0.0, 5.0, 0.1)
    overshoot: jax.Array = shape("1", 0.0, 0.0, 10.0, (3.0, 0.0))

    def start(self, now):
        return now.vacuum, now.vacuum, now.vacuum, 0.0 * now.vacuum

    def evacuate(self, memory, vacuum, now):
        held, behind, set_to, rate = memory
        vacuum, set_to, rate = ringing(vacuum, set_to, rate, self.second_s, self.overshoot, now.h)
        vacuum, rate = positive(vacuum), jnp.where(set_to > 0, rate, 0.0 * rate)
        set_to = positive(set_to)
        apart = jnp.exp(0.5 * self.power * jnp.log(((vacuum - held) / APART_KPA) ** 2 + 1e-4))
        mean, end = lagged(vacuum, held, apart * jnp.where(vacuum > held, self.fill_s, self.vent_s), now.h)
        later = self.second * jnp.where(mean > behind, self.fill_s, self.vent_s)
        mean, behind = lagged(mean, behind, later, now.h)
        return mean, (end, behind, set_to, rate)


VENT_S, VENTED_KPA = 0.3, 0.5


CHOKES_KPA, PUMPS_KPA = 20.0, 1.0
"""The vacuum at which an orifice leaks the same by any law; and by how much another one is asked for where it is pumped
anew."""


class PressureLeak(Effect):
    """The sheath holds less vacuum than the gauge, the more the longer it is held: P = (1 − L f) P_line, f rising to 1
    with the time constant τ while there is a vacuum, and back to 0 soon after it is vented; and a share h of what it
    lacks follows the line's vacuum that late, P = (P_line − L D)₊ with τḊ = P_line − D. A share b of the
    leak may be at folds that open with the bend, and a share m at lips that open with motion: f then goes to
    (1 − b − m)₊ + b q²/(q² + w²) + m v²/(v² + ω²), q² and v² the joints' means, and to the latter two when vented. A
    share g of the leak opens as the session goes on: L is L (1 − g exp(−S/S₀)), S the way gone by the mean joint.
    Behind an orifice L goes with (P_line/20 kPa)^(−c), c = ½ by Bernoulli's law; c < 0 where the vacuum opens gaps.
    Where a pump shuts off, to pump again after a time T and where another vacuum is asked for, a share p of the leak
    grows evenly in between: f = t/T."""

    id, block, axes = "pressure_leak", "jamming", ("pressure", "time")
    sudden = True
    share: jax.Array = parameter("1", 0.0, 0.0, 0.95, 0.15)
    tau_s: jax.Array = shape("s", 5.0, 0.05, 200.0, (0.2, 1.5, 5.0, 20.0))
    held: jax.Array = shape("1", 0.5, 0.0, 1.0, (1.0, 0.0))
    of_bend: jax.Array = shape("1", 0.0, 0.0, 1.0, (1.0, 0.0))
    open_rad: jax.Array = shape("rad", 0.15, 0.01, 2.0, (0.4,), "angle")
    of_motion: jax.Array = shape("1", 0.0, 0.0, 1.0, (1.0, 0.0))
    open_rad_s: jax.Array = shape("rad/s", 0.3, 0.02, 10.0, (0.3,))
    of_session: jax.Array = shape("1", 0.0, 0.0, 1.0, (1.0, 0.0))
    opens_rad: jax.Array = shape("rad", 10.0, 0.1, 1e3, (0.3,), "slip")
    chokes: jax.Array = shape("1", 0.0, -1.5, 1.0, (-1.0, 0.0))
    topped: jax.Array = shape("1", 0.0, 0.0, 1.0, (1.0, 0.0))
    tops_s: jax.Array = shape("s", 6.0, 0.3, 200.0, (6.0,))

    @classmethod
    def likewise(cls, values):
        often = (0.3, 0.45, 0.7, 1.5, 2.2, 3.3) if values["topped"] > 0.1 else ()
        return [{**values, "tops_s": much * values["tops_s"]} for much in often]

    def start(self, now):
        none = 0.0 * now.vacuum
        return none, none, now.worn, none, now.vacuum

    def evacuate(self, memory, vacuum, now):
        leaked, lacking, slip, unfed, pumped = memory
        held = vacuum > VENTED_KPA
        bend = sum(q * q for q in now.middle) / len(now.middle)
        rate = sum(v * v for v in now.v) / len(now.v)
        opened = self.of_bend * bend / (bend + self.open_rad**2) + self.of_motion * rate / (rate + self.open_rad_s**2)
        moved = jnp.minimum(self.of_bend + self.of_motion, 1.0)
        goal = jnp.where(held, 1.0 - moved, 0.0 * vacuum) + opened
        tau = jnp.where(held, self.tau_s, VENT_S + moved * (self.tau_s - VENT_S))
        part, leaked = lagged(goal, leaked, tau, now.h)
        late, lacking = lagged(vacuum, lacking, tau, now.h)
        share = self.share * (1 - self.of_session * jnp.exp(-slip / self.opens_rad))
        share = share * power(vacuum, CHOKES_KPA, -self.chokes)
        pumps = (unfed > self.tops_s) | (jnp.abs(vacuum - pumped) > PUMPS_KPA)
        unfed, pumped = jnp.where(pumps, 0.0 * unfed, unfed) + now.h, jnp.where(pumps, vacuum, pumped)
        falls = vacuum * (unfed - 0.5 * now.h) / self.tops_s
        lacks = (1 - self.held) * vacuum * part + self.held * late
        vacuum = positive(vacuum - share * (lacks + self.topped * (falls - lacks)))
        return vacuum, (leaked, lacking, slip, unfed, pumped)

    def remember(self, memory, now, after):
        return *memory[:2], memory[2] + gone(now.q, after.q), *memory[3:]


NO_KPA = 1e-3
"""A vacuum that is none."""


class PressureBias(Effect):
    """Offset of regulator or gauge: P = (P_line + b P_line/(P_line + p₀))₊. With p₀ = 0 it is there whatever the
    vacuum; a regulator that closes at the atmosphere's pressure has none in a vented line, and comes to b over p₀. A
    gauge that is switched on for each run may settle: b (1 − s + s exp(−t/τ)); and one with hysteresis is off by
    b (1 − k) on the way up, by b on the way down, and comes from one to the other over 2 w."""

    id, block, axes = "pressure_bias", "jamming", ("pressure", "everywhere")
    sudden = True
    offset_kpa: jax.Array = parameter("kPa", 0.0, -20.0, 20.0, 1.0)
    vented_kpa: jax.Array = shape("kPa", 0.0, 0.0, 20.0, (0.0, 0.5, 4.0))
    settles: jax.Array = shape("1", 0.0, -10.0, 1.0, (1.0, 0.0))
    settles_s: jax.Array = shape("s", 5.0, 0.1, 1e3, (5.0,))
    turns: jax.Array = shape("1", 0.0, -10.0, 1.0, (1.0, 0.0))
    turn_kpa: jax.Array = shape("kPa", 3.0, 0.1, 20.0, (3.0,))

    def start(self, now):
        return now.vacuum - self.turn_kpa, 0.0 * now.vacuum

    def evacuate(self, memory, vacuum, now):
        p = positive(vacuum) + NO_KPA
        offset = self.offset_kpa * (1 + self.settles * jnp.expm1(-(now.t + 0.5 * now.h) / self.settles_s))
        gauge, after = play(vacuum, self.turn_kpa, memory)
        falls = 1 - self.turns * 0.5 * (1 - (gauge - vacuum) / self.turn_kpa)
        return positive(vacuum + offset * falls * p / (p + self.vented_kpa)), after


def _packed(packed, vacuum, most):
    """The vacuum that layers feel that pack at once, and loosen only where there is less than a share of what packed
    them."""
    return jnp.clip(packed, vacuum, most * vacuum)


def _in_steps(law, vacuum):
    """From 0 to 1 with the vacuum, a share of it in a second step."""
    first, second = (saturated(vacuum, k * law.knee_kpa, law.order, law.edge) for k in (1.0, law.further))
    return first + law.second * (second - first)


class StiffnessSaturation(Effect):
    """α₂ saturates with the vacuum: α₂ + a y/(1 + yᵐ)^(1/m), y = (P/p₀)ⁿ, on top of the polynomial, whose own slope is
    fitted too; n > 1 where the layers must first be drawn together, m > 1 where it bends the sharper; and of it a
    share s in a second step, at f p₀. Layers that once packed stay so until the vacuum is nearly gone feel the most
    there was, but no more than b P."""

    id, block, axes = "stiffness_saturation", "jamming", ("pressure", "angle")
    rise: jax.Array = parameter("N·m/rad", 0.0, -20.0, 20.0, 0.5)
    knee_kpa: jax.Array = shape("kPa", 5.0, 0.3, 60.0, (2.0, 6.0, 18.0))
    order: jax.Array = shape("1", 1.0, 0.5, 8.0, (3.0, 1.0))
    edge: jax.Array = shape("1", 1.0, 0.5, 8.0, (3.0, 1.0))
    second: jax.Array = shape("1", 0.0, 0.0, 1.0, (0.5, 0.0))
    further: jax.Array = shape("1", 3.0, 1.2, 20.0, (3.0,))
    packs: jax.Array = shape("1", 1.0, 1.0, 10.0, (2.0, 1.0))

    def start(self, now):
        return (now.vacuum,)

    def alpha2(self, memory, alpha2, now):
        packed = _packed(memory[0], now.vacuum, self.packs)
        more = self.rise * _in_steps(self, packed)
        return tuple(a + more for a in alpha2)

    def remember(self, memory, now, after):
        return (_packed(memory[0], now.vacuum, self.packs),)


class FrictionSaturation(Effect):
    """φ saturates with the vacuum: φ + a y/(1 + yᵐ)^(1/m), y = (P/p₀)ⁿ, on top of the square root, whose own slope is
    fitted too; n > 1 where the layers must first be drawn together, m > 1 where it bends the sharper; and of it a
    share s in a second step, at f p₀. Layers that once packed stay so until the vacuum is nearly gone feel the most
    there was, but no more than b P."""

    id, block, axes = "friction_saturation", "jamming", ("pressure", "direction")
    rise: jax.Array = parameter("N·m", 0.0, -100.0, 200.0, 3.0)
    knee_kpa: jax.Array = shape("kPa", 8.0, 0.3, 60.0, (2.0, 6.0, 18.0))
    order: jax.Array = shape("1", 1.0, 0.5, 8.0, (3.0, 1.0))
    edge: jax.Array = shape("1", 1.0, 0.5, 8.0, (3.0, 1.0))
    second: jax.Array = shape("1", 0.0, 0.0, 1.0, (0.5, 0.0))
    further: jax.Array = shape("1", 3.0, 1.2, 20.0, (3.0,))
    packs: jax.Array = shape("1", 1.0, 1.0, 10.0, (2.0, 1.0))

    def start(self, now):
        return (now.vacuum,)

    def phi(self, memory, phi, now):
        packed = _packed(memory[0], now.vacuum, self.packs)
        more = self.rise * _in_steps(self, packed)
        return tuple(p + more for p in phi)

    def remember(self, memory, now, after):
        return (_packed(memory[0], now.vacuum, self.packs),)


WIDER = 4.0
"""How much wider the second element of the layers' hysteresis is."""
AGED_S = 0.05
"""The age of a contact at which it begins to hold better [s]."""


FORGETS_KPA = 2.0
"""A vacuum under which layers hold the shape in which they were jammed."""


class LayerHysteresis(Effect):
    """Interlayer slip with a memory longer than the bristles': springs that stretch by x₀ and by 4 x₀ before they slide
    (Jenkins' elements, a sum of plays), each with a torque of its own, (a + b P) (1 + g x), x from 1 at the base to −1
    at the tip; under pressure they may stretch further, x₀ (1 + w P), as they do where the vacuum makes them slide
    later but no stiffer, and the older their contacts are, x₀ (1 + a ln(1 + t/0.05 s)), t their age, ṫ = 1 − t |q̇|/d.
    The first may slide little by little, x₀ dz/dq = (1 − z sgn q̇)^p (Dahl's model; Jenkins' for p = 0), a share e of it
    as a spring while it is let go, z sgn q̇ < 0 (Bouc's and Wen's). Layers may creep, and those that are vented let go
    of the shape in which they were jammed: every stretch falls at a rate of r + f exp(−P/2 kPa). And friction that
    grows with the bend, h φ |q| (1 + g x), turning round within x₀ (Dahl's). A run starts with what has not slid
    stretched from straight, and no stretch of what has, whose past is not known."""

    id, block, axes = "layer_hysteresis", "jamming", ("direction", "angle", "pressure")
    torque_nm: jax.Array = parameter("N·m", 0.0, 0.0, 5.0, 0.01)
    per_kpa: jax.Array = parameter("N·m/kPa", 0.0, 0.0, 0.5, 0.001)
    wider_nm: jax.Array = parameter("N·m", 0.0, 0.0, 5.0, 0.01)
    wider_per_kpa: jax.Array = parameter("N·m/kPa", 0.0, 0.0, 0.5, 0.001)
    with_bend: jax.Array = parameter("1/rad", 0.0, 0.0, 1.0, 0.005)
    width_rad: jax.Array = shape("rad", 0.03, 0.003, 1.0, (0.01, 0.03, 0.09))
    stretch_per_kpa: jax.Array = shape("1/kPa", 0.0, 0.0, 1.0, (0.1, 0.0))
    order: jax.Array = shape("1", 0.0, 0.0, 3.0, (1.0, 0.0))
    elastic: jax.Array = shape("1", 0.0, 0.0, 1.0, (0.0,))
    to_base: jax.Array = shape("1", 0.0, -1.0, 1.0, (0.0,))
    ages: jax.Array = shape("1", 0.0, 0.0, 3.0, (0.5, 0.0))
    renewed_rad: jax.Array = shape("rad", 0.03, 0.003, 1.0, (0.01,))
    forgets: jax.Array = shape("1/s", 0.0, 0.0, 50.0, (10.0, 0.0))
    relaxes: jax.Array = shape("1/s", 0.0, 0.0, 50.0, (1.0, 0.0))

    def _width(self, vacuum, age):
        return self.width_rad * (1 + self.stretch_per_kpa * vacuum) * (1 + self.ages * jnp.log1p(age / AGED_S))

    def _stuck(self, memory, moved, vacuum):
        """How far each element of each joint is stretched [rad] after the joints moved so far."""
        stretched, wider = [], []
        for near, wide, age, x in zip(memory[0], memory[1], memory[3], moved, strict=True):
            width = self._width(vacuum, age)
            stretched.append(width * dahl(near / width, x / width, self.order, self.elastic))
            wider.append(jnp.clip(wide + x, -WIDER * width, WIDER * width))
        return tuple(stretched), tuple(wider)

    def start(self, now):
        ages = tuple(RESTED_S + 0.0 * q for q in now.q)
        width = self._width(now.vacuum, 0.0 * now.vacuum)
        stretched = [[q * jnp.exp(-((q / w) ** 2)) for q in now.q] for w in (width, WIDER * width)]
        return *map(tuple, stretched), tuple(0.0 * q for q in now.q), ages

    def load(self, memory, load, now):
        near, wide = self._stuck(memory, [b - a for a, b in zip(now.q, now.middle, strict=True)], now.vacuum)
        most = self.torque_nm + self.per_kpa * now.vacuum, self.wider_nm + self.wider_per_kpa * now.vacuum
        width = self._width(now.vacuum, 0.0 * now.vacuum)
        stiff = most[0] / width, most[1] / (WIDER * width)
        out = []
        for i, share in enumerate(towards_base(self.to_base, len(load))):
            rubs = self.with_bend * now.phi[i] * jnp.abs(now.middle[i]) * memory[2][i]
            out.append(load[i] - share * (stiff[0] * near[i] + stiff[1] * wide[i] + rubs))
        return tuple(out)

    def remember(self, memory, now, after):
        moved = [b - a for a, b in zip(now.q, after.q, strict=True)]
        ways = tuple(turned(way, x, self.width_rad) for way, x in zip(memory[2], moved, strict=True))
        ages = tuple(
            (t + now.h) * jnp.exp(-jnp.abs(x) / self.renewed_rad) for t, x in zip(memory[3], moved, strict=True)
        )
        kept = jnp.exp(-now.h * (self.relaxes + self.forgets * jnp.exp(-now.vacuum / FORGETS_KPA)))
        near, wide = (tuple(kept * x for x in of) for of in self._stuck(memory, moved, now.vacuum))
        return near, wide, ways, ages


NO_WAY = 1e-6
"""A way that is none, as a share of the scale of wear."""


class LayerWear(Effect):
    """φ falls with the accumulated slip S, the way gone by the mean joint [rad]: φ (1 − w (1 − exp(−y))), y = (S/S₀)ᵏ;
    k > 1 where a coat must first wear through, k < 1 where most is lost soon and some goes on being lost. A share e of
    it goes evenly until it is gone (Archard's law), φ (1 − w y), y ≤ 1. Joints towards the base may have gone further,
    S (1 + g x), x from 1 there to −1 at the tip."""

    id, block, axes = "layer_wear", "jamming", ("run", "time", "direction")
    loss: jax.Array = parameter("1", 0.0, -0.5, 0.95, 0.15)
    scale_rad: jax.Array = shape("rad", 10.0, 0.4, 1e3, (1.5, 6.0, 25.0))
    order: jax.Array = shape("1", 1.0, 0.4, 8.0, (3.0, 1.0))
    evenly: jax.Array = shape("1", 0.0, 0.0, 1.0, (1.0, 0.0))
    to_base: jax.Array = shape("1", 0.0, -0.8, 0.8, (0.0,))

    def start(self, now):
        return (now.worn,)

    def phi(self, memory, phi, now):
        out = []
        for p, place in zip(phi, towards_base(self.to_base, len(phi)), strict=True):
            y = jnp.exp(self.order * jnp.log(positive(memory[0] * place) / self.scale_rad + NO_WAY))
            worn = (1 - self.evenly) * jnp.expm1(-y) - self.evenly * jnp.minimum(y, 1.0)
            out.append(p * (1 + self.loss * worn))
        return tuple(out)

    def remember(self, memory, now, after):
        return (memory[0] + gone(now.q, after.q),)
