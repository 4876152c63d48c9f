"""The experiment to do next: of some standard ones, that in which the remaining candidates differ most."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ljjax.fit.windows import Motion
from ljjax.gap.search import Refit, Study

SECONDS, EVERY_S = 12.0, 0.01


def protocols(tension: float, pressure: float) -> dict[str, tuple[str, np.ndarray, np.ndarray]]:
    """Name → what to do, net tension [N] and vacuum [kPa] every `EVERY_S`, for a robot used up to such a tension and
    vacuum."""
    t = np.arange(round(SECONDS / EVERY_S)) * EVERY_S

    def lines(*knots: tuple[float, float]) -> np.ndarray:
        return np.interp(t, *np.array(knots).T)

    def triangle(period: float) -> np.ndarray:
        return 2 * np.abs(2 * ((t / period + 0.25) % 1) - 1) - 1

    rise = np.clip(t, 0, 1)
    still, some, much = np.zeros_like(t), np.full_like(t, 0.4 * pressure), np.full_like(t, pressure)
    steps = lines((0, 0), (1, 0), (1.1, 1), (3, 1), (3.1, 0.3), (5, 0.3), (5.1, 1), (7, 1), (7.1, 0), (12, 0))
    staircase = np.sign(np.sin(2 * np.pi * t / 6)) * np.ceil(3 * np.abs(np.sin(2 * np.pi * t / 6))) / 3
    fast = np.sin(2 * np.pi * (0.3 * t + 0.12 * t**2)) * np.clip(12 - t, 0, 1)
    hold = lines((0, 0), (0.5, 0), (0.7, 1), (9, 1), (9.2, 0), (12, 0))
    full = max(pressure, 1.0)
    reach = f"{tension:.3g} N"
    return {
        "slow_triangle_vented": (f"slow triangles to ±{reach} without vacuum", rise * triangle(6.0) * tension, still),
        "slow_triangle_jammed": (f"slow triangles to ±{reach} at {full:.3g} kPa", rise * triangle(6.0) * tension, much),
        "fast_sweep": (
            f"a sweep from 0.3 to 3 Hz at ±{0.7 * tension:.3g} N, {0.4 * full:.3g} kPa",
            0.7 * fast * tension,
            some,
        ),
        "pressure_steps": (
            f"a constant {0.6 * tension:.3g} N while the vacuum steps to {full:.3g} kPa and back",
            0.6 * hold * tension,
            steps * pressure,
        ),
        "long_hold": (f"a step to {reach} held for 8 s, then released", hold * tension, still),
        "staircase": (f"a staircase to ±{reach} at {0.4 * full:.3g} kPa", staircase * tension, some),
        "larger_angle": (
            f"slow triangles to ±{1.4 * tension:.3g} N without vacuum",
            rise * triangle(6.0) * 1.4 * tension,
            still,
        ),
        "one_sided": (
            f"triangles to +{reach} and only half as far the other way",
            rise * np.where(triangle(4.0) > 0, 1.0, 0.5) * triangle(4.0) * tension,
            still,
        ),
    }


def plan(name: str, tension: float, pressure: float) -> list[dict[str, Any]]:
    """The protocol as the runs of a rig's plan (`ljjax rig experiment` takes them from gap.json)."""
    known = {
        "slow_triangle_vented": ("triangle", 1.0, 0.0, {}),
        "slow_triangle_jammed": ("triangle", 1.0, 1.0, {}),
        "fast_sweep": ("sweep", 0.7, 0.4, {}),
        "pressure_steps": ("pressure_steps", 0.6, 1.0, {}),
        "long_hold": ("hold", 1.0, 0.0, {}),
        "staircase": ("staircase", 1.0, 0.4, {}),
        "larger_angle": ("triangle", 1.4, 0.0, {}),
        "one_sided": ("triangle", 1.0, 0.0, {"period_s": 4.0, "back_share": 0.5}),
    }
    protocol, pull, draw, rest = known[name]
    size = {"tension_n": round(pull * float(tension), 3), "vacuum_kpa": round(draw * float(pressure), 3)}
    return [{"protocol": protocol, "name": name, **size, **rest}]


def planned(study: Study, what: tuple[str, np.ndarray, np.ndarray]) -> Motion:
    """A run of an experiment that has not been done: nothing measured, the robot at rest before it."""
    from dataclasses import replace

    like = study.motions[0]
    _, net, vacuum = what
    t = np.arange(len(net)) * EVERY_S
    u = 0.2 + np.stack([np.maximum(net, 0), np.maximum(-net, 0)], axis=1)
    zero = np.zeros(len(t))
    n = len(like.q0)
    last = study.motions[-1]
    return replace(
        like,
        t=t,
        y=np.zeros((len(t), like.y.shape[1])),
        tip=None if like.tip is None else (zero, like.tip[1]),
        q0=np.zeros(n),
        v0=np.zeros(n),
        input_t=t,
        tendons=u,
        vacuum=vacuum,
        hold=True,
        warm=zero + last.warm[-1],
        worn=zero + last.worn[-1],
    )


def next_experiment(study: Study, rivals: Sequence[Refit], names: Sequence[str]) -> dict[str, Any] | None:
    """The protocol that parts the first two of `rivals`, named `names`, best; None for fewer than two, or where either
    simulates on no protocol.

    `expected_separation` is the RMS difference of what they predict in units of the measurements' noise.
    """
    if len(rivals) < 2:
        return None
    plans = protocols(study.span["tension"], study.pressure)
    motions = [planned(study, what) for what in plans.values()]
    first, second = (e.predicted for e in study.predict(rivals[:2], motions))
    sizes = np.bincount(np.repeat(np.arange(len(motions)), [len(m.t) for m in motions]))
    edges = np.cumsum([0, *sizes])
    difference = ((first - second) / study.noise) ** 2
    separation = [float(np.sqrt(difference[a:b].mean())) for a, b in zip(edges[:-1], edges[1:], strict=True)]
    if not np.any(np.isfinite(separation)):
        return None
    best = int(np.argmax(np.where(np.isfinite(separation), separation, -1.0)))
    name, (words, _, _) = list(plans.items())[best]
    return {
        "protocol": name,
        "separates": list(names[:2]),
        "expected_separation": round(separation[best], 2),
        "why": f"{words}: there {names[0]} and {names[1]}, each as fitted to these runs, predict angles "
        f"{separation[best]:.2g} times the noise apart (RMS); of the protocols tried it parts them best",
        "plan": plan(name, study.span["tension"], study.pressure),
    }
