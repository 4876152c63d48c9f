"""The overall system: the fast right-hand side, and its port-Hamiltonian form (model section 5)."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.scipy.linalg import cho_factor, cho_solve
from jaxtyping import Array, Float

from ljjax import energy
from ljjax._types import Joints, Scalar, Tendons
from ljjax.chain import coriolis_forces, kinetic_gradient
from ljjax.friction import bristle_rate, friction_torque, stribeck
from ljjax.model import Model


class State(NamedTuple):
    """Joint angles q [rad], rates v = q̇ [rad/s] and bristle deflections z [rad], each (n,). p = M(q)v."""

    q: Joints
    v: Joints
    z: Joints


def lever_arm(model: Model, q: Joints) -> Scalar:
    """g(q) [m] of G(q) = g(q)[1, −1]."""
    return model.chain.lever_arm_m if model.lever is None else model.lever(q)


def tendon_torque(model: Model, q: Joints, u: Tendons) -> Joints:
    """G(q)u [N·m]: every joint feels g(q)(u₁ − u₂)."""
    return jnp.full(q.shape, lever_arm(model, q) * (u[0] - u[1]))


def rhs(model: Model, state: State, u: Tendons, u_p: Scalar, tau_ext: Joints | None = None) -> State:
    """d(q, v, z)/dt for tensions u [N], vacuum u_P [kPa] and external joint torques τ_ext [N·m]."""
    q, v, z = state
    torque = tendon_torque(model, q, u) - energy.potential_gradient(model, q, u_p)
    torque = torque - friction_torque(model.friction, v, z, energy.phi(model, u_p))
    if tau_ext is not None:
        torque = torque + tau_ext
    if not model.constant_mass:
        torque = torque - coriolis_forces(model.chain, q, v)
    acceleration = cho_solve(cho_factor(energy.inertia(model, q), lower=True), torque)
    return State(v, acceleration, bristle_rate(model.friction, v, z))


def momentum(model: Model, state: State) -> Joints:
    """p = M(q)v [kg·m²/s]."""
    return energy.inertia(model, state.q) @ state.v


class PortHamiltonian(NamedTuple):
    """χ̇ = (𝒥 − 𝓡)∇𝓗 + 𝓖u over χ = (q, p, z): skew 𝒥, symmetric 𝓡, input map 𝓖 and gradient ∇𝓗."""

    j: Float[Array, "3n 3n"]
    r: Float[Array, "3n 3n"]
    g: Float[Array, "3n 2"]
    gradient: Float[Array, "3n"]


def port_hamiltonian(model: Model, state: State, u_p: Scalar) -> PortHamiltonian:
    """𝒥, 𝓡, 𝓖 and ∇𝓗, for analysis and teaching; `rhs` gives the same motion faster."""
    q, v, z = state
    f = model.friction
    n = q.shape[0]
    phi = energy.phi(model, u_p)
    eye, zero = jnp.eye(n, dtype=q.dtype), jnp.zeros((n, n), q.dtype)
    r_z = jnp.diag(jnp.abs(v) / (phi * stribeck(f, v)))
    n_mat = eye - 0.5 * f.sigma1 * phi * r_z
    p_mat = -0.5 * f.sigma1 * phi * r_z
    s_mat = (f.sigma1 + f.sigma2) * phi * eye
    j = jnp.block([[zero, eye, zero], [-eye, zero, -n_mat.T], [zero, n_mat, zero]])
    r = jnp.block([[zero, zero, zero], [zero, s_mat, p_mat.T], [zero, p_mat, r_z]])
    arm = jnp.full((n,), lever_arm(model, q))
    g = jnp.zeros((3 * n, 2), q.dtype).at[n : 2 * n].set(jnp.stack([arm, -arm], axis=1))
    bend = energy.potential_gradient(model, q, u_p)
    if not model.constant_mass:
        bend = bend - kinetic_gradient(model.chain, q, v)
    return PortHamiltonian(j, r, g, jnp.concatenate([bend, v, f.sigma0 * phi * z]))


def pressure_power(model: Model, state: State, u_p: Scalar, u_p_rate: Scalar) -> Scalar:
    """[½α₂′(u_P)|q|² + ½σ₀φ′(u_P)|z|²]·u̇_P [W], what the pressure port feeds in."""
    e = model.elastic
    phi_slope = jax.grad(lambda u: energy.phi(model, u))(u_p)
    elastic = 0.5 * (2 * e.c1 * u_p + e.c2) * jnp.sum(state.q**2)
    return (elastic + 0.5 * model.friction.sigma0 * phi_slope * jnp.sum(state.z**2)) * u_p_rate
