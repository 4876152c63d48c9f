"""The protocols that a plan may name: net tension u₁ − u₂ [N] and vacuum [kPa] over time."""

from __future__ import annotations

import inspect
import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

At = Callable[[float, float], tuple[float, float]]


class Protocol(NamedTuple):
    """How long it lasts [s], net tension [N] and vacuum [kPa] at a time [s] and a measured mean angle [rad], and the
    most it asks for: tension [N], vacuum [kPa], angle [rad]."""

    seconds: float
    at: At
    most_n: float
    most_kpa: float
    most_rad: float = 0.0


def _of_time(seconds: float, tension_n: float, vacuum_kpa: float, net: Callable[[float], float],
             vacuum: Callable[[float], float] = lambda t: 1.0) -> Protocol:  # fmt: skip
    """Shares of a tension and of a vacuum over time."""
    return Protocol(seconds, lambda t, _: (tension_n * net(t), vacuum_kpa * vacuum(t)), tension_n, vacuum_kpa)


def _lines(*knots: tuple[float, float]) -> Callable[[float], float]:
    """Straight lines between (time, value); the first and last values hold outside."""
    times = [t for t, _ in knots]

    def at(t: float) -> float:
        k = bisect_right(times, t)
        if k == 0 or k == len(knots):
            return knots[0 if k == 0 else -1][1]
        (a, x), (b, y) = knots[k - 1], knots[k]
        return x + (y - x) * (t - a) / (b - a)

    return at


def triangle(
    tension_n: float, vacuum_kpa: float = 0.0, period_s: float = 6.0, back_share: float = 1.0, seconds: float = 12.0
) -> Protocol:
    """Triangles between +tension and −`back_share` of it; slow or fast by their period, growing in the first second."""

    def net(t: float) -> float:
        x = 2 * abs(2 * ((t / period_s + 0.25) % 1) - 1) - 1
        return min(t, 1.0) * x * (1.0 if x > 0 else back_share)

    return _of_time(seconds, tension_n * max(1.0, back_share), vacuum_kpa, lambda t: net(t) / max(1.0, back_share))


def staircase(
    tension_n: float, vacuum_kpa: float = 0.0, steps: float = 3.0, period_s: float = 6.0, seconds: float = 12.0
) -> Protocol:
    """Steps up to +tension, down through 0 to −tension and back, in the times of a sine."""

    def net(t: float) -> float:
        x = math.sin(2 * math.pi * t / period_s)
        return math.copysign(math.ceil(steps * abs(x) - 1e-9) / steps, x)

    return _of_time(seconds, tension_n, vacuum_kpa, net)


def sweep(
    tension_n: float, vacuum_kpa: float = 0.0, low_hz: float = 0.3, high_hz: float = 3.18, seconds: float = 12.0
) -> Protocol:
    """A sine whose frequency rises evenly; the last second fades out."""

    def net(t: float) -> float:
        turns = low_hz * t + 0.5 * (high_hz - low_hz) / seconds * t * t
        return math.sin(2 * math.pi * turns) * min(seconds - t, 1.0)

    return _of_time(seconds, tension_n, vacuum_kpa, net)


def multisine(
    tension_n: float,
    vacuum_kpa: float = 0.0,
    low_hz: float = 0.1,
    high_hz: float = 3.0,
    tones: float = 10.0,
    seconds: float = 20.0,
) -> Protocol:
    """Equal tones evenly spaced, with Schroeder's phases −πk(k−1)/N, scaled so that the peak is the tension."""
    count = max(1, round(tones))
    gap = (high_hz - low_hz) / max(1, count - 1)
    parts = [(2 * math.pi * (low_hz + k * gap), -math.pi * k * (k + 1) / count) for k in range(count)]

    def raw(t: float) -> float:
        return sum(math.cos(w * t + phase) for w, phase in parts)

    samples = max(1, math.ceil(seconds * 50 * high_hz))
    peak = max(abs(raw(seconds * k / samples)) for k in range(samples + 1)) or 1.0
    return _of_time(seconds, tension_n, vacuum_kpa, lambda t: max(-1.0, min(1.0, raw(t) / peak)))


