"""From a model to a law: its tables against the model's own statics, what it reaches, and what is refused."""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from ljjax import energy, law
from ljjax.chain import mass_matrix
from ljjax.control import Hardware, design
from ljjax.control.refusals import UNIQUE
from ljjax.control.statics import tip_stiffness
from ljjax.errors import InputError
from ljjax.law import ops
from ljjax.law.step import root_of, step
from ljjax.step import Drive, settled
from ljjax.stiffness import closed_loop_stiffness, transverse_stiffness


def commanded(given: law.Law, stiffness: float) -> float:
    """The vacuum [kPa] to which the law goes for a stiffness [N/m]."""
    state = law.start(given, 0.0, 0.0, 1.0, 1.0)
    for _ in range(400):
        state, _ = step(ops, given, state, law.Measured(0.0, 0.0), law.Command(0.0, stiffness))
    return state.vacuum


@pytest.mark.parametrize("gamma", [0.05, 2.0])
@pytest.mark.parametrize("n", [1, 3])
def test_the_vacuum_has_the_stiffness_commanded(robot, n, gamma):
    model = robot(n)
    made = design(model, "passivity", gains={"gamma": gamma})
    for share in (0.0, 0.03, 0.31, 0.77, 1.0):
        low, high = made.reach["stiffness_n_m"]
        wanted = low + share * (high - low)
        k = closed_loop_stiffness(model, jnp.asarray(commanded(made.law, wanted)), jnp.asarray(gamma))
        assert float(transverse_stiffness(model, k)) == pytest.approx(wanted, rel=1e-4)


def test_effects_change_what_a_vacuum_gives(robot):
    rise, knee, share = 4.0, 5.0, 0.5
    model = robot(
        3,
        {
            "friction_saturation": {"rise": rise, "knee_kpa": knee},
            "stiffness_saturation": {"rise": 1.0, "knee_kpa": knee},
        },
    )
    made = design(model, "passivity")
    low, high = made.reach["stiffness_n_m"]
    wanted = low + share * (high - low)
    u = commanded(made.law, wanted)
    joint = energy.alpha2(model, jnp.asarray(u)) + energy.phi(model, jnp.asarray(u)) + 5.0 * u / (u + knee)
    k = made.law.gains.gamma * jnp.ones((3, 3)) + joint * jnp.eye(3)
    assert float(transverse_stiffness(model, k)) == pytest.approx(wanted, rel=1e-4)


def test_a_gauge_that_reads_low_is_allowed_for_and_a_slow_line_is_waited_for(robot):
    late = {"pressure_bias": {"offset_kpa": 3.0}, "pressure_lag": {"fill_s": 0.5}}
    plain, off = design(robot(), "passivity"), design(robot(effects=late), "passivity")
    wanted = 0.5 * sum(off.reach["stiffness_n_m"])
    gains = off.law.gains.gamma, plain.law.gains.gamma
    assert gains[0] > gains[1]  # α₂ at no vacuum is higher there
    same = design(robot(), "passivity", gains={"gamma": gains[0]})
    assert commanded(off.law, wanted) + 3.0 == pytest.approx(commanded(same.law, wanted), rel=1e-3)


def test_segments_of_their_own_stiffness_are_counted_one_by_one(robot):
    model = robot(3, {"nonuniform_stiffness": {"mode1": 0.3}})
    made = design(model, "passivity")
    joints = jnp.asarray([[3.0, 4.0, 6.0]])
    a = np.linalg.inv(0.4 * np.ones((3, 3)) + np.diag([3.0, 4.0, 6.0]))
    lateral = 0.021 * np.array([5.0, 3.0, 1.0])
    assert float(tip_stiffness(model, joints, 0.4)[0]) == pytest.approx(1 / (lateral @ a @ lateral), rel=1e-12)
    assert made.reach["stiffness_n_m"] != design(robot(3), "passivity").reach["stiffness_n_m"]


