"""From logs to a law on the rig: identify, tune, prove, export.

    python examples/logs_to_law.py [LOG… --model MODEL.toml] [--out out/logs_to_law] [--quick]

Without logs a robot is made up (OctRobot-I's geometry, stiffer and rougher than its starting values say) and recorded
in five short runs with a camera's noise; what is identified is then compared with the truth. Every step is a command
that could be typed, and is printed before it runs.
"""

import argparse
import math
import sys
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

import ljjax  # noqa: E402
from ljjax import law, modelfile  # noqa: E402
from ljjax.cli import main  # noqa: E402
from ljjax.data import OCTROBOT  # noqa: E402
from ljjax.logs import Writer  # noqa: E402
from ljjax.model import get, replace  # noqa: E402

TRUTH = {
    "gravity.alpha1": 0.15,
    "elastic.c2": 0.02,
    "elastic.c3": 1.5,
    "jamming.c4": 14.0,
    "jamming.c5": 2.0,
    "friction.mu_c": 0.004,
    "friction.mu_s": 0.005,
}
"""What the made-up robot has beside OctRobot-I's starting values."""
PERIOD_S, NOISE_RAD, P_ATM_PA = 0.005, math.radians(0.02), 101_325.0
SPEC = """schema = "ljjax.spec/1"
[[targets]]
theta_rad = 0.1
stiffness_n_m = {stiffness:.4g}
[loop]
duration_s = {seconds}
noise_rad = 3e-4
[require.settling_s]
limit = 1.0
weight = 1.0
[require.overshoot]
limit = 0.05
weight = 1.0
[require.steady_error_rad]
limit = 0.001
weight = 1.0
[require.stiffness_error]
limit = 0.02
weight = 0.1
"""


def experiments(seconds: float) -> list[tuple[str, np.ndarray, np.ndarray, np.ndarray]]:
    """Name, t (T,) [s], net tension (T,) [N], + on the left tendon, and vacuum (T,) [kPa] of each run."""
    t = np.arange(0.0, seconds, PERIOD_S)
    x = t / seconds
    wave = np.interp(x, [0, 0.1, 0.3, 0.5, 0.7, 0.9, 1], [0, 0, 1, -1, 1, 0, 0])
    several = sum(np.sin(2 * np.pi * f * t + f) for f in (0.3, 0.7, 1.6)) * np.interp(x, [0, 0.1, 0.9, 1], [0, 1, 1, 0])
    stairs = np.interp(x, [0, 0.1, 0.12, 0.4, 0.42, 0.7, 0.72, 1], [0, 0, 1, 1, -1, -1, 0.5, 0.5])
    steps = np.select([x < 0.35, x < 0.6], [10.0, 40.0], 25.0)
    held = [("triangles", 9.0 * wave, 0.0), ("triangles", 14.0 * wave, 20.0), ("multisine", 6.0 * several, 30.0)]
    runs = [(name, t, u, np.full(len(t), p)) for name, u, p in held]
    return [*runs, ("steps", t, 12.0 * stairs, np.full(len(t), 8.0)), ("pressure steps", t, 13.0 * wave, steps)]


def record(folder: Path, seconds: float) -> list[str]:
    """Logs of the made-up robot, as a rig would write them; their paths."""
    robot = replace(modelfile.load(OCTROBOT / "nominal.toml").model, TRUTH)
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for i, (name, t, net, vacuum) in enumerate(experiments(seconds)):
        tendons = np.stack([np.maximum(net, 0.0), np.maximum(-net, 0.0)], axis=1)
        inputs = ljjax.Inputs(jnp.asarray(t), jnp.asarray(tendons), jnp.asarray(vacuum))
        theta = np.asarray(ljjax.simulate(robot, inputs, at=t).theta)
        theta = theta + NOISE_RAD * np.random.default_rng(i).standard_normal(len(t))
        start_s = 1_767_225_600 + 60 * i
        about = {"run_id": f"made-up-{i}", "robot_id": "made-up", "experiment": name, "p_atm_pa": str(P_ATM_PA)}
        about["start_utc"] = str(np.datetime64(start_s, "s")) + "Z"
        paths.append(str(folder / f"run_{i}.mcap"))
        with Writer(paths[-1], about) as log:
            for k, at in enumerate(t):
                stamp = start_s * 10**9 + round(at * 1e9)
                log.write("cmd_tendons", stamp, tendons[k])
                log.write("cmd_pressure", stamp, [P_ATM_PA - 1e3 * vacuum[k]])
                log.write("pressure", stamp, [P_ATM_PA - 1e3 * vacuum[k]])
                log.write("shape", stamp, [theta[k]], columns=("theta",))
    return paths


def step(*arguments: object) -> None:
    """Run a command of ljjax, and stop where it does."""
    words = [str(a) for a in arguments]
    print(f"\n$ ljjax {' '.join(words)}", flush=True)
    if code := main(words):
        sys.exit(code)


def compared(model: ljjax.Model) -> None:
    """What was identified of the made-up robot beside the truth."""
    print("\nidentified   true")
    for path, true in TRUTH.items():
        print(f"{float(get(model, path)):10.4g} {true:6.4g}  {path}")


def run(logs: list[str], given: str | None, out: Path, quick: bool) -> None:
    """The whole way, into the folder `out`."""
    made_up = not logs
    if made_up:
        logs = record(out / "logs", 6.0 if quick else 12.0)
    model = [] if given is None else ["--model", given]
    step("fit", *logs, *model, "--out", out / "fit")
    identified = out / "fit" / "model.toml"
    if made_up:
        compared(modelfile.load(identified).model)
    design = ljjax.control.design(modelfile.load(identified).model, "observer", where=str(identified))
    low, high = design.reach["stiffness_n_m"]
    spec = out / "spec.toml"
    spec.write_text(SPEC.format(stiffness=0.6 * low + 0.4 * high, seconds=1.5 if quick else 3.0), encoding="utf-8")
    few = ["--samples", 4, "--iterations", 6, "--restarts", 1] if quick else []
    step("tune", identified, "--law", "observer", "--spec", spec, "--out", out / "tuned", *few)
    few = ["--samples", 64, "--sobol", 0, "--steps", 4] if quick else []
    tuned = out / "tuned" / "law.json"
    step("robust", tuned, "--model", identified, "--spec", spec, "--fit", out / "fit", "--out", out / "robust", *few)
    ready = law.load(tuned)  # its golden vectors have been run here, in plain Python
    state = law.start(ready, 0.0, 0.0, 0.0, 0.0)
    _, output = law.tick(ready, state, law.Measured(0.0, 0.0), law.Command(0.1, 0.6 * low + 0.4 * high))
    print(f"\n{tuned} is ready for the rig; its first tick asks for {output.left:.3g} and {output.right:.3g} N")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="From logs to a law on the rig.")
    parser.add_argument("logs", nargs="*")
    parser.add_argument("--model")
    parser.add_argument("--out", type=Path, default=Path("out/logs_to_law"))
    parser.add_argument("--quick", action="store_true", help="short runs and small studies, to see it work")
    chosen = parser.parse_args()
    run(chosen.logs, chosen.model, chosen.out, chosen.quick)
