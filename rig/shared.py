"""Numbers in memory that two processes share, with no lock."""

from __future__ import annotations

import mmap


class Shared:
    """Numbers of eight bytes each at the beginning of a mapped memory, as `whole` (unsigned) and `real`, by index.

    Each goes in and out in one piece. (`struct.pack_into` clears its place before it writes, and writes byte by byte:
    who reads meanwhile sees a 0 or half a number.) To be closed before the memory is.
    """

    def __init__(self, memory: mmap.mmap, count: int):
        with memoryview(memory) as every, every[: 8 * count] as head:
            self.whole, self.real = head.cast("Q"), head.cast("d")

    def close(self) -> None:
        """Let go of the memory."""
        self.whole.release()
        self.real.release()