def test_segments_of_their_own_stiffness_rest_at_the_angle_wanted(robot):
    """Under one torque each bends by its own share; the shares add up to nθ*, and one minimum is told by them, too."""
    model = robot(3, {"nonuniform_stiffness": {"mode1": 0.6}})
    zero = jnp.zeros(())
    alpha2, _ = settled(model, (zero,) * 3, Drive(zero, zero, zero), 1e9)
    each, theta = np.array([float(x) for x in alpha2]), 0.1
    assert each.max() > 2 * each.min()
    made = design(model, "passivity")
    shape = made.law.tables.alpha2[0] * theta / each
    assert shape.sum() == pytest.approx(3 * theta, rel=1e-9)
    state = law.start(made.law, 3 * theta, 0.0, 5.0, 5.0)
    for _ in range(200):
        state, _ = law.tick(made.law, state, law.Measured(shape.sum(), 0.0), law.Command(theta, 1e9))
    torque = 0.02 * state.net - 0.0205 * np.sin(shape.sum())
    np.testing.assert_allclose(each * shape, torque, rtol=1e-9)
    most = UNIQUE / np.sum(1 / each)
    assert made.reach["uniqueness"]["n_gamma_over_alpha2"] == pytest.approx(0.5 * UNIQUE, rel=1e-9)
    design(model, "passivity", gains={"gamma": 0.999 * most})
    with pytest.raises(InputError, match="choose gamma <"):
        design(model, "passivity", gains={"gamma": 1.001 * most})


@pytest.mark.parametrize(
    "effects,first",
    [
        ({"pressure_bias": {"offset_kpa": -3.0}}, 3.0),
        ({"pressure_leak": {"share": 0.6}}, 0.5),
        ({"pressure_leak": {"share": 0.6, "held": 0.0}}, 0.5),
    ],
)
def test_a_stiffness_that_rises_late_is_reached_from_there(robot, effects, first):
    model = robot(effects=effects)
    made = design(model, "passivity")
    assert made.reach["vacuum_kpa"] == pytest.approx([first, 40.0], abs=0.6)
    low, high = made.reach["stiffness_n_m"]
    for share in (0.1, 0.5, 1.0):
        wanted, zero = low + share * (high - low), jnp.zeros(())
        drive = Drive(zero, zero, jnp.asarray(commanded(made.law, wanted)))
        alpha2, phi = settled(model, (zero,) * 2, drive, 1e9)
        joints = jnp.stack(alpha2) + jnp.stack(phi)
        found = tip_stiffness(model, joints[None], made.law.gains.gamma)
        assert float(found[0]) == pytest.approx(wanted, rel=5e-3)


def test_the_mend_of_a_stiffness_that_falls_again_works(robot):
    model = robot(effects={"friction_saturation": {"rise": -40.0, "knee_kpa": 20.0}})
    with pytest.raises(InputError, match="lower vacuum_max_kpa to") as error:
        design(model, "passivity")
    lower = float(str(error.value).split()[-1])
    assert design(model, "passivity", hardware=Hardware(vacuum_max_kpa=lower)).reach["vacuum_kpa"][1] == lower


@pytest.mark.parametrize("rate_hz", [50.0, 200.0])
def test_damping_is_refused_from_where_the_sampled_loop_grows(robot, rate_hz):
    """Beside a body without stiction, moved in fine steps, with every tension a tick late."""
    model = robot(6)
    hardware = Hardware(
        rate_hz=rate_hz, tension_max_n=1e4, co_contraction_n=1e3, tension_slew_n_s=1e7, theta_max_rad=0.1
    )
    with pytest.raises(InputError, match="choose less than") as error:
        design(model, "passivity", gains={"damping": 1e6}, hardware=hardware)
    most = float(str(error.value).split("choose less than ")[1].split()[0])
    inertia = float(jnp.sum(mass_matrix(model.chain, jnp.zeros(6))))
    plain = design(model, "passivity", hardware=hardware).law
    assert 0 < plain.gains.damping < most

    def grows(damping):
        given = dataclasses.replace(plain, gains=plain.gains._replace(damping=damping))
        theta, speed, held, seen = 1e-7, 0.0, 0.0, []
        state = law.start(given, 6 * theta, 0.0, 1e3, 1e3)
        for _ in range(400):
            state, _ = law.tick(given, state, law.Measured(6 * theta, 0.0), law.Command(0.0, 0.0))
            h = given.period_s / 200
            for _ in range(200):
                spring = 1.861 * theta + 0.0205 * np.sin(6 * theta) - 0.02 * held
                speed = (speed - h * 6 * spring / inertia) / (1 + h * 6 * 0.012 * 12.0 / inertia)
                theta = theta + h * speed
            held = state.net
            seen.append(abs(theta))
        return max(seen[300:]) > max(seen[100:200])

    assert grows(1.2 * most) and not grows(0.85 * most) and not grows(plain.gains.damping)


