"""Grey views of a light field, with the margin that a sweep over disparities reads. C++ form: ``grey.cpp``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.native import load_native
from lfrig.processing.model import F32, F64, U8

I16 = NDArray[np.int16]
SCALE = 64
"""Fixed-point units per grey level: 255 fits 15 bits, and luma keeps a fraction that 8 bits would round away."""
SPARE = 32
"""Pixels to the right of and below the margin: the sweep reads whole blocks."""


@dataclass(frozen=True)
class GreyViews:
    """All views of a light field in grey, each with a margin of repeated border pixels.

    ``padded`` int16 [V, rows, stride], grey × 64, the image [height, width] at (pad, pad); ``offsets`` float64 [V, 2],
    (dr, dc) of each view from the centre view in view steps; ``centre`` the centre view's index.
    """

    padded: I16
    offsets: F64
    centre: int
    pad: int
    height: int
    width: int

    @property
    def images(self) -> I16:
        """The views without their margin, int16 [V, H, W]; not a copy."""
        inside = slice(self.pad, self.pad + self.height), slice(self.pad, self.pad + self.width)
        return self.padded[:, *inside]

    def others(self) -> NDArray[np.int32]:
        """Indices of all views but the centre."""
        return np.delete(np.arange(len(self.padded), dtype=np.int32), self.centre)

    def cross(self) -> NDArray[np.int32]:
        """Indices of the views in the centre's row and column of the array, without the centre."""
        every = self.others()
        return every[(np.abs(self.offsets[every]) < 1e-6).any(1)]

    def star(self) -> NDArray[np.int32]:
        """Indices of the views in the centre's row, column and diagonals of the array, without the centre."""
        every = self.others()
        down, across = np.abs(self.offsets[every]).T
        on_it = (down < 1e-6) | (across < 1e-6) | (np.abs(down - across) < 1e-6)
        return np.asarray(every[on_it], np.int32)

    def reach_px(self, disparity: float) -> float:
        """How far any view's pixels move at a disparity [px per view step]."""
        return abs(disparity) * float(np.abs(self.offsets).max(initial=0.0))


def padded_shape(count: int, height: int, width: int, pad: int) -> tuple[int, int, int]:
    """[V, rows, stride] of views with their margin; rows start at multiples of 64 bytes."""
    return count, height + 2 * pad + SPARE, -(-(width + 2 * pad + SPARE) // 32) * 32


def grey_views(views: U8, offsets: F64, centre: int, pad: int, *, threads: int = 0) -> GreyViews:
    """Luma (Rec. 601) × 64 of RGB views.

    Parameters
    ----------
    views : uint8 [V, H, W, 3]
    offsets : float64 [V, 2]
    centre : int
        Index of the centre view.
    pad : int
        Width of the margin [px].
    """
    count, height, width, _ = views.shape
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        return GreyViews(with_margin(grey_numpy(views), pad), offsets, centre, pad, height, width)
    out = np.empty(padded_shape(count, height, width, pad), np.int16)
    native.grey_views(np.ascontiguousarray(views), pad, out, threads)
    return GreyViews(out, offsets, centre, pad, height, width)


def halved(views: GreyViews, pad: int, *, threads: int = 0) -> GreyViews:
    """The views at half size, each pixel the mean of four; an odd last row or column is left out."""
    height, width = max(1, views.height // 2), max(1, views.width // 2)
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        out = with_margin(halve_numpy(views, height, width), pad)
    else:
        out = np.empty(padded_shape(len(views.padded), height, width, pad), np.int16)
        native.halve_views(views.padded, views.pad, views.height, views.width, pad, out, threads)
    return GreyViews(out, views.offsets, views.centre, pad, height, width)


def grey_numpy(views: U8) -> I16:
    """NumPy twin of `grey_views`, without the margin: the same bits."""
    weights = np.array([19595, 38470, 7471], np.int32)  # Rec. 601 × 64 in 1/1024: they sum to 65536
    out = np.empty(views.shape[:3], np.int16)
    for view, grey in zip(views, out, strict=True):
        grey[...] = (view.astype(np.int32) @ weights + 512) >> 10
    return out


def halve_numpy(views: GreyViews, height: int, width: int) -> I16:
    """NumPy twin of `halved`, without the margin: the same bits."""
    p = views.pad
    block = views.padded[:, p : p + 2 * height, p : p + 2 * width].astype(np.int32)
    sums = block[:, ::2, ::2] + block[:, ::2, 1::2] + block[:, 1::2, ::2] + block[:, 1::2, 1::2]
    return np.asarray((sums + 2) >> 2, np.int16)


def with_margin(images: I16, pad: int) -> I16:
    """Images int16 [V, H, W] with their border repeated around them: [V, rows, stride]."""
    count, height, width = images.shape
    _, rows, stride = padded_shape(count, height, width, pad)
    margin = ((0, 0), (pad, rows - height - pad), (pad, stride - width - pad))
    return np.pad(images, margin, mode="edge")


def as_grey(image: I16) -> F32:
    """Grey levels float32 of grey × 64."""
    return np.asarray(image * np.float32(1 / SCALE), np.float32)
