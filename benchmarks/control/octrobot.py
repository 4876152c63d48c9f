"""OctRobot-I as published, and the models identified from it."""

from __future__ import annotations

from functools import cache

import jax.numpy as jnp
import numpy as np
from scipy.optimize import least_squares

from ljjax import modelfile
from ljjax.data import OCTROBOT
from ljjax.effects import StiffnessSaturation
from ljjax.fit import fit
from ljjax.logs import read_all
from ljjax.model import Chain, Elastic, Gravity, Jamming, Model, get, replace

LEVER_ARM_M = 0.02
"""Not published; in the paper's units it is 1, and a gain of 1 N is one of 0.02 N·m here."""
PER_JOINT = 1 / float(np.sum((0.021 * np.arange(11, 0, -2)) ** 2))
"""K_T over k for K = kI and six segments [1/m²]."""


def table(name: str) -> np.ndarray:
    """A published table, a structured array with a field a column."""
    return np.genfromtxt(OCTROBOT / f"{name}.csv", delimiter=",", names=True)


@cache
def identified(segments: int = 6) -> Model:
    """The base model as `ljjax fit` finds it from the steady tensions and the probe, with nominal.toml's friction; with
    fewer segments, each as it is."""
    model = fit(None, read_all([OCTROBOT / f"{name}.mcap" for name in ("identification", "open_loop_stiffness")])).model
    c = model.chain
    chain = Chain(c.half_length_m, c.radius_m, c.lever_arm_m, c.segment_mass_kg, segments=segments)
    return Model(chain, model.gravity, model.elastic, model.jamming, model.friction)


@cache
def saturating() -> Model:
    """The form that the diagnosis names for the elasticity, α₂ = a + b u_P/(u_P + p₀), positive at every vacuum; by
    least squares on the steady tensions, without α₁. φ = c₄ + c₅√u_P, by least squares on the probe's stiffness."""
    steady, probe = table("identification"), table("open_loop_stiffness")
    theta, u = np.radians(steady["theta_deg"]), steady["pressure_kpa"]

    def alpha2(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        return x[0] + x[1] * u / (u + x[2])

    found = least_squares(lambda x: alpha2(x, u) * theta / LEVER_ARM_M - steady["force_mean_n"], [2.0, 2.0, 5.0]).x
    at = probe["pressure_kpa"]
    columns = np.stack([np.ones_like(at), np.sqrt(at)], axis=1)
    c4, c5 = np.linalg.lstsq(columns, probe["stiffness_mean_n_per_m"] / PER_JOINT - alpha2(found, at), rcond=None)[0]
    nominal = modelfile.load(OCTROBOT / "nominal.toml").model
    zero, (a, b, knee) = jnp.asarray(0.0), (jnp.asarray(x) for x in found)
    effect = StiffnessSaturation(rise=b, knee_kpa=knee)
    jamming = Jamming(jnp.asarray(c4), jnp.asarray(c5))
    return Model(nominal.chain, Gravity(zero), Elastic(zero, zero, a), jamming, nominal.friction, effects=(effect,))


def with_stiction(model: Model, mu_s: float) -> Model:
    """The same with another μ_S, and μ_C in the same ratio to it as before."""
    ratio = float(get(model, "friction.mu_c")) / float(get(model, "friction.mu_s"))
    return replace(model, {"friction.mu_s": mu_s, "friction.mu_c": ratio * mu_s})
