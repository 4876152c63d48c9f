"""Effects hook into the solver where they say: toy effects whose motion is known some other way."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ljjax import fast
from ljjax.effect import Effect, parameter
from ljjax.errors import InputError
from ljjax.inputs import Inputs
from ljjax.model import get, replace
from ljjax.simulation import rest, simulate

AT = np.linspace(0.0, 1.0, 51)
X = parameter("1", null=0.0, low=-10.0, high=10.0, scale=1.0)


class Lag(Effect):
    """The tensions follow their commands with the time constant x."""

    x: jax.Array = X

    def start(self, now):
        return now.u

    def actuate(self, memory, u, now):
        decay = jnp.exp(-now.h / self.x)
        mean = tuple(c + (t - c) * (1 - decay) * self.x / now.h for c, t in zip(u, memory, strict=True))
        return mean, tuple(c + (t - c) * decay for c, t in zip(u, memory, strict=True))


class Leak(Effect):
    x: jax.Array = X

    def evacuate(self, memory, vacuum, now):
        return (1 - self.x) * vacuum, memory


class Stiffer(Effect):
    x: jax.Array = X

    def alpha2(self, memory, alpha2, now):
        return tuple(a + self.x for a in alpha2)


class Slipperier(Effect):
    x: jax.Array = X

    def phi(self, memory, phi, now):
        return tuple(p * (1 - self.x) for p in phi)


class Heavier(Effect):
    x: jax.Array = X

    def inertia(self, memory, m, now):
        return tuple(tuple((1 + self.x) * e for e in row) for row in m)


class Pushed(Effect):
    x: jax.Array = X

    def load(self, memory, load, now):
        return tuple(t + self.x for t in load)


class Damped(Effect):
    x: jax.Array = X

    def torque(self, memory, i, q, v, stage):
        return self.x * stage.phi[i] * v


class Biased(Effect):
    x: jax.Array = X

    def sense(self, memory, y, now):
        return tuple(a + self.x for a in y), memory


class Worn(Effect):
    """φ falls with the way the joints have gone."""

    x: jax.Array = X

    def start(self, now):
        return tuple(jnp.zeros_like(q) for q in now.q)

    def phi(self, memory, phi, now):
        return tuple(p * jnp.exp(-self.x * s) for p, s in zip(phi, memory, strict=True))

    def remember(self, memory, now, after):
        return tuple(s + jnp.abs(b - a) for s, a, b in zip(memory, now.q, after.q, strict=True))


class Late(Effect):
    x: jax.Array = X

    def latency_s(self):
        return self.x


class Delayed(Effect):
    x: jax.Array = X

    def delay_s(self):
        return self.x


def number(x: float) -> jax.Array:
    return jnp.asarray(x, float)


def drive(lag: float = 0.0, later: float = 0.0) -> Inputs:
    """A net tension to and fro on 10 kPa, held on a grid; through a first-order lag, exactly sampled, if asked for."""
    t = np.linspace(0.0, 1.0, 401)
    pull = 12.0 * np.round(np.sin(2 * np.pi * np.floor(t / 0.05) * 0.05), 1)
    if lag:
        out, level = np.zeros_like(pull), 0.0
        decay = np.exp(-0.0025 / lag)
        for i, c in enumerate(pull):
            out[i] = c + (level - c) * (1 - decay) * lag / 0.0025
            level = c + (level - c) * decay
        pull = out
    u = np.stack([np.maximum(pull, 0), np.maximum(-pull, 0)], axis=1)
    t = np.r_[0.0, t[1:] + later]
    return Inputs(jnp.asarray(t), jnp.asarray(u), jnp.full(len(t), 10.0))


@eqx.filter_jit
def run(model, inputs):
    start = rest(model, inputs)
    return fast.run(model, inputs, start, jnp.asarray(AT), jnp.asarray(0.0), jnp.asarray(0.0025), 400, 3)


def having(model, *effects):
    return eqx.tree_at(lambda m: m.effects, model, effects, is_leaf=lambda x: x is model.effects)


@pytest.mark.parametrize(
    ("effect", "changes", "inputs"),
    [
        (Leak(number(0.3)), {}, {"vacuum": 7.0}),
        (Stiffer(number(0.2)), {"elastic.c3": 0.2}, {}),
        (Slipperier(number(0.4)), {"jamming.c4": -0.4 * 3.0, "jamming.c5": -0.4 * 0.7}, {}),
        (Heavier(number(20.0)), {"chain.segment_mass_kg": 1.2}, {}),
        (Damped(number(0.005)), {"friction.sigma2": 0.005}, {}),
        (Pushed(number(0.1)), {}, {"torque": 0.1}),
        (Lag(number(0.03)), {}, {"lag": 0.03}),
        (Delayed(number(0.05)), {}, {"later": 0.05}),
    ],
    ids=lambda x: type(x).__name__ if isinstance(x, Effect) else "",
)
def test_a_hook_acts_where_it_says(robot, effect, changes, inputs):
    """The same motion from a changed model or inputs; one joint, so that a heavier link is heavier in M alone."""
    model = robot(1)
    given, other = drive(), drive(inputs.get("lag", 0.0), inputs.get("later", 0.0))
    if "vacuum" in inputs:
        other = Inputs(other.t, other.tendons, jnp.full(len(other.t), inputs["vacuum"]))
    if "torque" in inputs:
        other = Inputs(other.t, other.tendons, other.pressure_kpa, jnp.full((len(other.t), 1), inputs["torque"]))
    expected = run(replace(model, {p: get(model, p) + d for p, d in changes.items()}), other)
    with_effect = run(having(model, effect), given)
    np.testing.assert_allclose(with_effect.q, expected.q, atol=1e-10)
    assert float(jnp.abs(with_effect.q - run(model, given).q).max()) > 1e-3


def test_what_is_seen_may_differ_from_what_is(robot):
    model = robot(1)
    plain = run(model, drive())
    seen = run(having(model, Biased(number(0.1))), drive())
    np.testing.assert_allclose(seen.q, plain.q, atol=1e-12)
    np.testing.assert_allclose(seen.seen, plain.q + 0.1, atol=1e-12)
    late = run(having(model, Late(number(0.02))), drive())
    np.testing.assert_allclose(late.seen[1:], plain.q[:-1], atol=1e-12)
    np.testing.assert_allclose(late.seen[0], plain.q[0], atol=1e-12)  # of before the run there is nothing to see
    np.testing.assert_array_equal(plain.seen, plain.q)


def test_effects_add_up_remember_vanish_at_null_and_differentiate(robot):
    model = robot(2)
    # slip would make the rounding of two programs larger
    gentle = eqx.tree_at(lambda x: x.tendons, drive(), drive().tendons / 30)
    nothing = run(having(model, Worn(number(0.0)), Pushed(number(0.0)), Biased(number(0.0))), gentle)
    np.testing.assert_allclose(nothing.q, run(model, gentle).q, rtol=0, atol=1e-14)  # to rounding
    assert float(jnp.abs(nothing.q).max()) > 5e-4

    def end(x):
        return run(having(model, Worn(x[0]), Pushed(x[1]), Biased(x[2])), drive()).seen[-1].sum()

    at = jnp.array([0.4, 0.05, 0.02])
    assert abs(float(end(at) - end(jnp.array([0.0, 0.05, 0.02])))) > 1e-3  # the wear is remembered
    slope = jax.jacfwd(end)(at)
    for i in range(3):
        d = jnp.zeros(3).at[i].set(1e-6)
        assert float(slope[i]) == pytest.approx(float((end(at + d) - end(at - d)) / 2e-6), rel=1e-4)
    np.testing.assert_allclose(jax.grad(end)(at), slope, rtol=1e-9)


def test_the_reference_refuses_effects(robot):
    with pytest.raises(InputError, match="knows no effects"):
        simulate(having(robot(1), Biased(number(0.1))), drive(), method="reference")


def test_the_step_is_judged_by_halving_it(robot):
    out = simulate(robot(1), drive(), at=AT, errors=True)
    fine = simulate(robot(1), drive(), at=AT, step_s=0.0025 / 16)
    plain = simulate(robot(1), drive(), at=AT)
    assert plain.error is None and plain.sensitive is None
    assert out.error is not None and not bool(out.sensitive)
    true = float(jnp.abs(plain.state.q - fine.state.q).max())
    assert float(out.error) == pytest.approx(true, rel=0.5)


def test_stick_slip_is_flagged(robot):
    """A strong Stribeck drop and a slow pull: every slip is an event whose time hangs on the step."""
    slips = {"mu_c": 0.01, "mu_s": 0.05, "v_s": 0.1, "sigma1": 0.001, "sigma2": 0.005}
    model = robot(1, {f"friction.{name}": value for name, value in slips.items()})
    t = jnp.linspace(0.0, 4.0, 401)
    slow = Inputs(t, jnp.stack([15.0 * t, 0 * t], axis=1), jnp.full(401, 30.0), hold=False)
    out = simulate(model, slow, at=np.linspace(0, 4, 401), step_s=0.005, errors=True)
    rate = np.abs(np.diff(out.state.q[:, 0]))
    assert rate.max() > 20 * np.median(rate)  # it sticks, and slips
    assert bool(out.sensitive)
