"""Points at rest out of runs made by hand: steady samples, holds of a staircase, presses; and why a run has none."""

from __future__ import annotations

import numpy as np
import pytest

from ljjax.data import OCTROBOT
from ljjax.errors import InputError
from ljjax.fit.points import collect, points_of
from ljjax.logs import read

P_ATM = 101_325.0
RATE = 50.0


def pascal(kpa):
    return P_ATM - 1e3 * np.asarray(kpa, float)


def one(run, kind: str):
    (found,) = (points for points in points_of(run)[0] if points.kind == kind)
    return found


STEPS = [(2.0, 5.0, 0.0), (2.0, 12.0, 0.0), (2.0, 12.0, 20.0), (2.0, 3.0, 20.0)]  # seconds, u₁ [N], u_P [kPa]


def staircase(run_of, *, dense=True, noise_deg=0.01, drift_deg=0.0, seconds=2.0, measured=False, joints=1, u_noise=0.0):
    """Commands in steps, co-contraction 2 N, the shape following with 0.1 s; θ = 1° a newton, plus a creep."""
    rng = np.random.default_rng(1)
    t = np.arange(0, seconds * len(STEPS), 1 / RATE)
    step = np.minimum((t / seconds).astype(int), len(STEPS) - 1)
    u1, kpa = (np.array([s[k] for s in STEPS])[step] for k in (1, 2))
    into = t - step * seconds
    before = np.array([STEPS[max(k - 1, 0)][1] for k in step])
    theta = np.radians(u1 + (before - u1) * np.exp(-into / 0.1) + drift_deg * into / (seconds / 2))
    theta = theta + np.radians(noise_deg) * rng.normal(size=len(t))
    keep = slice(None) if dense else np.flatnonzero(np.r_[True, np.diff(step) != 0])
    tendons = np.stack([u1 + 2, 0 * t + 2], 1) + u_noise * rng.normal(size=(len(t), 2))
    names = ("tendons", "pressure") if measured else ("cmd_tendons", "cmd_pressure")
    shape = np.repeat(theta[:, None], joints, axis=1) * np.linspace(0.5, 1.5, joints) if joints > 1 else theta
    inputs = {names[0]: (t[keep], tendons[keep]), names[1]: (t[keep], pascal(kpa)[keep])}
    return run_of(**inputs, shape=(t, shape))


HOLDS = {
    "commands at the shape's rate": {},
    "commands only where they change": {"dense": False},
    "measured inputs": {"measured": True},
    "noisy measured inputs": {"measured": True, "u_noise": 0.05},
    "noisy commands of a closed loop": {"u_noise": 0.05},
    "a noisy shape": {"noise_deg": 0.1},
    "no noise at all": {"noise_deg": 0.0},
    "q1 … q6": {"joints": 6},
    "short holds": {"seconds": 1.2},
}


@pytest.mark.parametrize("case", HOLDS)
def test_every_hold_of_a_staircase_is_a_point(run_of, case):
    run = staircase(run_of, **HOLDS[case])
    found = one(run, "steady")
    assert len(found) == 4 and np.all(found.hold)
    spread = HOLDS[case].get("u_noise", 0.0)
    np.testing.assert_allclose(found.value, [s[1] for s in STEPS], atol=1e-9 + spread)
    np.testing.assert_allclose(found.pressure_kpa, [s[2] for s in STEPS], atol=1e-9)
    np.testing.assert_allclose(np.degrees(found.theta), [s[1] for s in STEPS], atol=0.05)
    seconds = HOLDS[case].get("seconds", 2.0)
    np.testing.assert_allclose(found.t, seconds * (np.arange(4) + 0.75), atol=0.03)
    assert np.isnan(found.sd).all()


RESTLESS = {
    "creep": {"drift_deg": 0.4},
    "creep within the scatter that is let pass": {"drift_deg": 0.1},
    "creep, commands only where they change": {"drift_deg": 0.4, "dense": False},
    "too short": {"seconds": 0.7},
}


@pytest.mark.parametrize("case", RESTLESS)
def test_what_does_not_come_to_rest_is_no_point(run_of, case):
    with pytest.raises(InputError, match="a.mcap: nothing at rest"):
        points_of(staircase(run_of, **RESTLESS[case]))


@pytest.mark.parametrize("period_s", [0.5, 2.0, 5.0, 20.0])
@pytest.mark.parametrize("phase", [0.0, np.pi / 2])
@pytest.mark.parametrize("stuck", [False, True])
def test_a_moving_run_has_no_holds(run_of, period_s, phase, stuck):
    """Whole periods have no drift; commands in motion are no hold even where friction keeps the shape still."""
    t = np.arange(0, 20, 1 / RATE)
    wave = np.sin(2 * np.pi * t / period_s + phase)
    run = run_of(
        cmd_tendons=(t, np.stack([6 + 4 * wave, 0 * t + 1], 1)),
        cmd_pressure=([0.0], [pascal(10)]),
        shape=(t, 0.0 * t + 0.05 if stuck else 0.1 * wave),
    )
    with pytest.raises(InputError, match="nothing at rest"):
        points_of(run)


