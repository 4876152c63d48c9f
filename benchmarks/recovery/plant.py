"""A simulator of the robot that shares nothing with ljjax but the equations of docs/model.md: NumPy, many robots at
once.

It works in absolute angles ψᵢ = q₁ + … + qᵢ, where M_ab = A_ab cos(ψ_a − ψ_b), by an implicit midpoint rule for (v, z)
with z eliminated, between two half-steps of q: second order, and stable in the stiff friction. Arrays are (n, B): batch
last.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Robots = Mapping[str, Array]
"""Parameters by path (`friction.mu_s`), each (B,); σ₀ = 1 rad⁻¹."""

STEP_S = 5e-4


class Plant:
    """B robots of n segments."""

    def __init__(self, robots: Robots, n: int = 6):
        self.n, self.p = n, {path.split(".")[1]: np.asarray(x, float) for path, x in robots.items()}
        half_length, mass = self.p["half_length_m"], self.p["segment_mass_kg"]
        share = np.array([1.0] * (n - 1) + [0.5])  # of a full link's length and mass, for each link
        self.inertia = np.zeros((n, n, len(mass)))  # A_ab [kg·m²]
        for b in range(n):
            own, length = mass * share[b], 2 * half_length * share[b]
            beyond = mass * share[b + 1 :].sum()
            radius2 = self.p["radius_m"] ** 2 / 4 + length**2 / 12  # of gyration, squared
            self.inertia[b, b] = own * (radius2 + length**2 / 4) + beyond * length**2
            # A link a nearer the base carries b's centre, and all beyond b at b's end, on its own full length.
            carried = 2 * half_length * (own * length / 2 + beyond * length)
            self.inertia[b, :b] = self.inertia[:b, b] = carried

    def alpha2(self, pressure_kpa: Array) -> Array:
        """α₂(u_P) [N·m/rad]."""
        return self.p["c1"] * pressure_kpa**2 + self.p["c2"] * pressure_kpa + self.p["c3"]

    def phi(self, pressure_kpa: Array) -> Array:
        """φ(u_P) [N·m]."""
        return self.p["c4"] + self.p["c5"] * np.sqrt(pressure_kpa)

    def net_tension(self, theta: Array | float, pressure_kpa: Array | float) -> Array:
        """u₁ − u₂ [N] that holds every joint at θ, without friction."""
        p, pressure = self.p, np.asarray(pressure_kpa, float)
        return (p["alpha1"] * np.sin(self.n * theta) + self.alpha2(pressure) * theta) / p["lever_arm_m"]

    def tip_stiffness(self, pressure_kpa: Array | float) -> Array:
        """K_T [N/m] at rest at q = 0: 1/(aᵀK⁻¹a), K = α₁ 1_{n×n} + (α₂ + σ₀φ) I, by Sherman–Morrison."""
        pressure = np.asarray(pressure_kpa, float)
        joint, alpha1 = self.alpha2(pressure) + self.phi(pressure), self.p["alpha1"]
        a = 2 * np.arange(self.n, 0, -1) - 1  # lateral tip Jacobian over l
        compliance = (a @ a - alpha1 * a.sum() ** 2 / (joint + self.n * alpha1)) / joint
        return 1 / (compliance * self.p["half_length_m"] ** 2)

    def run(
        self,
        tendons: Array,
        pressure_kpa: Array,
        period_s: float,
        step_s: float = STEP_S,
    ) -> Array:
        """Motions from straight rest, under inputs that hold for `period_s` each.

        Args:
            tendons: (T, 2, B) tensions [N].
            pressure_kpa: (T, B) vacuum u_P.
            step_s: length of a step, rounded to a whole number of steps a period.

        Returns (T, n, B): q [rad] at the start of each period.
        """
        n, p, count = self.n, self.p, tendons.shape[2]
        substeps = max(1, round(period_s / step_s))
        half = period_s / substeps / 2
        over_half = self.inertia / half
        mu_c, drop, v_s = p["mu_c"], p["mu_s"] - p["mu_c"], p["v_s"]
        sigma2, sigma3, alpha1 = p["sigma2"], p["sigma3"], p["alpha1"]
        memory = p["sigma1"] / half  # σ₁ż = memory (z_mid − z)

        q, v, z, gain = (np.zeros((n, count)) for _ in range(4))
        out = np.empty((len(tendons), n, count))
        matrix = np.empty((n, n + 1, count))
        flat = matrix.reshape(n * (n + 1), count)
        diagonal, upper, lower = flat[:: n + 2], flat[1 : -n - 1 : n + 2], flat[n + 1 :: n + 2]

        def friction(v: Array) -> tuple[Array, Array, Array, Array]:
            """z at mid-step by its own equation, τ_f/φ there, and each one's derivative by v."""
            s = np.abs(v)
            x = np.exp(sigma3 * np.log(s / v_s + 1e-300))
            g = drop * np.exp(-x)
            rho = mu_c + g
            scale = 1 + half * s / rho
            mid = (z + half * v) / scale
            slope = np.sign(v) / rho * (1 + g * sigma3 * x / rho)  # of |v|/ρ
            d_mid = half * (1 - slope * mid) / scale
            return mid, d_mid, (1 + memory) * mid - memory * z + sigma2 * v, (1 + memory) * d_mid + sigma2

        def improve(mid_v: Array) -> tuple[Array, Array]:
            """One Newton iteration of M Δω/(h/2) + forces = 0 in absolute angles: v and z at mid-step."""
            mid_z, d_mid, tau, d_tau = friction(mid_v)
            joint, damping = held + phi * tau, phi * d_tau
            right = load + np.einsum("abk,bk->ak", mass, np.cumsum(mid_v - v, axis=0)) + joint
            right[:-1] -= joint[1:]  # ∂/∂ψ_a = ∂/∂q_a − ∂/∂q_{a+1}
            matrix[:, :n], matrix[:, n] = mass, -right
            diagonal[:] += damping
            diagonal[:-1] += damping[1:]
            upper[:] -= damping[1:]
            lower[:] -= damping[1:]
            change = np.diff(_solve(matrix), axis=0, prepend=0)
            return mid_v + change, mid_z + d_mid * change

        for k in range(len(tendons)):
            out[k] = q
            alpha2, phi = self.alpha2(pressure_kpa[k]), self.phi(pressure_kpa[k])
            pull = p["lever_arm_m"] * (tendons[k, 0] - tendons[k, 1])
            for _ in range(substeps):
                q = q + half * v
                psi = np.cumsum(q, axis=0)
                cos, sin = np.cos(psi), np.sin(psi)
                mass = over_half * (cos[:, None] * cos + sin[:, None] * sin)
                mid_v = v + gain  # last step's gain, to begin with
                spun = half * np.cumsum(mid_v, axis=0) ** 2
                load = sin * np.einsum("abk,bk->ak", over_half, cos * spun)
                load -= cos * np.einsum("abk,bk->ak", over_half, sin * spun)
                load[-1] += alpha1 * sin[-1] - pull
                held = alpha2 * q
                mid_v, mid_z = improve(improve(mid_v)[0])  # once is unstable
                gain = mid_v - v
                v, z = v + 2 * gain, 2 * mid_z - z
                q = q + half * v
        return out


def _solve(matrix: Array) -> Array:
    """Gauss elimination of (n, n + 1, B), destroyed; positive definite systems need no pivots."""
    n = len(matrix)
    for k in range(n - 1):
        factor = matrix[k + 1 :, k] / matrix[k, k]
        matrix[k + 1 :, k + 1 :] -= factor[:, None] * matrix[k, k + 1 :]
    x = np.empty_like(matrix[:, n])
    for k in reversed(range(n)):
        x[k] = matrix[k, n] / matrix[k, k]
        matrix[:k, n] -= matrix[:k, k] * x[k]
    return x
