"""Photo-consistency sweep: how well all views of a light field agree at each disparity plane.

``cost[y, x, k]`` = mean over views of ``min(|I_v(y − dr δ_k, x − dc δ_k) − I_centre(y, x)|, truncation)``, bilinear,
then a 3×3 box; grey levels of 0..255. Both forms work on grey × 64; the C++ one (``plane_cost.cpp``) in 16-bit fixed
point, so they agree to about 1/16 grey level.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.native import load_native
from lfrig.contracts.progress import Monitor
from lfrig.processing.model import F32, F64, U8

SCALE = 64
"""Fixed-point units per grey level."""
BLOCK = 64
"""Pixels of a row that the native form computes or skips together."""


def grey_views(views: U8) -> NDArray[np.int16]:
    """Luma (Rec. 601) × 64 of RGB views: uint8 [..., H, W, 3] → int16 [V, H, W]."""
    import cv2

    flat = views.reshape(-1, *views.shape[-3:])
    out = np.empty(flat.shape[:3], np.int16)
    weights = np.array([[0.299, 0.587, 0.114]], np.float32) * SCALE
    for i, view in enumerate(flat):
        # one matrix product keeps the fraction that an 8-bit grey conversion would round away
        out[i] = np.rint(cv2.transform(view.astype(np.float32), weights))
    return out


def plane_cost(
    grey: NDArray[np.int16],
    centre: NDArray[np.int16],
    offsets: F64,
    first: float,
    step: float,
    planes: int,
    truncation: float,
    *,
    active: NDArray[np.bool_] | None = None,
    threads: int = 0,
    monitor: Monitor | None = None,
) -> F32:
    """Sweep ``planes`` disparities ``first + step·k`` [px per view step].

    Parameters
    ----------
    grey : int16 [V, H, W]
        Views (without the centre), grey × 64.
    centre : int16 [H, W]
    offsets : float64 [V, 2]
        (dr, dc) of each view in view steps.
    truncation : float
        Cap of the absolute difference [grey levels].
    active : bool [H, W], optional
        Where the cost is wanted; elsewhere it is unspecified (0 or right), and not paid for by the native form.

    Returns
    -------
    float32 [H, W, planes], grey levels.
    """
    furthest = max(abs(first), abs(first + step * (planes - 1))) * float(np.abs(offsets).max())
    pad = int(np.ceil(furthest)) + 3
    padded = np.pad(grey, ((0, 0), (pad, pad), (pad, pad)), mode="edge")
    padded_centre = np.pad(centre, pad, mode="edge")
    cap = max(1, round(truncation * SCALE))
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        return plane_cost_numpy(padded, padded_centre, offsets, pad, first, step, planes, cap, monitor)
    out = np.zeros((*centre.shape, planes), np.float32)
    native.plane_cost(
        padded, padded_centre, np.ascontiguousarray(offsets, np.float32), _blocks(active, centre.shape), pad, first,
        step, cap, out, threads,
    )  # fmt: skip
    return out


def _blocks(active: NDArray[np.bool_] | None, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """Which blocks of 64 pixels the native form must compute, uint8 [H, ceil(W/64)]; one pixel more for the box."""
    import cv2

    height, width = shape
    count = -(-width // BLOCK)
    if active is None:
        return np.ones((height, count), np.uint8)
    grown = np.zeros((height, count * BLOCK), np.uint8)
    grown[:, :width] = cv2.dilate(active.astype(np.uint8), np.ones((3, 3), np.uint8))
    return np.ascontiguousarray(grown.reshape(height, count, BLOCK).max(2))


def plane_cost_numpy(
    padded: NDArray[np.int16],
    padded_centre: NDArray[np.int16],
    offsets: F64,
    pad: int,
    first: float,
    step: float,
    planes: int,
    cap: int,
    monitor: Monitor | None = None,
) -> F32:
    """NumPy/OpenCV twin on padded views, int16 [V, H+2p, W+2p]."""
    import cv2

    height, width = padded.shape[1] - 2 * pad, padded.shape[2] - 2 * pad
    source = padded.astype(np.float32)
    centre = padded_centre[pad : pad + height, pad : pad + width].astype(np.float32)
    out = np.empty((planes, height, width), np.float32)
    for k in range(planes):
        total = np.zeros((height, width), np.float32)
        for view, (dr, dc) in zip(source, offsets, strict=True):
            sample = _shifted(view, -dr * (first + step * k), -dc * (first + step * k), pad, height, width)
            cv2.add(total, np.minimum(cv2.absdiff(sample, centre), np.float32(cap)), total)
        cv2.blur(total, (3, 3), out[k], borderType=cv2.BORDER_REPLICATE)
        if monitor:
            monitor.advance(0)
    out *= np.float32(1.0 / (len(offsets) * SCALE))
    return np.ascontiguousarray(np.moveaxis(out, 0, 2))


def _shifted(view: F32, dy: float, dx: float, pad: int, height: int, width: int) -> F32:
    """View translated by a constant sub-pixel shift: float32 [H, W] sampled at (y + dy, x + dx)."""
    import cv2

    iy, ix = int(np.floor(dy)), int(np.floor(dx))
    fy, fx = dy - iy, dx - ix
    block = view[pad + iy : pad + iy + height + 1, pad + ix : pad + ix + width + 1]
    rows = cv2.addWeighted(block[:-1], 1 - fy, block[1:], fy, 0)
    return np.asarray(cv2.addWeighted(rows[:, :-1], 1 - fx, rows[:, 1:], fx, 0))
