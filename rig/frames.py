"""Where pictures come from: a source has `grab`, which waits for the next picture, and `close`.

`file:PATH` is a ring of pictures in a mapped file, which an emulator or a camera's own program writes; `opencv:N` a
camera through OpenCV; `PACKAGE.MODULE:NAME` a callable of yours that returns a source.
"""

from __future__ import annotations

import importlib
import mmap
import os
import struct
import time
from typing import Any, NamedTuple, Protocol

import numpy as np

from ljjax.rig.robot import RigError
from ljjax.rig.shared import Shared

MAGIC = b"ljjaxpic"
HEAD = struct.Struct("<8sIII")
"""Magic, width, height, slots."""
COUNT, STAMPS = 3, 8
"""Which number of eight bytes says how many pictures were written, and which is the first one's stamp."""
PICTURES_AT = 4096


class Frame(NamedTuple):
    """A picture (height, width) uint8 and when it was taken [s, `time.monotonic()`]."""

    stamp: float
    picture: np.ndarray


class Source(Protocol):
    """Where pictures come from."""

    def grab(self, wait_s: float) -> Frame | None:
        """The next picture that was not handed out yet, or None where none came in time."""
        ...

    def close(self) -> None: ...


class FrameWriter:
    """Writes pictures into a mapped file, over and over."""

    def __init__(self, path: str | os.PathLike[str], width: int, height: int, slots: int = 8):
        self._size, self._slots, self._count = width * height, slots, 0
        with open(path, "wb+") as file:
            file.truncate(PICTURES_AT + slots * self._size)
            self._map = mmap.mmap(file.fileno(), 0)
        self._numbers = Shared(self._map, STAMPS + slots)
        HEAD.pack_into(self._map, 0, MAGIC, width, height, slots)

    def put(self, frame: Frame) -> None:
        """Write a picture; it counts once it is whole."""
        slot = self._count % self._slots
        at = PICTURES_AT + slot * self._size
        self._map[at : at + self._size] = frame.picture.tobytes()
        self._numbers.real[STAMPS + slot] = frame.stamp
        self._count += 1
        self._numbers.whole[COUNT] = self._count

    def close(self) -> None:
        self._numbers.close()
        self._map.close()


class FrameReader:
    """The newest picture of a mapped file."""

    def __init__(self, path: str):
        try:
            with open(path, "rb") as file:
                self._map = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
            magic, self._width, self._height, self._slots = HEAD.unpack_from(self._map, 0)
        except (OSError, ValueError, struct.error) as error:
            raise RigError(f"camera.source file:{path}: {error}; start the emulator or the camera's program") from None
        if magic != MAGIC:
            raise RigError(f"camera.source file:{path}: no file of pictures; give the one that the emulator names")
        self._numbers = Shared(self._map, STAMPS + self._slots)
        self._seen = self._numbers.whole[COUNT]

    def grab(self, wait_s: float) -> Frame | None:
        size, end = self._width * self._height, time.monotonic() + wait_s
        while True:
            count = self._numbers.whole[COUNT]
            if count > self._seen:
                slot = (count - 1) % self._slots
                at = PICTURES_AT + slot * size
                picture = np.frombuffer(self._map[at : at + size], np.uint8).reshape(self._height, self._width)
                stamp = self._numbers.real[STAMPS + slot]
                if self._numbers.whole[COUNT] - count < self._slots - 1:  # not written over meanwhile
                    self._seen = count
                    return Frame(stamp, picture)
            elif time.monotonic() > end:
                return None
            else:
                time.sleep(0.0005)

    def close(self) -> None:
        self._numbers.close()
        self._map.close()


class OpenCvCamera:
    """A camera through OpenCV, grey, without its buffer. The stamp is when the picture was handed over."""

    def __init__(self, index: int, width: int, height: int, rate_hz: float):
        try:
            cv2: Any = importlib.import_module("cv2")
        except ImportError:
            raise RigError("camera: the package OpenCV is not installed; pip install opencv-python-headless") from None
        self._grey = lambda picture: cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
        self._camera: Any = cv2.VideoCapture(index)
        wanted = {
            cv2.CAP_PROP_FRAME_WIDTH: width,
            cv2.CAP_PROP_FRAME_HEIGHT: height,
            cv2.CAP_PROP_FPS: rate_hz,
            cv2.CAP_PROP_BUFFERSIZE: 1,
        }
        for name, value in wanted.items():
            self._camera.set(name, value)
        if not self._camera.isOpened():
            raise RigError(f"camera.source opencv:{index}: cannot be opened; check its cable, number and permissions")

    def grab(self, wait_s: float) -> Frame | None:
        ok, picture = self._camera.read()
        stamp = time.monotonic()
        if not ok:
            return None
        return Frame(stamp, np.ascontiguousarray(picture if picture.ndim == 2 else self._grey(picture)))

    def close(self) -> None:
        self._camera.release()


def open_source(name: str, width: int, height: int, rate_hz: float) -> Source:
    """The source that a text names. Raises RigError where there is none."""
    kind, _, rest = name.partition(":")
    if kind == "file":
        return FrameReader(rest)
    if kind == "opencv" and rest.isdecimal():
        return OpenCvCamera(int(rest), width, height, rate_hz)
    try:
        return getattr(importlib.import_module(kind), rest)()
    except (ImportError, AttributeError, ValueError) as error:
        raise RigError(
            f"camera.source {name!r}: {error}; expected file:PATH, opencv:NUMBER or PACKAGE.MODULE:NAME"
        ) from None
