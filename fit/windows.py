"""Runs cut into short windows of equal length: what drives each, where it starts, which samples lie in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from ljjax import fast
from ljjax.errors import InputError
from ljjax.inputs import from_run
from ljjax.logs import Run
from ljjax.simulation import initial_shape

STEPS = 200
"""Steps in a window, the same for every fit, so that one compilation serves them all."""
SMOOTH_S = 0.06
"""Half of the stretch of samples that tell the angle and the rate at which a window starts [s]."""
GAP_S = 0.2
"""Time without a pose of the tip [s] beyond which a run is taken to have none."""
Source = Literal["commands", "measured"]


class Logged(NamedTuple):
    """What is compared: every joint's angle or the mean one, and the tip's turn beside it or not."""

    joints: bool
    tip: bool


@dataclass(frozen=True, eq=False)
class Motion:
    """One run as a dynamic fit takes it.

    Attributes:
        run: the log; `source` of its inputs.
        t: (T,) stamps [s]; `y` (T, c) measured θ (c = 1) or joint angles (c = n) [rad].
        noise: (c,) standard deviation of the white part of the measurement [rad].
        q0, v0: (n,) shape [rad] and rates [rad/s] at the start, at rest unless the run begins in motion; `q0_sd`
            the standard deviation of the shape [rad].
        input_t, tendons, vacuum, hold: the inputs, as in `ljjax.inputs.Inputs`.
        warm, worn: (T,) rise of the temperature [K] and slip of the mean joint [rad] at the stamps `t` since the
            robot's first run began; effects ask for them.
        tip: (T,) the mean angle q_Σ/n [rad] by the tip's pose, which no effect of the shape's sensor touches, and the
            standard deviation of its white noise; None where it does not count.
    """

    run: Run
    source: Source
    t: np.ndarray
    y: np.ndarray
    noise: np.ndarray
    q0: np.ndarray
    v0: np.ndarray
    q0_sd: float
    input_t: np.ndarray
    tendons: np.ndarray
    vacuum: np.ndarray
    hold: bool
    warm: np.ndarray
    worn: np.ndarray
    tip: tuple[np.ndarray, float] | None = None

    @property
    def seen(self) -> np.ndarray:
        """(T, c) all that a model is compared with [rad]: the shape and, where it counts, the tip beside it."""
        return self.y if self.tip is None else np.column_stack([self.y, self.tip[0]])

    @property
    def seen_noise(self) -> np.ndarray:
        """(c,) standard deviation of the white noise of `seen` [rad]."""
        return self.noise if self.tip is None else np.append(self.noise, self.tip[1])


def with_tips(motions: Sequence[Motion]) -> list[Motion]:
    """Runs with what the tip's pose says of their mean angle, at the shape's stamps; as they are where not all of them
    have it or its orientation stays as it is though the shape moves."""
    tips = [_tip(m) for m in motions]
    found = [tip for tip in tips if tip is not None]
    if len(found) < len(tips) or not found:
        return list(motions)
    return [replace(m, tip=tip) for m, tip in zip(motions, found, strict=True)]


def _tip(m: Motion) -> tuple[np.ndarray, float] | None:
    """By the orientation's turn about +y, all along the shape's stamps."""
    if "tip" not in m.run.signals:
        return None
    s = m.run.signals["tip"]
    known = np.all(np.isfinite(s.value), axis=1)
    if known.sum() < 20 or s.t[known][0] > m.t[0] + GAP_S or s.t[known][-1] < m.t[-1] - GAP_S:
        return None
    if np.max(np.diff(s.t[known])) > GAP_S:
        return None
    y, w = s.value[known, 4], s.value[known, 6]
    turn = np.unwrap(2 * np.arctan2(y, w))
    angle = (turn - 2 * np.pi * np.round(turn[0] / (2 * np.pi))) / len(m.q0)  # −q is the same orientation as q
    noise = max(float(white_noise(angle[:, None])[0]), 1e-6)
    if np.std(angle) < 0.2 * np.std(m.y.mean(axis=1)):
        return None
    return np.interp(m.t, s.t[known], angle), noise


def motion(run: Run, n: int, source: Source = "commands") -> Motion:
    """A run as a dynamic fit takes it.

    Raises:
        InputError: no shape, no inputs, values in doubt, too few samples, or nothing that moves.
    """
    run.trusted()
    shape = run.signal("shape")
    inputs = from_run(run, source)
    known = np.all(np.isfinite(shape.value), axis=1)
    t, y = shape.t[known], shape.value[known]
    last = np.append(np.diff(t) > 0, True)  # of samples of one stamp
    t, y = t[last], y[last]
    if len(t) < 20 or t[-1] - t[0] < 0.5:
        raise InputError(f"{run.path}: {shape.topic}: {len(t)} samples; a dynamic fit needs 20 over half a second")
    noise = np.maximum(white_noise(y), _rounding(y))
    noise = np.where(noise > 0, noise, noise.max())  # of a joint that never moves
    tendons, vacuum = np.asarray(inputs.tendons), np.asarray(inputs.pressure_kpa)
    if np.all(np.std(y, axis=0) < 3 * noise + 1e-9) and np.all(np.ptp(tendons, axis=0) < 1e-9):
        raise InputError(f"{run.path}: no excitation: neither the tensions nor the shape move")
    if np.all(np.std(y, axis=0) < 2 * noise + 1e-9):
        moved = np.degrees(np.std(y.mean(axis=1)))
        raise InputError(f"{run.path}: no excitation: the shape moves by {moved:.2g}° only, no more than its noise")
    q0, v0 = np.asarray(initial_shape(run, n)), np.zeros(n)
    still = max(1, int(np.sum(t <= _first_change(np.asarray(inputs.t), tendons, vacuum, t))))
    spread = float(np.sqrt(np.mean(noise**2) / min(still, 200) / y.shape[1]))
    if (moving := _begins_moving(t, y, noise)) is not None:
        q0, v0, spread = np.broadcast_to(moving[0], (n,)), np.broadcast_to(moving[1], (n,)), 2 * spread
    hold = bool(inputs.hold)
    zero = np.zeros(len(t))
    given = np.asarray(inputs.t), tendons, vacuum, hold
    return Motion(run, source, t, y, noise, q0, v0, max(spread, 1e-6), *given, zero, zero)


def _begins_moving(t: np.ndarray, y: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Shape (c,) and rates (c,) at the first sample, where the first few samples show motion beyond noise."""
    near = t - t[0] <= SMOOTH_S + 1e-9
    if near.sum() < 5:
        return None
    x = t[near] - t[0]
    line = np.polynomial.polynomial.polyfit(x, y[near], 1)
    sd = noise / np.sqrt(np.sum((x - x.mean()) ** 2))
    return (line[0], line[1]) if np.all(np.abs(line[1]) > np.maximum(6 * sd, 0.02)) else None


