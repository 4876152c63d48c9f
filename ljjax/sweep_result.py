"""What a sweep found, as a value that is the content of its file: arrays with names, dimensions, units and meanings."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ljjax import sweep_file
from ljjax.errors import InputError
from ljjax.inputs import Inputs
from ljjax.logs.run import Run
from ljjax.model import UNITS
from ljjax.outputs import artefacts
from ljjax.simulation import SENSITIVE_RAD
from ljjax.sweep_file import Variable
from ljjax.sweep_plan import Plan, unit
from ljjax.sweep_run import Case

FILE, REPORT = "sweep.nc", "report.html"
STATUS = ("ok", "sensitive", "inadmissible", "failed")
OUTPUTS = {
    "theta_final": ("rad", "mean segment angle at the last stamp"),
    "theta_max": ("rad", "largest mean segment angle"),
    "theta_min": ("rad", "smallest mean segment angle"),
    "rms_error": ("rad", "root mean square of simulated minus measured mean segment angle, over the run's samples"),
    "loop_area": ("N rad", "integral of net tension over mean segment angle: a closed cycle's hysteresis loop area"),
    "error_estimate": ("rad", "largest change of a joint angle when the step is halved"),
}


@dataclass(frozen=True, eq=False)
class Sweep:
    """What a sweep found: the content of its file.

    Attributes:
        variables: name → dimensions, array and attributes (units, long_name, …). Outputs have the dimensions
            `run` and one a varied parameter (a grid), or `run` and `set`.
        attributes: where it comes from: model, seed, step, version, …
    """

    variables: Mapping[str, Variable]
    attributes: Mapping[str, Any]

    def __getitem__(self, name: str) -> np.ndarray:
        """An array by name, such as `"theta_final"`, `"theta"`, `"time"`, `"status"` or a parameter's path."""
        if name not in self.variables:
            raise KeyError(f"no {name!r} in this sweep; it has {', '.join(self.variables)}")
        return self.variables[name].data

    @property
    def parameters(self) -> tuple[str, ...]:
        """The paths that were varied."""
        return tuple(name for name in self.variables if "." in name)

    @property
    def how(self) -> str:
        """`"grid"`, `"zip"` or `"samples"`."""
        return self.attributes["how"]

    @property
    def counts(self) -> dict[str, int]:
        """How many elements are ok, sensitive, inadmissible, failed."""
        return {name: int(np.sum(self["status"] == k)) for k, name in enumerate(STATUS)}

    def column(self, path: str) -> np.ndarray:
        """The value of a varied parameter in each parameter set, in the shape of an output without its run."""
        shape = self["status"].shape[1:]
        if self.how != "grid":
            return self[path]
        k = self.variables["status"].dims.index(path) - 1
        return np.broadcast_to(np.expand_dims(self[path], [i for i in range(len(shape)) if i != k]), shape)

    def __str__(self) -> str:
        status = self["status"]
        said = [f"{count:,} {name}" for name, count in self.counts.items() if count or name == "ok"]
        lines = [f"{status.size:,} elements ({status.shape[0]} × {status[0].size:,} parameter sets): {', '.join(said)}"]
        for k, name in enumerate(STATUS[1:], 1):
            found = self["reason"][status == k]
            if len(found):
                lines.append(f"{name}, for example: {found[0]}")
        return "\n".join(lines)

    def report(self) -> str:
        """A page with pictures of the outputs over what was varied, as HTML."""
        from ljjax.sweep_report import report

        return report(self)

    def save(self, out: str | os.PathLike[str]) -> None:
        """Write `sweep.nc` and `report.html` into the folder `out`: both, or nothing. Raises InputError."""
        with artefacts(out, [file for file in self["run_file"] if file]) as made:
            sweep_file.write(made / FILE, self.variables, self.attributes)
            (made / REPORT).write_text(self.report(), encoding="utf-8")


def load(path: str | os.PathLike[str]) -> Sweep:
    """A sweep from its folder or its `.nc` file. Raises InputError where that is none."""
    file = Path(path) / FILE if Path(path).is_dir() else Path(path)
    variables, attributes = sweep_file.read(file)
    if "identity" not in attributes or "status" not in variables:
        raise InputError(f"{file}: is no sweep of ljjax; expected a {FILE} that ljjax sweep wrote")
    return Sweep(variables, attributes)


