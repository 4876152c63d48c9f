"""The full circle on a rig that is not there: experiments, what the model misses, a law that knows it, the rig again.

    python examples/full_circle.py [--out out/full_circle] [--effect actuator_lag.tau_s=0.2] [--quick]

`ljjax rig emulate` plays a robot in real time behind the drivers of the reference rig: another stiffness and friction
than OctRobot-I's starting values, and an effect that no other command is told. The commands, each of which could be
typed, find out: experiments on the rig, `fit`, `gap`, the experiment that gap asks for, `gap` again; then a law tuned
on the model without the effect and one tuned with it run the same schedule on the rig.
"""

import argparse
import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np

from ljjax.data import OCTROBOT
from ljjax.logs import read

PLANT = {
    "segments = 6": "segments = 2",
    "c3 = 1.0": "c3 = 1.6",
    "c5 = 1.0": "c5 = 2.0",
    "mu_c = 0.0025": "mu_c = 0.004",
}
PLANT |= {"mu_s = 0.0030": "mu_s = 0.005", "alpha1 = 0.0": "alpha1 = 0.1"}
"""The emulated robot: OctRobot-I's starting values but for these."""
RUNS = [
    {"protocol": "triangle", "tension_n": 12.0, "vacuum_kpa": 0.0, "period_s": 4.0},
    {"protocol": "triangle", "tension_n": 16.0, "vacuum_kpa": 25.0, "period_s": 4.0},
    {"protocol": "sweep", "tension_n": 12.0, "vacuum_kpa": 5.0},
    {"protocol": "multisine", "tension_n": 16.0, "vacuum_kpa": 15.0},
    {"protocol": "staircase", "tension_n": 14.0, "vacuum_kpa": 10.0},
    {"protocol": "sweep", "tension_n": 14.0, "vacuum_kpa": 20.0},
    {"protocol": "multisine", "tension_n": 10.0, "vacuum_kpa": 0.0},
    {"protocol": "pressure_steps", "tension_n": 12.0, "vacuum_kpa": 25.0},
]
"""The experiments to identify it by."""
PATIENT = """
[safety]
shape_s = 1.0
tendons_s = 1.0
log_s = 10.0
late_s = 1.0
missed_share = 0.9
"""
"""A computer that is busy with other things is late; here that harms nobody."""
SPEC = """schema = "ljjax.spec/1"
{targets}
[loop]
duration_s = {seconds}
noise_rad = 3e-4
[require.settling_s]
limit = 0.4
weight = 1.0
[require.overshoot]
limit = 0.05
weight = 1.0
[require.steady_error_rad]
limit = 0.001
weight = 1.0
[vary]
noise_rad = [2e-4, 6e-4]
"""
ANGLES_DEG = (5.0, 1.0, 4.0)
"""Where the rig is sent, one after the other; the laws are tuned to steps as large."""
ARRIVED_S = 0.5
"""From how long after each step on the angle counts: before that it is on its way. The specification asks for less, as
the model without the effect promises it."""


def ljjax(*arguments: object) -> None:
    """Run a command, and stop where it does."""
    words = [str(a) for a in arguments]
    print(f"\n$ ljjax {' '.join(words)}", flush=True)
    done = subprocess.run([sys.executable, "-m", "ljjax", *words])
    if done.returncode:
        sys.exit(done.returncode)


