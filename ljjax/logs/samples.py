"""Samples of one signal as a log has them, and what makes them a `Signal`: finite, in order, on one time axis."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ljjax.errors import InputError
from ljjax.logs.run import Signal


@dataclass(frozen=True)
class Samples:
    """Samples of one quantity with absolute times.

    Attributes:
        t_ns, log_ns, publish_ns: (N,) int64 nanoseconds; `t_ns` is the clock that counts.
        value: (N, k) in `unit`.
        sd: (N, k) or None.
    """

    t_ns: np.ndarray
    log_ns: np.ndarray
    publish_ns: np.ndarray
    value: np.ndarray
    columns: tuple[str, ...]
    unit: str
    topic: str
    sd: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.t_ns)

    def taken(self, index: np.ndarray) -> Samples:
        """The samples at `index` (integers or a mask)."""
        sd = None if self.sd is None else self.sd[index]
        return replace(self, t_ns=self.t_ns[index], log_ns=self.log_ns[index], publish_ns=self.publish_ns[index],
                       value=self.value[index], sd=sd)  # fmt: skip


def stamp_text(t_ns: int | np.integer) -> str:
    """A time as seconds with nine decimals, exact."""
    return f"{int(t_ns) // 10**9}.{int(t_ns) % 10**9:09d} s"


def check_finite(s: Samples, path: str) -> None:
    """Raises InputError naming the first sample whose value or standard deviation cannot be used."""
    for what, table, bad in (
        ("value", s.value, ~np.isfinite(s.value)),
        ("standard deviation", s.sd, None if s.sd is None else np.isinf(s.sd) | (s.sd < 0)),
    ):
        if table is not None and bad is not None and bad.any():
            row, column = (int(i) for i in np.argwhere(bad)[0])
            raise InputError(
                f"{path}: {s.topic}: sample {row} (stamp {stamp_text(s.t_ns[row])}): the {what} of "
                f"{s.columns[column]} is {table[row, column]} ({int(bad.any(axis=1).sum())} such samples of "
                f"{len(s)}); expected a finite number; leave such samples out when recording"
            )


def check_clock(s: Samples, path: str) -> None:
    """Raises InputError where the stamps were never set."""
    if len(s) > 1 and not s.t_ns.any():
        raise InputError(
            f"{path}: {s.topic}: every header.stamp is 0, so the samples have no time; let the publisher set the "
            "stamp, or read "
            'the log with a mapping that says time = "log" for this topic'
        )


def in_order(s: Samples, notes: list[str]) -> Samples:
    """Sorted by time, equal times in the order of the file; what was odd is noted."""
    steps = np.diff(s.t_ns)
    back, same = int((steps < 0).sum()), int((np.diff(np.sort(s.t_ns)) == 0).sum())
    if back:
        notes.append(f"{s.topic}: {back} stamps go back in time; sorted")
        s = s.taken(np.argsort(s.t_ns, kind="stable"))
    if same:
        notes.append(f"{s.topic}: {same} stamps are the same as the one before; kept")
    return s


def as_signals(samples: dict[str, Samples]) -> tuple[int, dict[str, Signal]]:
    """(t0_ns, signals): times in seconds since the first stamp of any signal."""
    t0 = min(int(s.t_ns[0]) for s in samples.values())

    def seconds(t_ns: np.ndarray) -> np.ndarray:
        return (t_ns - t0) / 1e9

    return t0, {
        name: Signal(
            seconds(s.t_ns),
            s.value,
            s.columns,
            s.unit,
            s.topic,
            s.sd,
            seconds(s.log_ns),
            seconds(s.publish_ns),
        )
        for name, s in samples.items()
    }


def with_sd(s: Samples, sd: Samples, path: str, notes: list[str]) -> Samples:
    """`s` with the standard deviations that `sd` states for its stamps; of equal stamps the k-th takes the k-th."""
    if sd.columns != s.columns:
        raise InputError(
            f"{path}: {sd.topic}: names {', '.join(sd.columns)}, expected those of {s.topic}: {', '.join(s.columns)}"
        )
    out = np.full_like(s.value, np.nan)
    waiting: dict[int, list[int]] = {}
    for row, t in enumerate(sd.t_ns.tolist()):
        waiting.setdefault(t, []).append(row)
    for row, t in enumerate(s.t_ns.tolist()):
        rows = waiting.get(t)
        if rows:
            out[row] = sd.value[rows.pop(0)]
    missing = int(np.isnan(out).any(axis=1).sum())
    if missing == len(s):
        notes.append(f"{sd.topic}: none of its stamps is one of {s.topic}; left out")
        return s
    if missing:
        notes.append(f"{sd.topic}: {missing} of {len(s)} samples of {s.topic} have no standard deviation (NaN)")
    return replace(s, sd=out)