def test_a_single_command_of_each_is_enough(run_of):
    """A run at one constant pressure, commanded once."""
    t = np.arange(0, 4, 1 / RATE)
    run = run_of(cmd_tendons=([0.0], [[7.0, 2.0]]), cmd_pressure=([0.0], [pascal(15)]), shape=(t, 0 * t + 0.1))
    found = one(run, "steady")
    assert (found.value.tolist(), len(found)) == ([5.0], 1)
    assert found.pressure_kpa[0] == pytest.approx(15)


N = 12
STEADY = {
    "equal stamps": (0.0, 0.0),
    "tension a moment later": (0.004, 0.0),
    "tension and pressure a moment earlier and later": (-0.004, 0.003),
}


@pytest.mark.parametrize("case", STEADY)
@pytest.mark.parametrize("joints", [1, 6])
def test_every_sample_of_a_steady_run_is_a_point(run_of, case, joints):
    """Each shape sample goes with the tension and pressure measured with it, whichever was stamped first."""
    later, pressure_later = STEADY[case]
    t, rng = np.arange(N) * 1.0, np.random.default_rng(2)
    u, kpa, q = rng.uniform(0, 20, (N, 2)), rng.uniform(0, 40, N), rng.uniform(0, 0.3, (N, joints))
    run = run_of(
        "Steady operating points",
        tendons=(t + later, u, np.tile([0.3, 0.4], (N, 1))),
        pressure=(t + pressure_later, pascal(kpa)),
        shape=(t, q),
    )
    found = one(run, "steady")
    np.testing.assert_allclose(found.value, u[:, 0] - u[:, 1])
    np.testing.assert_allclose(found.pressure_kpa, kpa, atol=1e-9)
    np.testing.assert_allclose(found.theta, q.mean(axis=1))
    np.testing.assert_allclose(found.sd, 0.5)
    np.testing.assert_array_equal(found.t, t)
    assert not found.hold.any()


def test_steady_samples_take_the_command_in_force(run_of):
    run = run_of(
        "steady",
        cmd_tendons=([0, 10], [[5, 1], [9, 1]]),
        cmd_pressure=([0], [pascal(5)]),
        shape=([1, 9, 11], [0, 1, 2]),
    )
    assert one(run, "steady").value.tolist() == [4, 4, 8]


@pytest.mark.parametrize("depth", [np.full(5, 1e-3), -np.full(5, 1e-3), 1e-3 * np.array([0.97, 1.0, 1.01, 1.03, 0.99])])
def test_single_presses(run_of, depth):
    stiffness, t = np.array([90.0, 150.0, 200.0, 220.0, 260.0]), np.arange(5.0)
    run = run_of(
        "Probe stiffness at rest",
        probe=(t, np.stack([depth, stiffness * depth], 1), np.stack([0 * depth, 5 * np.abs(depth)], 1)),
        pressure=(t, pascal(10 * t)),
        shape=(t, 0.01 * t),
    )
    found = one(run, "probe")
    np.testing.assert_allclose(found.value, stiffness)
    np.testing.assert_allclose(found.sd, 5.0)
    np.testing.assert_allclose(found.pressure_kpa, 10 * t, atol=1e-9)
    np.testing.assert_allclose(found.theta, 0.01 * t)


def pushes(run_of, *, sign=1.0, noise_n=1e-3, noise_m=0.0, offset_n=0.0, offset_m=0.0, hold_s=0.0, hysteresis_n=0.0):
    """Three pushes to 2 mm and back, 0.5 s each way, at 0, 10, 30 kPa with 100, 200, 250 N/m; less force on the way
    back."""
    rng = np.random.default_rng(3)
    whole = 1.6 + hold_s
    t = np.arange(0, 3 * whole, 0.01)
    into, count = t % whole, np.minimum((t / whole).astype(int), 2)
    depth = 2e-3 * np.interp(into, [0.2, 0.7, 0.7 + hold_s, 1.2 + hold_s], [0, 1, 1, 0])
    back = (into > 0.705 + hold_s) & (into < 1.2 + hold_s)
    k = np.array([100.0, 200.0, 250.0])[count]
    force = k * depth - hysteresis_n * back * depth / 2e-3 + noise_n * rng.normal(size=len(t)) + offset_n
    position = sign * depth + offset_m + noise_m * rng.normal(size=len(t))
    pressure = pascal(np.array([0.0, 10.0, 30.0])[count])
    return run_of("stiffness", probe=(t, np.stack([position, sign * force], 1)), pressure=(t, pressure))


