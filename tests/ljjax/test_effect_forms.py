"""Each effect's forms: what the equation of its page says, effect by effect."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ljjax import energy
from ljjax.effects import REGISTRY
from ljjax.effects.shapes import dahl
from ljjax.model import limits
from ljjax.simulation import simulate
from tests.ljjax.motion import AT, drive, seen


def test_a_filter_averages(robot):
    """r = 0 is a first-order filter; r = 1 a moving average over 6τ, which a first-order one is not."""
    t, window = np.linspace(0.0, 1.2, 2401), 0.12
    plain = np.interp(t, AT, np.asarray(seen(robot(3), drive())[:, 0]))
    grown = np.concatenate([np.full(400, plain[0]), plain])
    mean = np.convolve(grown, np.ones(round(window / 5e-4)) / round(window / 5e-4), mode="full")[400 : 400 + len(t)]

    def off(tau: float, later: float) -> float:
        kind = REGISTRY["sensor_filter"](**{"tau_s": tau, "later": later})
        filtered = seen(dataclasses.replace(robot(3), effects=(kind,)), drive())[:, 0]
        return float(np.sqrt(np.mean((filtered - np.interp(AT, t, mean)) ** 2)))

    average, first, none = off(window / 6, 1.0), off(window / 2, 0.0), off(0.0, 0.0)
    assert average < 0.2 * first < 0.1 * none, (average, first, none)


def test_a_filter_goes_as_its_transfer_function():
    """1/((τs + 1)(r²τ²(1 + o²)s² + 2rτs + 1)), but for what the first filter does within a step."""
    from scipy.signal import lsim

    tau, later, over, h = 0.01, 2.0, 1.2, 0.005
    kind: Any = REGISTRY["sensor_filter"]
    sensor = kind(tau_s=tau, later=later, overshoot=over)
    t = h * np.arange(200)
    q = 0.3 * np.sin(9.0 * t) + np.where(t > 0.5, 0.1, 0.0)
    now: Any = SimpleNamespace(q=(jnp.asarray(q[0]),), h=jnp.asarray(h))
    memory, got = sensor.start(now), [q[0]]
    for x in q[1:]:
        (y,), memory = sensor.sense(memory, (jnp.asarray(x),), now)
        got.append(float(y))
    second = later * tau
    below = np.polymul([tau, 1.0], [second**2 * (1 + over**2), 2 * second, 1.0])
    _, expected, _ = lsim(([1.0], below), q, t)
    np.testing.assert_allclose(got, expected, atol=5e-4)


def test_a_gains_error_may_come_after_the_start():
    """Within 2 s; what is wound up does not wait."""
    kind: Any = REGISTRY["actuator_gain"]
    gain, h = kind(error=0.1, difference=0.02, winding=0.3, warms=0.75, warms_s=2.0), 0.01
    now: Any = SimpleNamespace(
        u=(jnp.asarray(5.0), jnp.asarray(10.0)), middle=(jnp.asarray(0.1), jnp.asarray(-0.05)), h=jnp.asarray(h)
    )
    memory = gain.start(now)
    for k in range(300):
        (left, right), memory = gain.actuate(memory, now.u, now)
        came = 1 - 0.75 * np.exp(-(k + 0.5) * h / 2.0)
        assert float(left) == pytest.approx(5.0 * (1 + 0.12 * came + 0.015), rel=1e-5)
        assert float(right) == pytest.approx(10.0 * (1 + 0.08 * came - 0.015), rel=1e-5)


def test_a_motors_copper_may_warm_by_its_own_current():
    """Each motor's by what it carries of 10 N, squared, within 2 s: the left one loses 1.5 times as much of it."""
    kind: Any = REGISTRY["actuator_gain"]
    gain, h = kind(heat=0.04, heat_difference=0.02, heats_s=2.0), 0.01
    now: Any = SimpleNamespace(
        u=(jnp.asarray(20.0), jnp.asarray(10.0)), middle=(jnp.asarray(0.1), jnp.asarray(-0.05)), h=jnp.asarray(h)
    )
    memory = gain.start(now)
    for k in range(300):
        (left, right), memory = gain.actuate(memory, now.u, now)
        warm = 1 - np.exp(-(k + 0.5) * h / 2.0)
        assert float(left) == pytest.approx(20.0 / (1 + 0.06 * 4 * warm), rel=1e-5)
        assert float(right) == pytest.approx(10.0 / (1 + 0.02 * warm), rel=1e-5)


def test_a_loop_that_winds_up_must_unwind():
    """0.2 s at 5 N beyond the limit, half a second for each newton of them, wind up 2 N, on top of 7 N then until they
    are unwound."""
    kind: Any = REGISTRY["actuator_saturation"]
    motor, h = kind(share=1.0, limit_n=10.0, edge=16.0, windup=1.0, winds_s=0.5), 0.01
    now: Any = SimpleNamespace(u=(jnp.asarray(15.0), jnp.asarray(0.0)), h=jnp.asarray(h))
    memory, out = motor.start(now), []
    for k in range(100):
        (left, _), memory = motor.actuate(memory, (jnp.asarray(15.0 if k < 20 else 7.0), jnp.asarray(0.0)), now)
        out.append(float(left))
    wound = 5.0 * 0.2 / 0.5
    for k in range(20, 100):
        still = max(wound - 3.0 * (k - 20) * h / 0.5, 0.0)
        expected = 10.0 / (1 + (10.0 / (7.0 + still)) ** 16) ** (1 / 16)
        assert out[k] == pytest.approx(expected, abs=0.02), k


def test_a_loop_may_take_out_what_is_slow_of_a_ripple():
    """Of a ripple of ω a loop of τ leaves iωτ/(1 + iωτ), and of a body at rest none."""
    kind: Any = REGISTRY["actuator_ripple"]
    about = {"left_sine": 0.1, "waves": 10.0, "stretch": 1e-4, "power": 0.0, "held": 1.0, "held_s": 0.05}
    ripple, h, speed = kind(**about), 0.001, 2.0
    u, omega = (jnp.asarray(10.0), jnp.asarray(10.0)), 10.0 * speed

    def at(bend: float) -> Any:
        return SimpleNamespace(u=u, middle=(jnp.asarray(bend),), h=jnp.asarray(h))

    @jax.jit
    def step(memory, bend):
        return ripple.actuate(memory, u, at(bend))

    memory, got = ripple.start(at(0.0)), []
    for k in range(1500):
        (left, _), memory = step(memory, speed * h * min(k, 1000))
        got.append(float(left) - 10.0)
    gain = 1j * omega * 0.05 / (1 + 1j * omega * 0.05)
    t = h * np.arange(500, 1000)
    np.testing.assert_allclose(got[500:1000], np.imag(gain * np.exp(1j * (omega * t + 0.01))), atol=0.02)
    assert abs(got[-1]) < 1e-3 * max(map(abs, got))


def test_an_elastic_tendon_gives_the_body_what_the_loop_has_not_wound():
    """At a steady rate of the bend τ k q̇_Σ less in the tendon to whose side the body bends, more in the other."""
    kind: Any = REGISTRY["actuator_lag"]
    lag = kind(tau_s=0.05, elastic_n=20.0, power=0.0, later=0.0, falling=0.0)
    now: Any = SimpleNamespace(
        u=(jnp.asarray(5.0), jnp.asarray(8.0)), v=(jnp.asarray(0.5), jnp.asarray(0.3)), h=jnp.asarray(0.01)
    )

    def settled(memory: Any, now: Any) -> Any:
        for _ in range(200):
            _, memory = lag.actuate(memory, now.u, now)
        (left, right), memory = lag.actuate(memory, now.u, now)
        return float(left), float(right), memory

    left, right, memory = settled(lag.start(now), now)
    assert (left, right) == pytest.approx((5.0 - 0.05 * 20 * 0.8, 8.0 + 0.05 * 20 * 0.8))
    slack: Any = SimpleNamespace(u=(jnp.asarray(0.5), jnp.asarray(8.0)), v=now.v, h=now.h)
    assert settled(memory, slack)[0] == 0.0


def test_a_cable_that_stiffens_has_play_in_its_length():
    """Of √T: 9 N of 16 pass where the play is as wide as the length that 1 N has, and 2.25 N are held of 0.25."""
    kind: Any = REGISTRY["tendon_slack"]
    unit = np.sqrt(10.0)  # of a length that is 10 √(T/10 N)
    slack = kind(width_n=unit, length=0.5)
    now: Any = SimpleNamespace(
        u=(jnp.asarray(0.0), jnp.asarray(0.0)), v=(jnp.asarray(0.0),), q=(jnp.asarray(0.0),), h=jnp.asarray(0.01)
    )
    memory, out = slack.start(now), []
    for x in (16.0, 9.0, 4.0, 0.25):
        (left, _), memory = slack.actuate(memory, (jnp.asarray(x), jnp.asarray(0.0)), now)
        out.append(float(left))
    np.testing.assert_allclose(out, [9.0, 9.0, 9.0, 2.25], atol=0.05)


def test_a_gauge_may_have_hysteresis():
    """2 kPa off on the way down, by half of them on the way up, and from one to the other over twice 3 kPa."""
    kind: Any = REGISTRY["pressure_bias"]
    bias, now = kind(offset_kpa=2.0, turns=0.5, turn_kpa=3.0), SimpleNamespace(vacuum=jnp.asarray(5.0), t=0.0, h=0.01)
    memory, off = bias.start(cast(Any, now)), []
    for p in (5.0, 20.0, 17.0, 14.0, 5.0, 8.0, 11.0):
        inside, memory = bias.evacuate(memory, jnp.asarray(p), cast(Any, now))
        off.append(float(inside) - p)
    np.testing.assert_allclose(off, [1.0, 1.0, 1.5, 2.0, 2.0, 1.5, 1.0], atol=1e-3)


def test_a_pump_may_shut_off_and_pump_again():
    """A leak of 0.4 loses half of that of 20 kPa on the way to 2 s, all of it there, and begins anew; another vacuum is
    pumped at once."""
    kind: Any = REGISTRY["pressure_leak"]
    leak, h = kind(share=0.4, topped=1.0, tops_s=2.0), 0.01
    now: Any = SimpleNamespace(
        vacuum=jnp.asarray(20.0), worn=jnp.asarray(0.0), middle=(jnp.asarray(0.0),), v=(jnp.asarray(0.0),), h=h
    )
    memory, got = leak.start(now), []
    for k in range(350):
        inside, memory = leak.evacuate(memory, jnp.asarray(20.0 if k < 300 else 10.0), now)
        got.append(float(inside))
    for k in (0, 50, 100, 150, 198):
        assert got[k] == pytest.approx(20.0 * (1 - 0.4 * (k + 0.5) * h / 2.0), abs=0.01)
    assert got[203] > 19.8 and got[250] == pytest.approx(18.0, abs=0.1)
    values = {n: float(about["null"]) for n, about in kind.fields().items()}
    assert len({x["tops_s"] for x in kind.likewise(values | {"topped": 1.0})}) == 6 and not kind.likewise(values)
    assert got[300] > 9.95 and got[349] == pytest.approx(10.0 * (1 - 0.4 * 0.495 / 2), abs=0.01)


@pytest.mark.parametrize(("effect", "hook"), [("stiffness_saturation", "alpha2"), ("friction_saturation", "phi")])
def test_layers_may_stay_packed_until_the_vacuum_is_nearly_gone(effect, hook):
    """With b = 2: at 20 kPa what 20 kPa make, at 12 and 10 still, at 6 what 12 make, and none without a vacuum."""
    kind: Any = REGISTRY[effect]
    law = kind(rise=1.0, knee_kpa=10.0, packs=2.0)

    def at(vacuum: float) -> Any:
        return SimpleNamespace(vacuum=jnp.asarray(vacuum))

    memory = law.start(at(0.0))
    for vacuum, felt in ((20.0, 20.0), (12.0, 20.0), (10.0, 20.0), (6.0, 12.0), (0.0, 0.0), (5.0, 5.0)):
        (got,) = getattr(law, hook)(memory, (jnp.asarray(1.0),), at(vacuum))
        assert float(got) - 1 == pytest.approx(felt / 10 / (1 + felt / 10), abs=1e-6)
        memory = law.remember(memory, at(vacuum), None)


