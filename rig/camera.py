"""The shape by a camera: an AprilTag on the tip, watched by a process of its own (`ljjax.rig.eye`).

The tip turns by the whole bend q_Σ, so θ = (s·angle − zero)/n, with s = +1 where the picture shows the robot turning
counter-clockwise as it bends toward the left tendon.
"""

from __future__ import annotations

import contextlib
import json
import math
import mmap
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from typing import IO, Any, NamedTuple

from ljjax.rig.eye import Result
from ljjax.rig.keys import Keys
from ljjax.rig.robot import NAN, RigError


class Shape(NamedTuple):
    """When the shape was seen [s], the mean segment angle [rad], NaN where the tag was not found, and what is wrong."""

    t: float = -math.inf
    theta: float = NAN
    faults: tuple[str, ...] = ()


class TagCamera:
    """The camera behind connect, read and stop.

    A frozen camera leaves the old stamp. A tag out of sight is NaN with a new one.

    Args:
        table: [camera] of rig.toml: source (see `ljjax.rig.frames`), segments, sign, zero_rad (of q_Σ), tag_id, width,
            height, rate_hz, wait_s (for the first picture, at `connect`).

    Raises:
        InputError: a key that is missing, unknown or wrong.
    """

    def __init__(self, table: Mapping[str, Any]):
        keys = Keys("camera", table)
        self._options = {
            "source": keys.text("source", expected="file:PATH, opencv:NUMBER or PACKAGE.MODULE:NAME"),
            "tag_id": keys.whole("tag_id", 0, 0, 586),
            "width": keys.whole("width", 640, 16, 10_000),
            "height": keys.whole("height", 400, 16, 10_000),
            "rate_hz": keys.number("rate_hz", 210.0, "Hz", 1.0, 10_000.0),
        }
        self._segments = keys.whole("segments", low=1, high=100)
        self._sign = math.copysign(1.0, keys.number("sign", 1, low=-1, high=1))
        self._zero = keys.number("zero_rad", 0.0, "rad")
        self._wait = keys.number("wait_s", 20.0, "s", 0.0)
        keys.done()
        self._process: subprocess.Popen[bytes] | None = None
        self._said: IO[bytes] | None = None
        self._map: mmap.mmap | None = None
        self._result: Result | None = None

    def connect(self) -> None:
        """Start the process and wait for its first picture. Raises RigError."""
        with tempfile.NamedTemporaryFile(prefix="ljjax_eye_", delete=False) as file:
            file.write(bytes(Result.BYTES))
            file.flush()
            self._map = mmap.mmap(file.fileno(), Result.BYTES)
            result = self._result = Result(self._map)
        try:
            self._said = tempfile.TemporaryFile()
            command = [sys.executable, "-m", "ljjax.rig.eye", file.name, json.dumps(self._options)]
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=self._said,
                stderr=self._said,
                start_new_session=True,  # an interrupt is the loop's, which still needs the shape to come to rest
            )
            end = time.monotonic() + self._wait
            while not result.get()[2]:
                if self._process.poll() is not None:
                    raise RigError(self._ended())
                if time.monotonic() > end:
                    source = self._options["source"]
                    raise RigError(f"camera.source {source}: no picture in {self._wait:g} s; check camera and cable")
                time.sleep(0.005)
        except BaseException:
            self.stop()
            raise
        finally:
            os.unlink(file.name)

    def read(self) -> Shape:
        """The last shape seen."""
        if self._process is None or self._result is None:
            return Shape()
        stamp, bend, _ = self._result.get()
        gone = (self._ended(),) if self._process.poll() is not None else ()
        return Shape(stamp, (self._sign * bend - self._zero) / self._segments, gone)

    def stop(self) -> None:
        """End the process. Never raises."""
        with contextlib.suppress(Exception):
            if self._process is not None:
                self._process.kill()
                self._process.wait(10.0)
        for held in (self._result, self._map, self._said):
            with contextlib.suppress(Exception):
                if held is not None:
                    held.close()
        self._process = self._result = self._map = self._said = None

    def _ended(self) -> str:
        """Why the process ended: the last line it wrote."""
        assert self._said is not None
        self._said.seek(0)
        lines = self._said.read().decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else "camera: its process has ended without a word; connect again"
