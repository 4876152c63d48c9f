"""The chain: against MuJoCo, against quadrature, against finite differences (model section 2)."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco as _mujoco
import numpy as np
import pytest

from ljjax import chain as chain_of
from ljjax.energy import kinetic

mujoco: Any = _mujoco  # its stubs leave most of it out
SEGMENTS = [(6, 100), (1, 20), (2, 20), (9, 20)]
GRAVITY = 9.81


class Reference(NamedTuple):
    mass: np.ndarray
    bias: np.ndarray
    weight: np.ndarray


def mjcf(n: int, half_length: float, radius: float, mass: float) -> str:
    """The chain of model section 2, unbent along z; a positive q turns z toward x. MuJoCo derives the inertia."""
    text = ""
    for i in range(n):
        length = half_length if i == n - 1 else 2 * half_length
        weight = mass / 2 if i == n - 1 else mass
        offset = half_length if i == 0 else 2 * half_length
        text += (
            f'<body pos="0 0 {offset!r}"><joint type="hinge" axis="0 1 0"/>'
            f'<geom type="cylinder" size="{radius!r} {length / 2!r}" pos="0 0 {length / 2!r}" mass="{weight!r}" '
            'contype="0" conaffinity="0"/>'
        )
    return f'<mujoco><compiler angle="radian"/><worldbody>{text}{"</body>" * n}</worldbody></mujoco>'


def in_mujoco(n: int, chain: chain_of.Chain, q: np.ndarray, v: np.ndarray) -> Reference:
    sizes = (float(chain.half_length_m), float(chain.radius_m), float(chain.segment_mass_kg))
    spec = mujoco.MjModel.from_xml_string(mjcf(n, *sizes))
    data = mujoco.MjData(spec)

    def bias(angles, rates, gravity):
        spec.opt.gravity[:] = [0, 0, -gravity]
        data.qpos[:], data.qvel[:] = angles, rates
        mujoco.mj_forward(spec, data)
        return data.qfrc_bias.copy()

    masses, biases, weights = [], [], []
    for angles, rates in zip(q, v, strict=True):
        biases.append(bias(angles, rates, 0.0))
        weights.append(bias(angles, 0 * rates, GRAVITY))
        full = np.zeros((n, n))
        mujoco.mj_fullM(spec, data, full)
        masses.append(full)
    return Reference(np.array(masses), np.array(biases), np.array(weights))


def heights_energy(chain: chain_of.Chain, q):
    """Σ m g h of the links, h from ljjax's absolute angles."""
    n = chain.segments
    last = np.arange(n) == n - 1
    length = chain.half_length_m * jnp.asarray(np.where(last, 1.0, 2.0))
    rise = length * jnp.cos(chain_of.absolute_angles(q))
    centre = jnp.cumsum(rise) - rise / 2
    return GRAVITY * chain.segment_mass_kg * jnp.sum(jnp.asarray(np.where(last, 0.5, 1.0)) * centre)


