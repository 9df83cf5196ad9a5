"""The views of a light field from its centre view, the centre's disparity and two layers at depth steps.

Every view gathers the photo along its disparity field with a cubic B-spline; where the photo shows no surface the far
layer stands in, and at depth steps the near layer is put over it. C++ form: ``layered_views.cpp``, its field in
``view_field.cpp``, its samples in ``pair_sampling.cpp``.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.native import load_native
from lfrig.processing.kernels.spline import sample_spline, spline
from lfrig.processing.kernels.view_field import splat, z_buffered_field
from lfrig.processing.model import F32, Image

Mask = NDArray[np.bool_]

POLISH_ROUNDS, FAR_ROUNDS = 2, 6


@dataclass(frozen=True)
class Layers:
    """A photo taken apart at its depth steps. ``_grey`` are grey levels of 0..255, ``_px`` px per view step.

    ``behind_px`` float32 [H, W] is the surface with its near rims peeled off: the far layer, ``far_grey`` float32
    [H, W, 3] its colours. ``near_px`` float32 [H, W] is the near surface's disparity, continued beyond its edge;
    ``near_grey`` float32 [H, W, 4] its colours and its share 0..1 of a pixel. ``near_drawn`` bool [H, W]: the pixels at
    steps that are drawn as near layer over far layer. ``far_drawn`` bool [H, W]: far pixels at steps, whose colour in
    the photo is mixed.
    """

    behind_px: F32
    far_grey: F32
    near_px: F32
    near_grey: F32
    near_drawn: Mask
    far_drawn: Mask


def layered_views(
    image: Image,
    disparity: F32,
    layers: Layers,
    offsets: F32,
    *,
    match_px: float,
    hidden_px: float,
    certain: bool = True,
    threads: int = 0,
) -> tuple[Image, int, float]:
    """Render V views.

    Parameters
    ----------
    image : uint8 or uint16 [H, W, 3]
        The photo.
    disparity : float32 [H, W]
        px per view step, finite.
    offsets : float32 [V, 2]
        (dr, dc) of each view from the photo, in view steps; that at (0, 0) is the photo itself, bit for bit.
    match_px, hidden_px : float
        See `z_buffered_field`.
    certain : bool
        Leave out splat, polish and layers where one smooth surface stands before a pixel of the view.

    Returns
    -------
    views : uint8 or uint16 [V, H, W, 3]
    worked : int
        Pixels, over all views, that had the whole treatment.
    cpu_s : float
        What their disparity cost [CPU s].
    """
    height, width = image.shape[:2]
    if image.shape[2:] != (3,) or disparity.shape != (height, width) or offsets.shape[1:] != (2,):
        raise ValueError(f"shapes do not match: image {image.shape}, disparity {disparity.shape}, {offsets.shape}")
    out = np.empty((len(offsets), *image.shape), image.dtype)
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        start = time.process_time()
        view = _numpy_views(image, disparity, layers, match_px, hidden_px)
        for v, (dr, dc) in enumerate(offsets):
            out[v] = view(float(dr), float(dc)) if dr or dc else image
        return cast(Image, out), int(offsets.any(1).sum()) * height * width, time.process_time() - start
    maps = (disparity, layers.behind_px, layers.far_grey, layers.near_px, layers.near_grey)
    flags = (np.ascontiguousarray(flag).view(np.uint8) for flag in (layers.near_drawn, layers.far_drawn))
    worked, cpu_s = native.layered_views(
        np.ascontiguousarray(image),
        *(np.ascontiguousarray(a, np.float32) for a in maps),
        *flags,
        np.ascontiguousarray(offsets, np.float32),
        out, match_px, hidden_px, certain, threads,
    )  # fmt: skip
    return cast(Image, out), int(worked), float(cpu_s)


def _numpy_views(
    image: Image, disparity: F32, layers: Layers, match_px: float, hidden_px: float
) -> Callable[[float, float], Image]:
    """NumPy twin: what renders the view at an offset."""
    scale = np.float32(1 if image.dtype == np.uint8 else 257)
    photo, far, near = (spline(a) for a in (image.astype(np.float32) / scale, layers.far_grey, layers.near_grey))
    ys, xs = np.mgrid[0 : disparity.shape[0], 0 : disparity.shape[1]].astype(np.float32)

    def view(dr: float, dc: float) -> Image:
        row, col = np.float32(dr), np.float32(dc)
        field, hidden = z_buffered_field(disparity, dr, dc, match_px, hidden_px)
        grey = sample_spline(photo, xs + col * field, ys + row * field)

        def far_at(where: Mask, start: F32, rounds: int) -> tuple[F32, F32]:
            """The far layer's disparity [N] and colours [N, 3] at some pixels of the view."""
            x, y, found = xs[where], ys[where], start
            for _ in range(rounds):
                found = _bilinear(layers.behind_px, x + col * found, y + row * found)
            return found, sample_spline(far, x + col * found, y + row * found)

        drawn = hidden | _nearest(layers.far_drawn, xs + col * field, ys + row * field)
        behind_px, colours = far_at(drawn, field[drawn], FAR_ROUNDS - POLISH_ROUNDS)
        same = hidden[drawn] | (np.abs(behind_px - field[drawn]) < hidden_px)
        drawn[drawn] = same
        grey[drawn] = colours[same]
        edge, edge_px = _near_edge(layers, field, dr, dc, match_px, hidden_px)
        near_grey = sample_spline(near, xs[edge] + col * edge_px, ys[edge] + row * edge_px)
        share = np.clip(near_grey[:, 3:], 0, 1)
        grey[edge] = share * near_grey[:, :3] + (1 - share) * far_at(edge, edge_px, FAR_ROUNDS)[1]
        limit = 255 * scale
        return cast(Image, (np.clip(grey * scale, 0, limit) + np.float32(0.5)).astype(image.dtype))

    return view


def _near_edge(layers: Layers, field: F32, dr: float, dc: float, match_px: float, hidden_px: float) -> tuple[Mask, F32]:
    """Pixels of a view, bool [H, W], at which a near surface has its edge, and its disparity there, float32 [N]."""
    carried = splat(layers.near_px, dr, dc, layers.near_drawn)
    edge = carried > field - hidden_px  # else something nearer stands before the edge
    found = carried[edge]
    y, x = (a.astype(np.float32) for a in np.nonzero(edge))
    for _ in range(POLISH_ROUNDS):
        sample = _bilinear(layers.near_px, x + np.float32(dc) * found, y + np.float32(dr) * found)
        found = np.where(np.abs(sample - found) < match_px, sample, found)
    return edge, found


def _bilinear(values: F32, x: F32, y: F32) -> F32:
    """``values`` float32 [H, W] at N positions, beyond the frame its border."""
    height, width = values.shape
    x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
    ix, iy = x.astype(np.int64), y.astype(np.int64)
    right, down = np.minimum(ix + 1, width - 1), np.minimum(iy + 1, height - 1)
    wx, wy = x - ix, y - iy
    upper = values[iy, ix] * (1 - wx) + values[iy, right] * wx
    lower = values[down, ix] * (1 - wx) + values[down, right] * wx
    return np.asarray(upper * (1 - wy) + lower * wy, np.float32)


def _nearest(mask: Mask, x: F32, y: F32) -> Mask:
    """``mask`` bool [H, W] at the pixels nearest to positions [H, W]; false beyond the frame."""
    import cv2

    return np.asarray(cv2.remap(mask.astype(np.uint8), x, y, cv2.INTER_NEAREST) > 0)
