"""Planes that spread from seeds along shortest paths, as far as they do not float before what a source sees.

Dijkstra's algorithm from all seeds at once. Lengths are whole numbers and of equal paths that of the first seed counts,
so the result does not depend on the order of the visits. C++ form: ``spread.cpp``.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.native import load_native
from lfrig.processing.kernels.landing import Mask, Way, land_points, packed
from lfrig.processing.model import F32, U8

I32 = NDArray[np.int32]

STRAIGHT, DIAGONAL = 70, 99
"""Lengths of the steps to a pixel's neighbours; 99 / 70 is √2 to 7e-5."""


@dataclass(frozen=True)
class Seeds:
    """Planes of M pixels: ``x``, ``y`` int [M]; ``value``, ``slope_x``, ``slope_y`` (per px) float32 [M]."""

    x: NDArray[np.integer]
    y: NDArray[np.integer]
    value: F32
    slope_x: F32
    slope_y: F32

    def at(self, seed: NDArray[np.integer], x: NDArray[np.integer], y: NDArray[np.integer], reach: float) -> F32:
        """Values of the planes number ``seed`` at (x, y); slopes are followed up to ``reach`` px."""
        dx, dy = (x - self.x[seed]).astype(np.float32), (y - self.y[seed]).astype(np.float32)
        away = np.maximum(np.sqrt(dx * dx + dy * dy), np.float32(1))
        rise = (self.slope_x[seed] * dx + self.slope_y[seed] * dy) * np.minimum(1, np.float32(reach) / away)
        return np.asarray(self.value[seed] + rise, np.float32)


def spread(
    seeds: Seeds,
    domain: Mask,
    guide: U8,
    ways: Sequence[Way],
    *,
    step_grey: float,
    reach: float,
    most_ahead: float,
    longest: int,
) -> I32:
    """Which seed's plane each pixel of a domain takes over.

    Parameters
    ----------
    domain : bool [H, W]
        Where paths may run; they begin at the seeds, which may lie beside it.
    guide : uint8 [H, W, 3]
    ways : Sequence[Way]
        Into the sources.
    step_grey : float
        Sum of the absolute RGB differences that makes a step twice as long; whole numbers.
    reach : float
        Distance up to which slopes are followed [px].
    most_ahead : float
        How far a plane may lie before what a source sees [px per view step]; where it lies farther the path ends.
    longest : int
        Steps of the longest path.

    Returns
    -------
    int32 [H, W], the number of the seed; −1 where none arrives.
    """
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        return spread_numpy(seeds, domain, guide, ways, step_grey, reach, most_ahead, longest)
    out = np.empty(domain.shape, np.int32)
    native.spread(
        np.ascontiguousarray(domain).view(np.uint8), np.ascontiguousarray(guide),
        np.ascontiguousarray(np.c_[seeds.x, seeds.y], np.int32),
        np.ascontiguousarray(np.c_[seeds.value, seeds.slope_x, seeds.slope_y], np.float32),
        *packed(ways), STRAIGHT, DIAGONAL, max(1, round(step_grey)), reach, most_ahead, longest, out,
    )  # fmt: skip
    return out


def spread_numpy(
    seeds: Seeds,
    domain: Mask,
    guide: U8,
    ways: Sequence[Way],
    step_grey: float,
    reach: float,
    most_ahead: float,
    longest: int,
) -> I32:
    """NumPy twin."""
    height, width = domain.shape
    if ((seeds.x < 0) | (seeds.x >= width) | (seeds.y < 0) | (seeds.y >= height)).any():
        raise ValueError("spread: a seed lies outside the map")
    colour = guide.astype(np.int64)
    found = np.full(domain.shape, -1, np.int32)
    length = np.full(domain.shape, np.iinfo(np.int32).max, np.int64)
    steps = np.zeros(domain.shape, np.int64)
    numbers = np.arange(len(seeds.x), dtype=np.int32)
    found[seeds.y, seeds.x], length[seeds.y, seeds.x] = numbers, 0
    open_ = [(0, int(i), int(y) * width + int(x)) for i, x, y in zip(numbers, seeds.x, seeds.y, strict=True)]
    heapq.heapify(open_)
    dy, dx = (part.ravel() for part in np.mgrid[-1:2, -1:2])
    stretch = np.where((dx != 0) & (dy != 0), DIAGONAL, STRAIGHT)
    while open_:
        reached, seed, pixel = heapq.heappop(open_)
        y0, x0 = divmod(pixel, width)
        if reached != length[y0, x0] or seed != found[y0, x0] or steps[y0, x0] >= longest:
            continue
        y, x = y0 + dy, x0 + dx
        near = (y >= 0) & (y < height) & (x >= 0) & (x < width)
        near[near] = domain[y[near], x[near]]
        y, x = y[near], x[near]
        rough = max(1, round(step_grey)) + np.abs(colour[y, x] - colour[y0, x0]).sum(1)
        proposed = reached + stretch[near] * rough
        better = (proposed < length[y, x]) | ((proposed == length[y, x]) & (seed < found[y, x]))
        y, x, proposed = y[better], x[better], proposed[better]
        value = seeds.at(np.full(len(x), seed), x, y, reach)
        free = ~_floats(ways, x, y, value, most_ahead)
        y, x, proposed = y[free], x[free], proposed[free]
        length[y, x], found[y, x], steps[y, x] = proposed, seed, steps[y0, x0] + 1
        for entry in zip(proposed.tolist(), [seed] * len(x), (y * width + x).tolist(), strict=True):
            heapq.heappush(open_, entry)
    return found


def _floats(
    ways: Sequence[Way], x: NDArray[np.integer], y: NDArray[np.integer], inverse_depth: F32, most_ahead: float
) -> Mask:
    """Whether points [M] lie farther before the surface that any source sees there."""
    floats = np.zeros(len(x), bool)
    for way in ways:
        _, _, inside, ahead = land_points(way, x.astype(np.float32), y.astype(np.float32), inverse_depth)
        floats |= inside & (-ahead > np.float32(most_ahead))
    return floats
