"""Corners followed through the views of a light field, by one disparity each.

Gauss–Newton with the disparity as the only unknown (Lucas & Kanade 1981). C++ form: ``corner_disparity.cpp``.
"""

from __future__ import annotations

import numpy as np

from lfrig.contracts.native import load_native
from lfrig.processing.kernels.patches import SETTLED_PX, Window, centred, sampled
from lfrig.processing.model import F32, F64, U8


def follow_disparities(
    pictures: U8,
    offsets: F64,
    reference: tuple[F32, F32, F32],
    window: Window,
    xy: F64,
    start: F64,
    *,
    passes: int,
    max_step_px: float,
    robust_grey: float,
    threads: int = 0,
) -> tuple[F64, F64]:
    """Disparities by which patches of a centre view are found in other views: one number moves a patch in all of them.

    Brightness may differ from view to view: patches are compared without their means, and large differences count
    less (Cauchy).

    Parameters
    ----------
    pictures : uint8 [V, H, W]
        Grey views.
    offsets : float64 [V, 2]
        Of the views from the centre view, x and y [view steps].
    reference : (float32 [N, K],) * 3
        Grey of the centre view's patches, and its slopes in x and y.
    xy : float64 [N, 2]
        Middles of the patches [px].
    start : float64 [N]
        Disparities to start from [px per view step].

    Returns
    -------
    disparity, step : float64 [N]
        The disparities, and what the last pass would have moved them by without its limit.
    """
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        return follow_disparities_numpy(
            pictures, offsets, reference, window, xy, start, passes=passes, max_step_px=max_step_px,
            robust_grey=robust_grey,
        )  # fmt: skip
    disparity, step = np.array(start, np.float64), np.zeros(len(start))
    native.follow_disparities(
        np.ascontiguousarray(pictures), np.ascontiguousarray(offsets, np.float64),
        *(np.ascontiguousarray(r, np.float32) for r in reference), window.dx, window.dy, window.weight,
        np.ascontiguousarray(xy, np.float64), passes, max_step_px, SETTLED_PX, robust_grey, disparity, step, threads,
    )  # fmt: skip
    return disparity, step


def follow_disparities_numpy(
    pictures: U8,
    offsets: F64,
    reference: tuple[F32, F32, F32],
    window: Window,
    xy: F64,
    start: F64,
    *,
    passes: int,
    max_step_px: float,
    robust_grey: float,
) -> tuple[F64, F64]:
    """NumPy twin of `follow_disparities`."""
    grey, slope_x, slope_y = reference
    flat = np.broadcast_to(np.eye(2), (len(xy), 2, 2))
    disparity, step = start.astype(np.float64), np.zeros(len(start))
    rows = np.arange(len(xy))
    for _ in range(passes):
        slope, right = np.full(len(rows), 1e-9), np.zeros(len(rows))
        for offset, picture in zip(offsets, pictures, strict=True):
            places = xy[rows] - offset * disparity[rows, None]
            seen = sampled(picture[..., None].astype(np.float32), places, flat[rows], window)
            error = centred(seen[..., 0] - grey[rows], window.weight)
            derivative = -(np.float32(offset[0]) * slope_x[rows] + np.float32(offset[1]) * slope_y[rows])
            weight = window.weight / (1 + (error / np.float32(robust_grey)) ** 2)
            slope += np.einsum("nk,nk->n", weight * derivative, derivative)
            right += np.einsum("nk,nk->n", weight * derivative, error)
        step[rows] = -right / slope
        disparity[rows] += np.clip(step[rows], -max_step_px, max_step_px)
        rows = rows[~(np.abs(step[rows]) < SETTLED_PX)]
    return disparity, step
