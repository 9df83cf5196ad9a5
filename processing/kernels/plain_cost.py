"""The gradient constraint of plain areas: sums over views, and what they make of the matching cost.

C++ forms: ``plain_cost.cpp``. The method is that of `lfrig.processing.plain_areas`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.native import load_native
from lfrig.processing.kernels.grey import SCALE, GreyViews
from lfrig.processing.kernels.plane_cost import PlaneGrid
from lfrig.processing.kernels.softmax import NO_SPAN, in_span
from lfrig.processing.model import F32

I16 = NDArray[np.int16]
U16 = NDArray[np.uint16]
Mask = NDArray[np.bool_]

MOST_RADIUS = 32


def view_moments(views: GreyViews, wanted: Mask, *, threads: int = 0) -> tuple[F32, F32]:
    """Σ dr·(I_v − I_centre) and Σ dc·(I_v − I_centre) over all views.

    Parameters
    ----------
    wanted : bool [H, W]
        Elsewhere the sums may be 0 instead.

    Returns
    -------
    float32 [H, W] each, grey levels times view steps. The same bits natively and in NumPy.
    """
    native = load_native("lfrig.processing.kernels._native")
    by_row, by_column = (np.zeros((views.height, views.width), np.float32) for _ in range(2))
    offsets = np.ascontiguousarray(views.offsets, np.float32)
    if native is None:
        own = views.images[views.centre].astype(np.int32)
        for v in views.others():
            difference: F32 = (views.images[v] - own).astype(np.float32)
            by_row += offsets[v, 0] * difference
            by_column += offsets[v, 1] * difference
        return by_row / np.float32(SCALE), by_column / np.float32(SCALE)
    asked = np.ascontiguousarray(wanted).view(np.uint8)
    native.view_moments(views.padded, views.centre, views.pad, offsets, asked, by_row, by_column, threads)
    return by_row, by_column


def difference_power(views: GreyViews, blur_px: float, wanted: Mask, *, threads: int = 0) -> F32:
    """Sum over the views of the squared blurred difference from the centre.

    Parameters
    ----------
    blur_px : float
        Standard deviation; the blur ends at the views' margin at the latest.
    wanted : bool [H, W]
        Elsewhere the sum may be 0 instead.

    Returns
    -------
    float32 [H, W], grey levels squared.
    """
    import cv2

    radius = min(views.pad, MOST_RADIUS, max(1, round(4 * blur_px)))
    taps: F32 = np.ascontiguousarray(cv2.getGaussianKernel(2 * radius + 1, blur_px, cv2.CV_32F)[:, 0])
    power = np.zeros((views.height, views.width), np.float32)
    native = load_native("lfrig.processing.kernels._native")
    if native is not None:
        asked = np.ascontiguousarray(wanted).view(np.uint8)
        native.difference_power(views.padded, views.centre, views.pad, taps, asked, power, threads)
        return power
    own = views.images[views.centre]
    for v in views.others():
        difference = cv2.subtract(views.images[v], own, dtype=cv2.CV_32F)
        cv2.accumulateSquare(
            cv2.sepFilter2D(difference, cv2.CV_32F, taps, taps, borderType=cv2.BORDER_REPLICATE), power
        )
    power /= np.float32(SCALE**2)
    return power


def blend_plain(
    cost: U16,
    grid: PlaneGrid,
    disparity: F32,
    steepness: F32,
    weight: F32,
    cap: float,
    *,
    span: I16 | None = None,
    threads: int = 0,
) -> None:
    """``cost = (1 − weight)·cost + weight·min(steepness·(δ_k − disparity)², cap)``, in place where weight > 0.

    Parameters
    ----------
    cost : uint16 [H, W, D]
    disparity, steepness, weight : float32 [H, W]
        Finite; px per view step, units of cost per px², and 0..1.
    cap : float
        In units of the cost.
    span : int16 [ceil(H/8), ceil(W/8), 2], optional
        First and one-past-last plane of each tile of 8×8 pixels; the rest is left as it is.
    """
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        _blend_plain_numpy(cost, grid, disparity, steepness, weight, cap, span)
        return
    native.blend_plain(
        cost, NO_SPAN if span is None else np.ascontiguousarray(span, np.int16), np.ascontiguousarray(disparity),
        np.ascontiguousarray(steepness), np.ascontiguousarray(weight), grid.first, grid.step, cap, threads,
    )  # fmt: skip


def _blend_plain_numpy(
    cost: U16, grid: PlaneGrid, disparity: F32, steepness: F32, weight: F32, cap: float, span: I16 | None
) -> None:
    active = in_span(span, cost.shape)
    planes = np.float32(grid.first) + np.float32(grid.step) * np.arange(grid.count, dtype=np.float32)
    for y in range(cost.shape[0]):
        xs = np.nonzero(weight[y] > 0)[0]
        away = planes - disparity[y, xs, None]
        with np.errstate(over="ignore", invalid="ignore"):
            charge = np.fmin(away * away * steepness[y, xs, None], np.float32(cap))
        w = weight[y, xs, None]
        mixed = ((1 - w) * cost[y, xs] + w * charge + np.float32(0.5)).astype(np.int32)
        cost[y, xs] = np.where(active[y, xs], mixed, cost[y, xs])
