"""Effects between the command and the body: motors, spools, tendons."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from ljjax.effect import Effect, Now, Vector, parameter, shape
from ljjax.effects.shapes import (
    arm,
    bounded,
    lagged,
    play,
    positive,
    power,
    pursued,
    ringing,
    sawtooth,
    towards_base,
    turned,
    wave,
)


class ActuatorDelay(Effect):
    """The tensions follow their commands after a transport delay: T(t) = T_cmd(t − d). Where commands are read at a
    beat and held, or buffers fill and are emptied, it grows in between: T_cmd(t − d) − d r s Ṫ_cmd, s the sawtooth from
    −½ to ½ over the time T, at 0 at −φ T; r = 2 for a command held. Each tendon has a drive of its own: d (1 ± δ), to
    first order in δ, as is what it is more, or less, in one run than in others."""

    id, block, axes = "actuator_delay", "actuation", ("rate", "load", "time")
    sudden = True
    delay_seconds: jax.Array = parameter("s", 0.0, 0.0, 0.4, 0.03)
    drift: jax.Array = shape("1", 0.0, -2.0, 2.0, (0.0, 1.0), "drift")
    reset_s: jax.Array = shape("s", 5.0, 0.05, 1e3, (1.0,), "reset_s")
    phase: jax.Array = shape("1", 0.0, -10.0, 10.0, (1.0,), "phase")
    difference: jax.Array = shape("1", 0.0, -1.0, 1.0, (0.0,))

    def start(self, now):
        return now.u

    def delay_s(self):
        return self.delay_seconds

    def actuate(self, memory, u, now):
        later = self.more + self.drift * sawtooth((now.t + 0.5 * now.h) / self.reset_s + self.phase)
        shares = later + self.difference, later - self.difference
        late = [self.delay_seconds * share / now.h for share in shares]
        return tuple(x - part * (x - before) for x, before, part in zip(u, memory, late, strict=True)), u


SHARPLY = 5.0
"""How sharply a drive comes to turn about its deadband, over that."""


class ActuatorDeadband(Effect):
    """Stiction of gearbox and spool eats a share s ± δ of each tension's first d newtons, each tendon with a motor of
    its own: T − s T (1 + (T/d)^p)^(−1/p), (T − d)₊ for s = 1 and a sharp edge, p → ∞. Where what turns rubs less the
    more it is drawn, what is eaten falls as exp(−f (T/d − 1)₊); where load presses the teeth it is 1 + g T/10 N of
    that; and while a tendon is let go, after a fall by some ΔT, it is 1 − r of it, r = 2 where what rubs then holds the
    tension up."""

    id, block, axes = "actuator_deadband", "actuation", ("load", "everywhere", "angle")
    share: jax.Array = parameter("1", 0.0, 0.0, 1.0, 0.5)
    difference: jax.Array = parameter("1", 0.0, -0.5, 0.5, 0.2)
    band_n: jax.Array = shape("N", 1.0, 0.01, 50.0, (0.02, 0.05, 0.12), "tension")
    edge: jax.Array = shape("1", 8.0, 1.0, 8.0, (2.0, 8.0))
    fades: jax.Array = shape("1", 0.0, 0.0, 3.0, (0.5, 0.0))
    thins: jax.Array = shape("1", 0.0, 0.0, 1.0, (0.6, 0.0))
    thins_s: jax.Array = shape("s", 2.0, 0.05, 100.0, (2.0,))
    let_go: jax.Array = shape("1", 0.0, 0.0, 2.0, (1.0, 0.0))
    turn_n: jax.Array = shape("N", 0.5, 0.01, 20.0, (0.5,))
    pressed: jax.Array = shape("1", 0.0, 0.0, 0.5, (0.0,))

    def start(self, now):
        return tuple((0.0 * t, 1.0 + 0.0 * t, t) for t in now.u)

    def actuate(self, memory, u, now):
        out, after = [], []
        shares = self.share + self.difference, self.share - self.difference
        for t, (worked, way, last), share in zip(u, memory, shares, strict=True):
            turns = 0.5 + 0.5 * jnp.tanh(SHARPLY * (t / self.band_n - 1))
            mean, end = lagged(turns, worked, self.thins_s * (2 - turns), now.h)
            part = jnp.exp(-self.fades * jnp.maximum(t / self.band_n - 1, 0.0)) * (1 - self.thins * mean)
            way = turned(way, t - last, self.turn_n)
            part = part * (1 - 0.5 * self.let_go * (1 - way)) * (1 + self.pressed * t / LOAD_N)
            x = t - share * part * bounded(t, self.band_n, self.edge)
            out.append(jnp.where(t > 0, positive(x), x))
            after.append((end, way, t))
        return tuple(out), tuple(after)


CLIMBS, CLIMBS_AT_RAD = -0.1, (0.02, 0.05, 0.1, 0.2)
"""How much of a tension a second layer takes, and where it begins, in the searches for one."""


LOAD_N, HOTTEST = 10.0, 0.3
"""The tension whose current is that by which heat and load are counted; the least 1 + h c there is."""
LEAST = 0.05
"""The share of a limit that is left of it, however much a motor has carried, and of a spool's radius."""