def _first_change(input_t, tendons, vacuum, t) -> float:
    """When the inputs first change, within a second of the first sample."""
    drive = np.column_stack([tendons, vacuum])
    changed = np.flatnonzero(np.any(drive != drive[0], axis=1))
    return min(float(t[0]) + 1.0, float(input_t[changed[0]]) if len(changed) else np.inf)


KEPT, WITHIN = 2.0, 0.8796
"""Differences up to so many standard deviations are kept, and the standard deviation of a normal number so cut."""


def white_noise(y: np.ndarray) -> np.ndarray:
    """(c,) standard deviation of the white part of each column: that of the third differences, in which motion hardly
    shows, without the large ones, in which it does. Rounded values spoil it less than they do a median."""
    if len(y) < 6:
        return np.zeros(y.shape[1])
    third = np.abs(np.diff(y, 3, axis=0))
    sd = np.median(third, axis=0) / 0.6745
    for _ in range(20):
        near = third <= KEPT * sd
        sd = np.sqrt(np.sum(np.where(near, third, 0.0) ** 2, axis=0) / np.maximum(near.sum(axis=0), 1)) / WITHIN
    return sd / np.sqrt(20)


def _rounding(y: np.ndarray) -> np.ndarray:
    """(c,) standard deviation of what rounding takes from each column, by the least step between its values [rad]: of
    values so coarse that most third differences are nil these say nothing of the noise."""
    steps = [np.asarray(np.diff(np.unique(column)), float) for column in y.T]
    least = [np.min(s[s > 1e-9], initial=np.inf) for s in steps]
    return np.where(np.isfinite(least), least, 0.0) / np.sqrt(12)


