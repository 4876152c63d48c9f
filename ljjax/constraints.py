"""Admissible parameters by construction: a smooth one-to-one map from unconstrained numbers to a model.

With P the highest vacuum in use, for every real value of the free numbers the model has masses and lengths > 0,
α₂ > 0 and φ > 0 on [0, P], μ_S ≥ μ_C > 0, v_s > 0, σ₁ ≥ 0, σ₃ ≥ 1, and passive friction.

α₂ on [0, P] is a quadratic with Bernstein coefficients b₀, b₁, b₂; it is positive there exactly when b₀, b₂ > 0 and
b₁ > −√(b₀b₂). φ is linear in √u_P, so its two end values decide. σ₀ is the gauge and not among the free numbers.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from jax.core import Tracer

from ljjax._types import Scalar
from ljjax.errors import InputError
from ljjax.model import UNITS, Model, check, leaf, replace

_POSITIVE = ("chain.half_length_m", "chain.radius_m", "chain.lever_arm_m", "chain.segment_mass_kg")
FREE = tuple(path for path in UNITS if path != "friction.sigma0")
"""The parameters that the free numbers give, by path."""


def unconstrain(model: Model, pressure_max_kpa: float, xp: Any = jnp) -> dict[str, Any]:
    """The free numbers of an admissible model: path → scalar. A value on a bound gives −inf. `xp` is jax.numpy, or
    numpy for a model of numbers, for which nothing is compiled.

    Raises:
        InputError: the model is not admissible on [0, P], or P is not > 0 (values under a JAX transformation are not
            checked).
    """
    if not pressure_max_kpa > 0:
        raise InputError(f"the highest vacuum is {pressure_max_kpa:g} kPa; expected > 0")
    check(model, (0.0, pressure_max_kpa))
    x = {path: leaf(model, path) for path in UNITS}
    mu_gap = x["friction.mu_s"] - x["friction.mu_c"]
    margin = x["friction.sigma2"] - x["friction.sigma1"] * mu_gap / x["friction.mu_c"]
    if not isinstance(margin, Tracer) and margin < 0:
        raise InputError(
            f"model: friction.sigma2 must be ≥ sigma1·(mu_s − mu_c)/mu_c "
            f"for passive friction; it is {-float(margin):g} s/rad short"
        )
    p = pressure_max_kpa
    b0, b2 = x["elastic.c3"], (x["elastic.c1"] * p + x["elastic.c2"]) * p + x["elastic.c3"]
    b1 = x["elastic.c3"] + x["elastic.c2"] * p / 2
    free = {
        **{path: xp.log(x[path]) for path in _POSITIVE},
        "gravity.alpha1": x["gravity.alpha1"],
        "elastic.c3": xp.log(b0),
        "elastic.c2": xp.log(b1 + xp.sqrt(b0 * b2)),
        "elastic.c1": xp.log(b2),
        "jamming.c4": xp.log(x["jamming.c4"]),
        "jamming.c5": xp.log(x["jamming.c4"] + x["jamming.c5"] * p**0.5),
        "friction.sigma1": xp.log(x["friction.sigma1"]),
        "friction.sigma2": xp.log(margin),
        "friction.sigma3": xp.log(x["friction.sigma3"] - 1),
        "friction.mu_c": xp.log(x["friction.mu_c"]),
        "friction.mu_s": xp.log(mu_gap),
        "friction.v_s": xp.log(x["friction.v_s"]),
    }
    return {path: free[path] for path in FREE}


def constrain(free: dict[str, Scalar], like: Model, pressure_max_kpa: float) -> Model:
    """The admissible model of the free numbers; what is not in `free` (and the options) comes from `like`."""
    return replace(like, parameters({**unconstrain(like, pressure_max_kpa), **free}, pressure_max_kpa))


def parameters(free: dict[str, Any], pressure_max_kpa: float, xp: Any = jnp) -> dict[str, Any]:
    """The parameters, by path, that all the free numbers give; `xp` is jax.numpy, or numpy, real or complex."""
    e = {path: xp.exp(value) for path, value in free.items() if path != "gravity.alpha1"}
    p = pressure_max_kpa
    b0, b2 = e["elastic.c3"], e["elastic.c1"]
    b1 = e["elastic.c2"] - xp.sqrt(b0 * b2)
    mu_c, mu_gap = e["friction.mu_c"], e["friction.mu_s"]
    return {
        **{path: e[path] for path in (*_POSITIVE, "friction.sigma1", "friction.v_s")},
        "gravity.alpha1": free["gravity.alpha1"],
        "elastic.c3": b0,
        "elastic.c2": 2 * (b1 - b0) / p,
        "elastic.c1": (b0 - 2 * b1 + b2) / p**2,
        "jamming.c4": e["jamming.c4"],
        "jamming.c5": (e["jamming.c5"] - e["jamming.c4"]) / p**0.5,
        "friction.mu_c": mu_c,
        "friction.mu_s": mu_c + mu_gap,
        "friction.sigma2": e["friction.sigma2"] + e["friction.sigma1"] * mu_gap / mu_c,
        "friction.sigma3": 1 + e["friction.sigma3"],
    }
