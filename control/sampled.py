"""The bend with equal joints under the law's sampling, linear: how much damping the rate filter and the delay carry.

While every joint slides, friction is viscous and Iθ̈ + nσ₂φθ̇ + n(α₂ + nα₁)θ = n gτ₁, with τ₁ held and a tick late.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.linalg import expm

from ljjax.control.statics import Statics
from ljjax.law.parts import Gains
from ljjax.model import Model


def spectral_radius(model: Model, at_rest: Statics, gains: Gains, period_s: float, damping: Any) -> np.ndarray:
    """(D,) the largest over the vacuums, for each damping K_D (D,) [N·s/m]; the loop decays where it is below 1.

    The state is (θ, θ̇, the last θ, its filtered rate, the held gτ₁), a tick apart.
    """
    n, alpha1, t = model.n, float(model.gravity.alpha1), period_s
    inertia, damping = float(at_rest.inertia), np.atleast_1d(np.asarray(damping, float))
    body = np.zeros((at_rest.vacuum.shape[0], 3, 3))
    body[:, 0, 1] = 1.0
    body[:, 1, 0] = -n * (np.asarray(at_rest.mean_alpha2) + n * alpha1) / inertia
    body[:, 1, 1] = -n * float(model.friction.sigma2) * np.asarray(at_rest.phi).mean(axis=1) / inertia
    body[:, 1, 2] = n / inertia
    onward = expm(body * t)  # (V, 3, 3)

    fresh = t / (t + float(gains.filter_s))
    tick = np.zeros((len(damping), len(onward), 5, 5))
    tick[..., :2, :2], tick[..., :2, 4] = onward[:, :2, :2], onward[:, :2, 2]
    tick[..., 2, 0] = 1.0
    tick[..., 3, 0], tick[..., 3, 2], tick[..., 3, 3] = fresh / t, -fresh / t, 1.0 - fresh
    resisting = damping[:, None, None] * n * float(model.chain.lever_arm_m) ** 2
    tick[..., 4, :] = -resisting * tick[..., 3, :]
    tick[..., 4, 0] += n * (alpha1 - float(gains.gamma))
    return np.abs(np.linalg.eigvals(tick)).max(axis=(1, 2))


def most_damping(model: Model, at_rest: Statics, gains: Gains, period_s: float) -> float:
    """The largest damping [N·s/m] with which the loop decays, to a tenth; 0 where it does not with any."""
    scale = float(at_rest.inertia) / (model.n * float(model.chain.lever_arm_m)) ** 2 / period_s
    trial = scale * np.geomspace(1e-3, 1e5, 200)
    good = np.flatnonzero(spectral_radius(model, at_rest, gains, period_s, trial) < 1)
    return float(trial[good[-1]]) if len(good) else 0.0
