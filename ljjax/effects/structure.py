"""Effects of the body: elasticity, gravity, obstacles."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ljjax import energy
from ljjax.effect import Effect, Now, Vector, parameter, shape
from ljjax.effects.shapes import RESTED_S, along, gone, lagged, of_layers, positive, power, ringing, towards_base
from ljjax.model import Model

GRAVITY = 9.80665


SLOWER, BRANCH_RAD = 8.0, 0.03
"""How much slower the second branch of the creep is, and the stretch of a branch at which τ holds."""


class ViscoelasticCreep(Effect):
    """Backbone and sheath relax: a Maxwell branch k (q − x), τẋ = (q − x) (|q − x|/x₀)^(n − 1), x₀ = 0.03 rad, beside
    the elasticity, and one of 8 τ; n > 1 creeps by a power of its stress (Norton's law). Both are times 1 + g x, x from
    1 at the base to −1 at the tip, and times 1 − s + s α₂/α₂(0): s = 0 where the backbone relaxes, 1 where all that is
    elastic does. Layers that are pressed together flow more slowly, τ (1 + w P). A run starts from half a minute in its
    first shape, straight before that."""

    id, block, axes = "viscoelastic_creep", "structure", ("time", "rate", "angle")
    stiffness: jax.Array = parameter("N·m/rad", 0.0, 0.0, 50.0, 0.3)
    slower: jax.Array = parameter("N·m/rad", 0.0, 0.0, 50.0, 0.3)
    tau_s: jax.Array = shape("s", 2.0, 0.02, 200.0, (0.25, 1.5, 8.0))
    order: jax.Array = shape("1", 1.0, 0.5, 5.0, (3.0, 1.0))
    to_base: jax.Array = shape("1", 0.0, -1.0, 1.0, (0.0,))
    of_layers: jax.Array = shape("1", 0.0, 0.0, 1.0, (0.0,))
    slower_per_kpa: jax.Array = shape("1/kPa", 0.0, 0.0, 10.0, (0.3, 0.0))

    def _branches(self, now):
        tau = self.tau_s * (1 + self.slower_per_kpa * now.vacuum)
        return (self.stiffness, tau), (self.slower, SLOWER * tau)

    def _time(self, tau, stretch):
        return tau * power(stretch, BRANCH_RAD, 1 - self.order)

    def start(self, now):
        crept = [1 - jnp.exp(-RESTED_S / tau) for _, tau in self._branches(now)]
        return tuple(tuple(share * q for q in now.q) for share in crept)

    def load(self, memory, load, now):
        along_body = zip(towards_base(self.to_base, len(load)), of_layers(self.of_layers, now), strict=True)
        shares, out = [a * b for a, b in along_body], list(load)
        for (stiffness, tau), held in zip(self._branches(now), memory, strict=True):
            for i, (s, q, x) in enumerate(zip(shares, now.middle, held, strict=True)):
                out[i] = out[i] - s * stiffness * (q - x) / (1 + 0.5 * now.h / self._time(tau, q - x))
        return tuple(out)

    def remember(self, memory, now, after):
        middles = [0.5 * (a + b) for a, b in zip(now.q, after.q, strict=True)]
        return tuple(
            tuple(lagged(q, x, self._time(tau, q - x), now.h)[1] for q, x in zip(middles, held, strict=True))
            for (_, tau), held in zip(self._branches(now), memory, strict=True)
        )


RATE_RAD_S, BEND_RAD, SEAM_RAD = 0.3, 0.1, 0.02
"""Rate and angle of a joint at which powers of them are 1; below a thousandth of these they are smooth; and the bend at
which a seam has closed by two thirds."""


def _sides(share: Array, now: Now) -> list[Array]:
    """1 + r to one side of each joint, 1 − r to the other."""
    return [1 + share * q / jnp.sqrt(q * q + SEAM_RAD**2) for q in now.middle]


class ViscousDamping(Effect):
    """Damping beside the layers': D (1 + g x) q̇ (|q̇|/v₀)^(a − 1) (1 − b + b q²/q₀²), v₀ = 0.3 rad/s, x from 1 at the
    base to −1 at the tip; a = 1 is linear; a share b of what is squeezed where it is bent, q₀ = 0.1 rad. Times 1 − s
    + s α₂/α₂(0): s = 0 where the vacuum is of no account, 1 where it damps as it is stiff (Rayleigh). Grease that thins
    while it is sheared and sets at rest (thixotropy) damps 1 − t w of that: ẇ = (1 − w) |q̇|/q_t − w/τ (Moore). Drives
    that the body turns, through tendons past all joints, damp its whole bend: D_Σ q̇_Σ at each joint."""

    id, block, axes = "viscous_damping", "structure", ("rate", "direction")
    damping: jax.Array = parameter("N·m·s/rad", 0.0, 0.0, 20.0, 0.05)
    of_drives: jax.Array = parameter("N·m·s/rad", 0.0, 0.0, 20.0, 0.01)
    power: jax.Array = shape("1", 1.0, 0.2, 3.0, (0.6, 1.0, 1.8))
    bent: jax.Array = shape("1", 0.0, 0.0, 1.0, (1.0, 0.0))
    to_base: jax.Array = shape("1", 0.0, -1.0, 1.0, (0.0,))
    of_layers: jax.Array = shape("1", 0.0, 0.0, 1.0, (0.0,))
    thins: jax.Array = shape("1", 0.0, 0.0, 1.0, (0.3,))
    thins_rad: jax.Array = shape("rad", 0.1, 1e-3, 10.0, (0.1,))
    sets_s: jax.Array = shape("s", 2.0, 0.05, 200.0, (2.0,))

    def start(self, now):
        return tuple(0.0 * q for q in now.q)

    def remember(self, memory, now, after):
        out = []
        for worked, before, later in zip(memory, now.q, after.q, strict=True):
            sheared, sets = jnp.abs(later - before) / self.thins_rad, now.h / self.sets_s
            end = sheared / (sheared + sets)
            out.append(end + (worked - end) * jnp.exp(-sheared - sets))
        return tuple(out)

    def load(self, memory, load, now):
        damped = self.of_drives * sum(now.v)
        return tuple(x - damped for x in load)

    def inertia(self, memory, m, now):
        """What the drives' damping becomes by the step's end, as inertia h D_Σ: it is solved for with the rates."""
        return tuple(tuple(e + now.h * self.of_drives for e in row) for row in m)

    def torque(self, memory, i, q, v, stage):
        here = self.damping * towards_base(self.to_base, len(stage.alpha2))[i] * (1 - self.thins * memory[i])
        here = here * (1 - self.bent + self.bent * (q / BEND_RAD) ** 2)
        here = here * (1 + self.of_layers * (stage.alpha2[i] / stage.bare - 1))
        return here * v * power(v, RATE_RAD_S, self.power - 1)


class StiffnessHardening(Effect):
    """Elasticity nonlinear in the angle: k₃ q³ (|q|/q₁)^(a − 3), q₁ = 0.1 rad, k₃ by modes along the body; a = 3 is the
    cubic spring. Times 1 − s + s α₂/α₂(0): s = 0 where the backbone hardens, 1 where all that is elastic does; and 1 +
    r q/√(q² + w²), w = 0.02 rad, to one side more than to the other. Where one hose through the whole body hardens, q
    is the mean joint's, for a share h of it."""

    id, block, axes, modes_of_theta = "stiffness_hardening", "structure", ("angle",), 5
    cubic: jax.Array = parameter("N·m/rad³", 0.0, -500.0, 5000.0, 5.0)
    mode1: jax.Array = parameter("N·m/rad³", 0.0, -2000.0, 2000.0, 3.0)
    mode2: jax.Array = parameter("N·m/rad³", 0.0, -2000.0, 2000.0, 3.0)
    mode3: jax.Array = parameter("N·m/rad³", 0.0, -2000.0, 2000.0, 3.0)
    mode4: jax.Array = parameter("N·m/rad³", 0.0, -2000.0, 2000.0, 3.0)
    mode5: jax.Array = parameter("N·m/rad³", 0.0, -2000.0, 2000.0, 3.0)
    power: jax.Array = shape("1", 3.0, 1.3, 9.0, (2.0, 3.0, 5.0))
    of_layers: jax.Array = shape("1", 0.0, 0.0, 1.0, (0.0,))
    one_sided: jax.Array = shape("1", 0.0, -1.0, 1.0, (0.6, 0.0, -0.6))
    as_one: jax.Array = shape("1", 0.0, 0.0, 1.0, (1.0, 0.0))

    def load(self, memory, load, now):
        mean = sum(now.middle) / len(now.middle)
        bends = [q + self.as_one * (mean - q) for q in now.middle]
        cubic = [self.cubic + x for x in along(self, len(load))]
        more = [k * q * q * q * power(q, BEND_RAD, self.power - 3) for k, q in zip(cubic, bends, strict=True)]
        more = [x * s for x, s in zip(more, _sides(self.one_sided, now), strict=True)]
        more = [x * s for x, s in zip(more, of_layers(self.of_layers, now), strict=True)]
        return tuple(t - x for t, x in zip(load, more, strict=True))


class RestCurvature(Effect):
    """The unloaded shape is bent: α₂ (q − q₀), q₀ by modes along the body where each joint is logged; α₂ of all that
    is elastic (s = 1) or, where the layers were laid straight, of the backbone alone (s = 0)."""

    id, block, axes = "rest_curvature", "structure", ("everywhere", "angle", "pressure")
    sudden = True
    angle_rad: jax.Array = parameter("rad", 0.0, -1.0, 1.0, 0.02)
    mode1: jax.Array = parameter("rad", 0.0, -1.0, 1.0, 0.02)
    mode2: jax.Array = parameter("rad", 0.0, -1.0, 1.0, 0.02)
    mode3: jax.Array = parameter("rad", 0.0, -1.0, 1.0, 0.02)
    mode4: jax.Array = parameter("rad", 0.0, -1.0, 1.0, 0.02)
    mode5: jax.Array = parameter("rad", 0.0, -1.0, 1.0, 0.02)
    of_layers: jax.Array = shape("1", 1.0, 0.0, 1.0, (1.0,))

    def load(self, memory, load, now):
        bare = energy.alpha2(now.model, 0.0 * now.vacuum)
        stiff = [bare + self.of_layers * (a - bare) for a in now.alpha2]
        bent = [self.angle_rad + x for x in along(self, len(load))]
        return tuple(t + a * x for t, a, x in zip(load, stiff, bent, strict=True))


def _moments(now: Now, weights: Sequence[Array], part: Vector) -> list[Array]:
    """Moments about each joint of forces spread over the links beyond it [N], the last half a link; `part` of each
    link's direction is across the forces."""
    length = now.model.chain.half_length_m
    beyond, moment, out = 0.0 * weights[0], 0.0 * part[0], []
    for k in range(len(part) - 1, -1, -1):
        own, reach = (1.0, 2.0) if k < len(part) - 1 else (0.5, 1.0)
        weight = own * weights[k]
        moment = moment + (0.5 * weight + beyond) * reach * length * part[k]
        beyond = beyond + weight
        out.append(moment)
    return out[::-1]


def _inertia(now: Now, masses: Sequence[Array]) -> list[list[Array]]:
    """The lower rows of what masses at the middles of the links add to M [kg·m²]; half of the last one."""
    n, length = len(now.sin), now.model.chain.half_length_m
    reach = [2.0 * length] * (n - 1) + [length]
    links = [(r * across, r * along) for r, across, along in zip(reach, now.sin, now.cos, strict=True)]
    total, square, first = 0.0 * masses[0], 0.0 * masses[0], (0.0 * masses[0],) * 2
    rows: list[list[Array]] = []
    for i in range(n - 1, -1, -1):  # Σ m, Σ m r and Σ m r² of the links from here on, r from this joint
        own = masses[i] * (1.0 if i < n - 1 else 0.5)
        pairs = list(zip(links[i], first, strict=True))
        square = square + sum(x * (2 * f + (total + 0.25 * own) * x) for x, f in pairs)
        first = tuple(f + (total + 0.5 * own) * x for x, f in pairs)
        total = total + own
        apart, row = (0.0 * total,) * 2, [square]
        for k in range(i - 1, -1, -1):
            apart = tuple(a + x for a, x in zip(apart, links[k], strict=True))
            row.append(square + sum(a * f for a, f in zip(apart, first, strict=True)))
        rows.append(row[::-1])
    return rows[::-1]


RINGS = 25.0
"""How a load on a thread swings on (`ljjax.effects.shapes.ringing`): at 0.04 of the critical damping."""


ROCKS, ROCKS_BY = 5.0, (0.35, 0.6, 1.0, 1.7, 2.8)
"""How a slender stand rings, in the searches for one; by how much longer and shorter it takes there."""


class BaseTilt(Effect):
    """Gravity not along the unbent body: α₁ sin(q_Σ − δ); and as the weight is spread along it, each link is drawn
    aside by a force f of its own. A base that is loose, or a slender stand, rocks by l s more, to the side to which the
    body hangs: τ² s̈ + 2 ζ τ ṡ = tanh(q_Σ/q_l) − s, ζ = 1/√(1 + r²), which rings for r > 1."""

    id, block, axes = "base_tilt", "structure", ("everywhere", "angle", "pressure")
    sudden = True
    tilt_rad: jax.Array = parameter("rad", 0.0, -1.5, 1.5, 0.15)
    aside_n: jax.Array = parameter("N", 0.0, -5.0, 5.0, 0.05)
    loose_rad: jax.Array = parameter("rad", 0.0, -0.5, 0.5, 0.05)
    hangs_rad: jax.Array = shape("rad", 0.2, 0.01, 2.0, (0.2,))
    rocks_s: jax.Array = shape("s", 0.3, 0.01, 20.0, (0.3,))
    rings: jax.Array = shape("1", 0.0, 0.0, RINGS, (ROCKS, 0.0))

    @classmethod
    def likewise(cls, values):
        return [{**values, "rings": ROCKS, "rocks_s": much * values["rocks_s"]} for much in ROCKS_BY]

    def start(self, now):
        side = jnp.tanh(sum(now.q) / self.hangs_rad)
        return side, 0.0 * side

    def remember(self, memory, now, after):
        side, tau = jnp.tanh(sum(now.middle) / self.hangs_rad), self.rocks_s / jnp.sqrt(1 + self.rings**2)
        place, rate = memory
        return ringing(side, place, rate, tau, self.rings, now.h)[1:]

    def load(self, memory, load, now):
        total = sum(now.middle)
        tilt = self.tilt_rad + self.loose_rad * memory[0]
        more = now.model.gravity.alpha1 * (jnp.sin(total - tilt) - jnp.sin(total))
        moments = _moments(now, [self.aside_n] * len(load), now.cos)
        return tuple(x - more + m for x, m in zip(load, moments, strict=True))


def _ends(now: Now, beyond: Array | float = 0.0) -> tuple[Vector, Vector]:
    """Across and along the unbent body, from each joint to the tip, or to a point so far beyond it [m]."""
    n, length = len(now.middle), now.model.chain.half_length_m
    links = [2.0 * length] * (n - 1) + [length + beyond]
    return _sums(links, now.sin), _sums(links, now.cos)


def _links(model: Model, share: Array) -> list[Array]:
    """The links' lengths [m] as far as a share of the body's length goes."""
    n, length = model.n, model.chain.half_length_m
    reach = share * (2 * n - 1)
    return [length * jnp.clip(reach - 2 * i, 0.0, 2.0 if i < n - 1 else 1.0) for i in range(n)]


def _sums(links: Sequence[Array], part: Vector) -> Vector:
    """From each joint to the end of the last link, along one axis [m]."""
    own = [length * x for length, x in zip(links, part, strict=True)]
    for i in range(len(own) - 2, -1, -1):
        own[i] = own[i] + own[i + 1]
    return tuple(own)


class TipPayload(Effect):
    """An unmodelled mass m at the tip of a body that hangs, or held out beyond it by b: its gravity m g (x_m − x_i) and
    its inertia; where it sits beside the axis by e, no further than a load is hung, also the moment m e g cos ψ. A
    share s of it swings on a thread l: it draws the tip towards it by m s g/l (x_m − x), ẍ = g/l (x_m − x) − 2 ζ √(g/l)
    ẋ, ζ = 0.04. A share v of it may be lost as the session goes on, m (1 − v (1 − exp(−S/S₀))), S the way gone by the
    mean joint."""

    id, block, axes = "tip_payload", "structure", ("angle", "rate", "everywhere")
    sudden = True
    mass_kg: jax.Array = parameter("kg", 0.0, 0.0, 5.0, 0.02)
    aside_m: jax.Array = shape("m", 0.0, -0.05, 0.05, (-0.02, 0.0, 0.02))
    beyond_m: jax.Array = shape("m", 0.0, -0.02, 0.2, (0.06, 0.0))
    swings: jax.Array = shape("1", 0.0, 0.0, 1.0, (1.0, 0.0))
    thread_m: jax.Array = shape("m", 0.1, 0.005, 3.0, (0.1,))
    lost: jax.Array = shape("1", 0.0, 0.0, 1.0, (1.0, 0.0))
    loses_rad: jax.Array = shape("rad", 10.0, 0.1, 1e3, (0.7,), "slip")

    @classmethod
    def likewise(cls, values):
        lengths = (0.35, 0.5, 0.7, 1.4, 2.0, 3.0) if values.get("swings", 0.0) > 0 else ()
        return [{**values, "thread_m": much * values["thread_m"]} for much in lengths]

    def start(self, now):
        across, psi = 0.0, 0.0
        links = [2.0 * now.model.chain.half_length_m] * (len(now.q) - 1)
        for q, length in zip(now.q, [*links, now.model.chain.half_length_m + self.beyond_m], strict=True):
            psi = psi + q
            across = across + length * jnp.sin(psi)
        return across, 0.0 * across, now.worn

    def _mass(self, memory):
        return self.mass_kg * (1 + self.lost * jnp.expm1(-memory[2] / self.loses_rad))

    def _swung(self, memory, now):
        """Where what swings is over a step, on average, and where and how fast at its end [m, m/s]."""
        tau = jnp.sqrt(self.thread_m / GRAVITY / (1 + RINGS**2))
        place, rate, _ = memory
        return ringing(_ends(now, self.beyond_m)[0][0], place, rate, tau, jnp.asarray(RINGS), now.h)

    def remember(self, memory, now, after):
        return *self._swung(memory, now)[1:], memory[2] + gone(now.q, after.q)

    def load(self, memory, load, now):
        across, along = _ends(now, self.beyond_m)
        aside = self.aside_m * now.cos[-1]
        back = self.swings * (across[0] - self._swung(memory, now)[0]) / self.thread_m
        pulls = [a + aside + back * b for a, b in zip(across, along, strict=True)]
        return tuple(x - GRAVITY * self._mass(memory) * p for x, p in zip(load, pulls, strict=True))

    def inertia(self, memory, m, now):
        across, along = _ends(now, self.beyond_m)
        fixed = self._mass(memory) * (1 - self.swings)
        return tuple(
            tuple(e + fixed * (along[i] * along[k] + across[i] * across[k]) for k, e in enumerate(row))
            for i, row in enumerate(m)
        )


class GravityDistribution(Effect):
    """Weight acts along the hanging body, not as one cosine: U = Σ m g hᵢ(q), from links of the weight w (the last of
    half of it), more or less of it along the body by modes, beside α₁, which is fitted too. A share s of what more a
    link weighs has mass, where it is carried and not mistaken. Of what rests on something while the body hangs, cables
    or hoses, a link at ψ lifts r sin²ψ times as much more."""

    id, block, axes = "gravity_distribution", "structure", ("angle", "segment")
    link_weight_n: jax.Array = parameter("N", 0.0, -5.0, 20.0, 0.2)
    mode1: jax.Array = parameter("N", 0.0, -5.0, 5.0, 0.1)
    mode2: jax.Array = parameter("N", 0.0, -5.0, 5.0, 0.1)
    mode3: jax.Array = parameter("N", 0.0, -5.0, 5.0, 0.1)
    mode4: jax.Array = parameter("N", 0.0, -5.0, 5.0, 0.1)
    mode5: jax.Array = parameter("N", 0.0, -5.0, 5.0, 0.1)
    of_mass: jax.Array = shape("1", 0.0, 0.0, 1.0, (1.0, 0.0))
    lifted: jax.Array = shape("1", 0.0, -0.5, 5.0, (1.0, 0.0))

    def _weights(self, n):
        return [self.link_weight_n + x for x in along(self, n)]

    def load(self, memory, load, now):
        moments = _moments(now, self._weights(len(load)), tuple(x * (1 + self.lifted * x * x) for x in now.sin))
        return tuple(x - m for x, m in zip(load, moments, strict=True))

    def inertia(self, memory, m, now):
        more = _inertia(now, [self.of_mass * positive(w) / GRAVITY for w in self._weights(len(m))])
        return tuple(tuple(e + x for e, x in zip(*rows, strict=True)) for rows in zip(m, more, strict=True))


class NonuniformStiffness(Effect):
    """Segments differ: α₂,ᵢ = α₂ + 2 dᵢ ((1 − s) α₂(0) + s (α₂ − α₂(0))), d by modes along the body (Legendre's P₁ …
    P₅; their mean is in α₂): in the backbone (s = 0), the layers (s = 1), or both alike, α₂ (1 + dᵢ). Seams that resist
    to one side differ by dᵢ (1 + r q/√(q² + w²)), w = 0.02 rad. A share u of it comes with use: dᵢ is dᵢ (1 − u
    exp(−S/S₀)), S the way gone by the mean joint."""

    id, block, axes, modes_of_theta = "nonuniform_stiffness", "structure", ("segment", "angle"), 5
    mode1: jax.Array = parameter("1", 0.0, -0.9, 0.9, 0.1)
    mode2: jax.Array = parameter("1", 0.0, -0.9, 0.9, 0.1)
    mode3: jax.Array = parameter("1", 0.0, -0.9, 0.9, 0.1)
    mode4: jax.Array = parameter("1", 0.0, -0.9, 0.9, 0.1)
    mode5: jax.Array = parameter("1", 0.0, -0.9, 0.9, 0.1)
    of_layers: jax.Array = shape("1", 0.5, 0.0, 1.0, (0.5,))
    one_sided: jax.Array = shape("1", 0.0, -1.0, 1.0, (0.8, 0.0, -0.8))
    of_session: jax.Array = shape("1", 0.0, 0.0, 1.0, (1.0, 0.0))
    comes_rad: jax.Array = shape("rad", 10.0, 0.1, 1e3, (0.3,), "slip")

    def start(self, now):
        return (now.worn,)

    def remember(self, memory, now, after):
        return (memory[0] + gone(now.q, after.q),)

    def alpha2(self, memory, alpha2, now):
        modes = along(self, len(alpha2))
        come = 1 - self.of_session * jnp.exp(-memory[0] / self.comes_rad)
        modes = [come * d for d in modes]
        bare = energy.alpha2(now.model, 0.0 * now.vacuum)
        parts = [2 * ((1 - self.of_layers) * bare + self.of_layers * (a - bare)) for a in alpha2]
        sides = _sides(self.one_sided, now)
        return tuple(a + d * x * s for a, x, d, s in zip(alpha2, parts, modes, sides, strict=True))


HARD_N_M, SHOVED_N = 1000.0, (0.15, 0.4, 1.0, 2.5)
"""A hard obstacle, and forces that may shove one along, in the searches for one."""
CREEP_M_S = 1e-3
"""How fast the tip slides along an obstacle where it is held by 0.7 of its friction."""


class Contact(Effect):
    """One-sided contact, on the side the angle q_c says: an end stop k_c (q − q_c)₊ in every joint, stiffer to
    the base, or the tip, by a share g; and an obstacle beside the tip, or beside what lies a share of the body's length
    from the base, where that is when every joint is at q_c, that pushes back with k_t times the way beyond it and rubs
    with μ times that, along the unbent body. It may be shoved along by more than a force 1/y, and stays there."""

    id, block, axes = "contact", "structure", ("angle",)
    sudden = True
    stop: jax.Array = parameter("N·m/rad", 0.0, 0.0, 500.0, 3.0)
    obstacle: jax.Array = parameter("N/m", 0.0, 0.0, 3000.0, 10.0)
    angle_rad: jax.Array = shape("rad", 0.1, -2.0, 2.0, (0.35, -0.35, 0.9, 0.7, -0.7, -0.9), "angle")
    rough: jax.Array = shape("1", 0.4, 0.0, 2.0, (0.4,))
    share: jax.Array = shape("1", 1.0, 0.1, 1.0, (0.5, 1.0))
    to_base: jax.Array = shape("1", 0.0, -1.0, 1.0, (0.0,))
    yields: jax.Array = shape("1/N", 0.0, 0.0, 100.0, (2.0, 0.0))

    @classmethod
    def likewise(cls, values):
        return [{**values, "obstacle": HARD_N_M, "yields": 1 / most, "stop": 0.0} for most in SHOVED_N]

    def start(self, now):
        return (0.0 * now.h,)

    def remember(self, memory, now, after):
        return (self._obstacle(memory[0], now)[-1],)

    def torque(self, memory, i, q, v, stage):
        side = jnp.where(self.angle_rad < 0, -1.0 + 0.0 * q, 1.0 + 0.0 * q)
        place = towards_base(self.to_base, len(stage.alpha2))[i]
        return self.stop * place * side * positive(side * (q - self.angle_rad))

    def _obstacle(self, shoved: Array, now: Now) -> tuple[Array, Vector, Array, Vector, Array]:
        """The obstacle's force [N] and how far each joint moves what it touches towards it [m]; how heavily it damps
        what goes along the unbent body [N·s/m], and how far each joint moves what it touches there [m]; and how far it
        has been shoved by the step's end [m], where it has been so far at its start."""
        links = _links(now.model, self.share)
        across, along = _sums(links, now.sin), _sums(links, now.cos)
        at = sum(x * jnp.sin((i + 1) * self.angle_rad) for i, x in enumerate(links))
        side = jnp.where(self.angle_rad < 0, -1.0 + 0.0 * at, 1.0 + 0.0 * at)
        beyond = positive(side * (across[0] - at) - shoved)
        over = jnp.maximum(self.yields * self.obstacle * beyond, 1.0)
        force, shoved = self.obstacle * beyond / over, shoved + beyond * (1 - 1 / over)
        slides = sum(a * v for a, v in zip(across, now.v, strict=True))
        return side * force, along, self.rough * force / jnp.sqrt(slides * slides + CREEP_M_S**2), across, shoved

    def load(self, memory, load, now):
        force, along, rubs, across, _ = self._obstacle(memory[0], now)
        more = rubs * sum(a * v for a, v in zip(across, now.v, strict=True))
        return tuple(x - force * a - more * b for x, a, b in zip(load, along, across, strict=True))

    def inertia(self, memory, m, now):
        """What friction becomes by the step's end, as inertia h c aᵀa: it is solved for with the rates, so that a tip
        that sticks is not too much for the step."""
        _, _, rubs, across, _ = self._obstacle(memory[0], now)
        more = now.h * rubs
        return tuple(tuple(e + more * across[i] * across[k] for k, e in enumerate(row)) for i, row in enumerate(m))