class ActuatorGain(Effect):
    """The torque constant or the spool's radius is wrong: (1 + (e ± d) (1 − s + s c) ± w q_Σ) T_cmd, each tendon with a
    motor of its own; w where what is wound up makes the spool wider, or narrower (q_Σ: by how much the tendon is wound
    up), x/(1 − r x) of x = ±w q_Σ, as a torque over a radius goes for r = 1; and l (1 + tanh((±q̄ − q_l ∓ δ)/q_w))/2
    more where it climbs onto a second layer at a mean joint's angle of q_l. A share s of the error comes after a run's
    start, as where drives warm: τ ċ = 1 − c, c = 0 at first; a share b goes with the load, T/10 N, as where a motor's
    iron saturates. Copper that its own current warms carries less at a given voltage, a gear that load warms loses
    less: 1/(1 + (h ± d_h) c) of it is left, τ ċ = (T/10 N)² − c."""

    id, block, axes = "actuator_gain", "actuation", ("load", "everywhere", "angle")
    sudden = True
    error: jax.Array = parameter("1", 0.0, -0.6, 1.5, 0.1)
    difference: jax.Array = parameter("1", 0.0, -0.4, 0.4, 0.05)
    winding: jax.Array = parameter("1/rad", 0.0, -1.0, 1.0, 0.1)
    layer: jax.Array = parameter("1", 0.0, -0.6, 0.6, 0.1)
    heat: jax.Array = parameter("1", 0.0, -0.5, 1.0, 0.01)
    heat_difference: jax.Array = parameter("1", 0.0, -0.5, 0.5, 0.005)
    layer_rad: jax.Array = shape("rad", 0.0, -1.0, 1.0, (0.0, 0.4), "angle")
    layer_over_rad: jax.Array = shape("rad", 0.02, 1e-3, 0.5, (0.02,))
    layer_apart_rad: jax.Array = shape("rad", 0.0, -0.5, 0.5, (0.0,))
    radial: jax.Array = shape("1", 0.0, 0.0, 1.0, (0.0,))
    with_load: jax.Array = shape("1", 0.0, -1.0, 1.0, (1.0, 0.0))
    warms: jax.Array = shape("1", 0.0, 0.0, 1.0, (1.0, 0.0))
    warms_s: jax.Array = shape("s", 5.0, 0.1, 200.0, (5.0,))
    heats_s: jax.Array = shape("s", 5.0, 0.1, 200.0, (5.0,))

    @classmethod
    def likewise(cls, values):
        alone = dict.fromkeys(cls.sizes(), 0.0) | {"warms": 0.0, "layer": CLIMBS, "layer_apart_rad": 0.0}
        return [{**values, **alone, "layer_rad": x, "layer_over_rad": 0.3 * x} for x in CLIMBS_AT_RAD]

    def start(self, now):
        return 0.0 * now.h, *(0.0 * t for t in now.u)

    def actuate(self, memory, u, now):
        mean, end = lagged(1.0 + 0.0 * now.h, memory[0], self.warms_s, now.h)
        there, wound = 1 - self.warms * (1 - mean), self.winding * sum(now.middle)
        angle = sum(now.middle) / len(now.middle) - self.layer_apart_rad
        left, right = (jnp.tanh((x - self.layer_rad) / self.layer_over_rad) for x in (angle, -angle))
        out, carried = [], []
        for side, climbs, t, held in zip((1, -1), (left, right), u, memory[1:], strict=True):
            error, heat = self.error + side * self.difference, self.heat + side * self.heat_difference
            error = error * there * (1 - self.with_load + self.with_load * t / LOAD_N)
            wider = side * wound / jnp.maximum(1 - self.radial * side * wound, LEAST)
            hot, after = lagged((t / LOAD_N) ** 2, held, self.heats_s, now.h)
            gain = 1 + error + wider + self.layer * (1 + climbs) / 2
            out.append(t * gain / jnp.maximum(1 + heat * hot, HOTTEST))
            carried.append(after)
        return tuple(out), (end, *carried)


