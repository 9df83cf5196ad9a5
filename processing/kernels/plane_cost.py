"""Photo-consistency sweep: how well all views of a light field agree at each disparity plane.

``cost[y, x, k]`` = mean over views of ``min(|I_v(y − dr δ_k, x − dc δ_k) − I_centre(y, x)|, truncation)``, bilinear,
then a 3×3 box. Both forms work on grey × 64; the C++ one (``plane_cost.cpp``) in 16-bit fixed point, so they agree to
about 1/16 grey level.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.native import load_native
from lfrig.contracts.progress import Monitor
from lfrig.processing.kernels.grey import SCALE, GreyViews
from lfrig.processing.model import F32

I16 = NDArray[np.int16]
U16 = NDArray[np.uint16]
Mask = NDArray[np.bool_]

COST_UNIT = 128
"""Fixed-point units of a cost per grey level."""
TILE = 8
"""Side [px] of the squares that a span of planes is given for."""
MARGIN = 3
"""Pixels that the sweep reads beyond the furthest shift."""


@dataclass(frozen=True)
class PlaneGrid:
    """Disparity planes ``first + step·k``, k < ``count`` [px per view step]."""

    first: float
    step: float
    count: int

    @property
    def furthest(self) -> float:
        """The largest absolute disparity."""
        return max(abs(self.first), abs(self.first + self.step * (self.count - 1)))

    def values(self) -> F32:
        """All disparities, float32 [count]."""
        return np.asarray(self.first + self.step * np.arange(self.count), np.float32)


@dataclass(frozen=True)
class Halves:
    """Where the best half of the aperture (left, right, upper, lower) may take the place of all views.

    ``edges`` bool [H, W]; ``bias_grey`` is what a half must be better by.
    """

    edges: Mask
    bias_grey: float


def plane_cost(
    views: GreyViews,
    grid: PlaneGrid,
    truncation: float,
    *,
    chosen: NDArray[np.int32] | None = None,
    span: I16 | None = None,
    halves: Halves | None = None,
    out: U16 | None = None,
    threads: int = 0,
    monitor: Monitor | None = None,
    plain: bool = False,
) -> U16:
    """Matching cost of every pixel at every plane.

    Parameters
    ----------
    views : GreyViews
        With a margin of at least ``views.reach_px(grid.furthest) + MARGIN``.
    truncation : float
        Cap of the absolute difference [grey levels].
    chosen : int32 [n], optional
        Indices of the views to compare with the centre; all others by default.
    span : int16 [ceil(H/8), ceil(W/8), 2], optional
        First and one-past-last plane that is wanted in each tile of 8×8 pixels. Other planes are unspecified: 0, or
        their cost where a neighbouring tile wants them.
    halves : Halves, optional
    out : uint16 [H, W, D], optional
        What costs are known to be: lowered in place where ``halves`` says so; nothing else is computed.
    plain : bool
        Keep to the form that runs on every machine (for tests: the bits are the same).

    Returns
    -------
    uint16 [H, W, D], `COST_UNIT` per grey level. The same bits for any thread count.
    """
    if views.reach_px(grid.furthest) > views.pad - MARGIN + 1:
        raise ValueError(f"a margin of {views.pad} px does not hold disparity {grid.furthest:g}")
    used = views.others() if chosen is None else np.ascontiguousarray(chosen, np.int32)
    cap = max(1, round(truncation * SCALE))
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        return _plane_cost_numpy(views, grid, cap, used, halves, out, monitor)
    fresh = np.zeros((views.height, views.width, grid.count), np.uint16) if out is None else out
    edges = np.zeros((0, 0), np.uint8) if halves is None else np.ascontiguousarray(halves.edges, np.uint8)
    native.plane_cost(
        views.padded, views.centre, np.ascontiguousarray(views.offsets, np.float32), used,
        np.zeros((0, 0, 0), np.int16) if span is None else np.ascontiguousarray(span, np.int16),
        edges, out is not None, views.pad, grid.first, grid.step, cap, COST_UNIT,
        0 if halves is None else round(halves.bias_grey * COST_UNIT), fresh, threads, plain,
    )  # fmt: skip
    return fresh


def _plane_cost_numpy(
    views: GreyViews,
    grid: PlaneGrid,
    cap: int,
    chosen: NDArray[np.int32],
    halves: Halves | None,
    out: U16 | None,
    monitor: Monitor | None,
) -> U16:
    cost = mean_cost_numpy(views, grid, cap, chosen, monitor)
    if halves is not None:
        offsets = views.offsets[chosen]
        parts = [offsets[:, 0] < 0, offsets[:, 0] > 0, offsets[:, 1] < 0, offsets[:, 1] > 0]
        if not all(part.any() for part in parts):
            raise ValueError("half of the aperture has no view")
        best = np.min([mean_cost_numpy(views, grid, cap, chosen[part], monitor) for part in parts], axis=0)
        best += np.float32(halves.bias_grey * COST_UNIT)
        cost[halves.edges] = np.minimum(cost, best)[halves.edges]
    fresh = np.asarray(np.rint(cost), np.uint16)
    if out is None:
        return fresh
    if halves is not None:
        out[halves.edges] = np.minimum(out, fresh)[halves.edges]
    return out


def mean_cost_numpy(
    views: GreyViews, grid: PlaneGrid, cap: int, chosen: NDArray[np.int32], monitor: Monitor | None = None
) -> F32:
    """NumPy/OpenCV twin, one plane after the other: float32 [H, W, D], `COST_UNIT` per grey level."""
    import cv2

    source = views.padded[chosen].astype(np.float32)
    centre = views.images[views.centre].astype(np.float32)
    out = np.empty((grid.count, *centre.shape), np.float32)
    for k in range(grid.count):
        disparity = grid.first + grid.step * k
        total = np.zeros_like(centre)
        for view, (dr, dc) in zip(source, views.offsets[chosen], strict=True):
            sample = _shifted(view, -dr * disparity, -dc * disparity, views.pad, *centre.shape)
            cv2.add(total, np.minimum(cv2.absdiff(sample, centre), np.float32(cap)), total)
        cv2.blur(total, (3, 3), out[k], borderType=cv2.BORDER_REPLICATE)
        if monitor:
            monitor.advance(0)
    out *= np.float32(COST_UNIT / (len(chosen) * SCALE))
    return np.ascontiguousarray(np.moveaxis(out, 0, 2))


def _shifted(view: F32, dy: float, dx: float, pad: int, height: int, width: int) -> F32:
    """View translated by a constant sub-pixel shift: float32 [H, W] sampled at (y + dy, x + dx)."""
    import cv2

    iy, ix = int(np.floor(dy)), int(np.floor(dx))
    fy, fx = dy - iy, dx - ix
    block = view[pad + iy : pad + iy + height + 1, pad + ix : pad + ix + width + 1]
    rows = cv2.addWeighted(block[:-1], 1 - fy, block[1:], fy, 0)
    return np.asarray(cv2.addWeighted(rows[:, :-1], 1 - fx, rows[:, 1:], fx, 0))