def hold(tension_n: float, vacuum_kpa: float = 0.0, hold_s: float = 8.3, rest_s: float = 2.8) -> Protocol:
    """A step to the tension, held, then released."""
    net = _lines((0.5, 0), (0.7, 1), (0.7 + hold_s, 1), (0.9 + hold_s, 0))
    return _of_time(0.9 + hold_s + rest_s, tension_n, vacuum_kpa, net)


def pressure_steps(tension_n: float, vacuum_kpa: float) -> Protocol:
    """A constant tension while the vacuum steps to the full, to three tenths, to the full and away."""
    net = _lines((0.5, 0), (0.7, 1), (9, 1), (9.2, 0))
    steps = _lines((1, 0), (1.1, 1), (3, 1), (3.1, 0.3), (5, 0.3), (5.1, 1), (7, 1), (7.1, 0))
    return _of_time(12.0, tension_n, vacuum_kpa, net, steps)


def bend_vacuum_release(tension_n: float, vacuum_kpa: float, bend_s: float = 1.0, hold_s: float = 2.0) -> Protocol:
    """Bend without vacuum, draw the vacuum, let the tendon go: the shape stays locked; then vent."""
    a, b = bend_s + hold_s, 2 * bend_s + hold_s
    net = _lines((0, 0), (bend_s, 1), (a + hold_s, 1), (b + hold_s, 0))
    vacuum = _lines((bend_s, 0), (a, 1), (b + 2 * hold_s, 1), (2 * bend_s + b + hold_s * 2, 0))
    return _of_time(3 * bend_s + b + 3 * hold_s, tension_n, vacuum_kpa, net, vacuum)


def hold_angles(
    angles_deg: Sequence[float],
    vacuums_kpa: Sequence[float],
    tension_n: float = 20.0,
    move_s: float = 6.0,
    hold_s: float = 2.0,
    rate_n_s: float = 4.0,
) -> Protocol:
    """Every angle at every vacuum: the tension creeps toward the angle for `move_s`, then stays as it is for `hold_s`.

    The tension never passes `tension_n`, so that an angle beyond is not reached, and what is logged at rest is still
    true.
    """
    places = [(math.radians(a), p) for p in vacuums_kpa for a in angles_deg]
    span, near = move_s + hold_s, math.radians(1.0)
    net, before = 0.0, 0.0

    def at(t: float, theta: float) -> tuple[float, float]:
        nonlocal net, before
        k = min(int(t / span), len(places) - 1)
        angle, vacuum = places[k]
        dt, before = min(max(t - before, 0.0), 0.1), t
        if t - k * span < move_s:
            net += rate_n_s * dt * max(-1.0, min(1.0, (angle - theta) / near))
            net = max(-tension_n, min(tension_n, net))
        return net, vacuum

    most = max(abs(angle) for angle, _ in places)
    return Protocol(span * len(places), at, tension_n, max(vacuums_kpa), most)


def probe_press(
    vacuums_kpa: Sequence[float],
    angle_deg: float = 0.0,
    press_s: float = 15.0,
    move_s: float = 6.0,
    tension_n: float = 20.0,
    rate_n_s: float = 4.0,
) -> Protocol:
    """At every vacuum, the body bent to an angle and left there for a person or a stage to press the probe."""
    return hold_angles((angle_deg,), vacuums_kpa, tension_n, move_s, press_s, rate_n_s)


def _needs(make: Callable[..., Protocol]) -> dict[str, Any]:
    """What a plan may say of a protocol: its default; None where it must be said, and () where that is a list."""
    out: dict[str, Any] = {}
    for name, about in inspect.signature(make).parameters.items():
        needed = () if "Sequence" in str(about.annotation) else None
        out[name] = needed if about.default is inspect.Parameter.empty else about.default
    return out


PROTOCOLS: dict[str, tuple[Callable[..., Protocol], dict[str, Any]]] = {
    make.__name__: (make, _needs(make))
    for make in (
        triangle,
        staircase,
        sweep,
        multisine,
        hold,
        pressure_steps,
        bend_vacuum_release,
        hold_angles,
        probe_press,
    )
}
"""Each protocol by name, and what a plan may say of it."""