class ActuatorSaturation(Effect):
    """A share s ± δ of each tension stays below a limit L, its edge sharp or smooth, each tendon with a motor of its
    own: T − s T (1 − (1 + (T/L)^p)^(−1/p)), where both drives have one supply by T plus a part r of the other tension.
    The limit folds back with what the motor has carried of late: L (1 − f (c − c₀)₊), but not below k L, the load that
    it may carry for good; τ ċ = y (1 − x + x y) − c, y = T/L, x = 1 where heat is counted. A loop that winds up at the
    limit must unwind before it lets go: T is T + w there, τ_w ẇ = T − L, 0 ≤ w ≤ m L."""

    id, block, axes = "actuator_saturation", "actuation", ("load", "angle")
    share: jax.Array = parameter("1", 0.0, 0.0, 1.0, 0.5)
    difference: jax.Array = parameter("1", 0.0, -0.5, 0.5, 0.2)
    limit_n: jax.Array = shape("N", 10.0, 0.05, 1e3, (0.45, 0.65, 0.85), "tension")
    edge: jax.Array = shape("1", 8.0, 1.0, 16.0, (2.0, 8.0))
    fold: jax.Array = shape("1", 0.0, 0.0, 2.0, (1.0, 0.0))
    fold_s: jax.Array = shape("s", 1.0, 0.05, 60.0, (1.0,))
    fold_from: jax.Array = shape("1", 0.0, 0.0, 1.0, (0.0,))
    fold_to: jax.Array = shape("1", LEAST, LEAST, 1.0, (LEAST,))
    by_heat: jax.Array = shape("1", 0.0, 0.0, 1.0, (0.0,))
    shared: jax.Array = shape("1", 0.0, 0.0, 1.0, (1.0, 0.0))
    windup: jax.Array = shape("1", 0.0, 0.0, 3.0, (0.5, 0.0))
    winds_s: jax.Array = shape("s", 0.5, 0.01, 60.0, (0.5,))

    def start(self, now):
        none = tuple(0.0 * t for t in now.u)
        return none, none

    def actuate(self, memory, u, now):
        shares = self.share + self.difference, self.share - self.difference
        out, carried, wound = [], [], []
        for s, t, other, c, w in zip(shares, u, u[::-1], *memory, strict=True):
            part = 1 - self.fold * positive(c - self.fold_from)
            limit = self.limit_n * jnp.where(part > self.fold_to, part, self.fold_to + 0.0 * part)
            drawn = t + self.shared * other
            passed = bounded(drawn + w, limit, self.edge) / jnp.maximum(drawn, 1e-3)
            out.append(t - s * t * (1 - passed))
            y = out[-1] / self.limit_n
            carried.append(lagged(y * (1 - self.by_heat + self.by_heat * y), c, self.fold_s, now.h)[1])
            most = self.windup * self.limit_n
            wound.append(jnp.minimum(positive(w + now.h / self.winds_s * (drawn - limit)), most))
        return tuple(out), (tuple(carried), tuple(wound))