class Rig:
    """The emulated rig, and its rig.toml, as a context manager."""

    def __init__(self, model: Path, out: Path, effect: str):
        self.toml = out / "rig.toml"
        self._words = [sys.executable, "-m", "ljjax", "rig", "emulate", str(model), "--out", str(self.toml)]
        self._words += ["--effects", effect, "--rate-hz", "100"]

    def __enter__(self) -> Path:
        print(f"$ ljjax {' '.join(self._words[3:])} &", flush=True)
        self._process = subprocess.Popen(self._words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self._process.stdout is not None
        for line in self._process.stdout:
            print(line, end="", flush=True)
            if line.startswith("Written"):
                with self.toml.open("a", encoding="utf-8") as file:
                    file.write(PATIENT)
                return self.toml
        sys.exit(self._process.wait() or 1)

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        print(self._process.communicate()[0], end="", flush=True)  # says so where this machine was too slow


def plan(path: Path, runs: list[dict], seconds: float) -> None:
    """Write experiments as a plan.toml."""
    lines = ['schema = "ljjax.plan/1"']
    for run in runs:
        timed = {} if run["protocol"] == "pressure_steps" else {"seconds": seconds}
        lines += ["", "[[runs]]", *(f"{key} = {json.dumps(value)}" for key, value in {**run, **timed}.items())]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def diagnosed(folder: Path) -> dict:
    """What a diagnosis says, printed in a few lines."""
    gap = json.loads((folder / "gap.json").read_text(encoding="utf-8"))
    numbers = gap["gap"]
    before, after = (math.degrees(numbers[name]) for name in ("before", "after"))
    found = ", ".join(gap["selected"]) or "no effect"
    print(f"{gap['verdict']}: {found}; the gap on unseen runs {before:.3f}° → {after:.3f}°")
    return gap


def reach(model: Path, out: Path) -> tuple[float, float]:
    """The transverse stiffnesses that a law for a model reaches [N/m]."""
    ljjax("export", model, "--law", "observer", "--out", out)
    low, high = json.loads(out.read_text(encoding="utf-8"))["reach"]["stiffness_n_m"]
    return low, high


def tracked(log: Path, hold_s: float, ramp_s: float = 1.0) -> float:
    """RMS of the angle's distance from the schedule [°] in a log, from `ARRIVED_S` after each step on."""
    run = read(log)
    shape = run.signals["shape"]
    t = shape.t - run.signals["cmd_tendons"].t[0] - ramp_s
    k = np.floor(t / hold_s).astype(int)
    inside = (t >= 0) & (k < len(ANGLES_DEG))
    error = np.degrees(shape.value[inside, 0]) - np.array(ANGLES_DEG)[k[inside]]
    return float(np.sqrt(np.mean(error[t[inside] - k[inside] * hold_s > ARRIVED_S] ** 2)))


def laws_compared(rig: Path, out: Path, folder: Path, quick: bool) -> dict[str, float]:
    """A law tuned on the model without the effect and one with it, each proven and run on the rig: what they track."""
    hold_s = 4.0 if quick else 6.0
    models = {"before": folder / "base.toml", "after": folder / "model.toml"}
    steps, errors = np.diff((0.0, *ANGLES_DEG)), {}
    for name, model in models.items():
        least, most = reach(model, out / f"law_{name}.json")
        stiffness = least + 0.01 * (most - least)  # hardly any vacuum, so that both laws move the same robot
        targets = "\n".join(f"[[targets]]\ntheta_rad = {math.radians(a)}\nstiffness_n_m = {stiffness}" for a in steps)
        spec, schedule = out / f"spec_{name}.toml", out / f"schedule_{name}.toml"
        spec.write_text(SPEC.format(targets=targets, seconds=hold_s), encoding="utf-8")
        points = "\n".join(
            f"[[points]]\nt_s = {hold_s * k}\ntheta_deg = {a}\nstiffness_n_m = {stiffness}"
            for k, a in enumerate(ANGLES_DEG)
        )
        schedule.write_text(f'schema = "ljjax.schedule/1"\nseconds = {hold_s * len(ANGLES_DEG)}\n{points}\n')
        few = ["--samples", 4, "--restarts", 1] if quick else []
        ljjax("tune", model, "--law", "observer", "--spec", spec, "--out", out / f"tuned_{name}", *few)
        law = out / f"tuned_{name}" / "law.json"
        few = ["--samples", 64, "--sobol", 0, "--steps", 4] if quick else ["--samples", 500]
        ljjax("robust", law, "--model", model, "--spec", spec, "--out", out / f"robust_{name}", *few)
        ljjax("rig", "run", law, "--rig", rig, "--out", out / f"rig_{name}", "--schedule", schedule)
        errors[name] = tracked(max((out / f"rig_{name}").glob("*.mcap")), hold_s)
    return errors


def run(out: Path, effect: str, quick: bool) -> None:
    """The whole circle, into the folder `out`."""
    if (out / "runs").exists():
        sys.exit(f"{out} holds an earlier circle; delete it, or choose another --out")
    out.mkdir(parents=True, exist_ok=True)
    text = (OCTROBOT / "nominal.toml").read_text(encoding="utf-8")
    start = out / "start.toml"  # what the user knows: geometry and starting values; the mass, which was weighed
    known = '\n[fit]\nfrozen = ["chain.segment_mass_kg"]\n'
    start.write_text(text.replace("segments = 6", "segments = 2") + known, encoding="utf-8")
    for given, own in PLANT.items():
        text = text.replace(given, own)
    hidden = out / "hidden.toml"
    hidden.write_text(text, encoding="utf-8")
    with Rig(hidden, out, effect) as rig:
        plan(out / "plan.toml", RUNS, 6.0 if quick else 12.0)
        ljjax("rig", "experiment", out / "plan.toml", "--rig", rig, "--out", out / "runs")
        ljjax("fit", out / "runs", "--model", start, "--out", out / "fit")
        ljjax("gap", out / "runs", "--model", start, "--out", out / "gap")
        folder, gap = out / "gap", diagnosed(out / "gap")
        if gap["next_experiment"] is not None:
            ljjax("rig", "experiment", folder / "gap.json", "--rig", rig, "--out", out / "runs")
            folder = out / "gap_again"
            ljjax("gap", out / "runs", "--model", start, "--out", folder)
            gap = diagnosed(folder)
        errors = laws_compared(rig, out, folder, quick)
    print(f"\neffect found: {', '.join(gap['selected']) or 'none'} (hidden: {effect})")
    for name, error in errors.items():
        print(f"tracking error {name}: {error:.3f}° RMS from {ARRIVED_S} s after each step on")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="The full circle on an emulated rig.")
    parser.add_argument("--out", type=Path, default=Path("out/full_circle"))
    parser.add_argument("--effect", default="actuator_lag.tau_s=0.2")
    parser.add_argument("--quick", action="store_true", help="short runs and small studies, to see it work")
    chosen = parser.parse_args()
    run(chosen.out, chosen.effect, chosen.quick)