def states(n: int, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.uniform(-1.5, 1.5, (count, n)), rng.normal(scale=3, size=(count, n))


@pytest.mark.parametrize(("n", "count"), SEGMENTS)
def test_mujoco_has_the_same_chain(robot, n, count):
    """M(q) and C(q, v)v are MuJoCo's. Its gravity forces are the gradient of Σ m g h over ψᵢ = q₁ + … + qᵢ: that
    proves the placing of joints and link centres and the sign of q alike on both sides. The model's own gravity is
    one measured coefficient, α₁ sin q_Σ, and is not meant to equal this."""
    chain = robot(n).chain
    q, v = states(n, count)
    expected = in_mujoco(n, chain, q, v)
    got = Reference(
        *jax.jit(
            lambda q, v: (
                jax.vmap(partial(chain_of.mass_matrix, chain))(q),
                jax.vmap(partial(chain_of.coriolis_forces, chain))(q, v),
                jax.vmap(jax.grad(partial(heights_energy, chain)))(q),
            )
        )(jnp.asarray(q), jnp.asarray(v))
    )
    for name in Reference._fields:
        a, b = np.asarray(getattr(got, name)), getattr(expected, name)
        error, scale = (np.abs(x).reshape(count, -1).max(axis=1) for x in (a - b, b))
        assert np.all(error <= 1e-9 * scale + 1e-17), name
    if n > 1:
        assert np.abs(expected.bias).max() > 1e-4  # there is something to compare


@pytest.mark.parametrize("n", [1, 3, 6])
def test_mass_is_symmetric_and_positive(robot, n):
    m = np.asarray(jax.vmap(partial(chain_of.mass_matrix, robot(n).chain))(jnp.asarray(states(n, 50)[0])))
    np.testing.assert_allclose(m, m.transpose(0, 2, 1), rtol=1e-14)
    assert np.linalg.eigvalsh(m).min() > 0


@pytest.mark.parametrize("n", [1, 3, 6])
def test_inertia_forces_and_kinetic_energy_agree(robot, n):
    """∂T/∂q is the closed form, and d/dt ½vᵀMv = v·(Mv̇ + C v): Ṁ − 2C does no work."""
    model = robot(n)
    chain = model.chain
    accelerations = states(n, 20, seed=1)[1]

    @jax.jit
    @jax.vmap
    def compare(q, v, a):
        gradient = jax.grad(partial(kinetic, model))(q, v)
        _, power = jax.jvp(partial(kinetic, model), (q, v), (v, a))
        force = chain_of.mass_matrix(chain, q) @ a + chain_of.coriolis_forces(chain, q, v)
        return gradient, chain_of.kinetic_gradient(chain, q, v), power, v @ force

    gradient, closed, power, work = compare(*(jnp.asarray(x) for x in (*states(n, 20), accelerations)))
    np.testing.assert_allclose(closed, gradient, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(work, power, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("n", [1, 4])
def test_tip_is_the_end_of_arcs(robot, n):
    """The tip is ∫(sin, cos) of the tangent angle along the body, by Gauss quadrature over every segment."""
    chain = robot(n).chain
    nodes, weights = np.polynomial.legendre.leggauss(20)
    q = states(n, 1)[0][0]
    start = np.concatenate([[0.0], np.cumsum(q)[:-1]])
    angle = start[:, None] + q[:, None] * (nodes + 1) / 2
    l = float(chain.half_length_m)  # noqa: E741
    expected = [(l * weights * np.sin(angle)).sum(), (l * weights * np.cos(angle)).sum(), q.sum()]
    np.testing.assert_allclose(chain_of.tip_pose(chain, jnp.asarray(q)), expected, rtol=1e-13)


@pytest.mark.parametrize("theta", [0.3, -0.7, 1e-3, 1e-9])
def test_equal_angles_make_one_arc(robot, theta):
    """All q = θ: an arc of length 2nl and angle nθ, with the chord 2(2nl/nθ) sin(nθ/2)."""
    n, chain = 6, robot(6).chain
    length, angle = 2 * n * float(chain.half_length_m), n * theta
    x, y, turn = np.asarray(chain_of.tip_pose(chain, chain_of.constant_curvature(jnp.asarray(theta), n)))
    np.testing.assert_allclose(np.hypot(x, y), length * np.sinc(angle / 2 / np.pi), rtol=1e-13)
    np.testing.assert_allclose(np.arctan2(x, y), angle / 2, rtol=1e-13)
    np.testing.assert_allclose(turn, angle, rtol=1e-14)


@pytest.mark.parametrize("q", [np.zeros(4), np.array([0.3, -0.8, 0.0, 1.2]), np.full(4, 0.2999999)])
def test_tip_jacobian_against_differences(robot, q):
    chain = robot(4).chain
    pose = jax.jit(partial(chain_of.tip_pose, chain))
    h = 1e-5
    differences = [(pose(jnp.asarray(q + h * e)) - pose(jnp.asarray(q - h * e))) / (2 * h) for e in np.eye(4)]
    jacobian = chain_of.tip_jacobian(chain, jnp.asarray(q))
    np.testing.assert_allclose(jacobian, np.stack(differences, axis=1), atol=1e-10)
    np.testing.assert_allclose(chain_of.lateral_jacobian(chain, jnp.asarray(q)), jacobian[0], rtol=1e-14)


@pytest.mark.parametrize("n", [1, 2, 6])
def test_lateral_jacobian_when_straight(robot, n):
    chain = robot(n).chain
    expected = float(chain.half_length_m) * np.arange(2 * n - 1, 0, -2)
    np.testing.assert_allclose(chain_of.lateral_jacobian(chain, jnp.zeros(n)), expected, rtol=1e-14)


@pytest.mark.parametrize("order", [0, 1, 2, 3])
def test_sinc_is_smooth_where_its_two_forms_meet(order):
    """Value and derivatives at 0, on both sides of the seam at 0.3, and beyond, against the defining integral."""
    f = chain_of.sinc
    for _ in range(order):
        f = jax.grad(f)
    nodes, weights = np.polynomial.legendre.leggauss(30)
    k, w = (nodes + 1) / 2, weights / 2  # sin(s)/s = ∫₀¹ cos(ks) dk
    for s in (0.0, 1e-8, 0.2999, 0.3001, -1.7):
        expected = (w * k**order * np.cos(k * s + order * np.pi / 2)).sum()
        assert abs(float(f(jnp.asarray(s))) - expected) < 1e-11, s