def check_columns(motions: Sequence[Motion]) -> None:
    """Refuse runs of which some log θ, some every joint. Raises InputError with two files' names."""
    for m in motions[1:]:
        if m.y.shape[1] != motions[0].y.shape[1]:
            one, all_ = sorted((motions[0], m), key=lambda m: m.y.shape[1])
            raise InputError(
                f"{all_.run.path} logs {all_.y.shape[1]} joint angles, {one.run.path} their mean alone: give runs of "
                "one kind at a time"
            )


@dataclass(frozen=True, eq=False)
class Windows:
    """W windows of `STEPS` steps of h [s], of R runs, the windows of a run one after the other.

    Attributes:
        run: (W,) index of each window's run; `opens` (W,) whether it is its run's first.
        left, right, vacuum: (W, STEPS) mean tensions [N] and vacuum [kPa]; `t` (W, STEPS) starts of the steps [s].
        warm, worn: (W, STEPS) rise of the temperature [K], slip [rad] when the window begins.
        motions: (R,) the runs.
        h: length of a step [s].
        q, v: (W, n) shape [rad] and rates [rad/s] at each start, from the data; `q_sd` (W,) of the mean angle [rad].
        window, step, weight: (N,) where each sample lies: window, step in it, fraction of the step.
        y: (N, c) samples of `Motion.seen` [rad]; `sample_run`, `sample_t` (N,) their run and stamp.
    """

    run: np.ndarray
    opens: np.ndarray
    left: np.ndarray
    right: np.ndarray
    vacuum: np.ndarray
    t: np.ndarray
    h: float
    q: np.ndarray
    v: np.ndarray
    q_sd: np.ndarray
    window: np.ndarray
    step: np.ndarray
    weight: np.ndarray
    y: np.ndarray
    sample_run: np.ndarray
    sample_t: np.ndarray
    warm: np.ndarray
    worn: np.ndarray
    motions: Sequence[Motion]

    def __len__(self) -> int:
        return len(self.run)

    @property
    def logged(self) -> Logged:
        return Logged(self.motions[0].y.shape[1] > 1, self.motions[0].tip is not None)

    def shape(self, x: np.ndarray) -> np.ndarray:
        """The columns of x (N, c) that belong to the shape, not to the tip beside it."""
        return x[:, : self.motions[0].y.shape[1]]

    def some(self, most: int) -> Windows:
        """At most so many of the windows, evenly spread over the runs."""
        if len(self) <= most:
            return self
        return self.only(np.unique(np.linspace(0, len(self) - 1, most).astype(int)))

    def only(self, keep: np.ndarray) -> Windows:
        """The windows of these indices, in ascending order, and the samples in them."""
        mine = np.isin(self.window, keep)
        names = ("run", "left", "right", "vacuum", "t", "q", "v", "q_sd", "warm", "worn")
        of_window = {name: getattr(self, name)[keep] for name in names}
        of_sample = {name: getattr(self, name)[mine] for name in ("step", "weight", "y", "sample_run", "sample_t")}
        window = np.searchsorted(keep, self.window[mine])
        return Windows(opens=self.opens[keep], h=self.h, window=window, motions=self.motions, **of_window, **of_sample)

    def order_of(self, window: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Samples that lie in the windows (N,), window by window, and where each window's begin in that order."""
        order = np.argsort(window, kind="stable")
        return order, np.searchsorted(window[order], np.arange(len(self) + 1))

    @cached_property
    def order(self) -> tuple[np.ndarray, np.ndarray]:
        """`order_of` the samples' own windows."""
        return self.order_of(self.window)

    @cached_property
    def undelayed(self) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]:
        """`delayed` by nothing."""
        return self.delayed(0.0)

    def delayed(self, delay_s: float) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]:
        """(W, STEPS) mean tensions left and right [N], commanded so much earlier, and their slopes over the delay."""
        left, right = self.left.copy(), self.right.copy()
        slopes = np.zeros_like(left), np.zeros_like(right)
        for run in np.unique(self.run):
            m, mine = self.motions[run], self.run == run
            begins = self.t[mine] - delay_s
            edges = np.concatenate([begins, begins[:, -1:] + self.h], axis=1)
            for side, (mean, slope) in enumerate(zip((left, right), slopes, strict=True)):
                total, value = _integral(m, m.tendons[:, side], edges)
                if delay_s:
                    mean[mine] = np.diff(total, axis=1) / self.h
                slope[mine] = -np.diff(value, axis=1) / self.h
        return left, right, slopes


