"""Local planes through an inverse-depth map: bilateral weighted least squares, for smoothing and extrapolation.

C++ form: ``plane_fit.cpp``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.native import load_native
from lfrig.processing.model import F32, U8


def local_planes(
    values: F32,
    weights: F32,
    guide: U8,
    at: NDArray[np.bool_],
    *,
    radius: int,
    stride: int = 1,
    sigma_value: float,
    sigma_grey: float,
    ridge: float,
    slopes: tuple[F32, F32] | None = None,
    ceiling: F32 | None = None,
    threads: int = 0,
) -> tuple[F32, F32, F32, F32]:
    """Fit ``value ≈ v0 + gx·dx + gy·dy`` around the pixels ``at``.

    A neighbour counts by its weight × exp(−(residual/σ_value)² − Σ_rgb|ΔI|/σ_grey − (dx²+dy²)/radius²); the residual
    is taken against the plane through the pixel with ``slopes`` (0 when None).

    Parameters
    ----------
    values, weights : float32 [H, W]
        Values must be finite; weight 0 leaves a pixel out.
    at : bool [H, W]
        The M pixels to fit at; others cost nothing.
    ridge : float
        Added to Σdx² and Σdy²: pulls slopes to 0 where neighbours are few.
    ceiling : float32 [H, W], optional
        Neighbours with values above the pixel's ceiling do not count.

    Returns
    -------
    v0, gx, gy : float32 [M]; support : float32 [M], the sum of the weights.
        The same bits for any thread count; C++ and NumPy differ by rounding and 3e-7 of a weight.
    """
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        return local_planes_numpy(
            values, weights, guide, at, radius=radius, stride=stride, sigma_value=sigma_value, sigma_grey=sigma_grey,
            ridge=ridge, slopes=slopes, ceiling=ceiling,
        )  # fmt: skip
    out = np.empty((4, int(at.sum())), np.float32)
    none = np.zeros((0, 0), np.float32)
    native.plane_fit(
        np.ascontiguousarray(values, np.float32), np.ascontiguousarray(weights, np.float32),
        np.ascontiguousarray(guide.transpose(2, 0, 1), np.float32), _runs(at),
        none[None].repeat(2, 0) if slopes is None else np.stack(slopes).astype(np.float32, copy=False),
        none if ceiling is None else np.ascontiguousarray(ceiling, np.float32),
        radius, stride, sigma_value, sigma_grey, ridge, out, threads,
    )  # fmt: skip
    return out[0], out[1], out[2], out[3]


RUN = 64


def _runs(at: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Pixels of bool [H, W] as (row, first column, length ≤ `RUN`), int32 [R, 3], in reading order."""
    width = at.shape[1]
    starts = at.copy()
    starts[:, 1:] &= ~at[:, :-1]
    # A run is cut where the columns reach a multiple of RUN: no longer than that, and where does not matter.
    starts[:, ::RUN] |= at[:, ::RUN]
    first = np.flatnonzero(starts)
    pixels = np.flatnonzero(at)
    length = np.diff(np.r_[np.searchsorted(pixels, first), len(pixels)])
    return np.ascontiguousarray(np.c_[first // width, first % width, length], np.int32)


def local_planes_numpy(
    values: F32,
    weights: F32,
    guide: U8,
    at: NDArray[np.bool_],
    *,
    radius: int,
    stride: int,
    sigma_value: float,
    sigma_grey: float,
    ridge: float,
    slopes: tuple[F32, F32] | None,
    ceiling: F32 | None,
) -> tuple[F32, F32, F32, F32]:
    """NumPy twin of `local_planes`."""
    height, width = values.shape
    ys, xs = np.nonzero(at)
    centre = values[ys, xs]
    colour = guide.astype(np.float32)
    own = colour[ys, xs]
    gx0, gy0 = (s[ys, xs] for s in slopes) if slopes else (np.float32(0), np.float32(0))
    moments = np.zeros((9, len(ys)), np.float32)
    for dy in range(-radius, radius + 1, stride):
        for dx in range(-radius, radius + 1, stride):
            y, x = ys + dy, xs + dx
            inside = (y >= 0) & (y < height) & (x >= 0) & (x < width)
            y, x = np.where(inside, y, 0), np.where(inside, x, 0)
            rise = values[y, x] - centre
            residual = rise - gx0 * dx - gy0 * dy
            exponent = -((residual / np.float32(sigma_value)) ** 2)
            exponent -= np.abs(colour[y, x] - own).sum(1) / np.float32(sigma_grey)
            exponent -= np.float32((dx * dx + dy * dy) / radius**2)
            q = weights[y, x] * np.exp(exponent) * inside
            if ceiling is not None:
                q *= rise + centre <= ceiling[ys, xs]
            for i, factor in enumerate((1, dx, dy, dx * dx, dx * dy, dy * dy)):
                if factor:
                    moments[i] += q * np.float32(factor)
            q *= rise
            moments[6] += q
            moments[7] += q * np.float32(dx)
            moments[8] += q * np.float32(dy)
    support = moments[0].copy()
    offset, gx, gy = _solve(moments, ridge)
    return np.asarray(centre + offset, np.float32), gx, gy, support


def _solve(moments: F32, ridge: float) -> tuple[F32, F32, F32]:
    """Solve the symmetric 3×3 systems [s0 sx sy; sx sxx sxy; sy sxy syy] for all pixels, in float64."""
    s0, sx, sy, sxx, sxy, syy, t0, tx, ty = moments.astype(np.float64)
    s0 += 1e-9
    sxx += ridge
    syy += ridge
    m00, m01, m02 = sxx * syy - sxy**2, sy * sxy - sx * syy, sx * sxy - sy * sxx
    determinant = s0 * m00 + sx * m01 + sy * m02
    m11, m12, m22 = s0 * syy - sy**2, sx * sy - s0 * sxy, s0 * sxx - sx**2
    v = (m00 * t0 + m01 * tx + m02 * ty) / determinant
    gx = (m01 * t0 + m11 * tx + m12 * ty) / determinant
    gy = (m02 * t0 + m12 * tx + m22 * ty) / determinant
    return v.astype(np.float32), gx.astype(np.float32), gy.astype(np.float32)
