"""Where a source's volume holds any mass, and how near its surface comes, tile by tile.

Both answer questions about a box of pixels and planes without looking at its voxels: is there any mass in it (eight
look-ups in a summed-area table, after Crow 1984), and does the source's own surface pass in front of it (windows of
2 × 2 tiles, up to four of which cover a box). C++ form: ``occupancy.cpp``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.native import load_native
from lfrig.processing.model import F32

TILE_PX = 8
I32 = NDArray[np.int32]


@dataclass(frozen=True)
class Occupancy:
    """Tables of one source, for tiles of `TILE_PX` square.

    ``sums`` int32 [rows + 1, columns + 1, D + 1]: how many cells (tile, plane) before that row, column and plane hold a
    probability above the level. ``least``, ``greatest`` float32 [rows, columns]: of the disparities [px per view
    step] in this tile and its neighbours to the right and below; −inf where a pixel has none.
    """

    sums: I32
    least: F32
    greatest: F32


def occupancy(probability: NDArray[np.uint16], disparity: F32, level: int, *, threads: int = 0) -> Occupancy:
    """Tables of ``probability`` uint16 [H, W, D] (mass above ``level``) and ``disparity`` float32 [H, W]."""
    rows, columns = (-(-n // TILE_PX) for n in disparity.shape)
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        return Occupancy(_sums_numpy(probability, level), *_extremes_numpy(disparity))
    sums = np.empty((rows + 1, columns + 1, probability.shape[2] + 1), np.int32)
    least, greatest = np.empty((rows, columns), np.float32), np.empty((rows, columns), np.float32)
    native.sum_occupied(probability, level, TILE_PX, sums, threads)
    native.extremes(np.ascontiguousarray(disparity), TILE_PX, least, greatest)
    return Occupancy(sums, least, greatest)


def _sums_numpy(probability: NDArray[np.uint16], level: int) -> I32:
    """NumPy twin of the summed-area table."""
    starts = [np.arange(0, n, TILE_PX) for n in probability.shape[:2]]
    most = np.maximum.reduceat(np.maximum.reduceat(probability, starts[0], axis=0), starts[1], axis=1)
    occupied = (most > level).astype(np.int32)
    return np.asarray(np.pad(occupied, ((1, 0),) * 3).cumsum(0).cumsum(1).cumsum(2), np.int32)


def _extremes_numpy(disparity: F32) -> tuple[F32, F32]:
    """NumPy twin of the extremes in windows of 2 × 2 tiles."""
    known = np.where(np.isnan(disparity), np.float32(-np.inf), disparity)
    found = []
    for reduce in (np.minimum, np.maximum):
        tiles = known
        for axis in (0, 1):
            tiles = reduce.reduceat(tiles, np.arange(0, tiles.shape[axis], TILE_PX), axis=axis)
            last = tiles.take([-1], axis)
            tiles = reduce(tiles, np.concatenate([tiles, last], axis).take(np.arange(1, tiles.shape[axis] + 1), axis))
        found.append(np.asarray(tiles, np.float32))
    return found[0], found[1]
