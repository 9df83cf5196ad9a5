"""Patches aligned to a fraction of a pixel.

Gauss–Newton on a patch's shift under a known affine map, with brightness gain and offset removed (Lucas & Kanade 1981;
Shi & Tomasi 1994; Evangelidis & Psarakis 2008 for the normalised correlation). C++ form: ``patches.cpp``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.native import load_native
from lfrig.processing.model import F32, F64
from lfrig.processing.patch import slopes

SLANT_RIDGE = 0.01
SETTLED_PX = 0.002
"""A pass that moves a point by less is its last of that kind, as is one that changes a disparity by less; a slant that
changes by less moves no pixel of a patch by more than a hundredth."""


@dataclass(frozen=True)
class Window:
    """A patch's pixels: offsets ``dx``, ``dy`` and ``weight`` (sum 1), float32 [K], K ≤ 256."""

    dx: F32
    dy: F32
    weight: F32


@dataclass(frozen=True)
class Alignment:
    """How far alignment goes: passes on the shift alone, then with the slant, and the longest step [px]."""

    shift_passes: int
    slant_passes: int
    max_step_px: float


def with_slopes(grey: F32) -> F32:
    """A grey picture float32 [H, W] as patches are sampled from it, float32 [H, W, 4]."""
    slope_x, slope_y = slopes(grey)
    return np.ascontiguousarray(np.stack([grey, slope_x, slope_y, np.zeros_like(grey)], -1), np.float32)


def align_patches(
    first: F32,
    second: F32,
    first_xy: F64,
    second_xy: F64,
    affine: F64,
    along: F64,
    window: Window,
    alignment: Alignment,
    *,
    threads: int = 0,
) -> tuple[F64, F32]:
    """Move points of the second picture so that the patches around them look like those of the first.

    Two unknowns at first, the shift; then also the slant of the surface, which stretches a patch along its epipolar
    line.

    Parameters
    ----------
    first, second : float32 [H, W, 4]
        See `with_slopes`; the border is replicated.
    first_xy, second_xy : float64 [N, 2]
        Points [px], and where to start.
    affine : float64 [N, 2, 2]
        Derivative of second by first pixel coordinates.
    along : float64 [N, 2]
        Direction in which a point moves with its depth, unit vectors.

    Returns
    -------
    xy : float64 [N, 2]; likeness : float32 [N], the normalised correlation there.
        The same bits for any thread count; C++ and NumPy differ by rounding.
    """
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        return align_patches_numpy(first, second, first_xy, second_xy, affine, along, window, alignment)
    xy, likeness = np.array(second_xy, np.float64, order="C"), np.empty(len(second_xy), np.float32)
    native.patches_align(
        np.ascontiguousarray(first, np.float32), np.ascontiguousarray(second, np.float32),
        np.ascontiguousarray(first_xy, np.float64), np.ascontiguousarray(affine.reshape(-1, 4), np.float64),
        np.ascontiguousarray(along, np.float64), window.dx, window.dy, window.weight, alignment.shift_passes,
        alignment.slant_passes, SLANT_RIDGE, alignment.max_step_px, SETTLED_PX, xy, likeness, threads,
    )  # fmt: skip
    return xy, likeness