def test_a_gear_rubs_less_while_a_tendon_is_let_go_and_more_under_load():
    """2 N of what is drawn, times 1 + 0.5 T/10 N; the other way round once it has been let go by some ΔT, for r = 2."""
    gear: Any = REGISTRY["actuator_deadband"](
        **{"share": 1.0, "band_n": 2.0, "let_go": 2.0, "turn_n": 0.1, "pressed": 0.5}
    )
    now: Any = SimpleNamespace(u=(jnp.asarray(5.0), jnp.zeros(())), h=jnp.asarray(0.01))
    memory, felt = gear.start(now), {}
    for t in (5.0, 10.0, 20.0, 10.0, 5.0):
        (one, _), memory = gear.actuate(memory, (jnp.asarray(t), jnp.zeros(())), now)
        felt.setdefault(t, []).append(float(one))
    assert felt[20.0] == pytest.approx([20.0 - 2.0 * 2.0], abs=0.01)
    assert felt[10.0] == pytest.approx([10.0 - 3.0, 10.0 + 3.0], abs=0.01)
    assert felt[5.0] == pytest.approx([5.0 - 2.5, 5.0 + 2.5], abs=0.01)


def test_a_gain_may_go_with_the_load_or_as_a_torque_over_a_radius():
    """e = 0.1, half of it with the load; and 1/(1 + 0.5 q_Σ) on the left, 1/(1 − 0.5 q_Σ) on the right."""
    kind: Any = REGISTRY["actuator_gain"]
    u, still = (jnp.asarray(5.0), jnp.asarray(20.0)), (jnp.zeros(()),) * 2
    now: Any = SimpleNamespace(u=u, middle=still, h=jnp.asarray(0.01))
    loaded = kind(error=0.1, with_load=0.5)
    got, _ = loaded.actuate(loaded.start(now), u, now)
    np.testing.assert_allclose(np.array(got), [5.0 * 1.075, 20.0 * 1.15], rtol=1e-5)
    now.middle = (jnp.asarray(0.3), jnp.asarray(0.1))
    wound = kind(winding=-0.5, radial=1.0)
    got, _ = wound.actuate(wound.start(now), u, now)
    np.testing.assert_allclose(np.array(got), [5.0 / 1.2, 20.0 / 0.8], rtol=1e-5)


def test_a_cable_may_climb_onto_a_second_layer():
    """On the left spool once the mean joint has bent by 0.1 + 0.02 rad to its side, on the right one by 0.1 − 0.02."""
    kind: Any = REGISTRY["actuator_gain"]
    gain = kind(layer=-0.2, layer_rad=0.1, layer_over_rad=1e-3, layer_apart_rad=0.02)
    for angle, expected in ((0.11, (5.0, 5.0)), (0.13, (4.0, 5.0)), (-0.07, (5.0, 5.0)), (-0.09, (5.0, 4.0))):
        u = (jnp.asarray(5.0), jnp.asarray(5.0))
        now: Any = SimpleNamespace(u=u, middle=(jnp.asarray(2 * angle), jnp.zeros(())), h=jnp.asarray(0.01))
        tensions, _ = gain.actuate(gain.start(now), u, now)
        np.testing.assert_allclose(np.array(tensions), expected, rtol=1e-5)


def test_a_sheath_fills_behind_its_line():
    kind: Any = REGISTRY["pressure_lag"]
    lag, h = kind(fill_s=0.2, vent_s=0.1, power=0.0, second=0.5), 0.001
    now: Any = SimpleNamespace(vacuum=jnp.zeros(()), h=jnp.asarray(h))
    memory, got = lag.start(now), []
    for line in [20.0] * 2000 + [0.0] * 400:
        vacuum, memory = lag.evacuate(memory, jnp.asarray(line), now)
        got.append(float(vacuum))
    t = h * (np.arange(400) + 0.5)
    for begin, left in ((0, 2 * np.exp(-t / 0.2) - np.exp(-t / 0.1)), (2000, 2 * np.exp(-t / 0.1) - np.exp(-t / 0.05))):
        apart = np.abs(np.array(got[begin : begin + 400]) - (20.0 if begin == 0 else 0.0))
        np.testing.assert_allclose(apart, 20.0 * left, atol=0.02)


@pytest.mark.parametrize("opens", [{"of_bend": 1.0, "open_rad": 0.2}, {"of_motion": 1.0, "open_rad_s": 0.2}])
def test_a_leak_may_be_at_what_opens_with_the_bend_or_with_motion(opens):
    """Nothing is lost while the body is straight or at rest, with a time constant half of the share where q = w."""
    kind: Any = REGISTRY["pressure_leak"]
    leak, line = kind(share=0.4, tau_s=0.5, held=0.0, **opens), jnp.asarray(20.0)

    def held(opened: float, seconds: float) -> float:
        moved, none = jnp.asarray([opened, -opened]), jnp.zeros((2,))
        bent, fast = (moved, none) if "of_bend" in opens else (none, moved)
        now: Any = SimpleNamespace(vacuum=line, h=jnp.asarray(1e-3), middle=bent, v=fast, worn=jnp.asarray(0.0))
        memory, vacuum = leak.start(now), line
        for _ in range(round(seconds / 1e-3)):
            vacuum, memory = leak.evacuate(memory, line, now)
        return float(vacuum)

    assert held(0.0, 0.2) == pytest.approx(20.0)
    assert held(0.2, 0.5) == pytest.approx(20.0 * (1 - 0.2 * (1 - np.exp(-1))), rel=1e-3)


@pytest.mark.parametrize(("chokes", "of_five"), [(0.5, 2.0), (-1.0, 0.25)])
def test_a_leak_behind_an_orifice_takes_less_of_a_deeper_vacuum(chokes, of_five):
    """By the square root of it: 0.2 of 20 kPa, 0.4 of 5 kPa; and more where the vacuum opens gaps, 0.05 of 5 kPa."""
    leak: Any = REGISTRY["pressure_leak"](**{"share": 0.2, "tau_s": 0.05, "held": 0.0, "chokes": chokes})
    for line, lost in ((20.0, 4.0), (5.0, of_five)):
        q, vacuum = jnp.zeros((2,)), jnp.asarray(line)
        now: Any = SimpleNamespace(vacuum=vacuum, h=jnp.asarray(0.1), middle=q, v=q, worn=jnp.asarray(0.0))
        memory, held = leak.start(now), vacuum
        for _ in range(20):
            held, memory = leak.evacuate(memory, vacuum, now)
        assert float(held) == pytest.approx(line - lost, rel=1e-4)


def test_a_leak_may_open_as_the_session_goes_on():
    """S₀ = 5 rad: none of it at first, 1 − 1/e after 5 rad, in one run or before it; half of it always with g = ½."""
    kind: Any = REGISTRY["pressure_leak"]

    def held(leak: Any, before: float, in_run: float) -> float:
        q = jnp.zeros((2,))
        now: Any = SimpleNamespace(vacuum=jnp.asarray(20.0), h=jnp.asarray(1.0), middle=q, v=q, q=q)
        now.worn = jnp.asarray(before)
        memory = leak.remember(leak.start(now), now, SimpleNamespace(q=q + in_run))
        _, memory = leak.evacuate(memory, now.vacuum, now)
        return float(leak.evacuate(memory, now.vacuum, now)[0])

    leak = {"share": 0.4, "tau_s": 0.05, "held": 0.0, "opens_rad": 5.0}
    assert held(kind(**leak, of_session=1.0), 0.0, 0.0) == pytest.approx(20.0)
    for before, in_run in ((5.0, 0.0), (0.0, 5.0), (2.0, 3.0)):
        assert held(kind(**leak, of_session=1.0), before, in_run) == pytest.approx(20 * (1 - 0.4 * (1 - np.exp(-1))))
    assert held(kind(**leak, of_session=0.5), 0.0, 0.0) == pytest.approx(16.0)


def test_a_coat_may_wear_through():
    """k = 8: next to nothing is lost over half of S₀ of slip, all over twice as much as S₀; k = 1 is exponential."""
    kind: Any = REGISTRY["layer_wear"]

    def left(slip: float, order: float) -> float:
        wear, now = kind(loss=0.4, scale_rad=5.0, order=order), cast(Any, SimpleNamespace())
        return float(wear.phi((jnp.asarray(slip),), (jnp.asarray(1.0),), now)[0])

    np.testing.assert_allclose([left(s, 8.0) for s in (0.0, 2.5, 10.0)], [1.0, 1 - 0.4 * 0.5**8, 0.6], rtol=1e-4)
    np.testing.assert_allclose([left(s, 1.0) for s in (0.0, 5.0)], [1.0, 1 - 0.4 * (1 - np.exp(-1))], rtol=1e-5)


def test_springs_between_layers_may_slide_later_under_pressure_but_be_no_stiffer():
    """Torque and stretch both grow as 1 + P/10 kPa: the same slope to begin with, three times the torque at 20 kPa."""
    kind: Any = REGISTRY["layer_hysteresis"]
    layers = kind(torque_nm=0.1, per_kpa=0.01, width_rad=0.02, stretch_per_kpa=0.1)

    def felt(vacuum: float, bends: np.ndarray) -> np.ndarray:
        memory, out = None, []
        for q, after in zip(bends[:-1], bends[1:], strict=True):
            at: Any = SimpleNamespace(q=(jnp.asarray(q),), middle=(jnp.asarray(q),), phi=(1.0,), vacuum=vacuum, h=0.01)
            memory = layers.start(at) if memory is None else memory
            out.append(float(layers.load(memory, (jnp.zeros(()),), at)[0]))
            memory = layers.remember(memory, at, SimpleNamespace(q=(jnp.asarray(after),)))
        return np.array(out)

    loose, pressed = (felt(p, np.linspace(0.0, 0.1, 101)) for p in (0.0, 20.0))
    np.testing.assert_allclose(pressed[:20], loose[:20], rtol=1e-4)
    np.testing.assert_allclose([loose[-1], pressed[-1]], [-0.1, -0.3], rtol=1e-4)


def rough_contact(rough: float) -> Any:
    contact: Any = REGISTRY["contact"]
    return contact(angle_rad=0.02, obstacle=300.0, rough=rough)


def test_an_obstacle_rubs_with_its_share_of_what_it_pushes_with(robot):
    """Work of the friction: −μ F |slide|, whatever the joints do."""
    q, v = np.array([0.05, 0.03, 0.04]), np.array([8.0, -2.0, 4.0])
    psi, reach = np.cumsum(q), 2 * float(robot(3).chain.half_length_m) * np.array([1, 1, 0.5])
    now: Any = SimpleNamespace(
        model=robot(3), middle=tuple(q), v=tuple(v), sin=tuple(np.sin(psi)), cos=tuple(np.cos(psi))
    )
    smooth, rubbed = (np.array(rough_contact(r).load((0.0,), (jnp.zeros(()),) * 3, now)) for r in (0.0, 0.5))
    tip, at = np.sin(psi) @ reach, np.sin(0.02 * np.arange(1, 4)) @ reach
    slide = np.sin(psi) * np.cumsum(v) @ reach
    assert (rubbed - smooth) @ v == pytest.approx(-0.5 * 300.0 * (tip - at) * abs(slide), rel=0.02)


def test_an_obstacle_that_is_shoved_along_pushes_no_more_and_stays_there(robot):
    """Of 300 N/m, by more than 0.5 N: its force follows the tip's way less that by which it has been shoved."""
    contact: Any = REGISTRY["contact"]
    model, none = robot(1), jnp.zeros(())
    box, way = contact(angle_rad=0.02, obstacle=300.0, rough=0.0, yields=2.0), float(model.chain.half_length_m)

    def at(q: float) -> Any:
        x = jnp.asarray(q)
        return SimpleNamespace(model=model, middle=(x,), v=(none,), sin=(jnp.sin(x),), cos=(jnp.cos(x),))

    memory, shoved = (none,), 0.0
    for q in (0.03, 0.2, 0.4, 0.35, 0.39, 0.5):
        beyond = way * (np.sin(q) - np.sin(0.02)) - shoved
        force, shoved = min(300.0 * max(beyond, 0.0), 0.5), shoved + max(beyond - 0.5 / 300.0, 0.0)
        (felt,) = box.load(memory, (none,), at(q))
        assert float(felt) == pytest.approx(-force * way * np.cos(q), abs=1e-9)
        memory = box.remember(memory, at(q), None)
        assert float(memory[0]) == pytest.approx(shoved, abs=1e-12)
    assert 0 < shoved < way * (np.sin(0.5) - np.sin(0.02))