def describe(
    named: Sequence[tuple[str, Run | Inputs]],
    cases: Sequence[Case],
    sets: Plan,
    reasons: Sequence[Sequence[str]],
    results: Mapping[str, np.ndarray],
    trajectories: bool,
) -> dict[str, Variable]:
    """The variables of a sweep's file.

    Args:
        named: (name, run) of each run; cases: the same runs as `ljjax.sweep_run.Case`, not padded.
        sets: the parameter sets; reasons: (R, S) why an element was not simulated, empty where it was.
        results: outputs (R, S), and `theta` (R, S, K) if `trajectories`.
    """
    whole = (len(cases), *sets.shape)
    dims = ("run", *sets.dims)
    along = {} if sets.how == "grid" or not sets.dims else {"coordinates": " ".join(sets.values)}
    files = [(run.path, run.sha256) if isinstance(run, Run) else ("", "") for _, run in named]
    variables = {
        "run": Variable(("run",), np.array([name for name, _ in named]), {"long_name": "run"}),
        "run_file": Variable(("run",), np.array([f for f, _ in files]), {"long_name": "log of the run"}),
        "run_sha256": Variable(("run",), np.array([s for _, s in files]), {"long_name": "SHA-256 of the log"}),
    }
    for path, x in sets.values.items():
        kind = "parameter" if path in UNITS else "angle at rest from which the run starts:"
        about = {"units": _ascii(unit(path)), "long_name": f"{kind} {path}"}
        variables[path] = Variable((path,) if sets.how == "grid" else sets.dims, x, about)

    if trajectories:
        variables |= _over_time(cases, dims, along, results["theta"].reshape(*whole, -1))
    lost = np.isfinite(results["lost_at"])
    estimate = results["error_estimate"]
    bad = np.array([[bool(reason) for reason in own] for own in reasons])
    status = np.where(bad, 2, np.where(lost, 3, np.where(estimate > SENSITIVE_RAD, 1, 0))).astype("i1")
    text = np.array(reasons, dtype=object)
    for r, s in zip(*np.nonzero(status == 3), strict=True):
        text[r, s] = f"angles are not finite from t = {results['lost_at'][r, s]:.4g} s on; try a smaller step"
    for r, s in zip(*np.nonzero(status == 1), strict=True):
        text[r, s] = f"halving the step moves an angle by {estimate[r, s]:.2g} rad"
    for name, (units, long_name) in OUTPUTS.items():
        x = np.where(status < 2, results[name], np.nan)
        if name in ("rms_error", "error_estimate") and not np.isfinite(x).any():
            continue  # nothing was measured, or no error was asked for
        about = {"units": units, "long_name": long_name, "_FillValue": x.dtype.type(np.nan), **along}
        variables[name] = Variable(dims, x.reshape(whole), about)
    about = {
        "long_name": "what became of the element",
        "flag_values": np.arange(len(STATUS), dtype="i1"),
        "flag_meanings": " ".join(STATUS),
        **along,
    }
    variables["status"] = Variable(dims, status.reshape(whole), about)
    reason = text.astype(str).reshape(whole)
    variables["reason"] = Variable(dims, reason, {"long_name": "why the status is not ok", **along})
    return variables


def _over_time(
    cases: Sequence[Case], dims: tuple[str, ...], along: Mapping[str, str], theta: np.ndarray
) -> dict[str, Variable]:
    """Time, θ and, where there is any, measured θ; runs with stamps of their own share a dimension `stamp`."""
    kept = theta.shape[-1]

    def padded(x: np.ndarray) -> np.ndarray:
        return np.pad(x, (0, kept - len(x)), constant_values=np.nan)

    time = np.stack([padded(c.stamps[c.keep]) for c in cases])
    measured = np.stack([padded(c.measured[c.keep]) for c in cases])
    one = len(np.unique(time, axis=0)) == 1 and np.isfinite(time).all()
    dim = "time" if one else "stamp"
    more = {} if one else {"coordinates": " ".join(["time", *along.get("coordinates", "").split()])}
    fill = {"_FillValue": np.float64(np.nan)}
    about = {"units": "s", "long_name": "time since the run's first sample"} | ({} if one else fill)
    out = {"time": Variable((dim,) if one else ("run", dim), time[0] if one else time, about)}
    what = {"units": "rad", "long_name": "mean segment angle, as a log shows it"}
    what["_FillValue"] = theta.dtype.type(np.nan)
    out["theta"] = Variable((*dims, dim), theta, {**what, **along, **more})
    if np.isfinite(measured).any():
        about = {"units": "rad", "long_name": "measured mean segment angle", **fill, **more}
        if not one:
            about["coordinates"] = "time"
        out["theta_measured"] = Variable(("run", dim), measured, about)
    return out


def _ascii(units: str) -> str:
    """A unit as UDUNITS writes it, as far as it can."""
    return units.replace("·", " ").replace("√kPa", "kPa^0.5").replace("²", "2")