APART_N = 5.0
"""The difference between commanded and present tension at which the lag's time constant holds."""


class ActuatorLag(Effect):
    """The current or tension loop lags: τ Ṫ = T_cmd − T, and after it one of second order (loop, filter, springy
    tendon), of the time constants τ₂ (1 ± i r), which rings for r > 1. Where the loop's rate is limited τ goes with
    (|T_cmd − T|/5 N)^p, to a rate of its own for p = 1. A share s of the tension may come later, with a time constant
    of c τ, as where flux diffuses into iron or a tendon creeps; and where the tension falls τ is 1 + f of it, as a
    drive may let go more slowly than it winds. From an elastic tendon the body takes, and gives, what the loop has not
    wound yet: τ Ṫ = T_cmd − T − τ k q̇_Σ. Each tendon has a motor of its own: τ and τ₂ are 1 ± d of theirs. Exact for
    commands that hold over a step."""

    id, block, axes = "actuator_lag", "actuation", ("rate", "load", "time")
    tau_s: jax.Array = parameter("s", 0.0, 0.0, 1.0, 0.05)
    second_s: jax.Array = parameter("s", 0.0, 0.0, 1.0, 0.03)
    ring: jax.Array = shape("1", 0.0, 0.0, 10.0, (2.0, 0.0))
    power: jax.Array = shape("1", 0.0, 0.0, 1.0, (1.0, 0.0))
    difference: jax.Array = shape("1", 0.0, -1.0, 1.0, (0.0,))
    later: jax.Array = shape("1", 0.0, 0.0, 1.0, (0.3, 0.0))
    later_by: jax.Array = shape("1", 8.0, 1.0, 100.0, (8.0,))
    falling: jax.Array = shape("1", 0.0, -0.9, 10.0, (1.0, 0.0))
    elastic_n: jax.Array = shape("N/rad", 0.0, 0.0, 40.0, (10.0, 0.0))

    def start(self, now):
        return now.u, now.u, tuple(0.0 * x for x in now.u), now.u

    def actuate(self, memory, u, now):
        means, kept, bends = [], [], sum(now.v)
        shares, sides = (1 + self.difference, 1 - self.difference), (bends, -bends)
        for x, share, side, first, second, rate, slow in zip(u, shares, sides, *memory, strict=True):
            tau = share * self.tau_s * jnp.where(x < first, 1 + self.falling, 1.0)
            goal = x - tau * self.elastic_n * side
            quick, end = map(positive, pursued(goal, first, tau, self.power, APART_N, now.h))
            late, slow = lagged(x, slow, tau * self.later_by, now.h)
            once = quick + self.later * (late - quick)
            mean, held, rate = ringing(once, second, rate, share * self.second_s, self.ring, now.h)
            means.append(mean)
            kept.append((end, held, rate, slow))
        return tuple(means), tuple(zip(*kept, strict=True))


COGGING_N, SLACK_N = 10.0, 0.01
"""Tension at which a ripple is the same by any power of it, and one below which it no longer falls with it."""