def test_a_tip_that_sticks_to_an_obstacle_is_stable_at_long_steps(robot):
    """Such friction damps far more heavily than a step of 10 ms would bear if it were not solved for."""
    model = dataclasses.replace(robot(3), effects=(rough_contact(2.0),))
    coarse, fine = (np.asarray(simulate(model, drive(), at=jnp.asarray(AT), step_s=h).state.q) for h in (0.01, 0.001))
    assert np.abs(coarse - fine).max() < 0.05 * np.ptp(fine)
    free = np.asarray(simulate(robot(3), drive(), at=jnp.asarray(AT), step_s=0.01).state.q)
    assert np.abs(coarse - free).max() > 0.1 * np.ptp(fine)


@pytest.mark.parametrize(
    ("effect", "values"),
    [("viscoelastic_creep", {"stiffness": 1.0}), ("stiffness_hardening", {"cubic": 50.0}),
     ("rest_curvature", {"angle_rad": 0.1})],
)  # fmt: skip
def test_backbone_or_all_that_is_elastic(robot, effect, values):
    """The torque goes with α₂ of the sheath, or stays as it is in one without a vacuum."""
    kind: Any = REGISTRY[effect]
    model, one = robot(2), jnp.asarray(0.1)
    zero = jnp.zeros((2,))
    held = (tuple(zero),) * 2 if effect == "viscoelastic_creep" else ()

    def torque(layers: float, vacuum: float) -> float:
        alpha2 = (energy.alpha2(model, jnp.asarray(vacuum)),) * 2
        now: Any = SimpleNamespace(
            model=model, vacuum=jnp.asarray(vacuum), alpha2=alpha2, middle=(one, one), h=jnp.asarray(0.001)
        )
        return float(kind(**values, of_layers=layers).load(held, tuple(zero), now)[0])

    bare, stiff = (float(energy.alpha2(model, jnp.asarray(p))) for p in (0.0, 20.0))
    assert torque(0.0, 20.0) == pytest.approx(torque(1.0, 0.0)) != 0.0
    assert torque(1.0, 20.0) == pytest.approx(torque(0.0, 0.0) * stiff / bare)


def test_what_creeps_slower_than_a_rest_or_has_not_slid_is_no_spring_about_where_a_run_begins():
    """Branches of 3 s and 24 s have crept to where a body rests, one of 800 s has not; nor have wide layers slid."""
    q = jnp.asarray(0.02)
    now: Any = SimpleNamespace(q=(q,), vacuum=jnp.zeros(()))
    creep: Any = REGISTRY["viscoelastic_creep"]
    for tau, near, later in ((3.0, 1.0, 1 - np.exp(-30 / 24)), (100.0, 1 - np.exp(-0.3), 1 - np.exp(-30 / 800))):
        crept = [float(x[0]) for x in creep(stiffness=1.0, tau_s=tau).start(now)]
        np.testing.assert_allclose(crept, [0.02 * near, 0.02 * later], rtol=1e-3)
    layers: Any = REGISTRY["layer_hysteresis"]
    for width, stretched in ((0.5, 0.02), (0.002, 0.0)):  # and, four times as wide, nearly so
        first, second, *_ = layers(torque_nm=1.0, width_rad=width).start(now)
        assert float(first[0]) == pytest.approx(stretched, rel=0.01, abs=1e-4)
        assert float(second[0]) == pytest.approx(stretched, rel=0.01, abs=1e-4)


def test_a_lag_that_rings_goes_as_its_differential_equation():
    from scipy.integrate import solve_ivp

    from ljjax.effects.shapes import ringing

    tau, r, h = 0.02, 2.5, 0.005
    for x, held, speed in ((1.0, 0.2, 3.0), (0.0, 0.4, -1.0)):
        mean, end, rate = ringing(*(jnp.asarray(v) for v in (x, held, speed, tau, r, h)))
        ode = solve_ivp(
            lambda t, y: [y[1], (x - y[0] - 2 * tau * y[1]) / (tau**2 * (1 + r**2)), y[0]],  # noqa: B023
            (0, h), [held, speed, 0.0], rtol=1e-10, atol=1e-12,
        )  # fmt: skip
        np.testing.assert_allclose([end, rate, mean * h], ode.y[:, -1], rtol=1e-6)
    mean, end, rate = ringing(*(jnp.asarray(v) for v in (1.0, 0.2, 3.0, 0.0, r, h)))
    assert (float(mean), float(end), float(rate)) == (1.0, 1.0, 0.0)


def test_cogging_pulls_a_slack_tendon_but_never_pushes():
    """What a motor's cogging adds is the same at all tensions, up to what a slack tendon has to give."""
    ripple: Any = REGISTRY["actuator_ripple"]
    cogs = ripple(left_cosine=0.1, right_cosine=0.1, waves=10.0, stretch=1e-4, power=0.0)

    def pulled(t: float, bend: float) -> float:
        u = (jnp.asarray(t), jnp.asarray(5.0))
        now: Any = SimpleNamespace(u=u, middle=(jnp.asarray(bend),), h=jnp.asarray(0.01))
        (left, _), _ = cogs.actuate(cogs.start(now), u, now)
        return float(left)

    for tension in (0.3, 3.0, 30.0):
        assert pulled(tension, 0.0) == pytest.approx(tension + 1.0, abs=2e-3)
        half_a_wave = np.pi / 10
        assert pulled(tension, half_a_wave) == pytest.approx(max(tension - 1.0, 0.0), abs=2e-3)


def test_a_ripple_an_octave_up_does_the_same_and_has_room_for_its_own_overtone():
    """What only the second harmonic tells, on a wheel off its centre: the same tensions at twice the waves."""
    kind: Any = REGISTRY["actuator_ripple"]
    values = {n: float(about["null"]) for n, about in kind.fields().items()}
    values |= {"left_sine2": 0.07, "right_cosine2": -0.05, "left_once_sine": 0.1, "right_runout_cosine": 0.4}
    values |= {"waves": 9.0, "teeth": 6.0, "power": 0.5}
    (up,) = kind.likewise(values)
    assert up["waves"] == 18.0 and up["left_sine2"] == up["right_cosine2"] == 0.0
    for bend in np.linspace(-0.8, 0.8, 9):
        u = (jnp.asarray(6.0), jnp.asarray(3.0))
        now: Any = SimpleNamespace(u=u, middle=(jnp.asarray(bend),), h=jnp.asarray(0.01))
        one, other = (np.asarray(e.actuate(e.start(now), u, now)[0]) for e in (kind(**values), kind(**up)))
        np.testing.assert_allclose(one, other, rtol=1e-9)
        assert abs(one[0] - 6.0) > 1e-3


def test_a_soft_lining_rubs_no_more_than_so_much_at_small_tensions():
    """e³ at most: (0.1/10)^(0.3 − 1) makes an exponent of 20 of six joints' bends of 0.3 rad."""
    rubs: Any = REGISTRY["tendon_friction"](**{"mu": 1.0, "power": 0.3})
    one, rest = jnp.asarray(1.0), jnp.asarray(0.3)
    for u in (0.1, 0.0):
        now: Any = SimpleNamespace(middle=(rest,) * 6, q=(rest,) * 6, u=(jnp.zeros(()), jnp.asarray(u)), model=None)
        now.model = SimpleNamespace(lever=None, chain=SimpleNamespace(lever_arm_m=jnp.asarray(0.02)))
        felt = np.asarray(rubs.load(((one,) * 6, (one,) * 6), (jnp.zeros(()),) * 6, now))
        np.testing.assert_allclose(felt, -0.02 * u * np.expm1(3.0), rtol=1e-4)


def test_cable_let_go_below_the_tension_of_slack_is_not_lost():
    """f = 2 s/rad: of 0.1 rad of bending to its side at 9 N of T_s = 10 N, half is let go, faster than the spool winds;
    it is still to be wound up at 20 N."""
    slack: Any = REGISTRY["tendon_slack"](**{"freed": 2.0, "slack_n": 10.0})
    h, zero = jnp.asarray(0.01), jnp.zeros(())
    now: Any = SimpleNamespace(u=(jnp.asarray(9.0), zero), v=(jnp.asarray(1.0),), h=h)
    memory = slack.start(now)
    for _ in range(10):
        _, memory = slack.actuate(memory, now.u, now)
    held = float(memory[3])
    assert held > 0.005
    now.v, now.u = (zero,), (jnp.asarray(20.0), zero)
    (left, _), memory = slack.actuate(memory, now.u, now)
    assert float(left) < 20.0 and float(memory[3]) < held


def test_a_wheel_off_its_centre_ripples_more_on_one_side_of_its_turn():
    """Of 8 teeth, E = 1 + e sin(w φ/8) at the crests of the left tendon's wave, a cosine of its own at the right's."""
    ripple: Any = REGISTRY["actuator_ripple"]
    wheel = ripple(left_sine=0.1, right_sine=0.1, waves=16.0, stretch=1e-4, power=0.0, teeth=8.0,
                   left_runout_sine=0.6, right_runout_cosine=0.3)  # fmt: skip
    for crest in (0, 1, 2):
        bend = (2 * np.pi * crest + np.pi / 2) / 16.0
        u = (jnp.asarray(5.0), jnp.asarray(5.0))
        now: Any = SimpleNamespace(u=u, middle=(jnp.asarray(bend),), h=jnp.asarray(0.01))
        (left, right), _ = wheel.actuate(wheel.start(now), u, now)
        assert float(left) == pytest.approx(5.0 + 1 + 0.6 * np.sin(2 * bend), abs=0.02)
        assert float(right) == pytest.approx(5.0 - 1 - 0.3 * np.cos(2 * bend), abs=0.02)


@pytest.mark.parametrize("h", [0.002, 0.01, 0.04])
def test_a_loop_of_limited_rate_goes_at_that_rate_whatever_the_step(h):
    """A jump of 10 N at 5 N/0.01 s."""
    kind: Any = REGISTRY["actuator_lag"]
    lag, memory, out = kind(tau_s=0.01, power=1.0), ((jnp.asarray(2.0),) * 2,) * 2 + ((jnp.zeros(()),) * 2,) * 2, []
    for _ in range(round(0.08 / h)):
        (mean, _), memory = lag.actuate(memory, (jnp.asarray(12.0),) * 2, SimpleNamespace(h=jnp.asarray(h), v=()))
        out.append((float(mean), float(memory[0][0])))
    ends = h * np.arange(1, len(out) + 1)
    ramp = np.minimum(2 + 500 * np.linspace(0, 0.08, 8001), 12.0)
    means = ramp[:-1].reshape(len(out), -1).mean(axis=1)
    np.testing.assert_allclose(out, np.stack([means, np.minimum(2 + 500 * ends, 12.0)], axis=1), atol=0.02)


def test_each_motor_may_lag_in_its_own_way():
    kind: Any = REGISTRY["actuator_lag"]
    lag = kind(tau_s=0.1, second_s=0.05, difference=1.0)
    zero = jnp.zeros(())
    now: Any = SimpleNamespace(h=jnp.asarray(0.01), v=())
    (left, right), _ = lag.actuate(((zero, zero),) * 4, (jnp.asarray(4.0), jnp.asarray(4.0)), now)
    assert float(left) < 0.1 and float(right) == 4.0


def test_tension_may_fall_more_slowly_than_it_rises():
    """From 1 N to 4 N with a time constant of 0.1 s, back with one of 0.3 s."""
    kind: Any = REGISTRY["actuator_lag"]
    lag, now = kind(tau_s=0.1, falling=2.0), SimpleNamespace(h=jnp.asarray(1e-3), v=())
    low, high = jnp.asarray(1.0), jnp.asarray(4.0)
    for begin, asked, tau in ((low, high, 0.1), (high, low, 0.3)):
        memory, left = ((begin, begin), (begin, begin), (0.0 * begin,) * 2, (begin, begin)), begin
        for _ in range(200):
            (left, _), memory = lag.actuate(memory, (asked, asked), now)
        expected = float(asked + (begin - asked) * np.exp(-0.2 / tau))
        assert float(left) == pytest.approx(expected, rel=1e-2)


