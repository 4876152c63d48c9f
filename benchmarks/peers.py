"""Other simulators on the same robots and commands: each a function from a task to the time it took and its motion."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.compiled import library, numbers_of
from benchmarks.fleet import of_one
from ljjax.dynamics import State, rhs
from ljjax.inputs import Inputs
from ljjax.model import Model


class Task(NamedTuple):
    """Robots, commands and first states, the robots in front."""

    models: Model
    inputs: Inputs
    states: State

    def some(self, robots: int) -> Task:
        """The first few robots."""
        keep = lambda x: x[:robots]  # noqa: E731
        u = Inputs(self.inputs.t, keep(self.inputs.tendons), keep(self.inputs.pressure_kpa), hold=self.inputs.hold)
        return Task(jax.tree.map(keep, self.models), u, jax.tree.map(keep, self.states))


Simulator = Callable[[], np.ndarray]
"""Simulates every robot of a task, when called; q (robots, T, n) [rad] at the stamps of the commands."""


def diffrax_vmap(task: Task, solver: Any, rtol: float, atol: float) -> Simulator:
    """diffrax with its own defaults under vmap; where commands are held, steps end where they jump."""
    t = task.inputs.t
    steps: Any = diffrax.PIDController(rtol=rtol, atol=atol)
    if task.inputs.hold:
        steps = diffrax.ClipStepSizeController(steps, jump_ts=t)

    def one(model: Model, tendons: Any, vacuum: Any, state: State) -> Any:
        given = of_one(task.inputs, tendons, vacuum)
        out = diffrax.diffeqsolve(
            diffrax.ODETerm(lambda t, y, _: rhs(model, y, *given.at(jnp.asarray(t)))),
            solver,
            t0=t[0],
            t1=t[-1],
            dt0=None,
            y0=state,
            saveat=diffrax.SaveAt(ts=t, fn=lambda t, y, _: y.q),
            stepsize_controller=steps,
            max_steps=None,
            adjoint=diffrax.ForwardMode(),
            throw=False,
        )
        return out.ys

    u = task.inputs
    run = jax.jit(jax.vmap(one)).lower(task.models, u.tendons, u.pressure_kpa, task.states).compile()
    return lambda: np.asarray(run(task.models, u.tendons, u.pressure_kpa, task.states))


class _Plain:
    """The compiled right-hand side, one robot after the other, for solvers that take y' = f(t, y)."""

    def __init__(self, task: Task):
        self.t = np.asarray(task.inputs.t)
        self.numbers = numbers_of(task.models)
        u = np.asarray(task.inputs.tendons)
        drive = np.stack([u[..., 0] - u[..., 1], np.asarray(task.inputs.pressure_kpa)], axis=-1)
        self.drive = np.ascontiguousarray(drive)
        self.first = np.concatenate([np.asarray(x) for x in task.states], axis=1)
        self.call = library("rhs.c").rhs
        self.call.restype = None

    def into(self, robot: int) -> Callable[[float, np.ndarray, np.ndarray], None]:
        """f(t, y, out) of one robot."""
        fixed = (
            ctypes.c_void_p(self.numbers[robot].ctypes.data),
            ctypes.c_void_p(self.drive[robot].ctypes.data),
            ctypes.c_int(len(self.t)),
            ctypes.c_double(self.t[1] - self.t[0]),
        )
        call, double, pointer = self.call, ctypes.c_double, ctypes.c_void_p
        return lambda t, y, out: call(double(t), pointer(y.ctypes.data), pointer(out.ctypes.data), *fixed)


def cvode(task: Task, rtol: float, atol: float) -> Simulator:
    """SUNDIALS CVODE (BDF, Newton, dense) through scikit-sundae, the right-hand side compiled."""
    from sksundae.cvode import CVODE  # pyright: ignore[reportMissingImports]

    plain = _Plain(task)

    def run() -> np.ndarray:
        out = []
        for i, first in enumerate(plain.first):
            solver = CVODE(plain.into(i), rtol=rtol, atol=atol, max_num_steps=1_000_000)
            out.append(solver.solve(plain.t, first).y[:, :6])
        return np.stack(out)

    return run


def scipy_radau(task: Task, rtol: float, atol: float) -> Simulator:
    """SciPy's Radau (implicit Runge-Kutta of order 5), the right-hand side compiled."""
    from scipy.integrate import solve_ivp

    plain = _Plain(task)

    def run() -> np.ndarray:
        out = []
        for i, first in enumerate(plain.first):
            f = plain.into(i)

            def rates(t, y, f=f):
                dy = np.empty_like(y)
                f(t, np.ascontiguousarray(y), dy)
                return dy

            span = (plain.t[0], plain.t[-1])
            out.append(solve_ivp(rates, span, first, "Radau", plain.t, rtol=rtol, atol=atol).y[:6].T)
        return np.stack(out)

    return run


