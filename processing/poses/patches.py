"""Image patches around points: cut, aligned to a fraction of a pixel; and pictures without what exposure changes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from lfrig.processing.kernels.patches import Alignment, Window, align_patches
from lfrig.processing.model import F32, F64

WINDOW_SIGMA = 0.6
"""Width of a patch's Gaussian weight, as a fraction of its half width."""

ALIGN_HALF_PX = 6
ALIGNMENT = Alignment(shift_passes=2, slant_passes=3, max_step_px=1.5)
NORMALISE_SIGMA_PX = 6.0
SHRINK = 3
EXACT_WIDTHS = range(200, 400)
"""Pictures so wide [px] have few corners, and place views better by 0.01–0.02° where brightness and contrast are
measured in full. Larger ones gain nothing; in smaller ones other errors hide it."""
CONTRAST, LEAST_VARIANCE = 48.0, 9.0
"""Of normalised pictures: their standard deviation; the variance below which it is less."""


@dataclass(frozen=True)
class Patches:
    """Square patches of one image: ``grey``, and its slopes, float32 [N, K]."""

    grey: F32
    slope_x: F32
    slope_y: F32


def sample(picture: F32, x: NDArray[np.floating], y: NDArray[np.floating]) -> F32:
    """Bilinear values of an image float32 [H, W] or [H, W, C] at pixels, any shape [A, B]; the border is replicated."""
    import cv2

    if not x.size:
        return np.zeros((*x.shape, *picture.shape[2:]), np.float32)
    u, v = np.ascontiguousarray(x, np.float32), np.ascontiguousarray(y, np.float32)
    return np.asarray(cv2.remap(picture, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32)


def sample_points(picture: F32, xy: F64) -> F32:
    """Bilinear values at points [N, 2], float32 [N]."""
    return sample(picture, xy[:, :1], xy[:, 1:])[:, 0]


@cache
def square(half: int) -> Window:
    """A patch of (2 half + 1)² pixels with Gaussian weights."""
    g = np.arange(-half, half + 1, dtype=np.float32)
    dx, dy = (np.ascontiguousarray(m.ravel()) for m in np.meshgrid(g, g))
    weight = np.exp(-(dx**2 + dy**2) / (2 * (WINDOW_SIGMA * half) ** 2))
    return Window(dx, dy, np.asarray(weight / weight.sum(), np.float32))


def cut(detail: F32, xy: F64, window: Window) -> Patches:
    """Patches around points [N, 2] of a picture and its slopes float32 [H, W, 4] (`with_slopes`)."""
    patches = sample(detail, xy[:, :1] + window.dx, xy[:, 1:] + window.dy)
    return Patches(*(np.ascontiguousarray(patches[..., channel]) for channel in range(3)))


def normalised(grey: F32) -> NDArray[np.uint8]:
    """The image without local brightness and contrast, uint8 [H, W] around 128: what exposure cannot change.

    Both are so smooth that they are measured in an image a third as wide, but for `EXACT_WIDTHS`.
    """
    import cv2

    height, width = grey.shape
    shrink = 1 if width in EXACT_WIDTHS else SHRINK
    size = max(1, round(width / shrink)), max(1, round(height / shrink))
    mean, square_mean = (
        cv2.GaussianBlur(cv2.resize(p, size, interpolation=cv2.INTER_AREA), (0, 0), NORMALISE_SIGMA_PX / shrink)
        for p in (grey, cv2.multiply(grey, grey))
    )
    gain = CONTRAST / np.sqrt(np.maximum(square_mean - mean * mean, 0) + LEAST_VARIANCE)
    gain, level = (cv2.resize(p, (width, height)) for p in (gain, 128 - mean * gain))
    return np.asarray(cv2.add(cv2.multiply(grey, gain), level, dtype=cv2.CV_8U), np.uint8)


def align(
    first: F32, second: F32, first_xy: F64, second_xy: F64, affine: F64, along: F64, *, threads: int = 1
) -> tuple[F64, F32]:
    """Move points of the second picture so that the patches around them look like those of the first; see
    `align_patches`.

    A slant taken from a light field's depth, whose baseline is a hundred times shorter, is too rough for the second
    decimal: it is refined along with the shift.
    """
    return align_patches(
        first, second, first_xy, second_xy, affine, along, square(ALIGN_HALF_PX), ALIGNMENT, threads=threads
    )
