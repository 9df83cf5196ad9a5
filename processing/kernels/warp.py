"""The 49-view warp: every output view gathers the photo along its own disparity field, bicubic.

``out[v, y, x] = image(y + dr_v · field[v, y, x], x + dc_v · field[v, y, x])`` with Catmull–Rom weights (Keys 1981,
a = −1/2) and the border replicated. C++ form: ``warp.cpp``; 8-bit pictures are sampled in fixed point there
(``pair_sampling.cpp``), at positions rounded to 1/1024 px.
"""

from __future__ import annotations

from typing import cast

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.native import load_native
from lfrig.processing.model import F32, Image


def warp_views(image: Image, fields: F32, offsets: F32, *, threads: int = 0) -> Image:
    """Warp one image to V views.

    Parameters
    ----------
    image : uint8 or uint16 [H, W, 3]
    fields : float32 [V, H, W]
        Disparity [px per view step] on the grid of each *output* view; NaN gathers in place.
    offsets : float32 [V, 2]
        (dr, dc), the output view's angular offset from the image's, in view steps.

    Returns
    -------
    uint8 or uint16 [V, H, W, 3]
    """
    views = fields.shape[0]
    if image.ndim != 3 or fields.shape[1:] != image.shape[:2] or offsets.shape != (views, 2):
        raise ValueError(f"shapes do not match: image {image.shape}, fields {fields.shape}, offsets {offsets.shape}")
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        return cast(Image, np.stack([warp_view_numpy(image, fields[v], *map(float, offsets[v])) for v in range(views)]))
    out = np.empty((views, *image.shape), image.dtype)
    native.warp_views(
        np.ascontiguousarray(image),
        np.ascontiguousarray(fields, np.float32),
        np.ascontiguousarray(offsets, np.float32),
        out,
        threads,
    )
    return out


def warp_view_numpy(image: Image, field: F32, dr: float, dc: float) -> Image:
    """NumPy twin, one view: uint [H, W, 3], float32 [H, W] → uint [H, W, 3]."""
    height, width = field.shape
    d = np.where(np.isfinite(field), field, np.float32(0)).astype(np.float32)
    ys, xs = np.mgrid[0:height, 0:width].astype(np.float32)
    fx = np.clip(xs + np.float32(dc) * d, -1, width)
    fy = np.clip(ys + np.float32(dr) * d, -1, height)
    ix, iy = np.floor(fx).astype(np.int64), np.floor(fy).astype(np.int64)
    wx, wy = _cubic_weights(fx - ix), _cubic_weights(fy - iy)
    total = np.zeros((*field.shape, 3), np.float32)
    for j in range(4):
        rows = np.clip(iy - 1 + j, 0, height - 1)
        part = np.zeros_like(total)
        for i in range(4):
            cols = np.clip(ix - 1 + i, 0, width - 1)
            part += wx[i][..., None] * image[rows, cols]
        total += wy[j][..., None] * part
    limit = 255 if image.dtype == np.uint8 else 65535
    return cast(Image, (np.clip(total, 0, limit) + np.float32(0.5)).astype(image.dtype))


def _cubic_weights(t: NDArray[np.float32]) -> list[NDArray[np.float32]]:
    t = t.astype(np.float32)
    t2, t3 = t * t, t * t * t
    return [
        -0.5 * t3 + t2 - 0.5 * t,
        1.5 * t3 - 2.5 * t2 + 1.0,
        -1.5 * t3 + 2.0 * t2 + 0.5 * t,
        0.5 * t3 - 0.5 * t2,
    ]
