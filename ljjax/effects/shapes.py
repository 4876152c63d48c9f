"""Small pieces that several effects are made of."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array

from ljjax import energy
from ljjax.effect import Effect, Now

Vector = tuple[Array, ...]
RESTED_S = 30.0
"""How long a body is taken to have rested as a run finds it: what creeps slower is no spring about wherever the run
begins."""
SHORT_S = 1e-6
STEEP = 0.97
NEAR_ONE, LEAST_LEFT = 0.02, 1e-6
TINY = 1e-12
"""What is as good as 0: a lag leaves ever smaller numbers, whose inverse, in a derivative, would be infinite."""


def positive(x: Array) -> Array:
    """x₊, of slope 0 at 0."""
    return jnp.where(x > 0, x, 0.0 * x)


def power(x: Array, one: float, exponent: Array) -> Array:
    """(|x|/one)^exponent, smooth at 0."""
    return jnp.exp(0.5 * exponent * jnp.log((x / one) ** 2 + 1e-6))


def saturated(x: Array, knee: Array, order: Array, edge: Array) -> Array:
    """y/(1 + y^edge)^(1/edge), y = (x/knee)^n, for x > 0, 0 below: Hill's curve for an edge of 1, and for larger ones
    y up to the knee and 1 beyond it."""
    some = x > TINY
    log_y = order * jnp.log(jnp.where(some, x, 1.0 + 0.0 * x) / knee)
    return jnp.where(some, jnp.exp(log_y - jnp.logaddexp(0.0 * log_y, edge * log_y) / edge), 0.0 * x)


def bounded(x: Array, limit: Array, edge: Array) -> Array:
    """x₊ (1 + (x/limit)^edge)^(−1/edge): x below the limit and the limit beyond it, the sharper the larger the edge."""
    some = x > TINY
    over = jnp.log(jnp.where(some, x, 1.0 + 0.0 * x) / limit)
    return jnp.where(some, x * jnp.exp(-jnp.logaddexp(0.0 * over, edge * over) / edge), 0.0 * x)


def sawtooth(x: Array) -> Array:
    """From −½ to ½ between x = −½ and ½, and again over each 1; its fall a few hundredths wide."""
    return jnp.arctan2(STEEP * jnp.sin(2 * jnp.pi * x), 1 + STEEP * jnp.cos(2 * jnp.pi * x)) / jnp.pi


def lagged(x: Array, held: Array, tau: Array, h: Array) -> tuple[Array, Array]:
    """Mean over a step of h [s] and value at its end of τẏ = x − y, y = `held` at its start, x constant."""
    slow = tau > SHORT_S
    decay = jnp.where(slow, jnp.exp(-h / jnp.where(slow, tau, 1.0 + 0.0 * tau)), 0.0 * tau)
    return x + (held - x) * (1 - decay) * tau / h, x + (held - x) * decay


def pursued(x: Array, held: Array, tau: Array, power: Array, unit: float, h: Array) -> tuple[Array, Array]:
    """The same of τẏ = (x − y) (|x − y|/unit)^(−power): a first-order lag for 0, a rate of its own, unit/τ, for 1."""
    p = NEAR_ONE + (1 - NEAR_ONE) * power  # so that its derivative is there at 0
    slow = tau > SHORT_S
    apart = jnp.sqrt((x - held) ** 2 + (1e-3 * unit) ** 2) / unit
    rest = jnp.where(slow, jnp.exp(p * jnp.log(apart)) - p * h / jnp.where(slow, tau, 1.0 + 0.0 * tau), -1.0 + 0.0 * h)
    some = rest > 0
    end = jnp.where(some, jnp.exp(jnp.log(jnp.where(some, rest, 1.0 + 0.0 * rest)) / p), 0.0 * rest)
    mean = (apart ** (1 + p) - end ** (1 + p)) / (1 + p) * tau / h
    return x + (held - x) * mean / apart, x + (held - x) * end / apart


def ringing(x: Array, held: Array, speed: Array, tau: Array, r: Array, h: Array) -> tuple[Array, Array, Array]:
    """Mean over a step of h [s], and value and rate at its end, of a second-order lag of time constants τ (1 ± i r)
    that begins at `held` and `speed`, x constant: τ² (1 + r²) ÿ + 2 τ ẏ = x − y, two lags of τ for r = 0."""
    slow = tau > SHORT_S
    alpha = 1 / (jnp.where(slow, tau, 1.0 + 0.0 * tau) * (1 + r * r))
    beta, e = r * alpha, held - x
    z = beta * h
    small = z * z < 1e-6
    safe = jnp.where(small, 1.0 + 0.0 * z, z)
    decay, c, s = jnp.exp(-alpha * h), jnp.cos(z), h * jnp.where(small, 1 - z * z / 6, jnp.sin(safe) / safe)
    a = speed + alpha * e
    end = jnp.where(slow, decay * (e * c + a * s), 0.0 * e)
    rate = jnp.where(slow, decay * (speed * c - (alpha * a + beta * beta * e) * s), 0.0 * e)
    mean = -(tau * tau * (1 + r * r) * (rate - speed) + 2 * tau * (end - e)) / h
    return x + mean, x + end, rate


def play(x: Array, width: Array, memory: Vector) -> tuple[Array, Vector]:
    """What passes of x through a play of this half-width, and its memory: what it held, and the way it last moved."""
    held, way = memory
    through = jnp.where(x - width > held, x - width, jnp.where(x + width < held, x + width, held))
    way = jnp.where(x > held, 1.0 + 0.0 * x, jnp.where(x < held, -1.0 + 0.0 * x, way))
    new = jnp.where(width > 0, through, x - width * way)  # without play what is held must not stay in the derivatives
    return new, (new, way)


def turned(way: Array, moved: Any, width: float | Array, rest: Array | None = None, goal: float | Array = 1.0) -> Array:
    """Direction of motion in [−1, 1], times `goal` in the end, after a way `moved`, turning round within about `width`
    (Dahl's relay); it fades as if the way `rest` > 0, in no direction, had been gone beside."""
    whole = jnp.abs(moved) if rest is None else jnp.abs(moved) + rest
    end = goal * (jnp.sign(moved) if rest is None else moved / whole)
    return end + (way - end) * jnp.exp(-whole / width)


def gone(q: Vector, after: Vector) -> Array:
    """The way that the mean joint has gone in a step [rad]."""
    first, *others = (jnp.abs(b - a) for a, b in zip(q, after, strict=True))
    return sum(others, first) / len(q)


def dahl(z: Array, moved: Array, order: Array, elastic: Array | float = 0.0) -> Array:
    """z in [−1, 1] after a way `moved`: dz/dx = (1 − z sgn ẋ)^order (Dahl); a spring that slides at ±1 for 0. A share
    `elastic` of what is moved back goes as a spring's instead, 1 while z sgn ẋ < 0 (Bouc's and Wen's)."""
    way = jnp.sign(moved)
    back = jnp.clip(-way * z, 0.0, jnp.abs(moved))  # of the way, what unloads
    sprung = _dahl(z + way * back, moved - way * back, order)
    return (1 - elastic) * _dahl(z, moved, order) + elastic * sprung


def _dahl(z: Array, moved: Array, order: Array) -> Array:
    way, left = jnp.sign(moved), 1 - order
    left = jnp.where(jnp.abs(left) > NEAR_ONE, left, 2 * NEAR_ONE + left)  # so that its derivative is there at 1
    before = jnp.maximum(1 - way * jnp.clip(z, -1.0, 1.0), LEAST_LEFT)
    power = jnp.exp(left * jnp.log(before)) - left * jnp.abs(moved)
    some = power > 0
    after = jnp.where(some, jnp.exp(jnp.log(jnp.where(some, power, 1.0 + 0.0 * power)) / left), 0.0 * power)
    return jnp.where(way == 0, z, way * (1 - after))


def wave(phase: Array, sine: Array, cosine: Array, sine2: Array, cosine2: Array) -> Array:
    """The first two harmonics of a wave."""
    s, c = jnp.sin(phase), jnp.cos(phase)
    return sine * s + cosine * c + 2 * sine2 * s * c + cosine2 * (c * c - s * s)


def arm(now: Now) -> Array:
    """The tendons' lever arm g(q) at the middle of the step [m]."""
    model = now.model
    return model.chain.lever_arm_m if model.lever is None else model.lever(jnp.stack(now.middle))


def _legendre(i: int, n: int) -> tuple[float, ...]:
    """P₁ … P₅ at joint i of n, along the body from −1 to 1: ways in which segments may differ."""
    x = 2 * i / (n - 1) - 1 if n > 1 else 0.0
    return (
        x,
        (3 * x**2 - 1) / 2,
        (5 * x**3 - 3 * x) / 2,
        (35 * x**4 - 30 * x**2 + 3) / 8,
        (63 * x**5 - 70 * x**3 + 15 * x) / 8,
    )


def along(effect: Effect, n: int) -> list[Array]:
    """What each of n joints gets of an effect's `mode1` … `mode5` along the body (P₁ … P₅)."""
    modes: list[Array] = [getattr(effect, f"mode{k}") for k in range(1, 6)]
    return [sum((m * p for m, p in zip(modes, _legendre(i, n), strict=True)), 0.0 * modes[0]) for i in range(n)]


def of_layers(share: Array, now: Now) -> list[Array]:
    """1 − s + s α₂/α₂(0) for each joint: what goes with the backbone (s = 0), with all that is elastic (s = 1)."""
    bare = energy.alpha2(now.model, 0.0 * now.vacuum)
    return [1 + share * (a / bare - 1) for a in now.alpha2]


def towards_base(share: Array, n: int) -> list[Array]:
    """1 + g x for each of n joints, x along the body from 1 at the base to −1 at the tip."""
    return [1 - share * _legendre(i, n)[0] for i in range(n)]