PUSHES = {
    "toward +x": {},
    "toward −x": {"sign": -1.0},
    "the force back is another": {"hysteresis_n": 0.1},
    "toward −x, the force back is another": {"sign": -1.0, "hysteresis_n": 0.1},
    "held in between": {"hold_s": 1.0},
    "a force sensor that is off": {"offset_n": 0.05},
    "position counted from elsewhere": {"offset_m": 0.01},
    "a noisy position": {"noise_m": 1e-6},
}


@pytest.mark.parametrize("case", PUSHES)
def test_pushes_give_the_slope_of_the_way_in(run_of, case):
    found = one(pushes(run_of, **PUSHES[case]), "probe")
    np.testing.assert_allclose(found.value, [100, 200, 250], rtol=0.01)
    np.testing.assert_allclose(found.pressure_kpa, [0, 10, 30], atol=1e-9)
    np.testing.assert_array_less(np.abs(found.value - [100, 200, 250]), 4 * found.sd + 1e-9)
    assert np.all(found.sd < 1.0) and np.all(found.theta == 0)


def test_the_error_of_a_slope_is_that_of_a_regression(run_of):
    """Over 20 noisy runs of three pushes the slopes scatter as stated."""
    rng = np.random.default_rng(4)
    z = []
    for _ in range(20):
        t = np.arange(0, 1, 0.1)
        x = 1e-3 * t
        f = 150 * x + 2e-3 * rng.normal(size=len(t))
        found = one(run_of(probe=(t, np.stack([x, f], 1)), pressure=([0], [pascal(5)])), "probe")
        z.append((found.value[0] - 150) / found.sd[0])
    assert 0.5 < np.mean(np.square(z)) < 2.5


LEVELS = {
    "as commanded": ([0, 0, 10, 10, 20], [0, 0, 1, 1, 2]),
    "as measured, in any order": ([20.1, 0.2, 9.8, 0.0, 10.2, 19.9], [2, 0, 1, 0, 1, 2]),
    "one": ([5.0, 5.1, 4.9], [0, 0, 0]),
    "none": ([], []),
}


@pytest.mark.parametrize("case", LEVELS)
def test_pressures_fall_into_levels(points, case):
    pressures, expected = LEVELS[case]
    found = points("steady", np.zeros(len(pressures)), np.array(pressures, float))
    assert found.levels.tolist() == expected
    means = [np.mean(np.array(pressures)[np.array(expected) == k]) for k in sorted(set(expected))]
    np.testing.assert_allclose(found.level_pressures(), means)


T = np.arange(0, 4, 1 / RATE)
REST, U, P = (T, 0 * T + 0.1), (T, np.tile([5.0, 1.0], (len(T), 1))), (T, pascal(0 * T + 10))
NOTHING = {
    "a shape only": (dict(shape=REST), "nothing at rest to fit.*it has shape"),
    "no shape": (dict(tendons=U, pressure=P), "nothing at rest to fit.*it has tendons, pressure"),
    "no pressure": (dict(shape=REST, tendons=U), "no signal cmd_pressure or pressure"),
    "probe without pressure": (dict(probe=([0, 1], [[1e-3, 0.1]] * 2)), "no signal pressure or cmd_pressure"),
    "a probe that does not push": (dict(probe=(T, np.stack([0 * T, 0 * T], 1)), pressure=P), "no press found"),
}


@pytest.mark.parametrize("case", NOTHING)
def test_a_run_without_points_says_why(run_of, case):
    signals, why = NOTHING[case]
    with pytest.raises(InputError, match=f"a.mcap: .*{why}|a.mcap: {why}"):
        points_of(run_of(**signals))
    good = run_of(path="good.mcap", shape=REST, tendons=U, pressure=P)
    steady, probe, said = collect([run_of(**signals), good])
    assert steady.run.tolist() == [1] and len(probe) == 0
    assert said[0].startswith("left out: a.mcap") and said[1] == "good.mcap: 1 holds at rest"
    with pytest.raises(InputError, match="no usable signal in any log: a.mcap: .*; b.mcap: "):
        collect([run_of(**signals), run_of(path="b.mcap", **signals)])


def test_an_unknown_atmospheric_pressure_is_named(run_of):
    run = run_of(shape=REST, tendons=U, pressure=P)
    run.metadata["p_atm_pa"] = ""
    with pytest.raises(InputError, match="a.mcap: metadata ljjax.run: p_atm_pa is ''"):
        points_of(run)


def test_a_copy_of_a_log_is_counted_once(tmp_path):
    source = OCTROBOT / "identification.mcap"
    copy = tmp_path / "again.mcap"
    copy.write_bytes(source.read_bytes())
    steady, _, said = collect([read(source), read(copy)])
    assert len(steady) == 75
    assert [line for line in said if line.startswith("left out") and "the same log as" in line]
