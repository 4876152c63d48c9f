"""Where a tag is to a hundredth of a pixel: the picture itself held against the tag's, from where the detector saw it.

A detector's corners are drawn to the pixel grid, which turns a small tag by up to some tenths of a degree and lets a
slow bend stick. What is sought instead is the affine map from pixels to cells, the brightness and the contrast under
which the tag's pattern is nearest to the picture (Gauss–Newton, as Lucas and Kanade did for stereo in 1981).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

CODE = 0xD5D628584
"""The 36 bits of tag36h11's tag 0, row by row from the top, 1 for white."""
CELLS = 10
"""Cells across the tag: six of data, the black border, the white one."""
BORDER = 8
"""Cells across the black border's outer edge, at whose corners a detector finds the tag."""
FINE, BLUR = 40, 0.2
"""Points of the pattern a cell, and its blur [cells]."""
USED, ROUNDS = 4.5, 4
"""Half the width of what is compared [cells], and Gauss–Newton's steps."""
ENOUGH = 2000
"""Pixels that are compared, evenly spread where there are more."""
FAR_RAD, FAR_CELLS = 0.1, 0.5
"""A result further than this from the detector's is not believed."""


class Place(NamedTuple):
    """A tag's middle [px] and its angle counter-clockwise [rad]."""

    x: float
    y: float
    angle: float


def bitmap(code: int = CODE) -> np.ndarray:
    """(10, 10) a tag's cells, 1 for white."""
    cells = np.ones((CELLS, CELLS))
    cells[1:-1, 1:-1] = 0
    cells[2:-2, 2:-2] = np.reshape([code >> (35 - i) & 1 for i in range(36)], (6, 6))
    return cells


def blurred(cells: np.ndarray, fine: int, blur: float) -> np.ndarray:
    """(10 fine, 10 fine) a tag's pattern, so many points a cell, blurred by a bell of a standard deviation [cells]."""
    pattern = np.pad(np.kron(cells, np.ones((fine, fine))), fine, mode="edge")
    reach = round(3 * blur * fine)
    bell = np.exp(-0.5 * (np.arange(-reach, reach + 1) / (blur * fine)) ** 2)
    for axis in (0, 1):
        pattern = np.apply_along_axis(lambda row: np.convolve(row, bell / bell.sum(), "same"), axis, pattern)
    return pattern[fine:-fine, fine:-fine]


class Refiner:
    """Holds pictures against one tag's pattern."""

    def __init__(self, cells: np.ndarray):
        fine = blurred(cells, FINE, BLUR)
        self._pattern, self._down, self._right = (
            np.ascontiguousarray(x, np.float32) for x in (fine, *np.gradient(fine, 1 / FINE))
        )

    def refine(self, picture: np.ndarray, corners: np.ndarray) -> Place | None:
        """The tag's place in a picture (H, W), from the four corners (4, 2) [px] that a detector found, in its order;
        None where it cannot be told better than the corners do."""
        right = (corners[1] - corners[0] + corners[2] - corners[3]) / (2 * BORDER)  # pixels a cell
        down = (corners[0] - corners[3] + corners[1] - corners[2]) / (2 * BORDER)
        middle = corners.mean(axis=0)
        to_pixels = np.stack([right, down], axis=1)
        if abs(np.linalg.det(to_pixels)) < 1.0:
            return None
        reach = USED * (np.abs(right) + np.abs(down))
        low = np.maximum(np.floor(middle - reach), 0).astype(int)
        high = np.minimum(np.ceil(middle + reach) + 1, picture.shape[::-1]).astype(int)
        if (high - low < 8).any():
            return None
        y, x = np.mgrid[low[1] : high[1], low[0] : high[0]].reshape(2, -1) - middle[::-1, None]
        seen = _smooth(picture[low[1] : high[1], low[0] : high[0]].astype(np.float32)).reshape(-1)
        to_cells, offset = np.linalg.inv(to_pixels), np.zeros(2)
        inside = np.abs(to_cells @ np.stack([x, y])).max(axis=0) < USED
        chosen = np.flatnonzero(inside)
        chosen = chosen[:: 1 + len(chosen) // ENOUGH]
        ways, seen = np.stack([x[chosen], y[chosen], np.ones(len(chosen))]), seen[chosen]
        for _ in range(ROUNDS):
            u, v = to_cells @ ways[:2] + offset[:, None]
            column = np.clip((u + CELLS / 2) * FINE, 0, CELLS * FINE - 1).astype(int)
            row = np.clip((v + CELLS / 2) * FINE, 0, CELLS * FINE - 1).astype(int)
            pattern = self._pattern[row, column]
            mean, level = pattern.mean(), seen.mean()
            contrast = float((pattern - mean) @ (seen - level) / ((pattern - mean) @ (pattern - mean)))
            dark = level - contrast * mean
            if contrast < 10:
                return None
            slopes = contrast * np.concatenate([self._right[row, column] * ways, self._down[row, column] * ways])
            slopes = np.concatenate([slopes, pattern[None], np.ones((1, len(seen)))])
            step = np.linalg.lstsq(slopes @ slopes.T, slopes @ (seen - contrast * pattern - dark), rcond=None)[0]
            to_cells = to_cells + step[:6].reshape(2, 3)[:, :2]
            offset = offset + step[:6].reshape(2, 3)[:, 2]
        back = np.linalg.inv(to_cells)
        shift = -back @ offset
        angle = math.atan2(back[1, 0] - back[0, 1], back[0, 0] + back[1, 1])  # of the rotation nearest to the map
        first = math.atan2(to_pixels[1, 0] - to_pixels[0, 1], to_pixels[0, 0] + to_pixels[1, 1])
        moved = np.linalg.norm(shift) / math.sqrt(abs(np.linalg.det(to_pixels)))
        if not (abs(math.remainder(angle - first, 2 * math.pi)) < FAR_RAD and moved < FAR_CELLS):
            return None
        return Place(float(middle[0] + shift[0]), float(middle[1] + shift[1]), -angle)


def _smooth(picture: np.ndarray) -> np.ndarray:
    """Averages over neighbours, 1 4 6 4 1 each way, so that edges along the pixels' rows can be told between them."""
    for axis in (0, 1):
        x = np.moveaxis(np.pad(picture, [(2, 2) if k == axis else (0, 0) for k in (0, 1)], mode="edge"), axis, 0)
        x = (x[:-4] + x[4:]) / 16 + (x[1:-3] + x[3:-1]) / 4 + x[2:-2] * 0.375
        picture = np.moveaxis(x, 0, axis)
    return picture
