"""The runs of one robot as a session: their order, and what carries over from one to the next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ljjax.fit.windows import Motion
from ljjax.logs import started_ns
from ljjax.step import SELF_HEATING_K, SELF_HEATING_S


def by_start(motions: Sequence[Motion]) -> list[Motion]:
    """The runs in the order in which they were made."""
    return sorted(motions, key=lambda m: (started_ns(m.run), m.run.t0_ns, m.run.path))


def in_order(motions: Sequence[Motion]) -> list[Motion]:
    """The runs by their start, each with the temperature's rise and the slip since the first one began."""
    ordered = by_start(motions)
    if not ordered:
        return []
    first = started_ns(ordered[0].run)
    session = [(started_ns(m.run) - first) * 1e-9 + m.t for m in ordered]
    warmths = _logged(ordered, session) or _heating(ordered, session)
    slipped, out = 0.0, []
    for m, warm in zip(ordered, warmths, strict=True):
        way = travel(m.y, m.noise)
        out.append(replace(m, warm=warm, worn=slipped + way))
        slipped += float(way[-1])
    return out


def _logged(motions: Sequence[Motion], session: Sequence[np.ndarray]) -> list[np.ndarray]:
    """The rise of the logged temperature at the times of the session; between the runs that log it where one does not;
    none where none does."""
    t, value = [], []
    for m, own in zip(motions, session, strict=True):
        if "temperature" in m.run.signals:
            s = m.run.signals["temperature"]
            t.append(own)
            value.append(np.interp(m.t, s.t, s.value[:, 0]))
    if not t:
        return []
    at, known = np.concatenate(t), np.concatenate(value)
    order = np.argsort(at, kind="stable")
    at, known = at[order], known[order]
    cold = np.interp(session[0][0], at, known)
    return [np.interp(own, at, known) - cold for own in session]


def _heating(motions: Sequence[Motion], session: Sequence[np.ndarray]) -> list[np.ndarray]:
    """The warmth of a robot that warms while it runs and cools in between, as `thermal_drift` takes it."""
    heated, ended, out = 0.0, 0.0, []
    for m, own in zip(motions, session, strict=True):
        heated *= np.exp(-max(own[0] - ended, 0.0) / SELF_HEATING_S)
        warm = SELF_HEATING_K - (SELF_HEATING_K - heated) * np.exp(-(m.t - m.t[0]) / SELF_HEATING_S)
        heated, ended = float(warm[-1]), float(own[-1])
        out.append(warm)
    return out


def travel(y: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """(T,) the way gone by the mean joint [rad], noise of the standard deviations (c,) left out by a play."""
    kernel = np.ones(5) / 5
    smooth = np.stack([np.convolve(np.pad(c, 2, mode="edge"), kernel, mode="valid") for c in y.T], axis=1)
    half = 3 * noise
    held, total, out = smooth[0].copy(), 0.0, np.empty(len(y))
    for k, x in enumerate(smooth):
        new = np.clip(held, x - half, x + half)
        total += float(np.mean(np.abs(new - held)))
        held, out[k] = new, total
    return out