class ActuatorRipple(Effect):
    """Ripple over each spool's angle φ, which goes with the bend and with the stretch c of the tendon, ±q_Σ + c T:
    T + A E Σₖ aₖ sin(k w φ) + bₖ cos(k w φ), k = 1, 2, each tendon with a phase of its own; A = T₀ (T/T₀)^p, T₀ = 10 N,
    is the tension itself (ripple of the torque, p = 1) or the same for all tensions (cogging, p = 0). A wheel of N
    teeth off its centre pulls more on one side of its turn, A (o_s sin(w φ/N) + o_c cos(w φ/N)), and ripples more,
    E = 1 + e_s sin(w φ/N) + e_c cos(w φ/N). Of what is slow a loop may take out a share s: of all ripple r there is
    r − s c left, τ ċ = r − c. A tendon never pushes."""

    id, block, axes = "actuator_ripple", "actuation", ("angle", "load")
    left_sine: jax.Array = parameter("1", 0.0, -0.9, 0.9, 0.05)
    left_cosine: jax.Array = parameter("1", 0.0, -0.9, 0.9, 0.05)
    left_sine2: jax.Array = parameter("1", 0.0, -0.9, 0.9, 0.03)
    left_cosine2: jax.Array = parameter("1", 0.0, -0.9, 0.9, 0.03)
    right_sine: jax.Array = parameter("1", 0.0, -0.9, 0.9, 0.05)
    right_cosine: jax.Array = parameter("1", 0.0, -0.9, 0.9, 0.05)
    right_sine2: jax.Array = parameter("1", 0.0, -0.9, 0.9, 0.03)
    right_cosine2: jax.Array = parameter("1", 0.0, -0.9, 0.9, 0.03)
    left_once_sine: jax.Array = parameter("1", 0.0, -0.9, 0.9, 0.03)
    left_once_cosine: jax.Array = parameter("1", 0.0, -0.9, 0.9, 0.03)
    right_once_sine: jax.Array = parameter("1", 0.0, -0.9, 0.9, 0.03)
    right_once_cosine: jax.Array = parameter("1", 0.0, -0.9, 0.9, 0.03)
    waves: jax.Array = shape("1/rad", 15.0, 2.0, 200.0, (5.0, 8.0, 12.0, 18.0, 27.0, 40.0), "waves")
    stretch: jax.Array = shape("rad/N", 0.01, 1e-4, 0.3, (0.006, 0.018))
    power: jax.Array = shape("1", 1.0, 0.0, 1.0, (0.5,))
    teeth: jax.Array = shape("1", 10.0, 3.0, 50.0, (10.0,))
    left_runout_sine: jax.Array = shape("1", 0.0, -0.9, 0.9, (0.0,))
    left_runout_cosine: jax.Array = shape("1", 0.0, -0.9, 0.9, (0.0,))
    right_runout_sine: jax.Array = shape("1", 0.0, -0.9, 0.9, (0.0,))
    right_runout_cosine: jax.Array = shape("1", 0.0, -0.9, 0.9, (0.0,))
    held: jax.Array = shape("1", 0.0, 0.0, 1.0, (0.0,))
    held_s: jax.Array = shape("s", 0.05, 0.002, 5.0, (0.05,))

    @classmethod
    def likewise(cls, values):
        up = {n: values[n + "2"] for n in values if n + "2" in values} | {n: 0.0 for n in values if n.endswith("2")}
        return [{**values, **up, "waves": 2 * values["waves"], "teeth": 2 * values["teeth"]}]

    def _ripple(self, u, now):
        """What ripples add to each tension [N]."""
        bend = sum(now.middle)
        left = self.left_sine, self.left_cosine, self.left_sine2, self.left_cosine2
        right = self.right_sine, self.right_cosine, self.right_sine2, self.right_cosine2
        once = (
            (self.left_once_sine, self.left_once_cosine, self.left_runout_sine, self.left_runout_cosine),
            (self.right_once_sine, self.right_once_cosine, self.right_runout_sine, self.right_runout_cosine),
        )
        out = []
        for t, angle, shares, (a, b, more_a, more_b) in zip(u, (bend, -bend), (left, right), once, strict=True):
            turn = self.waves * (angle + self.stretch * t)
            sine, cosine = jnp.sin(turn / self.teeth), jnp.cos(turn / self.teeth)
            share = a * sine + b * cosine + (1 + more_a * sine + more_b * cosine) * wave(turn, *shares)
            size = COGGING_N * jnp.exp(0.5 * self.power * jnp.log((t * t + SLACK_N**2) / COGGING_N**2))
            out.append(size * share)
        return tuple(out)

    def start(self, now):
        return self._ripple(now.u, now)

    def actuate(self, memory, u, now):
        out, after = [], []
        for t, ripple, slow in zip(u, self._ripple(u, now), memory, strict=True):
            mean, end = lagged(ripple, slow, self.held_s, now.h)
            more, all_of_it = ripple - self.held * mean, positive(t)
            out.append(t + jnp.where(more >= -all_of_it, more, -all_of_it))
            after.append(end)
        return tuple(out), tuple(after)


