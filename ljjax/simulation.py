"""Simulate a run: by the fast fixed-step solver, or the reference, diffrax's adaptive, L-stable Kvaerno5."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from ljjax import energy, fast, step
from ljjax._types import Joints, Scalar
from ljjax.chain import tip_pose
from ljjax.dynamics import State, pressure_power, rhs, tendon_torque
from ljjax.errors import InputError, SolverError
from ljjax.friction import dissipation
from ljjax.inputs import Inputs, from_run
from ljjax.logs.run import Run
from ljjax.model import Model, check
from ljjax.step import Drive, at_rest, unroll

ITERATIONS = 3
"""Newton iterations a stage of the fast solver: two simulate as well, the third is for derivatives."""


SENSITIVE_RAD = 1e-3
"""A motion that halving the step moves by more than this is flagged: at 2.5 ms others move by 1e-5 to 1e-4."""


class Trajectory(NamedTuple):
    """A simulated run.

    Attributes:
        t: (T,) stamps [s].
        state: q, v, z, each (T, n).
        ok: whether the solver reached the last stamp; where False the states after the failure are not finite.
        steps: steps the solver took.
        seen: (T, n) the joint angles that are logged [rad]: q, but for effects of sensing.
        error: the largest error of an angle [rad], by step halving; None where that was not asked for.
    """

    t: Float[Array, "*batch T"]
    state: State
    ok: Bool[Array, "*batch"]
    steps: Array
    seen: Array
    error: Array | None = None

    @property
    def sensitive(self) -> Array | None:
        """Whether the motion depends on the step by more than `SENSITIVE_RAD`: stick-slip, as a rule. Such a run is
        one of many that the model allows; do not average it in silently. None where no error was estimated."""
        return None if self.error is None else self.error > SENSITIVE_RAD

    @property
    def theta(self) -> Array:
        """(T,) mean segment angle [rad]."""
        return jnp.mean(self.state.q, axis=-1)

    def tip(self, model: Model) -> Array:
        """(T, 3) tip x, y [m] and orientation q_Σ [rad]."""
        return jax.vmap(lambda q: tip_pose(model.chain, q))(self.state.q)


def rest(model: Model, inputs: Inputs, q: Joints | float = 0.0) -> State:
    """Rest at the shape q (n,) [rad] under the first inputs: z balances the forces, within |zᵢ| ≤ μ_S/σ₀."""
    shape = jnp.broadcast_to(jnp.asarray(q, inputs.t.dtype), (model.n,))
    found = at_rest(model, unroll(shape), _first(inputs))
    return State(*(jnp.stack(x) for x in (found.q, found.v, found.z)))


def unsensed(model: Model, inputs: Inputs, q: Joints) -> Joints:
    """(n,) the joint angles that are [rad] under the first inputs, from those logged at rest: effects of sensing
    undone."""
    return jnp.stack(step.unsensed(model, unroll(q), unroll(0.0 * q), _first(inputs)))


def _first(inputs: Inputs) -> Drive:
    u, u_p, tau = inputs.at(inputs.t[0])
    return Drive(u[0], u[1], u_p, None if tau is None else unroll(tau), t=inputs.t[0])


def simulate(
    model: Model,
    run: Run | Inputs,
    *,
    at: Any = None,
    initial: State | None = None,
    inputs: Literal["commands", "measured"] = "commands",
    method: Literal["fast", "reference"] = "fast",
    step_s: float = 0.0025,
    errors: bool = False,
    rtol: float = 1e-6,
    atol: float = 1e-8,
    max_steps: int = 1_000_000,
    derivatives: Literal["reverse", "forward"] = "reverse",
    throw: bool = True,
) -> Trajectory:
    """The model's motion under a run's inputs, at given stamps.

    `"fast"` is the fixed-step solver made for this model (`ljjax.step`), differentiable in both modes; `"reference"` is
    diffrax's adaptive Kvaerno5, much slower, against which it is checked.

    Args:
        run: a logged run, or synthetic `Inputs`.
        at: (T,) stamps [s] at which to report; a run's shape stamps, or the inputs' own, by default.
        initial: state at the first of all stamps; by default at rest, in the shape the run shows before its commands
            move (straight for synthetic inputs).
        inputs: drive a logged run by its commands or by its measured tension and pressure.
        method: `"fast"` or `"reference"`. The following but the last are of one of them alone.
        step_s: (fast) length of a step [s]; inputs are averaged over steps.
        errors: (fast) estimate the error by halving the step, at three times the cost: `Trajectory.error`.
        rtol, atol: (reference) tolerances of the adaptive step, on q [rad], v [rad/s], z [rad]. float32 takes 1e-4
            and 1e-6.
        max_steps: (reference) after which the solver gives up.
        derivatives: (reference) which mode of differentiation is to work (jax.grad, or jax.jvp and jax.jacfwd).
        throw: raise where the solver fails; otherwise `Trajectory.ok` says so, and a batch survives.

    Raises:
        InputError: missing signals, or parameters that are impossible within the run's pressures.
        SolverError: the solver failed, with advice (`throw=True` only).
    """
    if isinstance(run, Run):
        driven = from_run(run, inputs)
        at = run.signal("shape").t if at is None else at
        if initial is None:
            initial = rest(model, driven, unsensed(model, driven, initial_shape(run, model.n)))
        where = run.path
    else:
        driven, where = run, "inputs"
        at = driven.t if at is None else at
    for name in ("t", "tendons", "pressure_kpa", "torque"):
        x = getattr(driven, name)
        if x is not None and not isinstance(x, Tracer) and not np.isfinite(np.asarray(x)).all():
            raise InputError(f"{where}: inputs: {name} holds values that are not finite numbers")
    for name, x in (("t", driven.t), ("at", at)):
        if not isinstance(x, Tracer) and np.any(np.diff(np.asarray(x)) < 0):
            raise InputError(f"{where}: the stamps {name} go back in time; sort them")
    if not isinstance(driven.pressure_kpa, Tracer):
        check(model, np.asarray(driven.pressure_kpa).ravel().tolist(), where)
    initial = rest(model, driven) if initial is None else initial
    stamps = jnp.asarray(at, driven.t.dtype)
    if method == "fast":
        if isinstance(driven.t, Tracer) or isinstance(at, Tracer):
            raise InputError(f"{where}: stamps must be known; under jit or vmap over stamps use ljjax.fast.run")
        if not step_s > 0:
            raise InputError(f"{where}: step_s is {step_s}; expected a length > 0 [s]")
        start, steps = fast.grid(driven, at, step_s)
        first, h = jnp.asarray(start, stamps.dtype), jnp.asarray(step_s, stamps.dtype)
        out = _fast(model, driven, initial, stamps, first, h, steps, errors)
    elif method == "reference":
        if model.effects:
            raise InputError(f"{where}: the reference solver knows no effects; use method='fast', or remove them")
        out = _solve(model, driven, initial, stamps, rtol, atol, max_steps, derivatives)
    else:
        raise InputError(f"method is {method!r}; expected 'fast' or 'reference'")
    if throw and not isinstance(out.ok, Tracer) and not bool(jnp.all(out.ok)):
        last = float(out.t[np.isfinite(np.asarray(out.state.q[:, 0]))].max(initial=0.0))
        raise SolverError(
            f"{where}: the {method} solver stopped after t = {last:.4g} s and {int(out.steps)} steps. Try "
            + ("a smaller step_s" if method == "fast" else "a larger max_steps, looser tolerances")
            + ", or float64 (jax.config.update('jax_enable_x64', True))."
        )
    return out


@eqx.filter_jit
def _fast(model, inputs, initial, at, start, h, steps, errors: bool) -> Trajectory:
    given = (model, inputs, initial, at, start, h, steps, ITERATIONS)
    motion, error = fast.halved(*given) if errors else (fast.run(*given), None)
    finite = jnp.stack([jnp.all(jnp.isfinite(x)) for x in motion])
    steps = jnp.asarray(2 * steps if errors else steps)
    return Trajectory(at, State(*motion[:3]), jnp.all(finite), steps, motion.seen, error)


def check_joints(run: Run, n: int) -> None:
    """Raise InputError where a run's shape is neither θ nor the angles of n joints."""
    shape = run.signals.get("shape")
    if shape is not None and (joints := shape.value.shape[1]) not in (1, n):
        raise InputError(
            f"{run.path}: {shape.topic}: {joints} joint angles for a model of {n} segments; "
            "give a model with chain.segments to match"
        )


