"""A second plant, in MuJoCo: hinges, cylinders, fixed tendons; causes of gaps by MuJoCo's own means where it has them.

tip_payload is a body, base_tilt turns the gravity vector, contact is a wall beside the tip, tendon_friction is friction
loss of the tendons, actuator_lag is activation dynamics, viscous_damping is joint damping, nonuniform_stiffness and
rest_curvature are the joints' springs. Most of them come in shapes, by the same draws as in the other plant.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import mujoco as _mujoco
import numpy as np

from benchmarks.blind.plant import APART_S, JOINTS, Causes, Diverged, Motion, compiled, form, pointer
from benchmarks.recovery.experiments import PERIOD_S, Experiment
from benchmarks.recovery.robots import CENTRE

mujoco: Any = _mujoco  # its stubs lack what it is made of
IDS = (
    *("tip_payload", "base_tilt", "contact", "tendon_friction", "actuator_lag", "viscous_damping"),
    *("nonuniform_stiffness", "rest_curvature"),
)


def session(truth: Mapping[str, float], causes: Causes, runs: Sequence[Experiment], substeps: int) -> list[Motion]:
    """All runs, each from rest; arguments and result as of `plant.session`, half the steps. Raises Diverged."""
    substeps = max(1, substeps // 2)  # a step here costs more, and half as many leave 0.001°
    robot = np.array([truth[path] for path in CENTRE])
    value = {name: float(numbers[0]) for name, numbers in causes.items()}
    shape = {name: form(numbers) for name, numbers in causes.items()}
    uneven, shares = np.zeros(JOINTS), [1.0, 1.0]
    if d := causes.get("nonuniform_stiffness"):
        uneven = value["nonuniform_stiffness"] * np.array(d[1 : 1 + JOINTS])
        shares = shares if shape["nonuniform_stiffness"] == 0 else list(d[7:9])
    tilt, damping, friction = (value.get(x, 0.0) for x in ("base_tilt", "viscous_damping", "tendon_friction"))
    capstan, each = float(shape.get("tendon_friction", 0)), [1.0, 1.0]
    if shape.get("tendon_friction") == 2:
        each = list(causes["tendon_friction"][1:3])
    where = float(shape.get("viscous_damping", 0))
    extra = np.array([tilt, damping, where, friction * each[0], friction * each[1], capstan, *shares, *uneven])
    model = whole = mujoco.MjModel.from_xml_string(xml(truth, causes))
    bare = mujoco.MjModel.from_xml_string(xml(truth, {})) if shape.get("tip_payload") == 4 else whole
    motions = []
    for i, run in enumerate(runs):
        count = len(run.pressure_kpa)
        if shape.get("base_tilt") == 2:  # mounted anew for each run
            leaning = tilt * np.random.default_rng([int(causes["base_tilt"][1]), i]).uniform(0.5, 1.5)
            extra[0], model.opt.gravity[:] = leaning, _gravity(leaning)
        if shape.get("base_tilt") == 3:  # a mount that sags, here between the runs
            leaning = tilt * (1 - 0.8 * np.exp(-i * APART_S / causes["base_tilt"][1]))
            extra[0], model.opt.gravity[:] = leaning, _gravity(leaning)
        if shape.get("base_tilt") == 4:  # a stand that somebody knocks, here between two runs
            leaning = tilt * (i * APART_S > causes["base_tilt"][1])
            extra[0], model.opt.gravity[:] = leaning, _gravity(leaning)
        if shape.get("rest_curvature") == 4:  # a set that it takes little by little, here between the runs
            d = causes["rest_curvature"]
            model.qpos_spring[:] = d[0] * np.array(d[1 : 1 + JOINTS]) * -np.expm1(-i * APART_S / d[7])
        if shape.get("tip_payload") == 4:  # put on between two runs
            model = whole if i * APART_S > causes["tip_payload"][4] else bare
        data = mujoco.MjData(model)
        u, vacuum = np.ascontiguousarray(run.tendons), np.ascontiguousarray(run.pressure_kpa)
        q, tension = np.empty((count, JOINTS)), np.empty((count, 2))
        failed = _library().run(
            *(ctypes.c_void_p(x._address) for x in (model, data)),
            *(pointer(x) for x in (robot, extra)),
            ctypes.c_int(count),
            *(pointer(x) for x in (u, vacuum)),
            ctypes.c_double(PERIOD_S),
            ctypes.c_int(substeps),
            *(pointer(x) for x in (q, tension)),
        )
        if failed:
            raise Diverged(f"{', '.join(causes)}: run {i} diverged")
        motions.append(Motion(q, tension, vacuum.copy(), np.zeros(count)))
    return motions


def xml(truth: Mapping[str, float], causes: Causes) -> str:
    """The robot as MJCF: base at the origin, the unbent body along −z, + bends toward +x."""
    half, mass, radius = (truth[f"chain.{x}"] for x in ("half_length_m", "segment_mass_kg", "radius_m"))
    tilt = float(causes["base_tilt"][0]) if "base_tilt" in causes else 0.0
    body, close, limits = "", "", ""
    stop = causes.get("contact")
    if stop and form(stop) == 2:  # an end stop in each joint
        angle = stop[1] * (2.1 - 1.5 * stop[0] / (stop[0] + 10))
        ends = sorted([stop[2] * angle, -3 * stop[2]])
        limits = f'limited="true" range="{ends[0]:.9g} {ends[1]:.9g}" solreflimit="0.02 1"'
    for i in range(JOINTS):
        share = 1.0 if i < JOINTS - 1 else 0.5
        length, own = 2 * half * share, mass * share
        across, along = own * (radius**2 / 4 + length**2 / 12), own * radius**2 / 2
        rest = causes["rest_curvature"][0] * causes["rest_curvature"][1 + i] if "rest_curvature" in causes else 0.0
        body += (
            f'<body pos="0 0 {-2 * half * (i > 0):.9g}" gravcomp="1"><joint name="j{i}" type="hinge" axis="0 -1 0" '
            f'stiffness="1" damping="1" springref="{rest:.9g}" {limits}/>'
            f'<inertial pos="0 0 {-length / 2:.9g}" mass="{own:.9g}" '
            f'diaginertia="{across:.9g} {across:.9g} {along:.9g}"/>'
        )
        close += "</body>"
        if stop and not limits and i == (int(stop[3]) if form(stop) == 4 else JOINTS - 1):
            size = 'size="0.002" mass="1e-9"'
            body += f'<geom type="sphere" {size} pos="0 0 {-length:.9g}" conaffinity="2" contype="1"/>'
    if "tip_payload" in causes:
        grams, beyond, aside = causes["tip_payload"][:3]
        solid = 'type="sphere" size="0.01"'
        if form(causes["tip_payload"]) == 2:
            solid = f'type="box" size="0.01 0.01 {beyond:.9g}"'
        body += (
            f'<body pos="{aside:.9g} 0 {-half - beyond:.9g}"><geom {solid} mass="{grams:.9g}" '
            'contype="0" conaffinity="0"/></body>'
        )
    wall = ""
    if stop and not limits:
        strength, where, side = stop[:3]
        soft = ("0.01 1", "0.04 0.7", "", "0.07 0.9", "0.02 0.8")[form(stop)]
        away = where * (2.1 - 1.5 * strength / (strength + 1000))  # stronger is nearer
        wall = (
            f'<geom type="plane" size="1 1 1" pos="{side * (away + 0.002):.9g} 0 0" zaxis="{-side:.9g} 0 0" '
            f'contype="2" conaffinity="1" condim="1" solref="{soft}"/>'
        )
    lags = [causes["actuator_lag"][0]] * 2 if "actuator_lag" in causes else []
    if lags and form(causes["actuator_lag"]) == 2:
        lags[1] *= 0.2
    tendons, motors = "", ""
    for k, (name, way) in enumerate((("left", 1), ("right", -1))):
        lines = "".join(f'<joint joint="j{i}" coef="{way * truth["chain.lever_arm_m"]:.9g}"/>' for i in range(JOINTS))
        tendons += f'<fixed name="{name}" frictionloss="1e-9" solreffriction="0.002 1">{lines}</fixed>'
        lag = f'dyntype="filterexact" dynprm="{lags[k]:.9g}"' if lags else ""
        motors += f'<general tendon="{name}" {lag} gainprm="1"/>'
    return (
        f'<mujoco><option gravity="{" ".join(f"{x:.9g}" for x in _gravity(tilt))}" integrator="implicitfast" '
        f'iterations="50" tolerance="1e-10"/><compiler angle="radian"/><worldbody>{wall}{body}{close}</worldbody>'
        f"<tendon>{tendons}</tendon><actuator>{motors}</actuator></mujoco>"
    )


def _gravity(tilt: float) -> list[float]:
    return [9.81 * float(np.sin(tilt)), 0.0, -9.81 * float(np.cos(tilt))]


@cache
def _library() -> ctypes.CDLL:
    here = Path(mujoco.__file__).parent
    shared = next(here.glob("libmujoco.so*"))
    return compiled("mujoco_loop.c", (f"-I{here / 'include'}",), (str(shared), f"-Wl,-rpath,{here}"))