def test_a_share_of_the_tension_may_come_later():
    """0.7 of 4 N with a time constant of 0.1 s, 0.3 of it with one of 0.8 s."""
    kind: Any = REGISTRY["actuator_lag"]
    lag, u, now = (
        kind(tau_s=0.1, later=0.3),
        (jnp.asarray(4.0), jnp.zeros(())),
        SimpleNamespace(h=jnp.asarray(0.01), v=()),
    )
    memory = ((jnp.zeros(()),) * 2,) * 4
    for k in range(60):
        (left, _), memory = lag.actuate(memory, u, now)
        if k % 10 == 9:  # means of steps
            t = (k + 0.5) * 0.01
            came = 1 - 0.7 * np.exp(-t / 0.1) - 0.3 * np.exp(-t / 0.8)
            assert float(left) == pytest.approx(4.0 * came, rel=1e-2)


def test_load_presses_by_a_power_of_it_more_towards_the_base_and_more_where_it_goes_round_a_bend():
    kind: Any = REGISTRY["load_dependent_friction"]

    def more(load: float, **form: float) -> np.ndarray:
        q = tuple(jnp.asarray([0.0, 0.1, -0.2]))
        now: Any = SimpleNamespace(u=(jnp.asarray(0.5 * load), jnp.asarray(0.5 * load)), q=q)
        presses = kind(gain=0.2, **form)
        now.h = jnp.asarray(0.01)
        return np.array(presses.phi(presses.start(now), tuple(jnp.full((3,), 2.0)), now)) - 2.0

    along = more(10.0, power=0.5, to_base=0.5)
    np.testing.assert_allclose(along, [3.0, 2.0, 1.0], rtol=1e-5)  # 0.2 N·m/N of 10 N, and half as much again
    np.testing.assert_allclose(more(40.0, power=0.5, to_base=0.5), 2 * along, rtol=1e-5)
    np.testing.assert_allclose(more(10.0, bent=1.0), [0.0, 2.0, 4.0], atol=3e-3)
    np.testing.assert_allclose(more(10.0, of_layers=1.0), 2.0 * 2.0 / 10.0, rtol=1e-5)  # at φ = 2 N·m
    as_vacuum = np.sqrt(2.0**2 + 2 * 10.0 * 2.0) - 2.0  # c₅ √(P + κ u) − c₅ √P, where c₅² κ u is 40 (N·m)²
    np.testing.assert_allclose(more(10.0, as_vacuum=1.0), as_vacuum, rtol=2e-3)


NO_SLIP = (jnp.zeros(()),)


def test_segments_may_come_to_differ_with_use(robot):
    """u = 0.8, S₀ = 5 rad: a fifth of it at first, all but 0.8/e after 5 rad."""
    kind: Any = REGISTRY["nonuniform_stiffness"]
    differ, zero = kind(mode1=0.1, of_session=0.8, comes_rad=5.0), jnp.zeros(())
    now: Any = SimpleNamespace(model=robot(3), vacuum=zero, middle=(zero,) * 3, worn=zero, q=(zero, zero))
    memory, mean = differ.start(now), energy.alpha2(robot(3), zero)
    for worn, share in ((0.0, 0.2), (5.0, 1 - 0.8 * np.exp(-1))):
        if worn:
            memory = differ.remember(memory, now, SimpleNamespace(q=(jnp.asarray(8.0), jnp.asarray(-2.0))))
        more = np.array(differ.alpha2(memory, (mean,) * 3, now)) / float(mean) - 1
        np.testing.assert_allclose(more, 0.1 * share * np.array([-1, 0, 1]), rtol=1e-5, atol=1e-12)


def test_backbone_or_layers_may_differ_along_the_body(robot):
    kind: Any = REGISTRY["nonuniform_stiffness"]
    model, stiff = robot(3), {}
    for layers in (0.0, 0.5, 1.0):
        differ = kind(mode1=0.1, of_layers=layers)
        for vacuum in (0.0, 20.0):
            now: Any = SimpleNamespace(model=model, vacuum=jnp.asarray(vacuum), middle=(0.0, 0.1, -0.1))
            mean = energy.alpha2(model, now.vacuum)
            stiff[layers, vacuum] = np.array(differ.alpha2(NO_SLIP, (mean,) * 3, now)) / float(mean) - 1
    np.testing.assert_allclose(stiff[0.5, 20.0], [-0.1, 0.0, 0.1], atol=1e-12)
    np.testing.assert_allclose(stiff[0.5, 0.0], stiff[0.0, 0.0] / 2)
    np.testing.assert_allclose(stiff[1.0, 0.0], 0.0)
    np.testing.assert_allclose(stiff[0.0, 20.0] + stiff[1.0, 20.0], 2 * stiff[0.5, 20.0], atol=1e-12)
    assert min(np.ptp(stiff[0.0, 20.0]), np.ptp(stiff[1.0, 20.0])) > 0


def test_seams_may_resist_to_one_side(robot):
    model, one = robot(3), jnp.ones(())
    seam: Any = REGISTRY["nonuniform_stiffness"](**{"mode1": 0.1, "one_sided": 1.0})
    more = {}
    for q in (-0.5, 0.5):
        now: Any = SimpleNamespace(model=model, vacuum=0.0 * one, middle=(q * one,) * 3)
        mean = energy.alpha2(model, now.vacuum)
        more[q] = np.array(seam.alpha2(NO_SLIP, (mean,) * 3, now)) / float(mean) - 1
    np.testing.assert_allclose(more[0.5], [-0.2, 0.0, 0.2], rtol=1e-3, atol=1e-12)
    np.testing.assert_allclose(more[-0.5], 0.0, atol=1e-4)


def test_a_body_may_harden_to_one_side_more_than_to_the_other(robot):
    """r = 0.6: four times as much to the left as to the right."""
    kind: Any = REGISTRY["stiffness_hardening"]
    bent = jnp.asarray(0.3)
    model, felt = robot(3), []
    for side in (bent, -bent):
        now: Any = SimpleNamespace(model=model, middle=(side,) * 3, vacuum=jnp.zeros(()), alpha2=(jnp.ones(()),) * 3)
        felt.append(float(kind(cubic=2.0, one_sided=0.6).load((), (jnp.zeros(()),) * 3, now)[0]))
    np.testing.assert_allclose(felt, [-2.0 * 0.027 * 1.6, 2.0 * 0.027 * 0.4], rtol=5e-3)


def test_a_body_may_harden_in_some_joints_alone(robot):
    """P₁ − P₂ is −2, ½ and 0 along three joints: with a mean of 2 all of it is in the middle and at the tip."""
    kind: Any = REGISTRY["stiffness_hardening"]
    model, bent, none = robot(3), jnp.asarray(0.3), jnp.zeros(())
    now: Any = SimpleNamespace(model=model, middle=(bent,) * 3, vacuum=none, alpha2=(jnp.ones(()),) * 3)
    felt = kind(cubic=2.0, mode1=1.0, mode2=-1.0).load((), (none,) * 3, now)
    np.testing.assert_allclose(felt, -0.027 * np.array([0.0, 2.5, 2.0]), rtol=5e-3, atol=1e-9)


def test_a_slack_tendon_is_wound_up_before_the_body_feels_it():
    """Paid out within a tenth of a second, wound up in 20 ms at 10 N and in less the more pulls; in no less where the
    spool winds as fast under any load."""
    kind: Any = REGISTRY["tendon_slack"]
    h = 0.001
    for winds_n, tension, dead in ((5.0, 10.0, 0.020), (100.0, 40.0, 0.020 * 35 / 110), (0.01, 40.0, 0.020)):
        slack = kind(slack_s=0.02, slack_n=1.0, feels_s=1e-4, winds_n=winds_n)
        now: Any = SimpleNamespace(u=(jnp.asarray(5.0),) * 2, v=(jnp.zeros(()),) * 2, h=jnp.asarray(h))
        memory, felt = slack.start(now), []
        for u in [5.0] * 5 + [0.1] * 200 + [tension] * 40:
            (left, right), memory = slack.actuate(memory, (jnp.asarray(u), jnp.asarray(5.0)), now)
            felt.append(float(left))
            assert float(right) == pytest.approx(5.0)
        np.testing.assert_allclose(felt[:5], 5.0)
        assert max(felt[150:205]) < 0.01
        lost = (tension - np.array(felt[205:])).sum() * h / tension
        assert lost == pytest.approx(dead, rel=0.02)
        assert felt[-1] == pytest.approx(tension)


@pytest.mark.parametrize(("effect", "hook"), [("stiffness_saturation", "alpha2"), ("friction_saturation", "phi")])
def test_saturation_may_want_a_vacuum_first(effect, hook):
    """aPⁿ/(Pⁿ + p₀ⁿ): half at the knee; of third order an eighth of the first order's slope below it, none at 0."""
    kind: Any = REGISTRY[effect]

    def more(order: float, vacuum: float, edge: float = 1.0) -> float:
        now: Any = SimpleNamespace(vacuum=jnp.asarray(vacuum))
        law = kind(rise=2.0, knee_kpa=8.0, order=order, edge=edge)
        return float(getattr(law, hook)(law.start(now), (jnp.asarray(1.0),), now)[0]) - 1

    for order in (1.0, 3.0):
        assert [more(order, p) for p in (0.0, 8.0, 8e6)] == pytest.approx([0.0, 1.0, 2.0], abs=1e-4)
    assert more(1.0, 4.0) == pytest.approx(2 / 3) and more(3.0, 4.0) == pytest.approx(2 / 9)
    sharp = [more(1.0, p, edge=3.0) for p in (0.0, 4.0, 8.0, 8e6)]
    assert sharp == pytest.approx([0.0, 1 / np.cbrt(1 + 1 / 8), 2 / np.cbrt(2), 2.0], abs=1e-4)


@pytest.mark.parametrize(("effect", "hook"), [("stiffness_saturation", "alpha2"), ("friction_saturation", "phi")])
def test_saturation_may_come_in_two_steps(effect, hook):
    """Of 2 about 2 kPa and of 3 about 20: neither well below the first, one between them, both beyond."""
    kind: Any = REGISTRY[effect]
    law = kind(rise=5.0, second=0.6, knee_kpa=2.0, further=10.0, order=8.0)

    def more(vacuum: float) -> float:
        now: Any = SimpleNamespace(vacuum=jnp.asarray(vacuum))
        return float(getattr(law, hook)(law.start(now), (jnp.asarray(1.0),), now)[0]) - 1

    assert [more(p) for p in (0.0, 1.0, 6.0, 20.0, 60.0)] == pytest.approx([0.0, 0.0, 2.0, 3.5, 5.0], abs=0.01)


def test_a_motors_limit_folds_back_while_it_carries():
    """A sharp limit of 40 N that falls by what is carried: half of it is left in the end, all of it after a rest."""
    kind: Any = REGISTRY["actuator_saturation"]
    motor, h = kind(share=1.0, limit_n=40.0, edge=16.0, fold=1.0, fold_s=0.5), 0.01
    now: Any = SimpleNamespace(u=(jnp.zeros(()),) * 2, h=jnp.asarray(h))
    memory, felt = motor.start(now), []
    for u in [30.0] * 500 + [0.0] * 500 + [30.0]:
        (left, right), memory = motor.actuate(memory, (jnp.asarray(u), jnp.asarray(5.0)), now)
        felt.append(float(left))
        assert float(right) == pytest.approx(5.0, abs=1e-3)
    assert felt[0] == pytest.approx(felt[-1]) == pytest.approx(30.0, rel=0.01)
    assert felt[499] == pytest.approx(20.0, rel=0.05)


def test_a_hot_motor_is_derated_to_what_it_may_carry_for_good():
    """From c₀ = 0.2 on, and to 0.6 of 40 N; by heat, what is carried counts by its square."""
    kind: Any = REGISTRY["actuator_saturation"]
    h, u = 0.01, (jnp.asarray(20.0), jnp.zeros(()))
    now: Any = SimpleNamespace(u=u, h=jnp.asarray(h))
    for by_heat, hot in ((0.0, 0.5), (1.0, 0.25)):
        motor = kind(share=1.0, limit_n=40.0, edge=16.0, fold=1.0, fold_s=0.5, fold_from=0.2, by_heat=by_heat)
        memory = motor.start(now)
        for _ in range(1000):
            _, memory = motor.actuate(memory, u, now)
        assert float(memory[0][0]) == pytest.approx(hot, rel=0.02)
        felt = motor.actuate(memory, (jnp.asarray(100.0), u[1]), now)[0][0]
        assert float(felt) == pytest.approx(40.0 * (1 - (hot - 0.2)), rel=0.01)
    lasting = kind(share=1.0, limit_n=40.0, edge=16.0, fold=2.0, fold_s=0.5, fold_to=0.6)
    memory = lasting.start(now)
    for _ in range(1000):
        (felt, _), memory = lasting.actuate(memory, (jnp.asarray(100.0), u[1]), now)
    assert float(felt) == pytest.approx(0.6 * 40.0, rel=0.01)