def _integral(m: Motion, x: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """∫x dt from the first stamp, and x, at any times; x (T,) goes with the stamps of a run's inputs."""
    index = np.clip(np.searchsorted(m.input_t, at, side="right") - 1, 0, len(x) - 1)
    after = at - m.input_t[index]
    middle = x[:-1] if m.hold else 0.5 * (x[:-1] + x[1:])
    total = np.concatenate([[0.0], np.cumsum(middle * np.diff(m.input_t))])
    if m.hold:  # the value up to now: what a delay brings in
        before = np.clip(np.searchsorted(m.input_t, at - 1e-9, side="left") - 1, 0, len(x) - 1)
        return total[index] + x[index] * after, x[before]
    value = np.interp(at, m.input_t, x)
    return total[index] + 0.5 * (x[index] + value) * after, value


def cut(motions: Sequence[Motion], h: float) -> Windows:
    """Cut runs into windows of `STEPS` steps of h [s]; the last of a run may reach beyond its data."""
    rows: dict[str, list] = {name: [] for name in Windows.__dataclass_fields__ if name not in ("h", "motions")}
    first = 0
    for index, m in enumerate(motions):
        start = min(float(m.input_t[0]), float(m.t[0]))
        count = max(1, int(np.ceil((m.t[-1] - start) / (h * STEPS) - 1e-9)))
        edges = start + h * np.arange(count * STEPS + 1)
        tendons = fast.mean(m.input_t, m.tendons, edges, m.hold, np)
        vacuum = fast.mean(m.input_t, m.vacuum[:, None], edges, m.hold, np)[:, 0]
        begins = edges[:-1:STEPS]
        q, v, sd = _starts(m, begins)
        place = (m.t - start) / h
        step = np.clip(np.floor(place).astype(int), 0, count * STEPS - 1)
        for name, value in (
            ("run", np.full(count, index)),
            ("opens", np.arange(count) == 0),
            ("left", tendons[:, 0].reshape(count, STEPS)),
            ("right", tendons[:, 1].reshape(count, STEPS)),
            ("vacuum", vacuum.reshape(count, STEPS)),
            ("t", edges[:-1].reshape(count, STEPS)),
            ("q", q),
            ("v", v),
            ("q_sd", sd),
            ("window", first + step // STEPS),
            ("step", step % STEPS),
            ("weight", place - step),
            ("y", m.seen),
            ("sample_run", np.full(len(m.t), index)),
            ("sample_t", m.t),
            ("warm", np.interp(edges[:-1], m.t, m.warm).reshape(count, STEPS)),
            ("worn", np.repeat(np.interp(begins, m.t, m.worn)[:, None], STEPS, axis=1)),
        ):
            rows[name].append(value)
        first += count
    joined = {name: np.concatenate(parts) for name, parts in rows.items()}
    return Windows(**joined, h=h, motions=motions)


def _starts(m: Motion, begins: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shape (W, n) and rates (W, n) at the times `begins` by a quadratic through the samples near them, and the
    standard deviation of the mean angle (W,); the first is the run's own start."""
    q, v, sd = (np.tile(x, (len(begins), 1)) for x in (m.q0, m.v0, m.q0_sd))
    sd = sd[:, 0]
    noise = float(np.sqrt(np.mean(m.noise**2) / m.y.shape[1]))
    for i, t in enumerate(begins[1:], start=1):
        near = np.abs(m.t - t) <= SMOOTH_S
        if near.sum() < 5:
            near[np.argsort(np.abs(m.t - t))[:5]] = True
        x = (m.t[near] - t) / SMOOTH_S
        basis = np.stack([np.ones_like(x), x, x**2], axis=1)
        found = np.linalg.lstsq(basis, m.y[near], rcond=None)[0]
        q[i], v[i] = found[0], found[1] / SMOOTH_S
        sd[i] = noise * np.sqrt(np.linalg.pinv(basis.T @ basis)[0, 0]) + 1e-6
    return q, v, sd
