"""Where the points of a surface lie in a source, and how much nearer the source's own surface is there.

C++ form: ``landing.cpp``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.native import load_native
from lfrig.processing.geometry import project
from lfrig.processing.model import F32, F64, ScaleFit

Mask = NDArray[np.bool_]
FAR_OUTSIDE = -9e3
"""Pixel coordinate of what is not in front of a source."""
SANE = 1e9


@dataclass(frozen=True)
class Way:
    """Into one source: ``projection`` (A, b), float64 [3, 3] and [3], of pixels (`geometry.projection`); ``size``
    (height, width) of its frame; its own ``disparity`` float32 [Hs, Ws] px per view step, and the ``scale`` of that.
    """

    projection: tuple[F64, F64]
    size: tuple[int, int]
    disparity: F32
    scale: ScaleFit


def packed(ways: Sequence[Way]) -> tuple[list[F32], list[F32]]:
    """As kernels take them (ways.hpp): disparity maps, and float32 [16] each: A row by row, b, a, c, height, width."""
    numbers = [
        np.r_[way.projection[0].ravel(), way.projection[1], way.scale.a, way.scale.c, way.size].astype(np.float32)
        for way in ways
    ]
    return [np.ascontiguousarray(way.disparity, np.float32) for way in ways], numbers


def landing(inverse_depth: F32, way: Way, *, threads: int = 0) -> tuple[F32, F32, Mask, F32]:
    """Carry a surface into a source.

    Parameters
    ----------
    inverse_depth : float32 [H, W], 1/m

    Returns
    -------
    u, v : float32 [H, W]
        Pixel in the source, `FAR_OUTSIDE` for points that are not in front of it.
    inside : bool [H, W]
        Within its frame.
    ahead : float32 [H, W]
        How much nearer the source's own surface is at the nearest pixel [px per view step]; beyond the frame that of
        its rim.
    """
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        height, width = inverse_depth.shape
        ys, xs = np.mgrid[0:height, 0:width].astype(np.float32)
        return land_points(way, xs, ys, inverse_depth)
    u, v, ahead = (np.empty(inverse_depth.shape, np.float32) for _ in range(3))
    inside = np.empty(inverse_depth.shape, np.uint8)
    native.landing(np.ascontiguousarray(inverse_depth, np.float32), *packed([way]), u, v, ahead, inside, threads)
    return u, v, inside.view(np.bool_), ahead


def land_points(way: Way, x: F32, y: F32, inverse_depth: F32) -> tuple[F32, F32, Mask, F32]:
    """NumPy twin, for any points (x, y) of one shape."""
    with np.errstate(over="ignore", invalid="ignore"):
        u, v, w = project(*way.projection, x, y, inverse_depth)
        front = (np.abs(u) < SANE) & (np.abs(v) < SANE)
    u, v = (np.where(front, part, np.float32(FAR_OUTSIDE)) for part in (u, v))
    inside = (u >= 0) & (v >= 0) & (u <= way.size[1] - 1) & (v <= way.size[0] - 1)
    height, width = way.disparity.shape
    iu, iv = (np.rint(np.clip(part, 0, most - 1)).astype(np.int64) for part, most in ((u, width), (v, height)))
    ahead = way.disparity[iv, iu] - way.scale.disparity(np.where(front, w, np.float32(0)))
    return u, v, np.asarray(inside), np.asarray(ahead, np.float32)
