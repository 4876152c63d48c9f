"""From logs to steady operating points and probe stiffness: what statics can be identified from."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ljjax.errors import InputError
from ljjax.logs import Run, Signal

LEVEL_GAP_KPA = 0.5
"""Pressures closer than this count as one level: regulators and gauges are not finer."""


@dataclass(frozen=True, eq=False)
class Points:
    """Measured points at rest.

    Attributes:
        kind: `"steady"` (value = net tension u₁ − u₂ [N] that holds θ) or `"probe"` (value = tip stiffness [N/m]).
        value, sd: (N,) the measured quantity and its stated standard deviation (NaN where none is stated).
        pressure_kpa: (N,) vacuum u_P.
        theta: (N,) mean segment angle [rad] (0 for probes where no shape is logged).
        t: (N,) seconds since the run's start.
        run: (N,) index of the run in the list the points came from.
        hold: (N,) whether the point is a hold found in a moving run, which carries the friction left at rest.
    """

    kind: str
    value: np.ndarray
    sd: np.ndarray
    pressure_kpa: np.ndarray
    theta: np.ndarray
    t: np.ndarray
    run: np.ndarray
    hold: np.ndarray

    def __len__(self) -> int:
        return len(self.value)

    def take(self, keep: np.ndarray) -> Points:
        """The points where the mask (or the indices) `keep` says so."""
        return Points(self.kind, *(getattr(self, name)[keep] for name in _COLUMNS))

    @property
    def levels(self) -> np.ndarray:
        """(N,) index of each point's pressure level, in rising order."""
        order = np.argsort(self.pressure_kpa, kind="stable")
        steps = np.diff(self.pressure_kpa[order]) > LEVEL_GAP_KPA
        level = np.empty(len(self), int)
        level[order] = np.concatenate([[0], np.cumsum(steps)]) if len(self) else []
        return level

    @property
    def scatter(self) -> float | None:
        """RMS of the stated standard deviations; None where none is stated."""
        known = self.sd[np.isfinite(self.sd)]
        return float(np.sqrt(np.mean(known**2))) if len(known) else None

    @staticmethod
    def none(kind: str) -> Points:
        """No points."""
        x = np.empty(0)
        return Points(kind, x, x, x, x, x, x.astype(int), x.astype(bool))

    def level_pressures(self) -> np.ndarray:
        """(L,) mean pressure of each level [kPa]."""
        levels = self.levels
        return np.array([self.pressure_kpa[levels == k].mean() for k in range(levels.max(initial=-1) + 1)])


_COLUMNS = ("value", "sd", "pressure_kpa", "theta", "t", "run", "hold")
UNIT = {"steady": "N", "probe": "N/m"}


def collect(runs: Sequence[Run]) -> tuple[Points, Points, list[str]]:
    """Steady and probe points of all runs, and a line for every run about what it gave.

    Raises:
        InputError: no run gives any point; each run is named with the reason.
    """
    steady, probe, said = [], [], []
    seen: dict[str, str] = {}
    for index, run in enumerate(runs):
        if run.sha256 in seen:
            said.append(f"left out: {run.path}: the same log as {seen[run.sha256]}")
            continue
        if run.sha256:
            seen[run.sha256] = run.path
        try:
            found, how = points_of(run)
        except InputError as error:
            said.append(f"left out: {error}")
            continue
        for points in found:
            points.run[:] = index
            (steady if points.kind == "steady" else probe).append(points)
        said.append(f"{run.path}: {how}")
    if not steady and not probe:
        raise InputError("no usable signal in any log: " + "; ".join(s.removeprefix("left out: ") for s in said))
    return _join("steady", steady), _join("probe", probe), said


def set_aside(said: Sequence[str]) -> list[str]:
    """Why logs were left out, of all that was said of them."""
    return [line.removeprefix("left out: ") for line in said if line.startswith("left out: ")]


def beware_of(runs: Sequence[Run], said: Sequence[str]) -> list[str]:
    """A line for each log that was left out, or is there in part."""
    return [*set_aside(said), *(f"{r.path}: partial: {r.damage.why} at {r.damage.where}" for r in runs if r.damage)]


def _join(kind: str, parts: Iterable[Points]) -> Points:
    parts = list(parts)
    if not parts:
        return Points.none(kind)
    return Points(kind, *(np.concatenate([getattr(p, c) for p in parts]) for c in _COLUMNS))