PAYS_OUT_S, EDGE, WOUND_N, TAUT_N = 0.1, 0.2, 10.0, 0.01
"""In what time a slack tendon pays out all its slack; the share of the tension at which it begins to over which that
rate changes; the tension that winds at the stated rate [N], and at which a play in the length is one of the tension;
what a slack cable still has [N]."""


class TendonSlack(Effect):
    """Backlash between spool and body: each tendon's tension passes a play of half-width w (1 ± d) of its own, and
    their difference one of half-width w_d. A cable that is the stiffer the tauter it is has play in its length, that of
    T_p (T/T_p)^p, T_p = 10 N. And below the tension T_s a tendon goes slack, within tenths of a second by
    what takes l (1 ± d) to wind up at 10 N, at other tensions in proportion to T/(T + T_w), as a motor's speed; of what
    is slack by s the body feels T exp(−s/τ), as cable tightens little by little. Cable that the body lets go of by
    bending to the tendon's side is slack too, f a radian, half of it at T_s, up to m (1 ± d), and is taken up by
    bending back."""

    id, block, axes = "tendon_slack", "actuation", ("direction", "load", "rate")
    width_n: jax.Array = parameter("N", 0.0, 0.0, 20.0, 0.5)
    net_n: jax.Array = parameter("N", 0.0, 0.0, 20.0, 0.5)
    length: jax.Array = shape("1", 1.0, 0.3, 1.0, (0.5, 1.0))
    slack_s: jax.Array = parameter("s", 0.0, 0.0, 2.0, 0.02)
    slack_n: jax.Array = shape("N", 1.0, 0.05, 20.0, (1.0, 3.0))
    freed: jax.Array = parameter("s/rad", 0.0, 0.0, 5.0, 0.05)
    most_s: jax.Array = shape("s", 2.0, 0.001, 2.0, (0.1,))
    feels_s: jax.Array = shape("s", 0.005, 1e-4, 0.5, (0.02,))
    winds_n: jax.Array = shape("N", 5.0, 0.01, 100.0, (3.0,))
    difference: jax.Array = shape("1", 0.0, -1.0, 1.0, (0.0,))

    def _shares(self):
        return 1 + self.difference, 1 - self.difference

    def _slack(self, tension: jax.Array) -> jax.Array:
        """How slack a tendon is to be: 1 well below T_s, ½ at it, 0 well above."""
        return jax.nn.sigmoid((self.slack_n - tension) / (EDGE * self.slack_n))

    def start(self, now):
        plays = tuple((x, 0.0 * x) for x in (*map(self._length, now.u), now.u[0] - now.u[1]))
        return (*plays, *(s * self.slack_s * self._slack(x) for s, x in zip(self._shares(), now.u, strict=True)))

    def _length(self, x: jax.Array) -> jax.Array:
        """What the play is of, at a tension."""
        return WOUND_N * jnp.exp(self.length * jnp.log((positive(x) + TAUT_N) / WOUND_N))

    def _tension(self, of: jax.Array) -> jax.Array:
        return WOUND_N * jnp.exp(jnp.log(jnp.maximum(of, 1e-3 * TAUT_N) / WOUND_N) / self.length) - TAUT_N

    def _felt(self, held: jax.Array, wound: jax.Array, rest: jax.Array) -> jax.Array:
        """The mean over a step of exp(−s/τ), s wound up by so much from what is held, but no further than to rest."""
        some = wound > 1e-3 * self.feels_s
        by, before = jnp.where(some, wound, 1.0 + 0.0 * wound), jnp.exp(-held / self.feels_s)
        down = rest + positive(held - by - rest)
        after = jnp.exp(-down / self.feels_s)
        over = (1 - (held - down) / by) * after + self.feels_s / by * (after - before)
        return jnp.where(some & (held > rest), over, before)

    def actuate(self, memory, u, now):
        *plays, left, right = memory
        taut, slack, bends = [], [], sum(now.v)
        for x, share, held, rate in zip(u, self._shares(), (left, right), (bends, -bends), strict=True):
            free = now.h * self.freed * jnp.where(rate > 0, rate / (1 + (x / self.slack_n) ** 2), rate)
            let, most = held + free, jnp.maximum(held, share * self.most_s)
            held = jnp.where(((held > 0) | (rate > 0)) & (let >= 0), jnp.minimum(let, most), 0.0 * held)
            rest = jnp.where(x > self.slack_n, 0.0 * x, share * self.slack_s)
            wound = now.h * positive(x) / (positive(x) + self.winds_n) * (1 + self.winds_n / WOUND_N)
            paid = now.h / PAYS_OUT_S * self._slack(x) * share * self.slack_s
            taut.append(x * self._felt(held, wound, rest))
            slack.append(jnp.where(held > rest, rest + positive(held - wound - rest), jnp.minimum(held + paid, rest)))
        passed = zip(taut, self._shares(), plays[:2], strict=True)
        (one, first), (two, second) = (play(self._length(x), s * self.width_n, m) for x, s, m in passed)
        one, two = self._tension(one), self._tension(two)
        net, third = play(one - two, self.net_n, plays[2])
        half = 0.5 * (net - (one - two))
        return (one + half, two - half), (first, second, third, *slack)