def test_creep_goes_by_a_power_of_its_stress():
    """A branch held at a bend relaxes as ẋ = (q − x)/τ (|q − x|/x₀)²."""
    from scipy.integrate import solve_ivp

    kind: Any = REGISTRY["viscoelastic_creep"]
    creep, bend, h = kind(stiffness=1.0, tau_s=0.5, order=3.0), 0.05, 0.002
    now: Any = SimpleNamespace(q=(jnp.asarray(bend),), vacuum=jnp.asarray(10.0), h=jnp.asarray(h))
    memory: Any = ((jnp.zeros(()),), (jnp.zeros(()),))
    for _ in range(500):
        memory = creep.remember(memory, now, now)
    ode = solve_ivp(lambda _, x: (bend - x) / 0.5 * ((bend - x) / 0.03) ** 2, (0, 1.0), [0.0], rtol=1e-9)
    assert float(memory[0][0]) == pytest.approx(float(ode.y[0, -1]), rel=5e-3)
    assert float(memory[1][0]) < 0.5 * float(memory[0][0])


def test_layers_that_are_pressed_together_may_flow_more_slowly():
    """Of 0.05 rad 1 − exp(−t/τ) in 1 s, τ = 0.5 s without a vacuum, four times as long at 15 kPa."""
    kind: Any = REGISTRY["viscoelastic_creep"]
    creep, h = kind(stiffness=1.0, tau_s=0.5, slower_per_kpa=0.2), 0.01
    for vacuum, tau in ((0.0, 0.5), (15.0, 2.0)):
        now: Any = SimpleNamespace(q=(jnp.asarray(0.05),), vacuum=jnp.asarray(vacuum), h=jnp.asarray(h))
        memory: Any = ((jnp.zeros(()),), (jnp.zeros(()),))
        for _ in range(100):
            memory = creep.remember(memory, now, now)
        assert float(memory[0][0]) == pytest.approx(0.05 * (1 - np.exp(-1.0 / tau)))


def test_one_hose_through_the_whole_body_hardens_with_its_mean_bend(robot):
    """h = 1: every joint feels what the mean one's bend makes, also one that is straight."""
    kind: Any = REGISTRY["stiffness_hardening"]
    bends = (jnp.asarray(0.3), jnp.asarray(0.0), jnp.asarray(0.0))
    now: Any = SimpleNamespace(model=robot(3), middle=bends, vacuum=jnp.zeros(()), alpha2=(jnp.ones(()),) * 3)
    felt = kind(cubic=2.0, as_one=1.0).load((), (jnp.zeros(()),) * 3, now)
    np.testing.assert_allclose(felt, -2.0 * 0.1**3, rtol=1e-5)


@pytest.mark.parametrize(("effect", "size", "share", "over"), [
    ("tip_payload", "mass_kg", "lost", "loses_rad"), ("sensor_scale", "error", "creeps", "creeps_rad")])  # fmt: skip
def test_a_load_may_drip_and_a_zoom_may_creep(robot, effect, size, share, over):
    """After 20 rad of slip, of 10 rad, of what is there at first 1 − 0.5 (1 − e⁻²) and of what comes 1 − 0.5 e⁻²."""
    kind: Any = REGISTRY[effect]
    one, zero = jnp.ones(()), jnp.zeros(())
    about = {"model": robot(2), "q": (zero, zero), "middle": (zero, zero), "h": jnp.asarray(0.01)}
    now: Any = SimpleNamespace(**about, sin=(one, one), cos=(zero, zero), worn=20.0 * one)
    values = {size: 0.1, share: 0.5, over: 10.0}

    def acts(**values: float) -> float:
        acting = kind(**values)
        if effect == "tip_payload":
            return float(acting.load(acting.start(now), (zero, zero), now)[0])
        (seen, _), _ = acting.sense(acting.start(now), (one, one), now)
        assert float(acting.unsense((seen, seen), now)[0]) == pytest.approx(1.0)
        return float(seen) - 1

    left = 1 - 0.5 * (1 - np.exp(-2)) if effect == "tip_payload" else 1 - 0.5 * np.exp(-2)
    assert acts(**values) == pytest.approx(left * acts(**{size: 0.1}))


def test_an_offset_may_come_within_each_run():
    """g = 1: none at its start, of b half at 5 s; a run is begun where the body is."""
    kind: Any = REGISTRY["sensor_bias"]
    bias, y = kind(offset_rad=0.02, drifts=1.0), (jnp.asarray(0.1),)
    for t in (0.0, 5.0):
        now: Any = SimpleNamespace(t=jnp.asarray(t), h=jnp.asarray(0.0))
        (seen,), _ = bias.sense((), y, now)
        assert float(seen) == pytest.approx(0.1 + 0.02 * t / 10)
        assert float(bias.unsense((seen,), now)[0]) == pytest.approx(0.1)


def test_markers_may_be_read_one_after_the_other():
    """g = 0.5: to first order the base's joint is seen half as much later again, the tip's half as much sooner."""
    kind: Any = REGISTRY["sensor_delay"]
    now: Any = SimpleNamespace(q=(jnp.zeros(()),) * 2, t=jnp.zeros(()), h=jnp.asarray(0.01))
    delay = kind(delay_seconds=0.02, to_base=0.5, drift=0.0)
    seen, _ = delay.sense(delay.start(now), (jnp.asarray(0.01),) * 2, now)
    np.testing.assert_allclose(seen, [0.01 - 0.01, 0.01 + 0.01])


def test_warmth_may_be_near_the_base():
    kind: Any = REGISTRY["thermal_drift"]
    now: Any = SimpleNamespace(warm=jnp.asarray(2.0), h=jnp.asarray(0.01), u=(jnp.zeros(()),) * 2)
    drift = kind(friction_per_k=-0.1, to_base=0.5)
    got = drift.phi(drift.start(now), (jnp.ones(()),) * 3, now)
    np.testing.assert_allclose(got, [1 - 0.3, 1 - 0.2, 1 - 0.1], rtol=1e-4)


def test_grease_thins_as_it_warms():
    """By the half at W = 5 K for b = −0.1/K: so much less of φ σ₂ v."""
    kind: Any = REGISTRY["thermal_drift"]
    warm: Any = SimpleNamespace(warm=jnp.asarray(5.0), h=jnp.asarray(0.01))
    stage: Any = SimpleNamespace(phi=(jnp.asarray(4.0),), friction=SimpleNamespace(sigma2=jnp.asarray(0.02)))
    thin = kind(viscous_per_k=-0.1)
    felt = thin.torque(thin.start(warm), 0, jnp.zeros(()), jnp.asarray(3.0), stage)
    assert float(felt) == pytest.approx(-0.5 * 4.0 * 0.02 * 3.0, rel=1e-3)


def test_tendons_may_press_from_some_load_on():
    kind: Any = REGISTRY["load_dependent_friction"]
    press = kind(gain=0.1, from_n=8.0)
    for load, more in ((6.0, 0.0), (14.0, 0.6)):
        now: Any = SimpleNamespace(u=(jnp.asarray(load), jnp.zeros(())), q=(jnp.zeros(()),), h=jnp.asarray(0.01))
        (phi,) = press.phi(press.start(now), (jnp.asarray(10.0),), now)
        assert float(phi) == pytest.approx(10.0 + more)


def test_layers_rub_more_the_more_they_are_bent():
    """hφ|q| against the motion, turning round within x₀."""
    kind: Any = REGISTRY["layer_hysteresis"]
    rubs, phi = kind(with_bend=0.05, width_rad=0.01), 20.0
    path = [*np.linspace(0.0, 0.2, 201), *np.linspace(0.2, 0.1, 101)]
    memory, felt = None, []
    for q, after in zip(path[:-1], path[1:], strict=True):
        angle, h = (jnp.asarray(q),), jnp.asarray(0.01)
        at: Any = SimpleNamespace(q=angle, middle=angle, phi=(jnp.asarray(phi),), vacuum=0.0, h=h)
        memory = rubs.start(at) if memory is None else memory
        felt.append(float(rubs.load(memory, (jnp.zeros(()),), at)[0]))
        memory = rubs.remember(memory, at, SimpleNamespace(q=(jnp.asarray(after),)))
    assert felt[200] == pytest.approx(-0.05 * phi * 0.2, rel=1e-3)
    assert felt[-1] == pytest.approx(0.05 * phi * 0.101, rel=1e-3)
    assert abs(felt[200 + 7]) < 0.2 * abs(felt[200])


def warmed(kind: Any, kelvin: float, hook: str = "phi") -> jax.Array:
    """What becomes of a friction, or stiffness, of 1."""
    now: Any = SimpleNamespace(warm=jnp.asarray(kelvin), h=jnp.asarray(0.01), u=(jnp.zeros(()),) * 2)
    return getattr(kind, hook)(kind.start(now), (jnp.ones(()),), now)[0]


def test_a_robot_may_warm_faster_than_is_taken_for_granted():
    """W goes as 1 − exp(−t/τ) of 110 s where ΔT is taken to go with 600 s; c = 0 is ΔT itself."""
    kind: Any = REGISTRY["thermal_drift"]
    t = np.array([60.0, 150.0, 300.0, 540.0])
    given = -10.0 * np.expm1(-t / 600.0)

    def drift(curve: float) -> np.ndarray:
        return np.array([float(warmed(kind(friction_per_k=0.1, curve_per_k=curve), w)) - 1 for w in given])

    np.testing.assert_allclose(drift(0.0), 0.1 * given, rtol=1e-4)
    slope = jax.grad(lambda c: warmed(kind(friction_per_k=0.1, curve_per_k=c), 6.0))(0.0)
    assert float(slope) == pytest.approx(-0.1 * 6.0**2 / 2, rel=1e-3)  # or no fit would ever leave c = 0
    np.testing.assert_allclose(
        drift(0.6) / drift(0.6)[-1], -np.expm1(-t / 110.0) / -np.expm1(-540.0 / 110.0), atol=0.03
    )


def test_layers_may_rub_most_when_lukewarm():
    """f = 0.25/K: W exp(−f ΔT) rises to 4 K and falls."""
    warms = REGISTRY["thermal_drift"](**{"friction_per_k": 0.1, "falls_per_k": 0.25})
    more = [float(warmed(warms, w)) - 1 for w in (2.0, 4.0, 8.0)]
    np.testing.assert_allclose(more, [0.2 * np.exp(-0.5), 0.4 * np.exp(-1), 0.8 * np.exp(-2)], rtol=1e-3)


def test_layers_may_soften_all_at_once_at_some_warmth():
    """T₀ = 4 K, c = 3/K: nothing until 4 K, nearly all of b/c at 6 K; below 0 there is no threshold."""
    warms: Any = REGISTRY["thermal_drift"](**{"stiffness_per_k": -0.9, "curve_per_k": 3.0, "from_k": 4.0})

    def share(warm: float) -> float:
        return float(warmed(warms, warm, "alpha2"))

    past = 1 - 0.3 * -np.expm1(-3.0 * np.array([0.5, 2.0]))
    np.testing.assert_allclose([share(w) for w in (1.0, 3.9, 4.5, 6.0)], [1.0, 1.0, *past], rtol=1e-5)
    assert share(-0.1) == pytest.approx(1 - 0.3 * -np.expm1(0.3), rel=1e-5)