def points_of(run: Run) -> tuple[list[Points], str]:
    """The points one run gives, and in words how they were found.

    A run whose `experiment` starts with "steady" has an operating point in every sample of its shape; in any other
    run an operating point is a hold: commands (or, without them, measured inputs) constant and the shape at rest. A
    run with a probe gives stiffness: every sample a press where `experiment` starts with "probe" and presses are
    single samples, otherwise the slope of force over position in every press.

    Raises:
        InputError: the run has nothing to say about statics, or values in doubt, with the reason.
    """
    run.trusted()
    found, how = [], []
    if "probe" in run.signals:
        points = _presses(run)
        found.append(points)
        how.append(f"{len(points)} probe stiffness measurements")
    if "shape" in run.signals and ("tendons" in run.signals or "cmd_tendons" in run.signals):
        declared = run.experiment.lower().startswith("steady")
        points = _samples(run) if declared else _holds(run)
        if len(points):
            found.append(points)
            how.append(f"{len(points)} {'steady operating points' if declared else 'holds at rest'}")
    if not found:
        needed = "a shape with tensions and pressure, at rest, or a probe with pressure"
        raise InputError(
            f"{run.path}: nothing at rest to fit; expected {needed} (holds of 0.8 s or more, or samples that "
            "are points at rest, declared by an experiment that starts with 'steady'); it has "
            f"{', '.join(run.signals) or 'no signals'}"
        )
    return found, ", ".join(how)


