"""Random admissible robots, and wrong guesses of them for a fit to begin from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

PRESSURES_KPA = np.linspace(0, 40, 41)
CENTRE = {
    "chain.half_length_m": 0.021,
    "chain.radius_m": 0.025,
    "chain.lever_arm_m": 0.02,
    "chain.segment_mass_kg": 0.05,
    "gravity.alpha1": 0.1,
    "elastic.c1": -0.0006,
    "elastic.c2": 0.07,
    "elastic.c3": 1.5,
    "jamming.c4": 8.0,
    "jamming.c5": 3.8,
    "friction.sigma1": 0.004,
    "friction.sigma2": 0.0125,
    "friction.sigma3": 1.6,
    "friction.mu_c": 0.0032,
    "friction.mu_s": 0.0037,
    "friction.v_s": 0.045,
}
"""Parameters by path, in the units of `model.toml` and in the gauge σ₀ = 1 rad⁻¹."""
GEOMETRY = ("chain.half_length_m", "chain.radius_m", "chain.lever_arm_m", "chain.segment_mass_kg")
SPREAD = 0.3


@dataclass(frozen=True)
class Robot:
    """A simulated robot and what its laboratory knows.

    Attributes:
        truth: parameters by path.
        columns: how many angles are logged: 6 (every joint) or 1 (θ).
        known: chain parameters that are known; a fit is given them and freezes them.
        start: the wrong guess a fit begins from.
        static: whether there are logs of steady points and of a probe beside the moving ones.
    """

    robot_id: str
    truth: dict[str, float]
    start: dict[str, float]
    known: tuple[str, ...]
    columns: int
    static: bool


def draw(count: int, seed: int = 0) -> list[Robot]:
    """`count` robots; the first ones are the same whatever the count.

    Variants take turns: joint angles or θ logged; mass and lever arm both known, or one of them not (both at once
    cannot be observed); with and without static logs.
    """
    robots = []
    for i in range(count):
        rng = np.random.default_rng([seed, i])
        truth = _admissible(rng, CENTRE, lambda rng: np.exp(SPREAD * np.clip(rng.standard_normal(), -2, 2)))
        start = _admissible(rng, truth, lambda rng: 1 + rng.choice([-1, 1]) * rng.uniform(0.1, SPREAD))
        unknown = ((), ("chain.segment_mass_kg",), ("chain.lever_arm_m",))[i // 2 % 3]
        known = tuple(path for path in GEOMETRY if path not in unknown)
        start |= {path: truth[path] for path in known}
        robots.append(Robot(f"robot-{i:03d}", truth, start, known, (6, 1)[i % 2], i // 6 % 2 == 1))
    return robots


def _admissible(rng: np.random.Generator, around: dict[str, float], factor) -> dict[str, float]:
    """Every value times a random factor, drawn again until the robot is possible."""
    while True:
        p = {path: value * float(factor(rng)) for path, value in around.items()}
        p |= {path: CENTRE[path] for path in ("chain.half_length_m", "chain.radius_m")}
        p["friction.mu_s"] = p["friction.mu_c"] * float(np.exp(rng.uniform(np.log(1.02), np.log(1.5))))
        if admissible(p):
            return p


def admissible(p: dict[str, float]) -> bool:
    """1 < σ₃ ≤ 2.5, passive friction, and α₂ > 0, not falling by more than a tenth, over the pressures used."""
    c1, c2, c3 = (p[f"elastic.c{i}"] for i in (1, 2, 3))
    alpha2 = c1 * PRESSURES_KPA**2 + c2 * PRESSURES_KPA + c3
    sigma1, sigma2, mu_c, mu_s = (p[f"friction.{name}"] for name in ("sigma1", "sigma2", "mu_c", "mu_s"))
    passive = sigma2 > sigma1 * (mu_s - mu_c) / mu_c
    return passive and 1.05 < p["friction.sigma3"] <= 2.5 and bool(alpha2.min() > 0.9 * c3)