def initial_shape(run: Run, n: int) -> Array:
    """(n,) the shape [rad] a run starts from: the mean of the samples before its commands first change, in the first
    second; the first sample at least, and alone where no commands are logged. Joints share θ where only θ is logged."""
    shape = run.signal("shape")
    moves = []
    for name in ("cmd_tendons", "cmd_pressure"):
        if name in run.signals:
            s = run.signals[name]
            changed = np.flatnonzero(np.any(s.value != s.value[0], axis=1))
            moves += [s.t[changed[0]]] if len(changed) else []
            moves += [shape.t[0] + 1.0]
    still = shape.t <= min(moves, default=shape.t[0])
    still[0] = True
    mean = shape.value[still].mean(axis=0)
    check_joints(run, n)
    return jnp.broadcast_to(jnp.asarray(mean, float), (n,))


class _WithinStep(diffrax.Kvaerno5):
    """Kvaerno5 that tells the vector field where its step began, as `args`.

    Its third stage lies at 1.23 of the step. Seen from there an input that jumps at the end of the step has jumped
    already, and the step is rejected again and again on the way to every stamp.
    """

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        return super().step(terms, t0, t1, y0, t0, solver_state, made_jump)


def _solver(rtol: float, atol: float, dtype: Any) -> diffrax.AbstractSolver:
    """The solver, whose stages are found to the step's tolerances, or to rounding where those ask for more.

    diffrax's default root finder compares successive chord updates and takes rounding noise at rest for divergence:
    the step then shrinks to nothing while the robot stands still. Newton's method does not, unless asked for more
    than rounding leaves of forces of 1 N·m on links of 1e-5 kg·m².
    """
    rounding = 1e5 * float(jnp.finfo(dtype).eps)
    return _WithinStep(root_finder=optimistix.Newton(rtol=rtol, atol=max(atol, rounding)))