def test_drives_damp_the_whole_bend_at_any_step(robot):
    """So heavily that a step of 10 ms must solve for it; in a body of one joint as any damper does."""
    kind: Any = REGISTRY["viscous_damping"]
    model = dataclasses.replace(robot(3), effects=(kind(of_drives=0.5),))
    coarse, fine = (np.asarray(simulate(model, drive(), at=jnp.asarray(AT), step_s=h).state.q) for h in (0.01, 0.001))
    assert np.abs(coarse - fine).max() < 0.05 * np.ptp(fine)
    one, plain = (dataclasses.replace(robot(1), effects=(kind(**{n: 0.05}),)) for n in ("of_drives", "damping"))
    models = one, plain, robot(1)
    a, b, free = (np.asarray(simulate(m, drive(), at=jnp.asarray(AT), step_s=0.001).state.q) for m in models)
    assert np.abs(a - b).max() < 0.1 * np.abs(free - b).max()
    assert np.abs(a - b).max() < 0.01 * np.ptp(b)


def test_damping_may_be_of_grease_that_is_squeezed_more_towards_the_tip_or_go_with_the_stiffness():
    kind: Any = REGISTRY["viscous_damping"]
    stage: Any = SimpleNamespace(alpha2=(3.0, 3.0, 3.0), bare=2.0)

    def felt(bent: float, q: float) -> float:
        return float(kind(damping=0.5, bent=bent).torque((0.0,) * 3, 0, jnp.asarray(q), jnp.asarray(0.2), stage))

    assert felt(0.0, 0.2) == pytest.approx(0.5 * 0.2)
    np.testing.assert_allclose([felt(0.75, q) for q in (0.0, 0.1, 0.2)], [0.025, 0.1, 0.325], rtol=1e-6)
    rest, v = jnp.asarray(0.0), jnp.asarray(0.2)
    along = [float(kind(damping=0.5, to_base=-0.6).torque((0.0,) * 3, i, rest, v, stage)) for i in range(3)]
    np.testing.assert_allclose(along, [0.04, 0.1, 0.16], rtol=1e-6)  # more of it towards the tip
    stiff = [float(kind(damping=0.5, of_layers=s).torque((0.0,) * 3, 0, rest, v, stage)) for s in (0.0, 0.5, 1.0)]
    np.testing.assert_allclose(stiff, [0.1, 0.125, 0.15], rtol=1e-6)  # α₂ is half as much again as without a vacuum


def test_grease_may_thin_while_it_is_sheared_and_set_again():
    """Moore's law: at 0.5 rad/s with q_t = 0.1 rad and τ = 2 s it comes to w = 5/(5 + 0.5) at 5.5 a second."""
    kind: Any = REGISTRY["viscous_damping"]
    grease, h, stage = (
        kind(damping=0.5, thins=0.8, thins_rad=0.1, sets_s=2.0),
        0.01,
        SimpleNamespace(alpha2=(2.0,), bare=2.0),
    )

    def at(q: float) -> Any:
        return SimpleNamespace(q=(jnp.asarray(q),), h=jnp.asarray(h))

    memory, q, worked = grease.start(at(0.0)), 0.0, 0.0
    for rate in (0.5, 0.0):
        begun = worked
        for _ in range(50):
            memory = grease.remember(memory, at(q), at(q + rate * h))
            q += rate * h
        k, end = rate / 0.1 + 0.5, rate / 0.1 / (rate / 0.1 + 0.5)
        worked = end + (begun - end) * np.exp(-k * 0.5)
        felt = float(grease.torque(memory, 0, jnp.asarray(q), jnp.asarray(0.2), stage))
        assert felt == pytest.approx(0.5 * 0.2 * (1 - 0.8 * worked), rel=1e-5)


def test_a_base_that_is_loose_rocks_to_the_side_to_which_the_body_hangs(robot):
    """By 0.1 rad with two lags of 0.3 s, or on a slender stand to and fro, as a base tilted so far the other way."""
    kind: Any = REGISTRY["base_tilt"]
    model, t, rings = robot(2), 0.01 * np.arange(1, 61), 7.0
    damping = 1 / np.sqrt(1 + rings**2)
    own = np.sqrt(1 - damping**2) / 0.3
    swings = np.exp(-damping * t / 0.3) * (np.cos(own * t) + damping / (0.3 * own) * np.sin(own * t))

    def at(q: float) -> Any:
        joints = (jnp.asarray(q),) * 2
        now = SimpleNamespace(model=model, q=joints, middle=joints, h=jnp.asarray(0.01))
        now.sin, now.cos = (jnp.zeros(()),) * 2, (jnp.ones(()),) * 2
        return now

    for r, left in ((0.0, np.exp(-t / 0.3) * (1 + t / 0.3)), (rings, swings)):
        loose = kind(loose_rad=-0.1, hangs_rad=0.01, rocks_s=0.3, rings=r)
        memory = loose.start(at(0.2))
        for side in -1 + 2 * left:
            memory = loose.remember(memory, at(-0.2), None)
            felt, tilted = (
                e.load(m, (jnp.zeros(()),) * 2, at(-0.2))
                for e, m in ((loose, memory), (kind(tilt_rad=-0.1 * side), (0.0, 0.0)))
            )
            np.testing.assert_allclose(np.array(felt), np.array(tilted), rtol=1e-4, atol=1e-9)


def test_a_load_beside_the_axis_is_a_load(robot):
    """Its moment goes with its mass: a tilted base is no payload without one."""
    kind: Any = REGISTRY["tip_payload"]
    model, zero = robot(2), (jnp.zeros(()),) * 2
    now: Any = SimpleNamespace(
        model=model, q=zero, middle=zero, sin=zero, cos=(jnp.ones(()),) * 2, h=jnp.asarray(0.01), worn=jnp.zeros(())
    )
    none, some = kind(mass_kg=0.0, aside_m=0.05), kind(mass_kg=0.1, aside_m=0.05)
    assert [float(x) for x in none.load(none.start(now), zero, now)] == [0.0, 0.0]
    both = some.load(some.start(now), zero, now)
    np.testing.assert_allclose(both, -9.80665 * 0.1 * 0.05)
    assert limits(dataclasses.replace(model, effects=(kind(),)))["effects.tip_payload.aside_m"] == (-0.05, 0.05)


def test_a_load_may_be_held_out_beyond_the_tip(robot):
    """Of two joints the second is half a link, the first one and a half, from the tip: b more, for weight and mass."""
    held: Any = REGISTRY["tip_payload"](**{"mass_kg": 0.1, "beyond_m": 0.06})
    model, none, one = robot(2), (jnp.zeros(()),) * 2, (jnp.ones(()),) * 2
    arms = np.array([3.0, 1.0]) * float(model.chain.half_length_m) + 0.06
    about = {"model": model, "q": none, "middle": none, "h": jnp.asarray(0.01), "worn": jnp.zeros(())}
    level: Any = SimpleNamespace(**about, sin=one, cos=none)
    np.testing.assert_allclose(held.load(held.start(level), none, level), -9.80665 * 0.1 * arms)
    hung: Any = SimpleNamespace(**about, sin=none, cos=one)
    np.testing.assert_allclose(
        held.inertia(held.start(hung), ((0.0, 0.0), (0.0, 0.0)), hung), 0.1 * np.outer(arms, arms)
    )


def test_a_lens_stretches_what_is_off_the_axis():
    """The second of two links that lean alike by 0.25 rad is 0.5 rad off, which counts in full."""
    lens = REGISTRY["sensor_scale"](**{"off_axis": 0.1})
    bent, now = (jnp.asarray(0.25), jnp.asarray(0.25)), cast(Any, SimpleNamespace(worn=jnp.zeros(())))
    (first, second), _ = lens.sense(lens.start(now), bent, now)
    np.testing.assert_allclose((first, second), (0.25 * (1 + 0.1 / 4), 0.25 * 1.1), rtol=1e-12)
    np.testing.assert_allclose(lens.unsense((first, second)), (0.25, 0.25), rtol=1e-9)


def test_a_picture_may_be_wider_than_it_is_high():
    """Links at 0.3 and 0.7 rad, as their ends are seen."""
    wide = REGISTRY["sensor_scale"](**{"wide": 0.2})
    bent, now = (jnp.asarray(0.3), jnp.asarray(0.4)), cast(Any, SimpleNamespace(worn=jnp.zeros(())))
    seen, _ = wide.sense(wide.start(now), bent, now)
    expected = [np.arctan2(1.2 * np.sin(x), np.cos(x)) for x in (0.3, 0.7)]
    np.testing.assert_allclose(np.cumsum(seen), expected, rtol=1e-12)
    np.testing.assert_allclose(wide.unsense(seen), bent, rtol=1e-9)


def test_one_supply_limits_what_both_drives_draw():
    kind: Any = REGISTRY["actuator_saturation"]
    both: Any = (jnp.asarray(12.0), jnp.asarray(8.0))
    for shared, expected in ((0.0, (10.0, 8.0)), (1.0, (6.0, 4.0))):
        limit = kind(share=1.0, limit_n=10.0, edge=16.0, shared=shared)
        now: Any = SimpleNamespace(u=both, h=jnp.asarray(1e-3))
        (one, other), _ = limit.actuate(limit.start(now), both, now)
        np.testing.assert_allclose((one, other), expected, rtol=0.02)


def test_a_body_that_bends_to_a_tendon_lets_go_of_its_cable():
    """Bent at once by 1 rad to the left: 0.2 s of cable at hand there, half of it at T_s, which a tension of 10 N winds
    up before the body feels it; none on the other side."""
    kind: Any = REGISTRY["tendon_slack"]
    slack, h = kind(freed=0.2, slack_n=10.0, feels_s=1e-4), 0.01
    tension: Any = (jnp.asarray(10.5), jnp.asarray(10.5))
    now: Any = SimpleNamespace(u=tension, v=(jnp.asarray(100.0), jnp.asarray(0.0)), h=jnp.asarray(h))
    memory, felt = slack.start(now), []
    still: Any = SimpleNamespace(u=tension, v=(jnp.asarray(0.0),) * 2, h=jnp.asarray(h))
    for k in range(60):
        u, memory = slack.actuate(memory, tension, now if k < 1 else still)
        felt.append([float(x) for x in u])
    left, right = np.array(felt).T
    assert np.all(right == 10.5)
    assert left[1] < 1e-9 and left[-1] == 10.5 and 0.05 < h * np.sum(left < 1e-9) < 0.3


@pytest.mark.parametrize("h", [0.001, 0.01])
def test_slack_cable_tightens_little_by_little_from_no_more_than_there_is(h):
    """Of 0.5 s of cable let go 0.1 s are there to be slack; ∫ 1 − exp(−s/τ) dt of the tension is lost in winding it."""
    kind: Any = REGISTRY["tendon_slack"]
    slack = kind(freed=0.5, slack_n=1.0, most_s=0.1, feels_s=0.03)
    tension: Any = (jnp.asarray(1e-9), jnp.asarray(1e-9))
    bends: Any = SimpleNamespace(u=tension, v=(jnp.asarray(10.0),), h=jnp.asarray(h))
    memory = slack.start(bends)
    for _ in range(round(0.1 / h)):
        _, memory = slack.actuate(memory, tension, bends)
    assert float(memory[3]) == pytest.approx(0.1, rel=1e-6)
    still: Any = SimpleNamespace(u=tension, v=(jnp.asarray(0.0),), h=jnp.asarray(h))
    lost = 0.0
    for _ in range(round(0.2 / h)):
        (left, _), memory = slack.actuate(memory, (jnp.asarray(10.0), jnp.asarray(1e-9)), still)
        lost += h * (1 - float(left) / 10.0)
    assert lost == pytest.approx(0.1 - 0.03 * (1 - np.exp(-0.1 / 0.03)), rel=0.01)


def test_what_turns_may_rub_less_the_more_it_is_drawn():
    kind: Any = REGISTRY["actuator_deadband"]
    drawn: Any = (jnp.asarray(1.0), jnp.asarray(10.0))
    band, now = kind(share=1.0, band_n=2.0, edge=8.0, fades=0.5), SimpleNamespace(u=drawn, h=jnp.asarray(0.01))
    (below, above), _ = band.actuate(band.start(now), drawn, now)
    np.testing.assert_allclose((below, above), (0.0, 10 - 2 * np.exp(-2.0)), atol=2e-3)


