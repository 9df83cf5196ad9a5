"""NumPy twin of textures.hpp: trilinear lookup in mip-mapped, repeating textures."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfrig.sim.scene import F64, PackedScene

I64 = NDArray[np.int64]


def trilinear(scene: PackedScene, texture: int, u: F64, v: F64, footprint: F64) -> F64:
    """Linear RGB [N, 3] of a texture at (u, v) in repetitions, ``footprint`` texels of level 0 wide."""
    levels = scene.table.shape[1]
    lod = np.minimum(np.log2(np.maximum(footprint, 1.0)), float(levels - 1))
    level = np.minimum(lod.astype(np.int64), levels - 1)
    f = (lod - level)[:, None]
    fine = _bilinear(scene, texture, level, u, v)
    coarse = _bilinear(scene, texture, np.minimum(level + 1, levels - 1), u, v)
    return np.where((f > 0) & (level[:, None] + 1 < levels), fine * (1.0 - f) + coarse * f, fine)


def _bilinear(scene: PackedScene, texture: int, level: I64, u: F64, v: F64) -> F64:
    start, width, height = scene.table[texture, level].T
    x, y = (u - np.floor(u)) * width - 0.5, (v - np.floor(v)) * height - 0.5
    floor_x, floor_y = np.floor(x), np.floor(y)
    fx, fy = (x - floor_x)[:, None], (y - floor_y)[:, None]
    x0, y0 = floor_x.astype(np.int64) & (width - 1), floor_y.astype(np.int64) & (height - 1)
    x1, y1 = (x0 + 1) & (width - 1), (y0 + 1) & (height - 1)
    channel = np.arange(3)

    def texel(tx: I64, ty: I64) -> F64:
        return np.asarray(scene.texels[(start + (ty * width + tx) * 3)[:, None] + channel].astype(np.float64))

    a = texel(x0, y0) * (1.0 - fx) + texel(x1, y0) * fx
    b = texel(x0, y1) * (1.0 - fx) + texel(x1, y1) * fx
    return np.asarray(a * (1.0 - fy) + b * fy)
