"""The plant in C, called from Python: sessions of a robot with causes of gaps built in."""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.recovery.experiments import PERIOD_S, Array, Experiment
from benchmarks.recovery.robots import CENTRE

IDS = (
    *("tendon_friction", "tendon_slack", "actuator_lag", "actuator_delay", "actuator_deadband", "actuator_gain"),
    *("actuator_ripple", "actuator_saturation", "pressure_lag", "pressure_leak", "pressure_bias"),
    *("stiffness_saturation", "friction_saturation", "layer_hysteresis", "layer_wear", "viscoelastic_creep"),
    *("viscous_damping", "stiffness_hardening", "rest_curvature", "base_tilt", "tip_payload", "gravity_distribution"),
    *("nonuniform_stiffness", "contact", "friction_asymmetry", "load_dependent_friction", "thermal_drift"),
    *("jammed_joint", "base_vibration", "buckling_friction", "glue_failure", "snap_through", "hidden_pendulum"),
    *("dropout", "draught", "derailed_tendon", "pump_pulses", "magnet", "rough_patch"),
    *("column_softening", "brownout", "shaken_loose", "servo_hunting"),
)
"""The causes that act in the plant, in the order of `plant.c`."""
WIDTH = 10
FORM = WIDTH - 1
"""Where a cause's numbers say which of its shapes it has."""
JOINTS = 6
TRACK = 17
"""Angles at which a joint keeps its wear."""
APART_S = 75.0
"""From the start of one run to the start of the next."""
SUBSTEPS = 20
Causes = Mapping[str, Sequence[float]]
"""Numbers by cause, the strength first; a cause that is not there is left out. Short rows: the first shape."""


@dataclass(frozen=True)
class Motion:
    """One run of the plant, at the start of each period.

    Attributes:
        q: (T, 6) [rad].
        tension: (T, 2) what leaves the spools [N].
        line_kpa: (T,) vacuum in the line.
        warmth: (T,) temperature of the body above that of the room [K].
    """

    q: Array
    tension: Array
    line_kpa: Array
    warmth: Array


Session = Callable[[Mapping[str, float], Causes, Sequence[Experiment], int], list[Motion]]
"""What `session` is, in whatever simulator."""


class Diverged(ArithmeticError):
    """The motion left what a robot can do."""


def form(numbers: Sequence[float]) -> int:
    """Which of its shapes a cause of these numbers has."""
    return int(numbers[FORM]) if len(numbers) > FORM else 0


def compiled(source: str, flags: Sequence[str] = (), link: Sequence[str] = ()) -> ctypes.CDLL:
    """A C file of this folder as a loaded library."""
    with tempfile.TemporaryDirectory(prefix="ljjax-blind-") as folder:
        part, out = Path(folder) / "out.o", Path(folder) / "out.so"
        here = Path(__file__).parent / source
        options = ("-O2", "-ffast-math", "-fno-finite-math-only", "-march=native", "-fPIC", *flags)
        subprocess.run(["cc", *options, "-c", "-o", part, here], check=True)
        # Linked without the flags: -ffast-math at the link makes the whole process lose its subnormal numbers.
        subprocess.run(["cc", "-shared", "-o", out, part, *link, "-lm"], check=True)
        return ctypes.CDLL(str(out))


@cache
def _library() -> ctypes.CDLL:
    return compiled("plant.c")


def pointer(x: Array) -> ctypes.c_void_p:
    """To the first number of a contiguous array of doubles."""
    if x.dtype != np.float64 or not x.flags.c_contiguous:
        raise TypeError("expected a contiguous array of doubles")
    return x.ctypes.data_as(ctypes.c_void_p)


def session(
    truth: Mapping[str, float], causes: Causes, runs: Sequence[Experiment], substeps: int = SUBSTEPS
) -> list[Motion]:
    """All runs of one day, one after the other.

    Wear and warmth carry over; between two runs the body cools and everything else comes to rest.

    Args:
        truth: parameters by path.
        substeps: steps in one period of the commands.

    Raises Diverged where a joint passes 3 rad.
    """
    robot = np.array([truth[path] for path in CENTRE])
    rows = np.zeros((len(IDS), WIDTH))
    for name, numbers in causes.items():
        if name not in IDS:  # of the camera
            continue
        rows[IDS.index(name), : len(numbers)] = numbers
    carried = np.zeros(JOINTS + 2 + JOINTS * TRACK + 2)
    motions = []
    for i, run in enumerate(runs):
        count = len(run.pressure_kpa)
        u, pressure = np.ascontiguousarray(run.tendons), np.ascontiguousarray(run.pressure_kpa)
        out = [np.empty((count, JOINTS)), np.empty((count, 2)), np.empty(count), np.empty(count)]
        failed = _library().run(
            *(pointer(x) for x in (robot, rows, carried)),
            ctypes.c_int(count),
            *(pointer(x) for x in (u, pressure)),
            ctypes.c_double(PERIOD_S),
            ctypes.c_int(substeps),
            ctypes.c_double(i * APART_S),
            *(pointer(x) for x in out),
        )
        if failed:
            raise Diverged(f"{', '.join(causes) or 'no cause'}: run {i} diverged")
        motions.append(Motion(*out))
        carried[JOINTS : JOINTS + 2] *= np.exp(-(APART_S - count * PERIOD_S) / 260)
        carried[JOINTS + 1] = carried[JOINTS]
    return motions
