"""Pictures of the robot's tip: one AprilTag of the family tag36h11, turned as the tip is."""

from __future__ import annotations

import math

import numpy as np

from ljjax.rig.refine import CELLS, bitmap, blurred

DARK, LIGHT, BACKGROUND = 25.0, 225.0, 110.0
LENS_PX = 0.6
"""Standard deviation of what lens and pixel blur [px]."""
_FINE = 40


class TagPainter:
    """Draws the tag into pictures of the camera.

    Args:
        width, height: of a picture [px].
        cell_px: size of one of the tag's cells [px].
        noise: standard deviation of the pictures' noise, of 255.
    """

    def __init__(self, width: int = 640, height: int = 400, cell_px: float = 5.0, noise: float = 2.0, seed: int = 0):
        self.width, self.height, self.cell_px = width, height, cell_px
        self._texture = DARK + (LIGHT - DARK) * blurred(bitmap(), _FINE, LENS_PX / cell_px)
        rng = np.random.default_rng(seed)
        self._grounds = [BACKGROUND + noise * rng.standard_normal((height, width)) for _ in range(4)]
        self._grounds = [np.clip(x, 0, 255).astype(np.uint8) for x in self._grounds]
        self._speckle = [noise * rng.standard_normal((height, width)).astype(np.float32) for _ in range(4)]
        self._count = 0

    def paint(self, x_px: float, y_px: float, angle: float) -> np.ndarray:
        """A picture (height, width) uint8 with the tag's middle at a place, turned counter-clockwise [rad]."""
        picture = self.blank()
        reach = math.ceil(CELLS / 2 * self.cell_px * math.sqrt(2)) + 1
        left, right = max(0, math.floor(x_px) - reach), min(self.width, math.ceil(x_px) + reach + 1)
        top, bottom = max(0, math.floor(y_px) - reach), min(self.height, math.ceil(y_px) + reach + 1)
        if left >= right or top >= bottom:
            return picture
        x = np.arange(left, right) - x_px
        y = np.arange(top, bottom)[:, None] - y_px
        scale = _FINE / self.cell_px
        middle = CELLS * _FINE / 2
        u = np.floor((x * math.cos(angle) - y * math.sin(angle)) * scale + middle).astype(int)
        v = np.floor((x * math.sin(angle) + y * math.cos(angle)) * scale + middle).astype(int)
        size = self._texture.shape[0]
        inside = (u >= 0) & (u < size) & (v >= 0) & (v < size)
        seen = self._texture[np.where(inside, v, 0), np.where(inside, u, 0)]
        seen = seen + self._speckle[self._count % 4][top:bottom, left:right]
        place = picture[top:bottom, left:right]
        place[inside] = np.clip(seen, 0, 255).astype(np.uint8)[inside]
        return picture

    def blank(self) -> np.ndarray:
        """A picture without the tag."""
        self._count += 1
        return self._grounds[self._count % 4].copy()


class View:
    """Where the camera sees the tip of a body that hangs from the picture's top, the left tendon at the right.

    Args:
        segments, half_length_m: the body.
        width, height: of a picture [px].
    """

    def __init__(self, segments: int, half_length_m: float, width: int = 640, height: int = 400):
        self._half = half_length_m
        self._base = width / 2, 0.1 * height
        self._scale = 0.7 * height / (2 * segments * half_length_m)

    def tip(self, joints: tuple[float, ...]) -> tuple[float, float, float]:
        """x and y [px] and the angle counter-clockwise [rad] of the tip, for joint angles [rad]."""
        x = z = psi = 0.0
        for q in joints:
            x, z = x + self._half * math.sin(psi), z + self._half * math.cos(psi)
            psi += q
            x, z = x + self._half * math.sin(psi), z + self._half * math.cos(psi)
        return self._base[0] + self._scale * x, self._base[1] + self._scale * z, psi