def test_grease_may_thin_while_it_is_worked_and_set_again_at_rest():
    """Of 2 N three quarters, with 0.5 s while it turns and twice that while it does not."""
    kind: Any = REGISTRY["actuator_deadband"]
    band = kind(share=1.0, band_n=2.0, edge=8.0, fades=0.0, thins=0.75, thins_s=0.5)
    drawn, none = (jnp.asarray(10.0),) * 2, (jnp.zeros(()),) * 2
    now: Any = SimpleNamespace(u=drawn, h=jnp.asarray(0.01))
    memory, worked = band.start(now), 0.0
    for k in range(150):
        turns = k < 50 or k >= 100
        (left, _), memory = band.actuate(memory, drawn if turns else none, now)
        before, end = worked, 1.0 if turns else 0.0
        worked = end + (worked - end) * np.exp(-0.01 / (0.5 if turns else 1.0))
        if turns:
            assert 10 - float(left) == pytest.approx(2 * (1 - 0.75 * (before + worked) / 2), abs=2e-3)


def test_friction_differs_more_the_more_a_joint_is_bent():
    """Bending further and straightening, at once for a small w, in proportion for a large one."""
    kind: Any = REGISTRY["friction_asymmetry"]
    before, after = (tuple(map(jnp.asarray, q)) for q in ((0.04, 0.09, 0.11), (0.05, 0.1, 0.1)))
    here, there, phi = (
        cast(Any, SimpleNamespace(q=before)),
        cast(Any, SimpleNamespace(q=after)),
        (jnp.asarray(2.0),) * 3,
    )

    def scaled(w: float, **form: float) -> Any:
        effect = kind(whole=0.5, bent_rad=w, turn_rad=5e-4, **form)
        return effect.phi(effect.remember(effect.start(here), here, there), phi, there)

    np.testing.assert_allclose(scaled(0.002), (3.0, 3.0, 1.0), rtol=1e-3)
    np.testing.assert_allclose(np.subtract(scaled(1.0), 2.0), (0.05, 0.1, -0.1), rtol=1e-2)
    to_one_side = np.subtract(scaled(0.002, one_sided=0.6), 2.0) / np.subtract(scaled(0.002), 2.0)
    np.testing.assert_allclose(to_one_side, 1 + 0.6 * np.sign([float(q) for q in after]), rtol=1e-2)


def test_loading_and_unloading_change_places_within_a_rotation():
    effect: Any = REGISTRY["friction_asymmetry"](share=0.5, bent_rad=0.002, turn_rad=0.02)  # type: ignore[call-arg]
    memory, slips = (jnp.asarray(0.0),), []
    for a, b in ((-0.5, -0.4), (-0.001, 0.01), (0.01, 0.5)):  # straightened, just bent to the other side, bent far
        before, after = (cast(Any, SimpleNamespace(q=(jnp.asarray(q),))) for q in (a, b))
        memory = effect.remember(memory, before, after)
        slips.append(float(effect.slip(memory, (jnp.asarray(1.0),), after)[0]))
    bent = 0.01 / np.hypot(0.01, 0.002)
    turning = bent - (1 + bent) * np.exp(-0.011 / 0.02)
    assert slips == pytest.approx([0.5, 1 + 0.5 * turning, 1.5], abs=5e-3)


def test_an_obstacle_beside_the_body_leaves_the_joints_beyond_it_free(robot):
    contact: Any = REGISTRY["contact"]
    q = np.array([0.05, 0.03, 0.04])
    psi, zero = np.cumsum(q), (0.0,) * 3
    now: Any = SimpleNamespace(model=robot(3), middle=tuple(q), v=zero, sin=tuple(np.sin(psi)), cos=tuple(np.cos(psi)))
    beside = contact(angle_rad=0.02, obstacle=300.0, rough=0.0, share=0.5)  # half a link beyond the second joint
    load = np.array(beside.load((zero[0],), (jnp.zeros(()),) * 3, now))
    links = 2 * float(robot(3).chain.half_length_m) * np.array([1.0, 0.25])
    force = 300.0 * (np.sin(psi[:2]) - np.sin([0.02, 0.04])) @ links
    arms = [np.cos(psi[:2]) @ links, np.cos(psi[1]) * links[1], 0.0]
    np.testing.assert_allclose(load, -force * np.array(arms), atol=1e-9)


def test_a_soft_lining_rubs_by_a_power_of_what_presses_it_and_an_uneven_one_by_its_place(robot):
    kind: Any = REGISTRY["tendon_friction"]
    model, zero = robot(2), jnp.zeros(())

    def lost(tension: float, q: tuple[float, float], **form: float) -> np.ndarray:
        """(2,) torques that a small friction takes at each joint while the body bends further, over the arm."""
        now: Any = SimpleNamespace(
            model=model, q=(zero, zero), middle=tuple(map(jnp.asarray, q)), u=(jnp.asarray(tension), zero)
        )
        load = kind(mu=0.01, **form).load(((jnp.asarray(1.0),) * 2,) * 2, (zero, zero), now)
        return -np.array(list(map(float, load))) / float(model.chain.lever_arm_m)

    bent = (0.2, 0.05)
    np.testing.assert_allclose(lost(20.0, bent), [20 * 0.002, 20 * 0.0025], rtol=2e-3)
    first = 0.002 * (20 * 0.2 / (10 * 0.1)) ** -0.3
    second = 0.0005 * (20 * 0.05 / (10 * 0.1)) ** -0.3
    np.testing.assert_allclose(lost(20.0, bent, power=0.7), 20 * np.cumsum([first, second]), rtol=2e-3)
    np.testing.assert_allclose(lost(20.0, bent, to_base=0.5), 20 * np.cumsum([0.003, 0.00025]), rtol=2e-3)


def test_a_cable_that_sticks_hands_on_its_tension_until_friction_can_hold_no_more(robot):
    """Two bends of 0.2 rad, each of which holds e^0.1: from 10 N the tension falls by hundredths."""
    kind: Any = REGISTRY["tendon_friction"]
    cable, model, zero = kind(mu=0.5, held=1.0, still_rad_s=1e-4), robot(2), jnp.zeros(())
    bent = (jnp.asarray(0.2),) * 2

    def at(tension: float) -> Any:
        u = (jnp.asarray(tension), zero)
        return SimpleNamespace(model=model, q=bent, middle=bent, u=u, h=jnp.asarray(1e-6))

    memory, pull = cable.start(at(10.0)), 10.0
    for k in range(1, 41):
        memory = cable.remember(memory, at(pull := 10.0 * np.exp(-0.01 * k)), SimpleNamespace(q=bent))
        load = np.array(list(map(float, cable.load(memory, (zero, zero), at(pull)))))
        beyond = pull + load / float(model.chain.lever_arm_m)
        first = min(10.0, pull * np.exp(0.1))
        np.testing.assert_allclose(beyond, [first, min(10.0, first * np.exp(0.1))], rtol=1e-3)


def test_a_tendon_slides_past_each_joint_by_what_is_beyond_it_or_as_one(robot):
    """The first joint bends by 0.3 rad, the second back by 0.1: past the first the tendon is drawn in, past the second
    it is paid out."""
    kind: Any = REGISTRY["tendon_friction"]
    model, zero = robot(2), jnp.zeros(())
    about = {"model": model, "q": (zero, zero), "middle": (zero, zero), "h": jnp.asarray(1e-4)}
    before: Any = SimpleNamespace(u=(jnp.asarray(9.0),) * 2, **about)
    after: Any = SimpleNamespace(q=(jnp.asarray(0.3), jnp.asarray(-0.1)))
    for as_one, second in ((0.0, -1.0), (1.0, 1.0)):
        rubs = kind(mu=0.5, turn_rad=0.002, still_rad_s=1e-4, as_one=as_one)
        pulled, paid_out, _ = rubs.remember(rubs.start(before), before, after)
        np.testing.assert_allclose([pulled, paid_out], [[1.0, second]] * 2, atol=1e-3)


def test_a_command_may_be_read_at_a_beat_and_held():
    """What is held is late by up to the beat, half of it on the mean."""
    kind: Any = REGISTRY["actuator_delay"]
    beat, h, rate = 0.2, 0.005, 8.0
    late = kind(delay_seconds=beat / 2, drift=2.0, reset_s=beat, phase=0.5)
    memory: tuple = (jnp.asarray(10.0 - rate * (beat / 2 + h)),) * 2
    out, t = [], h * np.arange(200)
    for begin in t:
        u = (jnp.asarray(10.0 + rate * (begin - beat / 2)),) * 2  # as it comes, delayed
        now: Any = SimpleNamespace(t=jnp.asarray(begin), h=jnp.asarray(h))
        (left, _), memory = late.actuate(memory, u, now)
        out.append(float(left))
    held = 10.0 + rate * beat * np.floor((t + h / 2) / beat)
    inside = np.abs((t + h / 2) / beat % 1.0 - 0.5) < 0.4  # it is handed on within a few hundredths of the beat
    np.testing.assert_allclose(np.array(out)[inside], held[inside], atol=0.03 * rate * beat)


def test_each_tendon_may_be_commanded_by_a_drive_of_its_own():
    """One is late by more, the other by less, than the delay that the inputs hold already."""
    kind: Any = REGISTRY["actuator_delay"]
    h, delay = 0.005, 0.012
    late, memory, off = kind(delay_seconds=delay, difference=0.4), (jnp.zeros(()),) * 2, []
    for begin in h * np.arange(300):
        middle = begin + 0.5 * h
        now: Any = SimpleNamespace(t=jnp.asarray(begin), h=jnp.asarray(h))
        out, memory = late.actuate(memory, (jnp.asarray(np.sin(6 * (middle - delay))),) * 2, now)
        off.append(
            [float(x) - np.sin(6 * (middle - d)) for x, d in zip(out, delay * np.array([1.4, 0.6]), strict=True)]
        )
    assert np.abs(off[2:]).max() < 0.05 * 6 * 0.4 * delay


@pytest.mark.parametrize(("order", "elastic"), [(0.0, 0.0), (0.5, 0.0), (1.0, 0.0), (2.0, 0.0), (1.0, 1.0), (0.6, 1.0)])
def test_layers_may_slide_little_by_little(order, elastic):
    """Dahl's model, and Bouc's and Wen's, that lets go as a spring, against their differential equations in small
    steps, there and back."""
    way = 0.03 * np.concatenate([np.linspace(0, 2.5, 500), np.linspace(2.5, -1.0, 700)])
    z, held, out = 0.0, jnp.zeros(()), []
    for k in range(1, len(way)):
        x = way[k] - way[k - 1]
        for _ in range(20):
            along = z * np.sign(x)
            slope = 1.0 if elastic and along < 0 else max(1 - along, 0.0) ** order
            z = float(np.clip(z + x / 20 / 0.03 * slope, -1, 1))
        held = dahl(held, jnp.asarray(x / 0.03), jnp.asarray(order), elastic)
        out.append((z, float(held)))
    exact, found = np.array(out).T
    np.testing.assert_allclose(found, exact, atol=0.02)
    assert exact.max() > 0.7 and exact.min() < -0.6
    kind: Any = REGISTRY["layer_hysteresis"]
    steep = jax.grad(lambda p: kind(torque_nm=1.0, order=p)._stuck(((0.01,), (0.0,), (), (30.0,)), (0.01,), 0.0)[0][0])
    assert np.isfinite(steep(0.0)) and float(steep(1.0)) < -1e-4  # it is stretched less, the larger the order


def test_a_coat_may_go_evenly_until_it_is_gone():
    kind: Any = REGISTRY["layer_wear"]
    worn = kind(loss=0.6, scale_rad=20.0, evenly=1.0)
    left = [float(worn.phi((jnp.asarray(s),), (jnp.ones(()),), None)[0]) for s in (0.0, 5.0, 10.0, 30.0)]
    np.testing.assert_allclose(left, [1.0, 0.85, 0.7, 0.4], atol=1e-6)


def test_what_links_carry_has_mass(robot):
    """A body of two links: its energy by hand."""
    kind: Any = REGISTRY["gravity_distribution"]
    model = robot(2)
    length, psi = float(model.chain.half_length_m), np.array([0.3, 0.8])
    now: Any = SimpleNamespace(model=model, sin=tuple(np.sin(psi)), cos=tuple(np.cos(psi)))
    none = ((0.0,), (0.0, 0.0))
    carried = kind(link_weight_n=0.4, of_mass=1.0).inertia((), none, now)
    mass, axis = 0.4 / 9.80665, np.stack([np.sin(psi), np.cos(psi)], axis=1)
    first, second = length * axis[0], 0.5 * length * axis[1]  # from each joint to the middle of its link
    whole = 2 * length * axis[0] + second
    expected = [first @ first + 0.5 * whole @ whole, 0.5 * whole @ second, 0.5 * second @ second]
    np.testing.assert_allclose([carried[0][0], *carried[1]], mass * np.array(expected), rtol=1e-6)
    assert jax.tree.leaves(kind(link_weight_n=0.4).inertia((), none, now)) == [0.0, 0.0, 0.0]