def _column(s: Signal, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """u₁ − u₂ of the samples at `index` and its standard deviation, if stated."""
    value = s.value[index]
    sd = np.full(len(index), np.nan) if s.sd is None else np.hypot(s.sd[index, 0], s.sd[index, 1])
    return value[:, 0] - value[:, 1], sd


def _beside(run: Run, measured: str, commanded: str, t: np.ndarray) -> tuple[Signal, np.ndarray]:
    """The signal and the indices of its samples that belong to the times t: the nearest measurement, so that stamps a
    moment apart do not take the point before; or the command in force."""
    s = run.signal(measured, commanded)
    if measured in run.signals:
        return s, np.searchsorted((s.t[1:] + s.t[:-1]) / 2, t)
    return s, np.clip(np.searchsorted(s.t, t, side="right") - 1, 0, len(s) - 1)


def _samples(run: Run) -> Points:
    shape = run.signal("shape")
    value, sd = _column(*_beside(run, "tendons", "cmd_tendons", shape.t))
    _, index = _beside(run, "pressure", "cmd_pressure", shape.t)
    pressure = run.vacuum_kpa("pressure", "cmd_pressure").value[index, 0]
    none = np.zeros(len(shape), int)
    return Points("steady", value, sd, pressure, shape.value.mean(axis=1), shape.t, none, none.astype(bool))


def _holds(run: Run, minimum_s: float = 0.8) -> Points:
    """One point for every stretch of constant inputs in whose second half shape and inputs stand still, to their own
    noise. Inputs are taken at the shape's stamps, where a sparse command is constant between its samples."""
    shape = run.signal("shape")
    theta = shape.value.mean(axis=1)
    drive = np.column_stack(
        [run.signal(*names).held_at(shape.t) for names in (("cmd_tendons", "tendons"), ("cmd_pressure", "pressure"))]
    )
    tension, pressure = run.signal("tendons", "cmd_tendons"), run.vacuum_kpa("pressure", "cmd_pressure")
    u, p = tension.held_at(shape.t) @ np.array([1.0, -1.0]), pressure.held_at(shape.t)[:, 0]
    moved = np.any(np.abs(np.diff(drive, axis=0)) > 6 * 0.954 * _noise(drive), axis=1)
    watched = np.column_stack([theta, drive])
    quiet = 3 * _noise(watched) + np.r_[np.radians(0.02), 0.01 * np.ptp(drive, axis=0)]
    quiet += 1e-9 * np.abs(watched).max(axis=0)  # rounding
    edges = np.r_[0, np.flatnonzero(moved) + 1, len(shape)]
    rows = []
    for start, end in zip(edges[:-1], edges[1:], strict=True):
        first, last = shape.t[start], shape.t[end - 1]
        late = np.arange(start, end)[shape.t[start:end] >= (first + last) / 2]
        if last - first < minimum_s or len(late) < 5 or not _still(shape.t[late], watched[late], quiet):
            continue
        rows.append((u[late].mean(), np.nan, p[late].mean(), theta[late].mean(), shape.t[late].mean(), 0))
    value, sd, p, angle, at, index = np.array(rows, float).reshape(-1, 6).T
    return Points("steady", value, sd, p, angle, at, index.astype(int), np.ones(len(rows), bool))


def _noise(x: np.ndarray) -> np.ndarray:
    """(k,) standard deviation of white noise in each column, from the median step: a few jumps do not count."""
    steps = np.abs(np.diff(x, axis=0))
    return np.median(steps, axis=0) / 0.954 if len(steps) else np.zeros(x.shape[1])


def _still(t: np.ndarray, x: np.ndarray, quiet: np.ndarray) -> bool:
    """Whether each column of x drifts and scatters by no more than `quiet`."""
    line = np.polynomial.polynomial.polyfit(t - t[0], x, 1)
    drift = np.abs(line[1]) * (t[-1] - t[0])
    return bool(np.all(drift <= quiet) and np.all(np.std(x, axis=0) <= quiet))


def _presses(run: Run) -> Points:
    probe = run.signal("probe")
    position, force = probe.column("position"), probe.column("force")
    pressure = run.vacuum_kpa("pressure", "cmd_pressure")
    theta = run.signals["shape"].value.mean(axis=1) if "shape" in run.signals else np.zeros(1)
    angle_t = run.signals["shape"].t if "shape" in run.signals else np.zeros(1)
    rows = []
    if _single_samples(run, position):
        sd = np.full(len(probe), np.nan) if probe.sd is None else probe.sd[:, 1] / np.abs(position)
        for t, x, f, s in zip(probe.t, position, force, sd, strict=True):
            rows.append((f / x, s, pressure.held_at(np.array([t]))[0, 0], np.interp(t, angle_t, theta), t, 0))
    else:
        for part in _pushes(position, force):
            x, f, t = position[part], force[part], probe.t[part]
            (slope, offset), covariance = np.polyfit(x, f, 1, cov="unscaled")
            error = f - slope * x - offset
            scatter = np.sqrt(error @ error / (len(x) - 2))
            p = pressure.held_at(t)[:, 0].mean()
            sd = scatter * np.sqrt(covariance[0, 0])
            rows.append((slope, sd, p, np.interp(t.mean(), angle_t, theta), t.mean(), 0))
    if not rows:
        raise InputError(
            f"{run.path}: {probe.topic}: no press found: position never moves in over 5 samples or more; "
            "log single presses of one depth with experiment = 'probe …', or the push itself"
        )
    value, sd, p, angle, at, index = np.array(rows, float).T
    return Points("probe", value, sd, p, angle, at, index.astype(int), np.zeros(len(rows), bool))


def _single_samples(run: Run, position: np.ndarray) -> bool:
    """Whether every sample is a press of its own: declared so, and all of one depth to a tenth."""
    same_depth = np.ptp(position) <= 0.1 * np.abs(position).min()
    return run.experiment.lower().startswith("probe") and bool(np.all(position != 0)) and bool(same_depth)


def _pushes(position: np.ndarray, force: np.ndarray) -> list[slice]:
    """Stretches over which the probe pushes, toward +x or −x: the force grows in size, unlike in a release."""
    parts = [*_rising_parts(position), *_rising_parts(-position)]
    loading = [p for p in parts if abs(force[p][-3:].mean()) > abs(force[p][:3].mean())]
    return sorted(loading, key=lambda p: p.start)


def _rising_parts(position: np.ndarray) -> list[slice]:
    """Stretches over which the probe pushes in: from 10 % of each rise of the position to its highest sample."""
    smooth = np.convolve(np.pad(position, 2, mode="edge"), np.ones(5) / 5, mode="valid")
    rising = np.diff(smooth) > 0.02 * np.abs(np.diff(smooth)).max(initial=0.0)
    edges = np.flatnonzero(np.diff(np.r_[0, rising.astype(int), 0]))
    span = np.ptp(position)
    parts = []
    for start, end in zip(edges[::2], edges[1::2], strict=True):
        if end - start >= 5 and smooth[end] - smooth[start] > 0.2 * span:
            begin = start + int(np.searchsorted(smooth[start:end], smooth[start] + 0.1 * (smooth[end] - smooth[start])))
            parts.append(slice(begin, begin + int(np.argmax(position[begin : end + 1])) + 1))
    return parts
