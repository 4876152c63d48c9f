"""From the plant's motion to what markers show: causes of gaps in the camera, then noise."""

from __future__ import annotations

import numpy as np

from benchmarks.blind.plant import APART_S, Causes, Motion, form
from benchmarks.recovery.experiments import PERIOD_S, Array

JOINT_SD_RAD = np.radians(0.047)
THETA_SD_RAD = np.radians(0.0195)
SHAPE_EVERY = 2
"""Periods of the commands between two shapes: 100 Hz."""


def shape(motion: Motion, columns: int, causes: Causes, run: int) -> Array:
    """(T', columns): angles as the camera gives them at every `SHAPE_EVERY`-th period, without noise [rad].

    Args:
        columns: 6 for every joint, 1 for their mean.
        causes: numbers by cause; those that are not of the camera are ignored.
        run: place in the session.
    """
    q = motion.q if columns > 1 else motion.q.mean(axis=1, keepdims=True)
    t = np.arange(len(q)) * PERIOD_S
    at = t[::SHAPE_EVERY]
    if (f := causes.get("sensor_filter")) and f[0] > 0:
        q = (_averaged, _smoothed, _exposed, _calmed, _damped, _blurred, _tracked, _middling)[form(f)](q, f[0])
    if f := causes.get("sensor_delay"):
        late = f[0] * np.ones(len(at))
        if form(f) == 0:
            late *= 1 + 0.15 * np.sin(2 * np.pi * f[1] * at + f[2])
        elif form(f) == 2:  # frames queue up until the queue is emptied
            late *= 0.5 + (at + f[2]) / f[1] % 1
        elif form(f) == 3:  # a computer that is busy by spells
            spells = np.random.default_rng([int(f[1]), run]).uniform(0.3, 1.7, int(at[-1]) + 1)
            late *= spells[at.astype(int)]
        elif form(f) == 4:  # no two frames take the same time
            late *= np.random.default_rng([int(f[1]), run]).gamma(4, 0.25, len(at))
        elif form(f) == 5:  # a thin link, on which pictures that change much queue up
            late *= 0.3 + 1.7 * _queued(motion.q, f[1])[::SHAPE_EVERY]
        elif form(f) == 7 and f[0] > 0:  # few pictures a second, worked on for a while; each is kept until the next
            every = 1.2 * f[0]
            late = at - every * (np.floor((at - 0.4 * f[0]) / every - f[1]) + f[1])
        if form(f) == 6:  # markers are read one after the other, from the base on
            each = np.linspace(0.3, 1.7, motion.q.shape[1])
            y = np.stack([np.interp(at - late * k, t, x) for k, x in zip(each, motion.q.T, strict=True)], axis=1)
            y = y if columns > 1 else y.mean(axis=1, keepdims=True)
        else:
            y = np.stack([np.interp(at - late, t, x) for x in q.T], axis=1)
    else:
        y = q[::SHAPE_EVERY].copy()
    if f := causes.get("sensor_scale"):
        if form(f) == 2:  # the camera looks from one side
            y *= 1 + f[0] * (0.3 + np.tanh(y / 0.15))
        elif form(f) == 3:  # a lens that stretches what is off the middle
            aside = np.cumsum(y, axis=1) if columns > 1 else 3.5 * y
            y *= 1 + f[0] * (aside / 0.5) ** 2
        elif form(f) == 4:  # a picture that is stretched sideways
            aside = np.cumsum(y, axis=1) if columns > 1 else 6 * y
            more = np.arctan2(f[0] * np.sin(aside) * np.cos(aside), 1 + f[0] * np.sin(aside) ** 2)
            y += np.diff(more, axis=1, prepend=0) if columns > 1 else more / 6
        elif form(f) == 5:  # set up at another distance for each run
            y *= 1 + f[0] * np.random.default_rng([int(f[1]), run]).normal()
        elif form(f) == 6:  # a zoom that creeps
            y *= 1 - f[0] * np.expm1(-(run * APART_S + at) / f[1])[:, None]
        elif form(f) == 7:  # an autofocus that hunts, and changes the size of the picture with it
            y *= 1 + f[0] * _focused(len(at), np.random.default_rng([int(f[1]), run]))[:, None]
        else:
            y += f[0] * y * (1 - 0.1 * (y / 0.6) ** 2 * (form(f) == 0))
    if f := causes.get("sensor_bias"):
        offsets = np.array(f[1 : 1 + columns]) if columns > 1 else np.ones(1)
        if form(f) == 3:  # markers knocked in the middle of a run
            y[at + 1e3 * (run - f[7]) >= f[8]] += f[0] * offsets
        elif form(f) == 4:  # zeroed by hand before each run
            y += f[0] * offsets * np.random.default_rng([int(f[7]), run]).normal()
        elif form(f) == 5:  # markers that creep on their glue, as the logarithm of time
            crept = np.log1p((run * APART_S + at) / f[7]) / np.log1p(8 * APART_S / f[7])
            y += f[0] * offsets * (0.2 + 0.8 * crept)[:, None]
        elif form(f) == 6:  # gyroscopes, set to zero at the start of each run
            y += f[0] * offsets * (at / at[-1])[:, None]
        elif form(f) == 7:  # accelerometers on the links, off by a share of gravity
            upright = np.cumsum(y, axis=1) if columns > 1 else 6 * y
            off = f[0] * offsets * np.cos(upright + f[7])
            y += np.diff(off, axis=1, prepend=0) if columns > 1 else off / 6
        else:
            y += f[0] * offsets * (np.cos(y) if form(f) == 0 else 1)
    if f := causes.get("edge_of_view"):  # the ends of the picture, where markers hardly get on
        y += f[0] * (np.maximum(-y - f[2], 0) - np.maximum(y - f[1], 0))
    if f := causes.get("camera_wander"):
        rng = np.random.default_rng([int(f[1]), run])
        for hz in (0.04, 0.09, 0.17, 0.31):
            turn = rng.uniform(0, 2 * np.pi)
            y += (f[0] * rng.normal() * (np.sin(2 * np.pi * hz * at + turn) - np.sin(turn)))[:, None]
    if f := causes.get("lost_frames"):
        rng = np.random.default_rng([int(f[1]), run])
        for begin in np.arange(2, at[-1], 3.0):
            begin += rng.uniform(-0.7, 0.7)
            lost = (at >= begin) & (at < begin + f[0])
            y[lost] = y[lost][:1]
    if (f := causes.get("false_detections")) and f[0] > 0:  # glints taken for a marker
        rng = np.random.default_rng([int(f[1]), run])
        for begin in rng.uniform(0, at[-1], 12):
            seen = (at >= begin) & (at < begin + rng.uniform(0.03, 0.2))
            y[seen, rng.integers(columns)] += f[0] * rng.choice([-1, 1]) * rng.uniform(0.5, 1)
    if (f := causes.get("coarse_pixels")) and f[0] > 0:  # angles in steps
        y = f[0] * np.round(y / f[0])
    return y


