"""Bend, apply vacuum, release: the shape holds, and the better the deeper the vacuum.

    python examples/shape_locking.py [MODEL.toml] [--out lock.png]

Without a model: OctRobot-I as identified by `make demo` where that has run, else its starting values. Its jamming was
measured with a sheath of two layers, its shape locking with five: the example takes the friction scale to grow with the
sliding interfaces, from one to four, and assumes a stiction that holds.
"""

import argparse
import sys
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

import ljjax  # noqa: E402
from ljjax.data import OCTROBOT  # noqa: E402
from ljjax.energy import phi  # noqa: E402
from ljjax.model import get, replace  # noqa: E402
from ljjax.simulation import Trajectory, simulate  # noqa: E402
from ljjax.stiffness import steady_tension  # noqa: E402

PRESSURES_KPA = (0.0, 10.0, 20.0, 30.0, 40.0)
INTERFACES = 4
MU_S, MU_C = 0.006, 0.005


def bend_vacuum_release(robot: ljjax.Model, pressure_kpa: float, theta_deg: float = 10.0) -> Trajectory:
    """Pull to θ in 1 s, hold, draw the vacuum from 2 to 3 s, hold, let go from 4 to 5 s, wait until 7 s."""
    still = jnp.asarray(0.0)
    friction = phi(robot, still) * robot.friction.mu_s / robot.chain.lever_arm_m
    pull = float(steady_tension(robot, jnp.radians(theta_deg), still) + friction)
    t = jnp.array([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 7.0])
    tendon = pull * jnp.array([0.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0])
    vacuum = pressure_kpa * jnp.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0])
    inputs = ljjax.Inputs(t, jnp.stack([tendon, jnp.zeros_like(tendon)], axis=1), vacuum, hold=False)
    return simulate(robot, inputs, at=jnp.linspace(0.0, 7.0, 141))


def main(model: Path, out: Path | None) -> list[float]:
    """Print, for each vacuum, how far the tip moves on release [mm]; draw the angles into `out`."""
    robot = ljjax.load_model(model).model
    robot = replace(robot, {name: INTERFACES * get(robot, name) for name in ("jamming.c4", "jamming.c5")})
    robot = replace(robot, {"friction.mu_s": MU_S, "friction.mu_c": MU_C})
    moved, motions = [], []
    for pressure in PRESSURES_KPA:
        motion = bend_vacuum_release(robot, pressure)
        tip = np.asarray(motion.tip(robot))
        held, released = np.searchsorted(motion.t, 4.0), -1
        moved.append(1e3 * float(np.hypot(*(tip[released, :2] - tip[held, :2]))))
        motions.append(motion)
        angle = np.degrees(motion.theta[held])
        print(f"{pressure:4.0f} kPa: held at {angle:5.2f} deg, moves {moved[-1]:6.2f} mm on release")
    if out:
        from matplotlib.figure import Figure

        figure = Figure(figsize=(7, 4), layout="constrained")
        ax = figure.add_subplot(xlabel="time [s]", ylabel="mean segment angle [deg]")
        for pressure, motion in zip(PRESSURES_KPA, motions, strict=True):
            ax.plot(motion.t, np.degrees(motion.theta), label=f"{pressure:.0f} kPa")
        ax.axvspan(2, 3, color="0.93")
        ax.axvspan(4, 5, color="0.93")
        for x, what in ((0.5, "pull"), (2.5, "vacuum on"), (4.5, "release")):
            ax.text(x, 0.97, what, ha="center", va="top", transform=ax.get_xaxis_transform())
        ax.legend(frameon=False, loc="lower right")
        figure.savefig(out, dpi=120)
    return moved


if __name__ == "__main__":
    demo = Path("out/demo/fit/model.toml")
    parser = argparse.ArgumentParser(description="Bend, apply vacuum, release.")
    parser.add_argument("model", nargs="?", type=Path, default=demo if demo.exists() else OCTROBOT / "nominal.toml")
    parser.add_argument("--out", type=Path, help="picture to draw, such as lock.png")
    arguments = parser.parse_args()
    try:
        main(arguments.model, arguments.out)
    except ljjax.InputError as error:
        sys.exit(str(error))
