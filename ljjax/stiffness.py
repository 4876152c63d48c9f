"""What statics show: tension at rest, stiffness matrices, tip stiffness, shape locking (model sections 2, 6)."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from ljjax import energy
from ljjax._types import Flag, JointMatrix, Joints, Scalar
from ljjax.chain import constant_curvature, lateral_jacobian
from ljjax.dynamics import State, lever_arm
from ljjax.friction import breakaway
from ljjax.model import Model


def steady_tension(model: Model, theta: Scalar, u_p: Scalar) -> Scalar:
    """u₁ − u₂ [N] that holds the mean segment angle θ [rad] with the bristles at rest: [α₁ sin(nθ) + α₂θ]/g."""
    q = constant_curvature(theta, model.n)
    return energy.potential_gradient(model, q, u_p)[0] / lever_arm(model, q)


def open_loop_stiffness(model: Model, u_p: Scalar) -> JointMatrix:
    """K = α₁1_{n×n} + [α₂ + σ₀φ]I [N·m/rad] at q = 0, z = 0."""
    return closed_loop_stiffness(model, u_p, model.gravity.alpha1)


def closed_loop_stiffness(model: Model, u_p: Scalar, gamma: Scalar) -> JointMatrix:
    """K = γ1_{n×n} + [α₂ + σ₀φ]I [N·m/rad] under the energy-shaping law with gain γ [N·m], at z = 0."""
    joint = energy.alpha2(model, u_p) + model.friction.sigma0 * energy.phi(model, u_p)
    ones = jnp.ones((model.n, model.n), joint.dtype)
    return gamma * ones + joint * jnp.eye(model.n, dtype=joint.dtype)


def transverse_stiffness(model: Model, k: JointMatrix, q: Joints | None = None) -> Scalar:
    """K_T = 1/(aᵀK⁻¹a) [N/m], what a probe at the tip measures for the joint stiffness matrix K [N·m/rad].

    Args:
        q: (n,) shape at which to take the lateral Jacobian a [rad]; straight by default.
    """
    a = lateral_jacobian(model.chain, jnp.zeros((model.n,), k.dtype) if q is None else q)
    return 1 / (a @ jnp.linalg.solve(k, a))


def probe_stiffness(model: Model, u_p: Scalar) -> Scalar:
    """K_T of the open loop at q = 0 [N/m]."""
    return transverse_stiffness(model, open_loop_stiffness(model, u_p))


class Lock(NamedTuple):
    """A shape held by the bristles alone: its state, and whether they can hold it."""

    state: State
    holds: Flag


def lock(model: Model, q: Joints, u_p: Scalar) -> Lock:
    """The equilibrium (q, 0, z) for u = 0 with z = −∇U(q)/(σ₀φ); it holds if |zᵢ| ≤ μ_S/σ₀ for every joint."""
    z = -energy.potential_gradient(model, q, u_p) / (model.friction.sigma0 * energy.phi(model, u_p))
    return Lock(State(q, jnp.zeros_like(q), z), jnp.all(jnp.abs(z) <= breakaway(model)))