def noise_sd(columns: int) -> float:
    """Of one angle [rad]."""
    return JOINT_SD_RAD if columns > 1 else THETA_SD_RAD


def _averaged(q: Array, seconds: float) -> Array:
    """A mean over the past `seconds`, the middle of it counting most."""
    m = max(2, round(seconds / PERIOD_S))
    weight = np.hanning(m + 2)[1:-1]
    return _weighted(q, weight / weight.sum())


def _exposed(q: Array, seconds: float) -> Array:
    """The mean over the past `seconds`."""
    m = max(2, round(seconds / PERIOD_S))
    return _weighted(q, np.full(m, 1 / m))


def _smoothed(q: Array, seconds: float) -> Array:
    """A filter of first order, from rest."""
    decay = np.exp(-PERIOD_S * np.arange(round(8 * seconds / PERIOD_S) + 1) / seconds)
    return _weighted(q, decay / decay.sum())


def _calmed(q: Array, seconds: float) -> Array:
    """A filter of first order that smooths less the faster it moves."""
    out, rate = q.copy(), np.zeros_like(q[0])
    for k in range(1, len(q)):
        rate += 0.1 * ((q[k] - q[k - 1]) / PERIOD_S - rate)
        out[k] = out[k - 1] + (q[k] - out[k - 1]) * -np.expm1(-PERIOD_S * (1 + np.abs(rate) / 0.2) / seconds)
    return out


def _damped(q: Array, seconds: float) -> Array:
    """Butterworth's filter of second order, from rest."""
    x = np.arange(round(12 * seconds / PERIOD_S) + 2) * PERIOD_S / (2**0.5 * seconds)
    weight = np.diff(1 - np.exp(-x) * (np.cos(x) + np.sin(x)))
    return _weighted(q, weight / weight.sum())


def _blurred(q: Array, seconds: float) -> Array:
    """Smoothed afterwards, over what came before and after alike: a bell, without lag."""
    m = max(1, round(2 * seconds / PERIOD_S))
    weight = np.exp(-0.5 * (np.arange(-m, m + 1) * PERIOD_S / (0.5 * seconds)) ** 2)
    return _weighted(np.concatenate([q, np.repeat(q[-1:], m, axis=0)]), weight / weight.sum())[m:]


def _tracked(q: Array, seconds: float) -> Array:
    """A tracker that takes motion to be steady: no lag while it is, too far where it turns."""
    x, rate, gain = q[0], np.zeros_like(q[0]), -np.expm1(-PERIOD_S / seconds)
    out = np.empty_like(q)
    for k, seen in enumerate(q):
        x = x + rate
        x, rate = x + (1 - (1 - gain) ** 2) * (seen - x), rate + gain**2 * (seen - x)
        out[k] = x
    return out


def _middling(q: Array, seconds: float) -> Array:
    """The median of the past `seconds`."""
    m = max(3, round(seconds / PERIOD_S))
    padded = np.concatenate([np.repeat(q[:1], m - 1, axis=0), q])
    return np.median(np.lib.stride_tricks.sliding_window_view(padded, m, axis=0), axis=-1)


def _focused(count: int, rng: np.random.Generator) -> Array:
    """(T,) 0 … 1: near or far, where an autofocus goes by turns, for spells."""
    at = np.arange(count) * SHAPE_EVERY * PERIOD_S
    turns = np.cumsum(rng.uniform(1, 4, int(at[-1]) + 2))
    goal = (np.searchsorted(turns, at, side="right") + rng.integers(2)) % 2
    focus = goal.astype(float)
    for k in range(1, count):
        focus[k] = focus[k - 1] + (goal[k] - focus[k - 1]) * -np.expm1(-SHAPE_EVERY * PERIOD_S / 0.1)
    return focus


def _queued(q: Array, seconds: float) -> Array:
    """(T,) 0 … 1: how full the link is that carries the pictures of this motion."""
    rate = np.abs(np.diff(q, axis=0, prepend=q[:1])).mean(axis=1) / PERIOD_S
    full, busy = np.zeros(len(q)), rate / (rate + 0.3)
    for k in range(1, len(q)):
        full[k] = full[k - 1] + (busy[k] - full[k - 1]) * -np.expm1(-PERIOD_S / seconds)
    return full


def _weighted(q: Array, weight: Array) -> Array:
    """The mean over the past, the weight of what is newest first."""
    m = len(weight)
    padded = np.concatenate([np.repeat(q[:1], m - 1, axis=0), q])
    return np.stack([np.convolve(x, weight, "valid") for x in padded.T], axis=1)