def test_tables_are_the_models(robot):
    model = robot()
    tables = design(model, "passivity").law.tables
    w = np.linspace(0, root_of(ops, 40.0), len(tables.alpha2))
    u = 0.5 * w * (w + np.sqrt(w * w + 4e-4))
    np.testing.assert_allclose(tables.alpha2, energy.alpha2(model, jnp.asarray(u)), rtol=1e-12)
    np.testing.assert_allclose(tables.phi, energy.phi(model, jnp.asarray(u)), rtol=1e-12)


def test_every_angle_said_to_be_in_reach_can_be_held_and_no_further(robot):
    model, hardware = robot(), Hardware(tension_max_n=20.0)
    theta = design(model, "passivity", hardware=hardware).law.limits.theta_max_rad
    u = jnp.linspace(0.0, 40.0, 401)

    def most(theta):
        hold = 0.0205 * np.sin(2 * theta) + energy.alpha2(model, u) * theta + 0.003 * energy.phi(model, u)
        return float(jnp.max(hold)) / 0.02

    assert most(theta) <= 19.5 < most(theta + 0.01)


def test_below_the_bound_the_desired_potential_has_one_minimum():
    x = np.linspace(-20, 20, 400_001)
    for share, roots in ((0.999, 1), (1.001, 5)):
        slope = x + share * UNIQUE * np.sin(x)
        assert np.count_nonzero(np.diff(np.sign(slope[slope != 0])) != 0) == roots


WRONG = [
    (dict(kind="magic"), "law is 'magic'; expected one of passivity"),
    (dict(gains={"gama": 1.0}), "no gain 'gama'; the gains are gamma"),
    (dict(gains={"gamma": 50.0}), "choose gamma <"),
    (dict(gains={"gamma": 0.0}), "gains.gamma = 0: must be > 0"),
    (dict(gains={"gamma": float("nan")}), "must be a finite number"),
    (dict(gains={"dead_zone_rad": 0.5}), "gains.dead_zone_rad = 0.5: must be < 0.5"),
    (dict(gains={"integral": 1e6}), "gains.integral = 1e+06: unstable"),
    (dict(kind="passivity", gains={"damping": 1e6}), "gains.damping = 1e+06: with a tick of delay at 200 Hz"),
    (dict(gains={"compensation": 1.5}), "gains.compensation = 1.5: must be between 0 and 1"),
    (dict(hardware=Hardware(vacuum_max_kpa=90.0)), "elastic.c1, c2, c3 give α₂ = -"),
    (dict(hardware=Hardware(tension_max_n=3.0)), "does not even overcome stiction"),
    (dict(hardware=Hardware(tension_max_n=20.0, theta_max_rad=0.5)), "raise tension_max_n, or ask for less"),
    (dict(hardware=Hardware(co_contraction_n=50.0)), "limits.co_contraction_n = 50"),
    (dict(hardware=Hardware(rate_hz=0.0)), "rate_hz = 0: must be > 0"),
    (dict(effects={"stiffness_saturation": {"rise": -6.0}}), "α₂ is -"),
    (
        dict(effects={"friction_saturation": {"rise": -40.0, "knee_kpa": 20.0}}),
        "the tip's stiffness rises no further than",
    ),
]


@pytest.mark.parametrize("given,said", WRONG, ids=[said for _, said in WRONG])
def test_what_cannot_work_is_refused_in_a_line_with_the_mend(robot, given, said):
    options = {"kind": "integral", **given}
    with pytest.raises(InputError) as error:
        design(robot(effects=options.pop("effects", None)), **options, where="robot.toml")
    assert said in str(error.value) and "\n" not in str(error.value)


def test_a_command_out_of_reach_is_refused(designs):
    given = designs["integral"].law
    with pytest.raises(InputError, match=r"theta = 0.3 rad \(17.2°\) is out of reach; the law reaches ±0.25 rad"):
        law.refuse_beyond(given, law.Command(0.3, 6000.0))
    low, high = designs["integral"].reach["stiffness_n_m"]
    for k in (0.9 * low, 1.1 * high):
        with pytest.raises(InputError, match="N/m is out of reach; the law reaches"):
            law.refuse_beyond(given, law.Command(0.1, k))
    law.refuse_beyond(given, law.Command(-0.25, high))
