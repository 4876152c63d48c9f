"""Memory that two processes share: no number is ever seen half written."""

from __future__ import annotations

import math
import mmap
import subprocess
import sys
from pathlib import Path

from ljjax.rig.eye import Result
from ljjax.rig.ring import Ring

SECONDS = 1.0
WRITER = """import sys, time, mmap
from ljjax.rig.eye import Result
from ljjax.rig.ring import Ring
what, end = sys.argv[1], time.monotonic() + float(sys.argv[3])
if what == "ring":
    ring = Ring(int(sys.argv[2]))
    while time.monotonic() < end:
        ring.synced = 1e4
else:
    with open(sys.argv[2], "rb+") as file:
        result, k = Result(mmap.mmap(file.fileno(), Result.BYTES)), 0
    while time.monotonic() < end:
        k += 1
        result.put(float(k), -float(k), k)"""


def test_the_time_of_the_disk_is_never_seen_half_written():
    ring = Ring()
    ring.synced = 1e4
    writer = subprocess.Popen([sys.executable, "-c", WRITER, "ring", str(ring.fd), str(SECONDS)], pass_fds=(ring.fd,))
    seen = set()
    while writer.poll() is None:
        seen.update(ring.synced for _ in range(1000))
    ring.close()
    assert writer.returncode == 0 and seen == {1e4}


def test_a_result_of_the_eye_is_never_a_mixture(tmp_path: Path):
    path = tmp_path / "result"
    path.write_bytes(bytes(Result.BYTES))
    with path.open("rb+") as file:
        memory = mmap.mmap(file.fileno(), Result.BYTES)
    result = Result(memory)
    assert result.get()[0] == -math.inf and result.get()[2] == 0
    writer = subprocess.Popen([sys.executable, "-c", WRITER, "eye", str(path), str(SECONDS)])
    mixed, last = [], 0
    while writer.poll() is None:
        stamp, bend, pictures = result.get()
        if pictures and not (stamp == -bend == pictures >= last):
            mixed.append((stamp, bend, pictures))
        last = pictures
    assert writer.returncode == 0 and last > 100 and not mixed
    result.close()
    memory.close()