def _integrate(field: Callable, inputs: Inputs, y0: Any, at: Array, rtol, atol, max_steps, derivatives="reverse"):
    """Integrate y' = field(t, y, t₀) from the first stamp through `at`, restarting at every stamp of the inputs; t₀ is
    the beginning of the step."""
    start = jnp.minimum(inputs.t[0], at[0])
    return diffrax.diffeqsolve(
        diffrax.ODETerm(field),
        _solver(rtol, atol, at.dtype),
        t0=start,
        t1=at[-1],
        dt0=None,
        y0=y0,
        args=start,
        saveat=diffrax.SaveAt(ts=at),
        stepsize_controller=diffrax.ClipStepSizeController(
            diffrax.PIDController(rtol=rtol, atol=atol), jump_ts=inputs.t
        ),
        max_steps=max_steps,
        adjoint=diffrax.ForwardMode() if derivatives == "forward" else diffrax.RecursiveCheckpointAdjoint(),
        throw=False,
    )


@eqx.filter_jit
def _solve(model, inputs, initial, at, rtol, atol, max_steps, derivatives) -> Trajectory:
    def field(t, state, begun):
        return rhs(model, state, *inputs.at(t, begun))

    out = _integrate(field, inputs, initial, at, rtol, atol, max_steps, derivatives)
    assert out.ys is not None
    return Trajectory(at, out.ys, out.result == diffrax.RESULTS.successful, out.stats["num_steps"], out.ys.q)


class EnergyBalance(NamedTuple):
    """Stored energy against what came in and what was lost, at the stamps `t` [s]; every entry (T,) [J].

    `stored` = 𝓗(t) − 𝓗(t₀), `tendons` the work of the tensions, `pressure` of the moving vacuum, `external` of
    outside torques, `lost` the friction's dissipation; `residual` = stored − tendons − pressure − external + lost.
    """

    t: Array
    stored: Array
    tendons: Array
    pressure: Array
    external: Array
    lost: Array

    @property
    def residual(self) -> Array:
        return self.stored - self.tendons - self.pressure - self.external + self.lost


def energy_balance(
    model: Model,
    inputs: Inputs,
    *,
    at: Any = None,
    initial: State | None = None,
    rtol: float = 1e-8,
    atol: float = 1e-10,
    max_steps: int = 1_000_000,
) -> EnergyBalance:
    """The balance of model section 5, the pressure port included; it closes to the solver's tolerance.

    A held pressure jumps at its stamps; the work of a jump is 𝓗 after it minus 𝓗 before it, in the same state.

    Raises:
        SolverError: the solver failed.
    """
    initial = rest(model, inputs) if initial is None else initial
    at = np.asarray(inputs.t if at is None else at)
    jumps = np.asarray(inputs.t)[1:] if inputs.hold else np.empty(0)
    jumps = jumps[(jumps > at[0]) & (jumps <= at[-1])]
    everywhere = np.union1d(at, jumps)
    (state, work), ok = _solve_with_work(
        model, inputs, initial, jnp.asarray(everywhere, inputs.t.dtype), rtol, atol, max_steps
    )
    if not bool(ok):
        raise SolverError("inputs: the reference solver stopped before the last stamp. Try looser tolerances.")
    level = jax.vmap(lambda s, u_p: energy.total(model, s.q, s.v, s.z, u_p))
    after = jax.vmap(lambda t: inputs.at(t)[1])(jnp.asarray(everywhere, inputs.t.dtype))
    before = jnp.concatenate([after[:1], after[:-1]]) if inputs.hold else after
    h_after = np.asarray(level(state, after))
    jump_work = np.cumsum(h_after - np.asarray(level(state, before))) if inputs.hold else 0.0
    tendons, pressure, external, lost = (np.asarray(w) - np.asarray(w)[0] for w in work)  # `at` may start later
    keep = np.isin(everywhere, at)
    series = (h_after - h_after[0], tendons, pressure + jump_work, external, lost)
    return EnergyBalance(jnp.asarray(everywhere[keep]), *(jnp.asarray(x[keep]) for x in series))


@eqx.filter_jit
def _solve_with_work(model, inputs, initial, at, rtol, atol, max_steps):
    def field(t, y, begun):
        state, _ = y
        u, u_p, tau = inputs.at(t, begun)
        rates = (
            tendon_torque(model, state.q, u) @ state.v,
            pressure_power(model, state, u_p, inputs.pressure_rate(begun)),
            jnp.zeros_like(t) if tau is None else tau @ state.v,
            dissipation(model.friction, state.v, state.z, energy.phi(model, u_p)),
        )
        return rhs(model, state, u, u_p, tau), rates

    zero: Scalar = jnp.zeros((), at.dtype)
    out = _integrate(field, inputs, (initial, (zero, zero, zero, zero)), at, rtol, atol, max_steps)
    assert out.ys is not None
    return out.ys, out.result == diffrax.RESULTS.successful