def casadi_cvodes(task: Task, rtol: float, atol: float) -> Simulator:
    """CasADi's interface to SUNDIALS CVODES: symbolic right-hand side, exact Jacobian, commands by interpolation."""
    import casadi  # pyright: ignore[reportMissingImports]

    plain = _Plain(task)
    cs: Any = casadi
    n, stamps = 6, len(plain.t)
    y, p, u = cs.SX.sym("y", 3 * n), cs.SX.sym("p", plain.numbers.shape[1]), cs.SX.sym("u", 2)
    q, v, z = y[:n], y[n : 2 * n], y[2 * n :]
    lever, alpha1, c1, c2, c3, c4, c5, s0, s1, s2, s3, mu_c, mu_s, v_s = (p[i] for i in range(14))
    a, j = cs.reshape(p[14 : 14 + n * n], n, n), p[14 + n * n :]
    psi, omega = cs.cumsum(q), cs.cumsum(v)
    turn = cs.repmat(psi, 1, n) - cs.repmat(psi.T, n, 1)
    total = cs.DM(np.tril(np.ones((n, n))))
    mass = total.T @ (a * cs.cos(turn) + cs.diag(j)) @ total
    coriolis = total.T @ ((a * cs.sin(turn)) @ omega**2)
    alpha2, phi = (c1 * u[1] + c2) * u[1] + c3, c4 + c5 * u[1] / cs.sqrt(u[1] + 1e-4)
    rho = mu_c + (mu_s - mu_c) * cs.exp(-((cs.fabs(v) / v_s + 1e-12) ** s3))
    rate = v - s0 * cs.fabs(v) / rho * z
    torque = lever * u[0] - alpha1 * cs.sin(psi[-1]) - alpha2 * q - phi * (s0 * z + s1 * rate + s2 * v) - coriolis
    ode = cs.vertcat(v, cs.solve(mass, torque), rate)
    options = {"reltol": rtol, "abstol": atol, "max_num_steps": 1_000_000}
    rates = cs.Function("rates", [y, p, u], [ode])
    t, state, given = cs.MX.sym("t"), cs.MX.sym("y", 3 * n), cs.MX.sym("p", p.numel() + 2 * stamps)
    command = cs.interpolant("u", "linear", [plain.t.tolist()], 2)(t, given[p.numel() :])
    ode = rates(state, given[: p.numel()], command)
    f = cs.integrator("f", "cvodes", {"t": t, "x": state, "p": given, "ode": ode}, 0.0, plain.t[1:].tolist(), options)

    def run() -> np.ndarray:
        out = []
        for first, numbers, drive in zip(plain.first, plain.numbers, plain.drive, strict=True):
            found = np.asarray(f(x0=first, p=np.concatenate([numbers, drive.ravel()]))["xf"])[:n].T
            out.append(np.concatenate([first[None, :n], found]))
        return np.stack(out)

    return run


def mujoco_rollout(task: Task, step_s: float, threads: int) -> Simulator:
    """MuJoCo's `rollout` of the same chain under the same commands, the friction another: MuJoCo knows no LuGre, so
    joints have its `stiffness` α₂, `damping` φσ₂ and `frictionloss` φμ_C at 20 kPa. Its motion is not ours."""
    import mujoco as _mujoco
    from mujoco import rollout as _rollout

    from ljjax import energy
    from ljjax.model import get

    mujoco: Any = _mujoco
    rollout: Any = _rollout
    vacuum = jnp.asarray(20.0)
    alpha2, phi = (np.asarray(jax.vmap(lambda m, f=f: f(m, vacuum))(task.models)) for f in (energy.alpha2, energy.phi))
    robots, n = task.states.q.shape
    paths = ("chain.half_length_m", "chain.radius_m", "chain.segment_mass_kg", "friction.sigma2", "friction.mu_c")
    numbers = np.stack([np.asarray(get(task.models, path)) for path in paths], axis=1)
    chains = []
    for k in range(robots):
        half, radius, mass, sigma2, mu_c = numbers[k]
        joint = (
            f'<joint type="hinge" axis="0 1 0" stiffness="{alpha2[k]}" damping="{phi[k] * sigma2}" '
            f'frictionloss="{phi[k] * mu_c}"/>'
        )
        body = ""
        for i in range(n):
            length, weight = (half, mass / 2) if i == n - 1 else (2 * half, mass)
            body += (
                f'<body pos="0 0 {half if i == 0 else 2 * half}">{joint}<geom type="cylinder" '
                f'size="{radius} {length / 2}" pos="0 0 {length / 2}" mass="{weight}" contype="0" conaffinity="0"/>'
            )
        chains.append(
            mujoco.MjModel.from_xml_string(
                f'<mujoco><compiler angle="radian"/><option timestep="{step_s}" integrator="implicitfast" '
                f'gravity="0 0 0"/><worldbody>{body}{"</body>" * n}</worldbody></mujoco>'
            )
        )
    t = np.asarray(task.inputs.t)
    u = np.asarray(task.inputs.tendons)
    steps, every = round(t[-1] / step_s), round((t[1] - t[0]) / step_s)
    middle = (np.arange(steps) + 0.5) * step_s
    pull = np.asarray(get(task.models, "chain.lever_arm_m"))[:, None] * (u[..., 0] - u[..., 1])
    torque = np.stack([np.interp(middle, t, x) for x in pull])[..., None] * np.ones(n)
    data = [mujoco.MjData(chains[0]) for _ in range(threads)]
    first = np.stack([np.zeros(mujoco.mj_stateSize(m, mujoco.mjtState.mjSTATE_FULLPHYSICS)) for m in chains])
    applied = int(mujoco.mjtState.mjSTATE_QFRC_APPLIED)

    def run() -> np.ndarray:
        states, _ = rollout.rollout(chains, data, first, torque, control_spec=applied)
        return np.concatenate([np.zeros((robots, 1, n)), states[:, every - 1 :: every, 1 : 1 + n]], axis=1)

    return run
