"""LuGre friction scaled by the vacuum, elementwise over the joints (model section 4)."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from ljjax._types import Joints, Scalar
from ljjax.model import Friction, Model


def stribeck(friction: Friction, v: Float[Array, "..."]) -> Float[Array, "..."]:
    """ρ(v) = μ_C + (μ_S − μ_C) exp(−|v/v_s|^σ₃), elementwise, differentiable at v = 0 for σ₃ ≥ 1."""
    x = jnp.abs(v / friction.v_s)
    tiny = x < 1e-30  # |x|^σ₃ and its derivatives vanish here; the logarithm would not
    log_power = friction.sigma3 * jnp.log(jnp.where(tiny, jnp.ones_like(x), x))
    log_power = jnp.minimum(log_power, 5.0)  # exp(−e⁵) is below rounding; beyond it the slope would be 0·∞
    power = jnp.where(tiny, 0.0 * x, jnp.exp(log_power))
    return friction.mu_c + (friction.mu_s - friction.mu_c) * jnp.exp(-power)


def bristle_rate(friction: Friction, v: Joints, z: Joints) -> Joints:
    """ż = v − σ₀(|v|/ρ(v))z [rad/s]. |zᵢ| ≤ μ_S/σ₀ is invariant."""
    return v - friction.sigma0 * jnp.abs(v) / stribeck(friction, v) * z


def friction_torque(friction: Friction, v: Joints, z: Joints, phi: Scalar) -> Joints:
    """τ_f = φ(σ₀z + σ₁ż + σ₂v) [N·m]."""
    return phi * (friction.sigma0 * z + friction.sigma1 * bristle_rate(friction, v, z) + friction.sigma2 * v)


def sliding_torque(friction: Friction, v: Joints, phi: Scalar) -> Joints:
    """Steady sliding: τ_f = φ[ρ(v) sign v + σ₂v] [N·m]."""
    return phi * (stribeck(friction, v) * jnp.sign(v) + friction.sigma2 * v)


def dissipation(friction: Friction, v: Joints, z: Joints, phi: Scalar) -> Scalar:
    """v·τ_f − dH_z/dt at constant φ [W]: φ Σ[σ₀²|v|z²/ρ + σ₁vż + σ₂v²].

    It is ≥ 0 on |zᵢ| ≤ μ_S/σ₀ where σ₂ ≥ σ₁(μ_S − μ_C)/μ_C.
    """
    slip = friction.sigma0**2 * jnp.abs(v) / stribeck(friction, v) * z**2
    return phi * jnp.sum(slip + friction.sigma1 * v * bristle_rate(friction, v, z) + friction.sigma2 * v**2)


def breakaway(model: Model) -> Scalar:
    """μ_S/σ₀ [rad], the largest bristle deflection."""
    return model.friction.mu_s / model.friction.sigma0