PRESSED_N, PRESSED_RAD, MOST = 10.0, 0.1, 3.0
"""Tension and bend at which a lining rubs the same by any power of what presses it; and the largest exponent, which
soft linings have at small tensions."""
LEAST_N, LEAST_HOLD = 0.05, 1e-3
"""What counts as no tension, and as no hold on it (a power of e)."""


def _gained(exponent: jax.Array) -> jax.Array:
    """What rubbing adds to a tension, as a share of it."""
    return jnp.expm1(jnp.minimum(exponent, MOST))


def _pull(now: Now) -> Vector:
    """Logarithms of the tensions."""
    return tuple(jnp.log(jnp.maximum(u, LEAST_N)) for u in now.u)


class TendonFriction(Effect):
    """Friction along the routing: joint k feels T exp(∓(s₀ (ε + β|q_Σ|) + Σ_{j ≤ k} s_j (μ w_j |q_j| + ν))), less in
    the tendon pulled in, more in the one paid out, from the entry, from a liner that bends with the body, from bends
    (capstan), from guides; and a drag s₀ whatever the load. s_j is the way the tendon last slid past joint j, by Σ_{k ≥
    j} q_k and, for a share a, by Σ q_k, all of it, as s₀ is. Each tendon has a channel of its own: ε ± δ_ε, μ ± δ_μ. A
    soft lining rubs by a power of what presses it, an uneven one by its place: w_j = (T |q_j|/T₀ q₀)^(p − 1) (1 + g
    x_j), with T₀ = 10 N, q₀ = 0.1 rad, and x from 1 at the base to −1 at the tip. It turns round within some rotation,
    over which tendon and liner stretch, and, for a share h, with the tension: a cable that sticks hands on what it did,
    until what is lost on the way changes by no more than friction can hold, joint by joint, each tendon by itself. At
    rest it fades, in that rotation over the rate that counts as rest."""

    id, block, axes = "tendon_friction", "actuation", ("direction", "angle", "load")
    mu: jax.Array = parameter("1/rad", 0.0, 0.0, 6.0, 0.2)
    guide: jax.Array = parameter("1", 0.0, 0.0, 0.5, 0.02)
    entry: jax.Array = parameter("1", 0.0, 0.0, 0.9, 0.03)
    liner: jax.Array = parameter("1/rad", 0.0, 0.0, 3.0, 0.05)
    drag_n: jax.Array = parameter("N", 0.0, 0.0, 20.0, 0.3)
    mu_difference: jax.Array = parameter("1/rad", 0.0, -3.0, 3.0, 0.1)
    entry_difference: jax.Array = parameter("1", 0.0, -0.5, 0.5, 0.02)
    turn_rad: jax.Array = shape("rad", 0.01, 0.001, 0.5, (0.08, 0.01))
    still_rad_s: jax.Array = shape("rad/s", 0.02, 1e-4, 10.0, (1e-3, 0.03, 0.3))
    power: jax.Array = shape("1", 1.0, 0.3, 2.0, (0.7, 1.0))
    to_base: jax.Array = shape("1", 0.0, -1.0, 1.0, (0.0,))
    held: jax.Array = shape("1", 0.0, 0.0, 1.0, (0.0, 1.0))
    as_one: jax.Array = shape("1", 0.0, 0.0, 1.0, (1.0, 0.0))

    def start(self, now):
        still = tuple(0.0 * q for q in now.q)
        return still, still, _pull(now)

    def _lost(self, now):
        """What friction can hold of either tendon's tension past each joint, as a power of e; the first joint's entry
        by itself."""
        entered = self.entry + self.liner * jnp.abs(sum(now.middle))
        soft = [power(u, PRESSED_N, self.power - 1) for u in now.u]
        of_place = towards_base(self.to_base, len(now.q))
        bends = [
            jnp.abs(q) * power(q, PRESSED_RAD, self.power - 1) * place
            for q, place in zip(now.middle, of_place, strict=True)
        ]
        left = [self.guide + (self.mu + self.mu_difference) * bend * soft[0] for bend in bends]
        right = [self.guide + (self.mu - self.mu_difference) * bend * soft[1] for bend in bends]
        return (entered + self.entry_difference, left), (entered - self.entry_difference, right)

    def load(self, memory, load, now):
        out, (pulled, paid_out) = [], memory[:2]
        (first, by_left), (second, by_right) = self._lost(now)
        left, right = pulled[0] * first, paid_out[0] * second
        drag = self.drag_n * (pulled[0] + paid_out[0]) / 2
        for before, a, way, b, back in zip(load, by_left, pulled, by_right, paid_out, strict=True):
            left, right = left + way * a, right + back * b
            out.append(before + arm(now) * (now.u[0] * _gained(-left) - now.u[1] * _gained(right) - drag))
        return tuple(out)

    def remember(self, memory, now, after):
        pull, out = _pull(now), []
        moved, beyond = 0.0 * now.q[0], []
        for before, later in zip(now.q[::-1], after.q[::-1], strict=True):
            moved = moved + later - before
            beyond.append(moved)
        each = zip((1, -1), memory[:2], self._lost(now), pull, memory[2], strict=True)
        for sense, ways, (entered, lost), new, old in each:
            more, mine = sense * (new - old), []
            for i, (way, hold, own) in enumerate(zip(ways, lost, beyond[::-1], strict=True)):
                hold = hold + entered if i == 0 else hold
                slid = own + self.as_one * (beyond[-1] - own)
                by_tension = jnp.clip(way + self.held * more / (jnp.abs(hold) + LEAST_HOLD), -1.0, 1.0)
                mine.append(turned(by_tension, slid, self.turn_rad, self.still_rad_s * now.h))
                more = more - hold * (mine[-1] - way)
            out.append(tuple(mine))
        return (*out, pull)
