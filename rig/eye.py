"""Watches an AprilTag in a process of its own: `python -m ljjax.rig.eye FILE JSON`, started by `ljjax.rig.camera`.

A detection on the whole picture takes several milliseconds, near where the tag was last about one; in the loop's own
process either would hold up the loop.
"""

from __future__ import annotations

import importlib
import json
import math
import mmap
import os
import sys
from typing import Any, NamedTuple

import numpy as np

from ljjax.errors import InputError
from ljjax.rig.frames import Frame, open_source
from ljjax.rig.refine import Place, Refiner, bitmap
from ljjax.rig.robot import NAN, RigError
from ljjax.rig.shared import Shared

MARGIN = 0.6
"""What is searched beyond the tag's last place, of its size on each side."""


class Result:
    """The last result in memory of `BYTES` that two processes share: how many there were, and the last two of them by
    turns, each a stamp [s], a bend q_Σ [rad] counter-clockwise and the pictures seen. A place is written again only
    after the number has moved on, so what is read is whole where the number stood still; and nothing waits for a
    process that is killed as it writes."""

    BYTES = 56

    def __init__(self, memory: mmap.mmap):
        self._at = Shared(memory, 7)

    def put(self, stamp: float, bend: float, pictures: int) -> None:
        """Write the next result."""
        number = self._at.whole[0] + 1
        place = 1 + 3 * (number % 2)
        self._at.real[place], self._at.real[place + 1], self._at.whole[place + 2] = stamp, bend, pictures
        self._at.whole[0] = number

    def get(self) -> tuple[float, float, int]:
        """Stamp, bend and pictures; −∞, NaN and 0 before there are any."""
        while True:
            number = self._at.whole[0]
            place = 1 + 3 * (number % 2)
            found = self._at.real[place], self._at.real[place + 1], self._at.whole[place + 2]
            if self._at.whole[0] == number:
                return found if number else (-math.inf, NAN, 0)

    def close(self) -> None:
        """Let go of the memory."""
        self._at.close()


class Seen(NamedTuple):
    """A tag in a picture: its middle and size [px], and its angle counter-clockwise [rad]."""

    x: float
    y: float
    size: float
    angle: float


class TagFinder:
    """Finds one tag of the family tag36h11, at first near where it was; tag 0 to a hundredth of a pixel
    (`ljjax.rig.refine`). Raises RigError where no detector is there."""

    def __init__(self, tag_id: int, refine: bool = True):
        try:
            package: Any = importlib.import_module("pupil_apriltags")
        except ImportError:
            raise RigError("camera: pupil-apriltags is not installed; pip install 'ljjax[rig]'") from None

        class Kept(package.Detector):
            def __del__(self) -> None:
                pass  # the package's own frees the family before the detector that uses it, and may crash

        self._near: Any = Kept(families="tag36h11", nthreads=1, quad_decimate=1.0)
        self._whole: Any = Kept(families="tag36h11", nthreads=1, quad_decimate=2.0)
        self._id = tag_id
        self._refiner = Refiner(bitmap()) if refine and tag_id == 0 else None
        self._last: Seen | None = None

    def find(self, picture: np.ndarray) -> Seen | None:
        """The tag in a picture, or None."""
        last, found = self._last, None
        if last is not None:
            reach = (0.5 + MARGIN) * last.size * math.sqrt(2)
            left, top = max(0, int(last.x - reach)), max(0, int(last.y - reach))
            right, bottom = math.ceil(last.x + reach), math.ceil(last.y + reach)
            found = self._detect(self._near, np.ascontiguousarray(picture[top:bottom, left:right]), left, top)
        else:
            found = self._detect(self._whole, picture, 0, 0)
        self._last = found
        return found

    def _detect(self, detector: Any, picture: np.ndarray, left: int, top: int) -> Seen | None:
        for one in detector.detect(picture):
            if one.tag_id == self._id and one.hamming <= 1:
                corners = np.asarray(one.corners)
                along = corners[1] - corners[0] + corners[2] - corners[3]
                size = float(np.linalg.norm(along)) / 2
                place = self._refiner.refine(picture, corners) if self._refiner else None
                place = place or Place(one.center[0], one.center[1], math.atan2(-along[1], along[0]))
                return Seen(left + place.x, top + place.y, size, place.angle)
        return None


class Eye:
    """From pictures to the tip's bend, which goes on beyond half a turn as long as the tag is followed."""

    def __init__(self, tag_id: int):
        self._finder = TagFinder(tag_id)
        self._bend = 0.0
        self._before: np.ndarray | None = None

    def look(self, frame: Frame) -> float | None:
        """The bend [rad], NaN where no tag is seen; None for a picture that is the last one again: a camera's noise
        never repeats, so the camera is frozen, and the old result stays."""
        if self._before is not None and np.array_equal(self._before, frame.picture):
            return None
        self._before = frame.picture
        seen = self._finder.find(frame.picture)
        if seen is None:
            return NAN
        self._bend += math.remainder(seen.angle - self._bend, 2 * math.pi)
        return self._bend


def main(path: str, options: str) -> None:
    """Watch until the process that started this one is gone."""
    parent = os.getppid()
    about = json.loads(options)
    with open(path, "rb+") as file:
        result = Result(mmap.mmap(file.fileno(), Result.BYTES))
    source = open_source(about["source"], about["width"], about["height"], about["rate_hz"])
    eye = Eye(about["tag_id"])
    pictures = 0
    stamp, bend = -math.inf, NAN
    while os.getppid() == parent:
        frame = source.grab(0.1)
        if frame is None:
            continue
        found = eye.look(frame)
        pictures += 1
        if found is not None:
            stamp, bend = frame.stamp, found
        result.put(stamp, bend, pictures)


if __name__ == "__main__":
    try:
        main(sys.argv[1], sys.argv[2])
    except InputError as error:
        sys.exit(str(error))
