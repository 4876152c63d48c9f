"""Write a log that follows contract v1. What was written before a crash stays readable."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ljjax.errors import InputError
from ljjax.logs import cdr, contract
from ljjax.logs.sink import Sink

Numbers = Sequence[float | int] | np.ndarray
_REQUIRED = ("run_id", "robot_id", "experiment", "p_atm_pa", "start_utc")


class Writer:
    """A log being written, as a context manager.

        with Writer("run.mcap", {"run_id": "7", "robot_id": "octrobot-1", "experiment": "bend",
                                 "p_atm_pa": "101325", "start_utc": "2026-03-03T09:40:37Z"}) as log:
            log.write("cmd_tendons", t_ns, [1.0, 0.5])
            log.write("shape", t_ns, [0.01, 0.02], columns=("q1", "q2"))

    Metadata `ljjax.run` is written first without `end_reason` and again, whole, at the end: `end_reason` is
    `completed`, or `error: …` where the block raised. Values are refused (InputError) where they are not
    finite or not of the signal's shape; times may come in any order.

    Args:
        path: written directly, so that a crash leaves what was written; an existing file is replaced.
        metadata: run_id, robot_id, experiment, p_atm_pa, start_utc, and law_sha256, software_version where
            known.
        library: what the file says it was written by.
    """

    def __init__(self, path: str | os.PathLike[str], metadata: Mapping[str, object], *, library: str = "ljjax"):
        self.path = os.fspath(path)
        self._metadata = self._checked(metadata)
        self._sink = Sink(path, library)
        self._sink.metadata(contract.RUN_RECORD, self._metadata)
        self._sequence: dict[int, int] = {}
        self._ids: dict[str, int] = {}
        self._columns: dict[str, tuple[str, ...]] = {}
        self._shas: dict[str, str] = {}
        self._last_ns = 0
        self.closed = False

    def _checked(self, metadata: Mapping[str, object]) -> dict[str, str]:
        stated = {
            "contract_version": contract.VERSION,
            "law_sha256": "",
            "software_version": _version(),
            **metadata,
        }
        found: dict[str, str] = {}
        for key, value in stated.items():
            if not isinstance(value, str):
                raise InputError(f"{self.path}: metadata {key} is {value!r}, expected a string")
            found[key] = value
        for key in _REQUIRED:
            if not found.get(key):
                raise InputError(f"{self.path}: metadata {key} is missing; a log needs {', '.join(_REQUIRED)}")
        for key in ("end_reason", "sha256"):
            if key in found:
                raise InputError(f"{self.path}: metadata {key} is the writer's own (close() takes end_reason)")
        if found["contract_version"] != contract.VERSION:
            raise InputError(f"{self.path}: contract_version is {found['contract_version']!r}, expected '1'")
        return found

    def write(
        self,
        signal: str,
        t_ns: int,
        value: Numbers,
        *,
        sd: Numbers | None = None,
        columns: Sequence[str] | None = None,
        prefix: str = "/real",
        log_ns: int | None = None,
        publish_ns: int | None = None,
    ) -> None:
        """One sample, by signal name, in the units of `Run`.

        Args:
            signal: `cmd_tendons`, `tendons`, `cmd_pressure`, `pressure`, `shape`, `tip`, `probe` or
                `temperature`. `tendons`
                takes two tensions, or four numbers: two tensions, then the spool travel [m].
            t_ns: header stamp in ns.
            sd: standard deviations of the numbers, on `<topic>/sd` (for pressures and temperatures: the
                message's variance).
            columns: for a shape, `("theta",)` or `("q1", …)`; by default theta for one number, q1 … qn for
                several.
            prefix: `/real`, `/sim` or `/residual`.
            log_ns, publish_ns: the other clocks; by default t_ns.

        Raises InputError.
        """
        topic, kind, pack = self._form(signal, value, columns, prefix)
        if sd is not None and np.size(sd) != np.size(value):
            raise InputError(f"{self.path}: {topic}: {np.size(sd)} standard deviations for {np.size(value)} values")
        data, sd_data = pack(
            t_ns,
            self._numbers(topic, t_ns, value),
            None if sd is None else self._numbers(topic, t_ns, sd, True),
        )
        if sd_data is not None:  # first, so that a cut never leaves a sample without its standard deviation
            self._message(topic + contract.SD, kind, t_ns, sd_data, log_ns, publish_ns)
        self._message(topic, kind, t_ns, data, log_ns, publish_ns)

    def _form(self, signal: str, value: Any, columns: Sequence[str] | None, prefix: str):
        entry = contract.BY_SIGNAL.get(signal)
        if entry is None or signal == "spool":
            names = ", ".join(n for n in contract.BY_SIGNAL if n != "spool")
            mend = "; spool travel goes with tendons: [N, N, m, m]" if signal == "spool" else ""
            raise InputError(f"{self.path}: no signal {signal!r} to write; expected {names}{mend}")
        topic, size = prefix + entry.topic, np.size(value)
        if entry.signal == "shape":
            columns = self._shape_columns(topic, size, columns)
        sizes = (
            (2, 4) if signal == "tendons" else (len(columns) if columns and signal == "shape" else len(entry.columns),)
        )
        if size not in sizes or np.ndim(value) > 1:
            raise InputError(
                f"{self.path}: {topic}: {np.shape(value)} numbers, expected {' or '.join(map(str, sizes))} "
                f"({', '.join(columns or entry.columns)})"
            )
        return topic, entry.type, packer(entry, tuple(columns or entry.columns))

    def _shape_columns(self, topic: str, size: int, columns: Sequence[str] | None) -> tuple[str, ...]:
        default = ("theta",) if size == 1 else tuple(f"q{i + 1}" for i in range(size))
        names = tuple(columns) if columns is not None else self._columns.get(topic, default)
        if names != ("theta",) and names != tuple(f"q{i + 1}" for i in range(len(names))):
            raise InputError(f"{self.path}: {topic}: columns {', '.join(names) or 'none'}, expected theta or q1 … qn")
        if self._columns.setdefault(topic, names) != names:
            raise InputError(
                f"{self.path}: {topic}: columns {', '.join(names)}, earlier {', '.join(self._columns[topic])}"
            )
        return names

    def _numbers(self, topic: str, t_ns: int, value: Any, is_sd: bool = False) -> list[float]:
        try:
            numbers = np.asarray(value, dtype=float).reshape(-1)
        except (TypeError, ValueError):
            raise InputError(f"{self.path}: {topic}: {value!r} at {t_ns} ns, expected numbers") from None
        if not np.isfinite(numbers).all() or (is_sd and (numbers < 0).any()):
            what = "standard deviations" if is_sd else "values"
            raise InputError(f"{self.path}: {topic}: {what} {numbers.tolist()} at {t_ns} ns, expected finite numbers"
                             f"{' ≥ 0' if is_sd else ''}; leave such a sample out")  # fmt: skip
        return numbers.tolist()

    def write_diagnostics(
        self, t_ns: int, statuses: Sequence[tuple[int, str, str, Mapping[str, str]]], *, prefix: str = "/real"
    ) -> None:
        """A DiagnosticArray of (level, name, message, values); levels are 0 OK, 1 WARN, 2 ERROR, 3 STALE."""
        rows = [(level, name, message, "", tuple(values.items())) for level, name, message, values in statuses]
        data = cdr.diagnostic_array(t_ns, rows)
        self._message(prefix + contract.DIAGNOSTICS_TOPIC, contract.DIAGNOSTIC_ARRAY, t_ns, data, None, None)

    def _message(
        self, topic: str, kind: str, t_ns: int, data: bytes, log_ns: int | None, publish_ns: int | None
    ) -> None:
        if self.closed:
            raise InputError(f"{self.path}: is closed; nothing more can be written")
        log, publish = (
            int(t_ns if log_ns is None else log_ns),
            int(t_ns if publish_ns is None else publish_ns),
        )
        if log <= 0 or publish <= 0:
            raise InputError(
                f"{self.path}: {topic}: log time {log} ns and publish time {publish} ns, expected more than 0"
            )
        if topic not in self._ids:
            self._ids[topic] = self._sink.contract_channel(topic, kind)
        channel = self._ids[topic]
        sequence = self._sequence.get(channel, 0)
        self._sequence[channel] = sequence + 1
        self._last_ns = max(self._last_ns, log)
        self._sink.message(channel, log, publish, data, sequence)

    def attach(
        self, name: str, data: bytes, media_type: str = "application/octet-stream", t_ns: int | None = None
    ) -> None:
        """A file beside the samples, such as the control law. Its sha256 goes into metadata `ljjax.attachments`.

        `t_ns` is its time, by default that of the newest sample.
        """
        import hashlib

        if name in self._shas:
            raise InputError(f"{self.path}: attachment {name!r} is there already; give it another name")
        self._shas[name] = hashlib.sha256(data).hexdigest()
        self._sink.attachment(self._last_ns if t_ns is None else t_ns, name, media_type, data)
        self._sink.metadata(contract.ATTACHMENT_RECORD, {f"sha256:{n}": sha for n, sha in self._shas.items()})

    def flush(self, sync: bool = False) -> None:
        """Hand everything so far to the operating system; with `sync`, wait until it is on the disk."""
        self._sink.flush(sync)

    def close(self, end_reason: str = "completed") -> None:
        """Finish the file. Further calls do nothing."""
        if not self.closed:
            self.closed = True
            self._sink.flush()
            self._sink.metadata(contract.RUN_RECORD, {**self._metadata, "end_reason": end_reason})
            self._sink.close()

    def __enter__(self) -> Writer:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        self.close("completed" if error is None else f"error: {type(error).__name__}: {error}")


def packer(entry: contract.Entry, columns: tuple[str, ...]):
    """A function (t_ns, numbers, sd or None) → (message, message of the standard deviations or None)."""
    frame = entry.frame_id

    def joints(t_ns: int, v: list[float]) -> bytes:
        if entry.signal == "probe":
            return cdr.joint_state(t_ns, frame, ("probe",), v[:1], (), v[1:])
        if entry.signal == "shape":
            return cdr.joint_state(t_ns, frame, columns, v)
        return cdr.joint_state(t_ns, frame, columns, v[2:], (), v[:2])

    def pack(t_ns: int, v: list[float], sd: list[float] | None) -> tuple[bytes, bytes | None]:
        if entry.type == contract.JOINT_STATE:
            return joints(t_ns, v), None if sd is None else joints(t_ns, sd)
        if entry.type == contract.POSE_STAMPED:
            return cdr.scalars(t_ns, frame, v), None if sd is None else cdr.scalars(t_ns, frame, sd)
        return cdr.scalars(t_ns, frame, [v[0], sd[0] ** 2 if sd else 0.0]), None

    return pack


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return f"ljjax {version('ljjax')}"
    except PackageNotFoundError:
        return "ljjax"
