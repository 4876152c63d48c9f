"""The planar rigid-link chain: inertia and Coriolis forces in closed form, tip kinematics (model section 2)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ljjax._types import JointMatrix, Joints, Scalar
from ljjax.model import Chain


def absolute_angles(q: Joints) -> Joints:
    """ψᵢ = q₁ + … + qᵢ [rad], the direction of link i."""
    return jnp.cumsum(q)


def to_joints(force_on_angles: Joints) -> Joints:
    """Generalised forces on ψ turned into forces on q: the transpose of the running sum."""
    return jnp.cumsum(force_on_angles[::-1])[::-1]


def inertia_constants(chain: Chain) -> tuple[JointMatrix, Joints]:
    """A (n, n) and J (n,) [kg·m²] of M in absolute angles, M_ab = A_ab cos(ψ_a − ψ_b) + J_a δ_ab.

    Links 1 … n−1 are cylinders of length 2l and mass m, link n a half-link of length l and mass m/2. The centre of
    link k moves with Σ_a s_ka ψ̇_a, s_ka = L_a for a < k, L_a/2 for a = k, 0 beyond; A = Σ_k m_k s_k s_kᵀ.
    """
    n = chain.segments
    dtype = chain.half_length_m.dtype
    last = np.arange(n) == n - 1
    length = chain.half_length_m * jnp.asarray(np.where(last, 1.0, 2.0), dtype)
    mass = chain.segment_mass_kg * jnp.asarray(np.where(last, 0.5, 1.0), dtype)
    reach = jnp.asarray(np.tril(np.ones((n, n)), -1) + 0.5 * np.eye(n), dtype) * length[None, :]
    a = jnp.einsum("k,ka,kb->ab", mass, reach, reach)
    own = mass * (chain.radius_m**2 / 4 + length**2 / 12)
    return a, own


def mass_matrix(chain: Chain, q: Joints) -> JointMatrix:
    """M(q) [kg·m²] in joint angles."""
    a, own = inertia_constants(chain)
    psi = absolute_angles(q)
    m_psi = a * jnp.cos(psi[:, None] - psi[None, :]) + jnp.diag(own)
    return jax.vmap(to_joints)(jax.vmap(to_joints)(m_psi).T)


def coriolis_forces(chain: Chain, q: Joints, v: Joints) -> Joints:
    """C(q, v)v [N·m], so that M(q)v̇ + C(q, v)v are the inertia forces.

    In absolute angles Σ_b A_ab sin(ψ_a − ψ_b) ψ̇_b²; the running sum has constant coefficients and adds nothing.
    """
    a, _ = inertia_constants(chain)
    psi, omega = absolute_angles(q), absolute_angles(v)
    return to_joints((a * jnp.sin(psi[:, None] - psi[None, :])) @ omega**2)


def kinetic_gradient(chain: Chain, q: Joints, v: Joints) -> Joints:
    """∂/∂q of ½ vᵀM(q)v at fixed v [N·m]; minus this is ∂/∂q of ½ pᵀM(q)⁻¹p at fixed p."""
    a, _ = inertia_constants(chain)
    psi, omega = absolute_angles(q), absolute_angles(v)
    return to_joints(-omega * ((a * jnp.sin(psi[:, None] - psi[None, :])) @ omega))


def sinc(s: Float[Array, "..."]) -> Float[Array, "..."]:
    """sin(s)/s, smooth at 0 with all its derivatives (a series near 0, to rounding)."""
    near = jnp.abs(s) < 0.3
    far = jnp.where(near, jnp.ones_like(s), s)
    s2 = jnp.where(near, s, jnp.zeros_like(s)) ** 2
    series = 1 - s2 / 6 * (1 - s2 / 20 * (1 - s2 / 42 * (1 - s2 / 72 * (1 - s2 / 110))))
    return jnp.where(near, series, jnp.sin(far) / far)


def tip_pose(chain: Chain, q: Joints) -> Float[Array, "3"]:
    """The tip in the base frame: lateral x [m, + toward tendon_left], axial y [m], orientation q_Σ [rad].

    Constant-curvature form: x = Σ 2l·sinc(qᵢ/2)·sin(ψᵢ₋₁ + qᵢ/2), y likewise with the cosine.
    """
    middle = absolute_angles(q) - q / 2
    chord = 2 * chain.half_length_m * sinc(q / 2)
    return jnp.stack([jnp.sum(chord * jnp.sin(middle)), jnp.sum(chord * jnp.cos(middle)), jnp.sum(q)])


def tip_jacobian(chain: Chain, q: Joints) -> Float[Array, "3 n"]:
    """∂(x, y, q_Σ)/∂q; its first row is a = l·(2n−1, …, 3, 1) at q = 0. τ_ext = J[:2]ᵀf for a tip force f [N]."""
    return jax.jacfwd(lambda x: tip_pose(chain, x))(q)


def lateral_jacobian(chain: Chain, q: Joints) -> Joints:
    """∂x/∂q [m], the lateral tip Jacobian a."""
    return tip_jacobian(chain, q)[0]


def constant_curvature(theta: Scalar, n: int) -> Joints:
    """q = (θ, …, θ): every segment bent by the mean segment angle θ [rad]."""
    return jnp.full((n,), theta)
