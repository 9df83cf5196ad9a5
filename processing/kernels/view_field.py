"""The z-buffered disparity field of an output view, on the grid of that view: the NumPy form of ``view_field.cpp``.

Every surface point is carried to the view and the nearest kept (a splat at twice the density); holes grow shut from
the far side; a few rounds of ``g ← d(u + g · offset)`` polish what the splat rounded to pixels. The native form does
that near depth steps only: elsewhere one smooth surface stands before a pixel, and the iteration alone finds it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfrig.processing.model import F32

SUBPIXELS = np.array([(-0.25, -0.25), (-0.25, 0.25), (0.25, -0.25), (0.25, 0.25)], np.float32)


def z_buffered_field(
    disparity: F32, dr: float, dc: float, match_px: float, hidden_px: float, hole_rounds: int = 10_000
) -> tuple[F32, NDArray[np.bool_]]:
    """Disparity on the grid of the output view at offset (dr, dc), and which of its pixels the photo does not show.

    Parameters
    ----------
    disparity : float32 [H, W]
        The centre's [px per view step], finite.
    match_px : float
        The polish keeps the splatted disparity unless it moves less than this.
    hidden_px : float
        A gathered sample this much nearer than the field shows the foreground: the point is disoccluded.
    hole_rounds : int
        See `fill_holes`.

    Returns
    -------
    field : float32 [H, W], hidden : bool [H, W]
    """
    field = fill_holes(splat(disparity, dr, dc), hole_rounds)
    field = fixed_point(disparity, field, dr, dc, 3, match_px)
    sample = gather(disparity, field, dr, dc)
    return field, np.asarray(sample - field > hidden_px)


def splat(disparity: F32, dr: float, dc: float, where: NDArray[np.bool_] | None = None) -> F32:
    """Nearest surface carried to each output pixel, −inf where nothing lands; splatted at twice the density.

    Parameters
    ----------
    where : bool [H, W], optional
        The pixels to carry; by default all.
    """
    import cv2

    height, width = disparity.shape
    if where is None:
        near = cv2.resize(disparity, (2 * width, 2 * height), interpolation=cv2.INTER_NEAREST)
        ys, xs = np.mgrid[0 : 2 * height, 0 : 2 * width].astype(np.float32)
        ys, xs = (ys - 0.5) / 2, (xs - 0.5) / 2
    else:
        ys, xs = (a.astype(np.float32) for a in np.nonzero(where))
        ys, xs = (ys + SUBPIXELS[:, :1]).ravel(), (xs + SUBPIXELS[:, 1:]).ravel()
        near = np.tile(disparity[where], len(SUBPIXELS))
    x = np.rint(xs - np.float32(dc) * near).astype(np.int32)
    y = np.rint(ys - np.float32(dr) * near).astype(np.int32)
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    out = np.full(height * width, -np.inf, np.float32)
    np.maximum.at(out, y[inside] * width + x[inside], near[inside])
    return out.reshape(height, width)


def fill_holes(field: F32, rounds: int) -> F32:
    """Holes grow shut from the far side, a pixel per round: the lowest disparity next to them. What is left after the
    last round takes the median.
    """
    import cv2

    window = np.ones((3, 3), np.uint8)
    for _ in range(rounds):
        hole = np.isneginf(field)
        if not hole.any():
            return field
        lowest = cv2.erode(np.where(hole, np.float32(1e9), field), window)
        field = np.where(hole & (lowest < 1e8), lowest, field).astype(np.float32)
    hole = np.isneginf(field)
    if hole.any():
        known = field[~hole]
        field[hole] = np.median(known) if known.size else 0.0
    return field


def gather(disparity: F32, field: F32, dr: float, dc: float) -> F32:
    """The centre's disparity, float32 [H, W], where ``field`` says that each pixel of the view at (dr, dc) lies."""
    import cv2

    ys, xs = np.mgrid[0 : field.shape[0], 0 : field.shape[1]].astype(np.float32)
    x, y = xs + np.float32(dc) * field, ys + np.float32(dr) * field
    return np.asarray(cv2.remap(disparity, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


def fixed_point(disparity: F32, field: F32, dr: float, dc: float, rounds: int, limit: float) -> F32:
    """``g ← d(u + g·offset)``, as long as it moves less than ``limit``: sub-pixel polish on smooth surfaces."""
    for _ in range(rounds):
        sample = gather(disparity, field, dr, dc)
        field = np.where(np.abs(sample - field) < limit, sample, field).astype(np.float32)
    return field
