"""The parallax path of animations: viewpoints on a circle in the aperture, and the picture seen from each."""

from __future__ import annotations

import numpy as np

from lfrig.processing.export.content import Content
from lfrig.processing.export.png import to_8_bit
from lfrig.processing.model import F32, F64, U8
from lfrig.processing.nearest import Nearest

ITERATIONS = 5
"""Of the fixed point below: it contracts by the slope of the disparity times the step, a few tenths at most."""


def circle(angular: tuple[int, int], frames: int) -> F64:
    """Viewpoints (row, col) as offsets from the centre [view steps], float64 [frames, 2], on the inscribed ellipse."""
    rows, cols = angular
    angle = 2 * np.pi * np.arange(frames) / frames
    return np.stack([np.sin(angle) * (rows - 1) / 2, np.cos(angle) * (cols - 1) / 2], -1)


class Sweep:
    """Pictures from anywhere inside the aperture of a light field.

    With a disparity map a viewpoint between views blends its four neighbours, each shifted along the disparity, so
    that motion is smooth and edges stay sharp; without one the nearest view is shown as it is.
    """

    def __init__(self, content: Content, size: tuple[int, int] | None = None) -> None:
        """``size`` (width, height) resamples the pictures [px]."""
        self.views: U8 = to_8_bit(content.views)
        self.disparity = None if content.disparity is None else fill_unknown(content.disparity)
        self.size = size

    def picture(self, row: float, col: float) -> U8:
        """uint8 [H, W, 3] RGB as seen from ``row``, ``col`` view steps away from the centre."""
        import cv2

        rows, cols = self.views.shape[:2]
        r, c = row + (rows - 1) / 2, col + (cols - 1) / 2
        if self.disparity is None:
            image = self.views[min(rows - 1, max(0, round(r))), min(cols - 1, max(0, round(c)))]
        else:
            image = self._between(r, c, disparity_at(self.disparity, row, col))
        if self.size is not None and self.size != (image.shape[1], image.shape[0]):
            image = cv2.resize(image, self.size, interpolation=cv2.INTER_AREA).astype(np.uint8)
        return np.ascontiguousarray(image)

    def _between(self, r: float, c: float, disparity: F32) -> U8:
        import cv2

        rows, cols, height, width = self.views.shape[:4]
        ys, xs = np.mgrid[:height, :width].astype(np.float32)
        total = np.zeros((height, width, 3), np.float32)
        r0, c0 = min(int(r), rows - 2), min(int(c), cols - 2)
        for i, j in ((r0, c0), (r0, c0 + 1), (r0 + 1, c0), (r0 + 1, c0 + 1)):
            weight = (1 - abs(r - i)) * (1 - abs(c - j))
            if weight > 1e-6:
                # A point at p here is at p + (here − there) · δ in the view there.
                x, y = xs + np.float32(c - j) * disparity, ys + np.float32(r - i) * disparity
                there = cv2.remap(self.views[i, j], x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
                total += np.float32(weight) * there
        return np.rint(total).astype(np.uint8)


def disparity_at(centre: F32, row: float, col: float) -> F32:
    """The disparity map seen from (row, col) view steps off the centre: δ(p) = centre(p + step · δ), float32 [H, W]."""
    import cv2

    height, width = centre.shape
    ys, xs = np.mgrid[:height, :width].astype(np.float32)
    field = centre
    for _ in range(ITERATIONS):
        x, y = xs + np.float32(col) * field, ys + np.float32(row) * field
        field = cv2.remap(centre, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(np.float32)
    return field


def fill_unknown(disparity: F32) -> F32:
    """NaN replaced by the nearest known value (0 when nothing is known), float32 [H, W]."""
    unknown = ~np.isfinite(disparity)
    if not unknown.any():
        return disparity
    if unknown.all():
        return np.zeros_like(disparity)
    return Nearest.of(~unknown).look_up(disparity)
