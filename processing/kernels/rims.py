"""What lies behind and beside the rims of near surfaces. C++ forms: ``rims.cpp``.

Near pixels next to a depth step are peeled off, ring by ring from the step inwards, and the far surface is continued
under them (a layered depth image after Shade et al., SIGGRAPH 1998, whose second layer reaches as far as any view can
look). In the same way colours grow from where they are known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.native import load_native
from lfrig.processing.model import F32

Mask = NDArray[np.bool_]

SLOPE_WINDOW_PX = 9
SLOPE_LIMIT = 0.25
"""Differences above this share of a step are no slope of a surface."""
SLOPE_PIXELS = 9
"""Fewer differences in the window say nothing: the surface is continued flat."""
GROW_RADIUS_PX = 2
GROW_SIGMA_PX = 1.0


@dataclass(frozen=True)
class Peeled:
    """``disparity`` float32 [H, W] px per view step with the far surface where ``peeled`` bool [H, W]."""

    disparity: F32
    peeled: Mask


def near_rim(disparity: F32, step_px: float) -> Mask:
    """Pixels that are more than ``step_px`` nearer than one of their eight neighbours."""
    return np.asarray(disparity - lowest(disparity, 3) > step_px)


def lowest(values: F32, window_px: int) -> F32:
    """The lowest value of the window around each pixel."""
    import cv2

    return np.asarray(cv2.erode(values, np.ones((window_px, window_px), np.uint8)))


def peel(disparity: F32, step_px: float, reach_px: int) -> Peeled:
    """Continue the far side of every depth step ``reach_px`` under the near side.

    Parameters
    ----------
    disparity : float32 [H, W]
        px per view step, finite.
    step_px : float
        Neighbours that differ by more are two surfaces.
    """
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        return peel_numpy(disparity, step_px, reach_px)
    surface = np.ascontiguousarray(disparity, np.float32)
    behind, done = np.empty_like(surface), np.empty(surface.shape, np.uint8)
    native.peel(
        surface, lowest(surface, SLOPE_WINDOW_PX), near_rim(surface, step_px).view(np.uint8), behind, done,
        step_px, SLOPE_LIMIT * step_px, SLOPE_WINDOW_PX, SLOPE_PIXELS, reach_px,
    )  # fmt: skip
    return Peeled(behind, done.view(bool))


def peel_numpy(disparity: F32, step_px: float, reach_px: int) -> Peeled:
    """NumPy twin."""
    height, width = disparity.shape
    stride = width + 2
    # One pixel of infinity around: nothing is behind the frame's border, and no neighbour falls off the arrays.
    surface = np.pad(disparity, 1, constant_values=np.inf).ravel()
    behind = surface.copy()
    slopes = [np.pad(slope, 1).ravel() for slope in _slopes(disparity, step_px)]
    done = np.isposinf(surface)
    ring = np.flatnonzero(np.pad(near_rim(disparity, step_px), 1))
    around = [(dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if dy or dx]
    offsets = np.array([dy * stride + dx for dy, dx in around])
    first = True
    for _ in range(reach_px):
        sums, count = np.zeros((3, ring.size), np.float32), np.zeros(ring.size, np.float32)
        for (dy, dx), offset in zip(around, offsets, strict=True):
            other = ring + offset
            farther = (surface[ring] - behind[other] > step_px) & (first | done[other])
            sy, sx = (slope[other] for slope in slopes)
            with np.errstate(invalid="ignore"):
                plane = behind[other] - np.float32(dx) * sx - np.float32(dy) * sy
            for total, value in zip(sums, (plane, sy, sx), strict=True):
                total += np.where(farther, value, np.float32(0))
            count += farther
        hit = count > 0
        ring = ring[hit]
        if not ring.size:
            break
        mean = sums[:, hit] / count[hit]
        behind[ring] = np.minimum(mean[0], surface[ring])
        slopes[0][ring], slopes[1][ring] = mean[1], mean[2]
        done[ring], first = True, False
        ring = np.unique((ring[:, None] + offsets).ravel())
        ring = ring[~done[ring]]
    shape = (height + 2, stride)
    inner = np.s_[1:-1, 1:-1]
    return Peeled(behind.reshape(shape)[inner].copy(), done.reshape(shape)[inner].copy())


def _slopes(disparity: F32, step_px: float) -> tuple[F32, F32]:
    """Mean slope down and to the right [px per view step and px] of the surface around each pixel, steps and what
    stands before a step left out.
    """
    import cv2

    found = []
    far = disparity - lowest(disparity, SLOPE_WINDOW_PX) <= step_px
    for axis in (0, 1):
        difference = np.diff(disparity, axis=axis, append=np.inf).astype(np.float32)
        valid = far & (np.abs(difference) <= SLOPE_LIMIT * step_px)
        window = (SLOPE_WINDOW_PX, SLOPE_WINDOW_PX)
        count, total = (
            cv2.boxFilter(a.astype(np.float32), -1, window, normalize=False, borderType=cv2.BORDER_CONSTANT)
            for a in (valid, np.where(valid, difference, 0))
        )
        found.append(np.where(count >= SLOPE_PIXELS, total / np.maximum(count, 1), 0).astype(np.float32))
    return found[0], found[1]


def grow(values: F32, known: Mask, wanted: Mask, rounds: int) -> tuple[F32, Mask]:
    """Continue ``values`` from the known to the wanted pixels, ring by ring, each the Gaussian mean of what is there.

    Parameters
    ----------
    values : float32 [H, W, C]
    known, wanted : bool [H, W]
        A pixel that is neither gives nothing and gets nothing.

    Returns
    -------
    (float32 [H, W, C], bool [H, W])
        The values (unchanged outside ``wanted``), and where they are known now.
    """
    grown = np.array(values, np.float32, order="C")
    return grown, grow_in_place(grown, known, wanted, rounds)


def grow_in_place(values: F32, known: Mask, wanted: Mask, rounds: int) -> Mask:
    """`grow` that writes into ``values`` (C-contiguous); returns where they are known now."""
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        values[...], reached = grow_numpy(values, known, wanted, rounds)
        return reached
    now = known.astype(np.uint8)
    native.grow(values, now, np.ascontiguousarray(wanted).view(np.uint8), _gaussian(), rounds)
    return now.view(bool)


def _gaussian() -> F32:
    """float32 [2·GROW_RADIUS_PX + 1]², 1 in the middle."""
    d2 = np.square(np.arange(-GROW_RADIUS_PX, GROW_RADIUS_PX + 1))
    return np.asarray(np.exp(-(d2[:, None] + d2) / (2 * GROW_SIGMA_PX**2)), np.float32)


def grow_numpy(values: F32, known: Mask, wanted: Mask, rounds: int) -> tuple[F32, Mask]:
    """NumPy twin."""
    r = GROW_RADIUS_PX
    height, width, channels = values.shape
    stride = width + 2 * r
    reach = range(-r, r + 1)
    offsets = np.array([dy * stride + dx for dy in reach for dx in reach])
    weights = _gaussian().ravel()
    touching = np.array([-stride - 1, -stride, -stride + 1, -1, 1, stride - 1, stride, stride + 1])
    flat = np.pad(values, ((r, r), (r, r), (0, 0))).reshape(-1, channels)
    have, want = (np.pad(mask, r).ravel() for mask in (known, wanted & ~known))
    for _ in range(rounds):
        candidates = np.flatnonzero(want)
        ring = candidates[have[candidates[:, None] + touching].any(1)]
        if not ring.size:
            break
        taps = ring[:, None] + offsets
        share = have[taps] * weights
        flat[ring] = np.einsum("nt,ntc->nc", share, flat[taps]) / share.sum(1, keepdims=True)
        have[ring], want[ring] = True, False
    shape, inner = (height + 2 * r, stride), np.s_[r:-r, r:-r]
    return flat.reshape(*shape, channels)[inner].copy(), have.reshape(shape)[inner].copy()
