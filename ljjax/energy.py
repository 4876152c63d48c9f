"""Elastic, gravity, bristle and kinetic energy (model section 3)."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from ljjax._types import Joints, Scalar
from ljjax.chain import mass_matrix
from ljjax.model import Model

ROOT_SCALE_KPA = 1e-4
"""Width of the smoothing of √u_P at 0 [kPa]; at 1 kPa it changes the root by 5e-5 of its value."""


def root(u_p: Float[Array, "..."]) -> Float[Array, "..."]:
    """√u_P with a finite slope at 0 and the value 0 below: u/√(u + ε), u = max(u_P, 0)."""
    u = jnp.maximum(u_p, jnp.zeros_like(u_p))
    return u / jnp.sqrt(u + ROOT_SCALE_KPA)


def alpha2(model: Model, u_p: Float[Array, "..."]) -> Float[Array, "..."]:
    """α₂(u_P) = c₁u_P² + c₂u_P + c₃ [N·m/rad]."""
    e = model.elastic
    return (e.c1 * u_p + e.c2) * u_p + e.c3


def phi(model: Model, u_p: Float[Array, "..."]) -> Float[Array, "..."]:
    """φ(u_P) = c₄ + c₅√u_P [N·m]."""
    return model.jamming.c4 + model.jamming.c5 * root(u_p)


def potential(model: Model, q: Joints, u_p: Scalar) -> Scalar:
    """U(q) = α₁(1 − cos q_Σ) + ½α₂(u_P)|q|² [J]."""
    return model.gravity.alpha1 * (1 - jnp.cos(jnp.sum(q))) + 0.5 * alpha2(model, u_p) * jnp.sum(q**2)


def potential_gradient(model: Model, q: Joints, u_p: Scalar) -> Joints:
    """∇U = α₁ sin(q_Σ)·1 + α₂(u_P)q [N·m]."""
    return model.gravity.alpha1 * jnp.sin(jnp.sum(q)) + alpha2(model, u_p) * q


def inertia(model: Model, q: Joints) -> Float[Array, "n n"]:
    """M(q) [kg·m²], or M(0) where the model asks for a constant one."""
    return mass_matrix(model.chain, jnp.zeros_like(q) if model.constant_mass else q)


def kinetic(model: Model, q: Joints, v: Joints) -> Scalar:
    """½vᵀM(q)v = ½pᵀM(q)⁻¹p [J]."""
    return 0.5 * v @ (inertia(model, q) @ v)


def bristle(model: Model, z: Joints, u_p: Scalar) -> Scalar:
    """H_z = ½σ₀φ(u_P)|z|² [J]."""
    return 0.5 * model.friction.sigma0 * phi(model, u_p) * jnp.sum(z**2)


def total(model: Model, q: Joints, v: Joints, z: Joints, u_p: Scalar) -> Scalar:
    """𝓗 = ½pᵀM⁻¹p + U(q) + H_z [J]."""
    return kinetic(model, q, v) + potential(model, q, u_p) + bristle(model, z, u_p)