def test_what_rests_on_the_floor_weighs_more_the_further_it_is_lifted(robot):
    """Two links, the outer one half as long: their moments by hand, each weight times 1 + r sin²ψ."""
    kind: Any = REGISTRY["gravity_distribution"]
    model = robot(2)
    length, psi, weight = float(model.chain.half_length_m), np.array([0.3, -0.8]), np.array([0.4, 0.2])
    now: Any = SimpleNamespace(model=model, sin=tuple(np.sin(psi)), cos=tuple(np.cos(psi)))
    moments = -np.array(kind(link_weight_n=0.4, lifted=2.0).load((), (0.0, 0.0), now))
    across = np.sin(psi) * (1 + 2.0 * np.sin(psi) ** 2)
    outer = weight[1] * 0.5 * length * across[1]
    inner = outer + (weight[0] + 2 * weight[1]) * length * across[0]
    np.testing.assert_allclose(moments, [inner, outer], rtol=1e-6)


def test_an_end_stop_may_be_stiffer_to_the_base():
    kind: Any = REGISTRY["contact"]
    stop = kind(stop=3.0, angle_rad=-0.2, to_base=0.5)
    stage: Any = SimpleNamespace(alpha2=(0.0,) * 3)
    torques = [float(stop.torque((), i, jnp.asarray(-0.3), 0.0, stage)) for i in range(3)]
    np.testing.assert_allclose(torques, -3.0 * 0.1 * np.array([1.5, 1.0, 0.5]), rtol=1e-6)
    assert float(stop.torque((), 0, jnp.asarray(0.3), 0.0, stage)) == 0.0


def test_what_holds_the_vacuum_may_overshoot():
    """τ₂ (1 ± i o): by exp(−π/o) of the step, at π τ₂ (1 + o²)/o; never below none."""
    kind: Any = REGISTRY["pressure_lag"]
    tau, o, h = 0.05, 3.0, 1e-3
    regulator = kind(second_s=tau, overshoot=o)
    now: Any = SimpleNamespace(vacuum=jnp.asarray(10.0), h=jnp.asarray(h))
    memory, got = regulator.start(now), []
    for line in [20.0] * 2000 + [0.0] * 500:
        vacuum, memory = regulator.evacuate(memory, jnp.asarray(line), now)
        got.append(float(vacuum))
    assert max(got) == pytest.approx(20.0 + 10.0 * np.exp(-np.pi / o), rel=1e-3)
    assert h * np.argmax(got) == pytest.approx(np.pi * tau * (1 + o * o) / o, abs=2 * h)
    assert min(got) == 0.0 and got[-1] < 0.5


def test_layers_hold_the_better_the_longer_they_lie():
    """a = 0.5: rested for 30 s, then slid at 0.1 rad/s, where contacts of d = 0.01 rad are 0.1 s old."""
    kind: Any = REGISTRY["layer_hysteresis"]
    layers, h = kind(torque_nm=0.1, width_rad=0.01, ages=0.5, renewed_rad=0.01), 1e-3
    memory, felt = None, []
    for k in range(1000):
        q = 0.1 * h * k
        at: Any = SimpleNamespace(q=(jnp.asarray(q),), middle=(jnp.asarray(q),), phi=(1.0,), vacuum=0.0, h=h)
        memory = layers.start(at) if memory is None else memory
        felt.append(-float(layers.load(memory, (jnp.zeros(()),), at)[0]))
        memory = layers.remember(memory, at, SimpleNamespace(q=(jnp.asarray(q + 0.1 * h),)))
    assert felt[-1] == pytest.approx(0.1 * (1 + 0.5 * np.log(1 + 0.1 / 0.05)), rel=0.02)
    assert max(felt) > 1.5 * felt[-1]


def test_vented_layers_let_go_of_the_shape_in_which_they_were_jammed():
    """At 5/s a stretch of 0.02 rad is e⁻¹ of it after 0.2 s without vacuum, and as it was under 20 kPa; or under any
    vacuum, where layers creep."""
    kind: Any = REGISTRY["layer_hysteresis"]
    felt, h = {}, 0.01
    for way, vacuum in (("forgets", 0.0), ("forgets", 20.0), ("relaxes", 20.0)):
        layers = kind(torque_nm=0.1, width_rad=0.05, **{way: 5.0})
        q = (jnp.asarray(0.3),)
        at: Any = SimpleNamespace(q=q, middle=q, phi=(1.0,), vacuum=jnp.asarray(vacuum), h=h)
        memory = layers.start(at)
        memory = ((jnp.asarray(0.02),), *memory[1:])
        for _ in range(20):
            memory = layers.remember(memory, at, at)
        felt[way, vacuum] = -float(layers.load(memory, (jnp.zeros(()),), at)[0])
    assert felt["forgets", 0.0] == felt["relaxes", 20.0] == pytest.approx(0.1 * 0.4 * np.exp(-1), rel=1e-3)
    assert felt["forgets", 20.0] == pytest.approx(0.1 * 0.4, rel=1e-3)


def test_what_load_presses_together_parts_later():
    """2 s after half of the load has gone, with 2 s, e⁻¹ of what it pressed more is left; it joins at once."""
    kind: Any = REGISTRY["load_dependent_friction"]
    presses, h = kind(gain=0.1, parts_s=2.0), 0.01
    now: Any = SimpleNamespace(u=(jnp.asarray(10.0), jnp.asarray(0.0)), q=(jnp.zeros(()),), h=jnp.asarray(h))
    memory = presses.start(now)
    now.u = jnp.asarray(5.0), jnp.asarray(0.0)
    for _ in range(200):
        memory = presses.remember(memory, now, now)
    assert float(presses.phi(memory, (jnp.zeros(()),), now)[0]) == pytest.approx(0.1 * (5 + 5 * np.exp(-1)), rel=0.01)
    now.u = jnp.asarray(20.0), jnp.asarray(0.0)
    assert float(presses.phi(memory, (jnp.zeros(()),), now)[0]) == pytest.approx(2.0, rel=1e-6)


def test_what_lies_inside_warms_later():
    """With 50 s, from 1.5 ΔT at a run's start."""
    kind: Any = REGISTRY["thermal_drift"]
    warms = kind(friction_per_k=0.1, inside_s=50.0, kept=1.5)
    now: Any = SimpleNamespace(warm=jnp.asarray(2.0), h=jnp.asarray(0.5), u=(jnp.zeros(()),) * 2)
    memory = warms.start(now)
    assert float(warms.phi(memory, (jnp.ones(()),), now)[0]) == pytest.approx(1.3, abs=1e-3)
    for _ in range(100):
        memory = warms.remember(memory, now, now)
    assert float(warms.phi(memory, (jnp.ones(()),), now)[0]) == pytest.approx(1.2 + 0.1 * np.exp(-1), abs=1e-3)


def test_work_warms_what_no_thermometer_shows():
    """k = 4 K a (10 N)², within 20 s, from nothing at a run's start."""
    kind: Any = REGISTRY["thermal_drift"]
    warms = kind(friction_per_k=0.1, viscous_per_k=0.1, worked_k=4.0, worked_s=20.0)
    now: Any = SimpleNamespace(warm=jnp.zeros(()), h=jnp.asarray(0.5), u=(jnp.asarray(10.0), jnp.asarray(5.0)))
    memory = warms.start(now)
    assert float(warms.phi(memory, (jnp.ones(()),), now)[0]) == pytest.approx(1.0, abs=0.01)
    for _ in range(40):
        memory = warms.remember(memory, now, now)
    worked = 4.0 * 1.25 * (1 - np.exp(-1))
    assert float(warms.phi(memory, (jnp.ones(()),), now)[0]) == pytest.approx(1 + 0.1 * worked, abs=0.01)
    stage: Any = SimpleNamespace(phi=(jnp.ones(()),), friction=SimpleNamespace(sigma2=jnp.ones(())))
    assert float(warms.torque(memory, 0, jnp.zeros(()), jnp.ones(()), stage)) == pytest.approx(0.1 * worked, rel=1e-3)


def test_a_load_may_swing_on_a_thread(robot):
    """It hangs below the tip at rest, and swings at √(g/l) about where the tip is drawn to."""
    kind: Any = REGISTRY["tip_payload"]
    model, one, length, h = robot(2), jnp.ones(()), 0.05, 1e-3
    load = kind(mass_kg=0.1, swings=1.0, thread_m=length)
    straight: Any = SimpleNamespace(model=model, q=(0.0 * one,) * 2, h=jnp.asarray(h), worn=0.0 * one)
    memory = load.start(straight)
    drawn: Any = SimpleNamespace(**vars(straight), middle=(0.0 * one, 0.0 * one), sin=(0.1 * one,) * 2, cos=(one,) * 2)
    reach = 3.0 * float(model.chain.half_length_m)
    weight, way, felt = 9.80665 * 0.1, 0.1 * reach, []
    for _ in range(3000):
        felt.append(-float(load.load(memory, (0.0 * one,) * 2, drawn)[0]))
        memory = load.remember(memory, drawn, drawn)
    assert felt[0] == pytest.approx(weight * way + weight / length * way * reach, rel=1e-3)
    turns = np.flatnonzero(np.diff(np.sign(np.array(felt) - weight * way)))
    assert np.diff(turns).mean() * h == pytest.approx(np.pi * np.sqrt(length / 9.80665), rel=0.01)
    bare = tuple(tuple(0.0 * one for _ in range(2)) for _ in range(2))
    assert float(load.inertia(memory, bare, drawn)[0][0]) == 0.0


def test_a_filter_may_smooth_less_what_moves_fast():
    """What moves steadily at v is late by τ/(1 + a |v|)."""
    kind: Any = REGISTRY["sensor_filter"]
    sensor = kind(tau_s=0.1, later=0.0, adapts=4.0)
    now: Any = SimpleNamespace(q=(jnp.zeros(()),), h=jnp.asarray(0.01))
    for v in (0.05, 2.0):
        memory, y = sensor.start(now), jnp.zeros(())
        for k in range(1, 101):
            (y,), memory = sensor.sense(memory, (jnp.asarray(0.01 * k * v),), now)
        assert (v - float(y)) / v == pytest.approx(0.1 / (1 + 4.0 * v), rel=1e-3)


def test_angles_smoothed_afterwards_need_not_lag(robot):
    """A filter whose lag is undone is late no more: what it shows is nearest to the plain shape at no shift."""
    kind: Any = REGISTRY["sensor_filter"]
    plain = np.asarray(seen(robot(3), drive())[:, 0])

    def late(undone: float) -> float:
        smoothed = kind(tau_s=0.02, later=1.0, undone=undone)
        q = np.asarray(seen(dataclasses.replace(robot(3), effects=(smoothed,)), drive())[:, 0])
        shifts = np.arange(0.0, 0.1, 0.005)
        off = [np.mean((np.interp(AT[20:-20] - s, AT, plain) - q[20:-20]) ** 2) for s in shifts]
        return float(shifts[int(np.argmin(off))])

    assert late(0.0) == pytest.approx(0.06, abs=0.006)
    assert late(1.0) < 0.006


def test_a_gauge_may_settle_after_it_was_switched_on():
    """s = 0.8, τ = 4 s: in full at first, 0.2 + 0.8/e of it after 4 s."""
    bias: Any = REGISTRY["pressure_bias"](**{"offset_kpa": 2.0, "settles": 0.8, "settles_s": 4.0})
    for t, share in ((0.0, 1.0), (4.0, 0.2 + 0.8 * np.exp(-1))):
        now: Any = SimpleNamespace(vacuum=jnp.asarray(10.0), t=jnp.asarray(t), h=jnp.asarray(1e-6))
        assert float(bias.evacuate(bias.start(now), now.vacuum, now)[0]) == pytest.approx(10.0 + 2.0 * share, rel=1e-3)
