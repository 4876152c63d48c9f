"""The cost of derivatives: a Jacobian for 13 parameters beside one simulation."""

from __future__ import annotations

from collections.abc import Callable

import diffrax
import jax
import jax.numpy as jnp

from benchmarks.fleet import element, fleet, of_one
from benchmarks.sides import Row, interleaved, ratio
from ljjax import batch, fast
from ljjax.dynamics import State, rhs
from ljjax.model import get, replace

LEARNED = (
    *("chain.lever_arm_m", "gravity.alpha1", "elastic.c1", "elastic.c2", "elastic.c3", "jamming.c4", "jamming.c5"),
    *("friction.sigma1", "friction.sigma2", "friction.sigma3", "friction.mu_c", "friction.mu_s", "friction.v_s"),
)
SECONDS, STEP_S, ITERATIONS = 2.0, 0.005, 3


def cost(say: Callable[[str], None]) -> list[Row]:
    """Jacobians of θ at 100 Hz, for batches of 4 and 64 runs of one robot each."""
    out: dict[str, float] = {}
    for runs in (4, 64):
        models, inputs, states = fleet(runs, SECONDS)
        t, h, steps = inputs.t, jnp.asarray(STEP_S), round(SECONDS / STEP_S)

        def theta(x, model, tendons, vacuum, state, t=t, h=h, steps=steps, inputs=inputs):
            changed = replace(model, dict(zip(LEARNED, x, strict=True)))
            given = of_one(inputs, tendons, vacuum)
            return fast.run(changed, given, state, t, t[0], h, steps, ITERATIONS).q.mean(axis=1)

        x = jnp.stack([get(models, name) for name in LEARNED], axis=1)
        given = (models, inputs.tendons, inputs.pressure_kpa, states)
        one, all_of_them = (_ready(jax.vmap(f), x, *given) for f in (theta, jax.jacfwd(theta)))
        differences = jnp.concatenate([jnp.zeros((1, len(LEARNED))), jnp.diag(jnp.full(len(LEARNED), 1e-6))])

        def shifted(x, *rest, theta=theta, differences=differences):
            return jax.vmap(lambda d: theta(x * (1 + d), *rest))(differences)

        sides = {"simulation": one, "jacobian": all_of_them, "differences": _ready(jax.vmap(shifted), x, *given)}
        times = interleaved(sides, rounds=7, least_s=0.3)
        out[f"{runs} runs"] = ratio(times, "jacobian", "simulation")
        out[f"{runs} runs, finite differences"] = ratio(times, "differences", "simulation")
    out["diffrax forward mode, one run of 0.5 s"] = _diffrax()
    value = out.pop("64 runs")
    note = f"{ITERATIONS} Newton iterations in both; each one's Jacobian ÷ its own simulation; the same batch in both"
    return [Row("Jacobian for 13 parameters ÷ one simulation, 64 runs", value, "×", "≤ 4", value <= 4, out, note)]


def _diffrax() -> float:
    models, inputs, states = fleet(1, 0.5)
    model, state = element(models, 0), element(states, 0)
    given = of_one(inputs, inputs.tendons[0], inputs.pressure_kpa[0])

    def theta(x):
        changed = replace(model, dict(zip(LEARNED, x, strict=True)))
        out = diffrax.diffeqsolve(
            diffrax.ODETerm(lambda t, y, _: rhs(changed, y, *given.at(jnp.asarray(t)))),
            diffrax.Kvaerno5(),
            t0=given.t[0],
            t1=given.t[-1],
            dt0=None,
            y0=State(*state),
            saveat=diffrax.SaveAt(ts=given.t),
            stepsize_controller=diffrax.PIDController(rtol=1e-3, atol=1e-5),
            max_steps=100_000,
            adjoint=diffrax.ForwardMode(),
            throw=False,
        )
        assert out.ys is not None
        return out.ys.q.mean(axis=1)

    x = jnp.stack([get(model, name) for name in LEARNED])
    times = interleaved({"one": _ready(theta, x), "all": _ready(jax.jacfwd(theta), x)}, rounds=5, least_s=0.3)
    return ratio(times, "all", "one")


def _ready(function: Callable, *given):
    """A call of the compiled function on these arguments, run once."""
    compiled = jax.jit(function, compiler_options=batch.options()).lower(*given).compile()
    call = lambda: jax.block_until_ready(compiled(*given))  # noqa: E731
    call()
    return call