def align_patches_numpy(
    first: F32,
    second: F32,
    first_xy: F64,
    second_xy: F64,
    affine: F64,
    along: F64,
    window: Window,
    alignment: Alignment,
) -> tuple[F64, F32]:
    """NumPy twin of `align_patches`."""
    flat = np.broadcast_to(np.eye(2), affine.shape)
    reference = _standard(sampled(first, first_xy, flat, window)[..., 0], window.weight)[0]
    xy, stretch = second_xy.astype(np.float64), np.zeros(second_xy.shape)
    last = alignment.shift_passes + alignment.slant_passes
    moving = np.ones(len(xy), bool)
    for done in range(last):
        slant = done >= alignment.shift_passes
        if done == alignment.shift_passes:
            moving[:] = True
        rows = np.flatnonzero(moving)
        full = affine[rows] + along[rows, :, None] * stretch[rows, None, :]
        seen = sampled(second, xy[rows], full, window)
        there, contrast = _standard(seen[..., 0], window.weight)
        step = _step(seen, there - reference[rows], contrast, along[rows], stretch[rows], window, slant)
        length = np.linalg.norm(step[:, :2], axis=1)
        kept = step * np.minimum(1, alignment.max_step_px / np.maximum(length, 1e-6))[:, None]
        xy[rows] += kept[:, :2]
        stretch[rows] += kept[:, 2:]
        moving[rows] = ~((length < SETTLED_PX) & (np.abs(step[:, 2:]).max(1, initial=0) < SETTLED_PX))
    seen = sampled(second, xy, affine + along[:, :, None] * stretch[:, None, :], window)
    there = _standard(seen[..., 0], window.weight)[0]
    return xy, np.asarray(np.einsum("nk,nk,k->n", there, reference, window.weight), np.float32)


def _step(seen: F32, error: F32, contrast: F32, along: F64, stretch: F64, window: Window, slant: bool) -> F64:
    """Gauss–Newton step of shift and slant, float64 [N, 4]; 0 for what is held."""
    gx, gy = seen[..., 1] / contrast, seen[..., 2] / contrast
    columns = [gx, gy]
    if slant:
        steep = gx * along[:, :1].astype(np.float32) + gy * along[:, 1:].astype(np.float32)
        columns += [steep * window.dx, steep * window.dy]
    jacobian = np.stack([centred(c, window.weight) for c in columns], 1)
    weighted = jacobian * window.weight
    normal = (weighted @ jacobian.transpose(0, 2, 1)).astype(np.float64)
    normal += np.diag([1e-6, 1e-6, SLANT_RIDGE, SLANT_RIDGE][: len(columns)])
    right = np.einsum("nak,nk->na", weighted, error).astype(np.float64)
    if slant:
        right[:, 2:] += SLANT_RIDGE * stretch
    step = np.zeros((len(seen), 4))
    step[:, : len(columns)] = -np.linalg.solve(normal, right[..., None])[..., 0]
    return step


def sampled(picture: F32, xy: F64, full: NDArray[np.floating], window: Window) -> F32:
    """Bilinear values of a picture [H, W, C] around points under affine maps [N, 2, 2], float32 [N, K, C]."""
    height, width = picture.shape[:2]
    f, at = full.astype(np.float32), xy.astype(np.float32)
    x = at[:, :1] + (f[:, 0, :1] * window.dx + f[:, 0, 1:] * window.dy)
    y = at[:, 1:] + (f[:, 1, :1] * window.dx + f[:, 1, 1:] * window.dy)
    x, y = (np.clip(np.nan_to_num(c), 0, n - 1).astype(np.float32) for c, n in ((x, width), (y, height)))
    i, j = (np.clip(c.astype(np.int64), 0, max(n - 2, 0)) for c, n in ((x, width), (y, height)))
    fx, fy = (x - i).astype(np.float32)[..., None], (y - j).astype(np.float32)[..., None]
    right, below = np.minimum(i + 1, width - 1), np.minimum(j + 1, height - 1)
    top = picture[j, i] + fx * (picture[j, right] - picture[j, i])
    low = picture[below, i] + fx * (picture[below, right] - picture[below, i])
    return np.asarray(top + fy * (low - top), np.float32)


def centred(values: F32, weight: F32) -> F32:
    """Patches [N, K] without their weighted means."""
    return np.asarray(values - (values * weight).sum(1, keepdims=True), np.float32)


def _standard(values: F32, weight: F32) -> tuple[F32, F32]:
    """Patches without mean and of unit contrast; and the contrast [N, 1]."""
    with np.errstate(over="ignore", invalid="ignore"):  # pictures may hold anything: what is lost is no match
        values = centred(values, weight)
        contrast = np.sqrt((values * values * weight).sum(1, keepdims=True)) + np.float32(1e-3)
        return np.asarray(values / contrast, np.float32), np.asarray(contrast, np.float32)
