"""Wide-baseline matching in a narrow band: the photo against one source, slanted, bilateral, zero-mean.

For every pixel and every label k the patch around it, tilted like the surface there, is carried into the source at
inverse depth ``w(x, y) + (k − K/2)·step`` and compared by weighted zero-mean normalised cross-correlation. Weights fall
with colour difference (Yoon & Kweon, PAMI 2006) and distance. ``noise`` is added to both variances, so that what
is no texture but noise correlates with nothing. C++ form: ``band_cost.cpp``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lfrig.contracts.native import load_native
from lfrig.processing.model import F32, F64, U8


@dataclass(frozen=True)
class Patch:
    """The window: radius and stride [px], colour scale (sum of absolute RGB differences), variance of the noise
    [grey levels²] and the cost at which a label says nothing.
    """

    radius: int = 4
    stride: int = 2
    sigma_grey: float = 40.0
    noise: float = 1.0
    cap: float = 1.0


def band_cost(
    photo: F32,
    guide: U8,
    source: F32,
    visible: F32,
    surface: tuple[F32, F32, F32],
    projection: tuple[F64, F64],
    step: float,
    labels: int,
    patch: Patch,
    *,
    threads: int = 0,
) -> F32:
    """Matching cost of every label.

    Parameters
    ----------
    photo : float32 [H, W]
        Grey levels.
    guide : uint8 [H, W, 3]
        The photo's colours.
    source : float32 [Hs, Ws]
        Grey levels of the source's centre view.
    visible : float32 [H, W]
        How far the source sees the surface, 0..1; pixels at ≤ 0.01 cost nothing and get the cap.
    surface : (w, gx, gy), float32 [H, W] each
        Inverse depth [1/m] of the middle label and its slopes per pixel.
    projection : (A, b), float64 [3, 3] and [3]
        Of photo pixels into the source (`geometry.projection`).
    step : float
        Between labels [1/m].
    labels : int
        K, at most 128.

    Returns
    -------
    float32 [H, W, K], ``min(1 − ZNCC, cap)``; the cap where the source does not show the point.
    """
    shape = photo.shape
    if guide.shape != (*shape, 3) or visible.shape != shape or any(part.shape != shape for part in surface):
        raise ValueError(f"shapes do not match: photo {shape}, guide {guide.shape}, visible {visible.shape}")
    flat = np.ascontiguousarray(np.r_[projection[0].ravel(), projection[1]], np.float32)
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        return band_cost_numpy(photo, guide, source, visible, surface, flat, step, labels, patch)
    out = np.empty((*shape, labels), np.float32)
    native.band_cost(
        *(np.ascontiguousarray(a) for a in (photo, guide, source, visible, *surface)), flat, step, patch.radius,
        patch.stride, patch.sigma_grey, patch.noise, patch.cap, out, threads,
    )  # fmt: skip
    return out


def band_cost_numpy(
    photo: F32,
    guide: U8,
    source: F32,
    visible: F32,
    surface: tuple[F32, F32, F32],
    flat: F32,
    step: float,
    labels: int,
    patch: Patch,
) -> F32:
    """NumPy twin; ``flat`` float32 [12] holds A and b."""
    height, width = photo.shape
    a, b = flat[:9].reshape(3, 3), flat[9:]
    ys, xs = np.mgrid[0:height, 0:width].astype(np.float32)
    w, gx, gy = surface
    taps = list(_taps(photo, guide, patch))
    mass = sum(weight for weight, *_ in taps)
    mean = sum(weight * grey for weight, grey, *_ in taps) / mass
    own = sum(weight * (grey - mean) ** 2 for weight, grey, *_ in taps) / mass + np.float32(patch.noise)
    cost = np.full((height, width, labels), patch.cap, np.float32)
    seen = visible > 0.01
    for k in range(labels):
        offset = np.float32((k - labels // 2) * step)
        m1, m2, mc = (np.zeros_like(photo) for _ in range(3))
        for weight, grey, dx, dy in taps:
            u, v, _ = _carry(a, b, xs + dx, ys + dy, w + offset + gx * dx + gy * dy)
            value = _bilinear(source, u, v)
            m1 += weight * value
            m2 += weight * value * value
            mc += weight * value * (grey - mean)
        m = m1 / mass
        other = np.maximum(m2 / mass - m * m, 0) + np.float32(patch.noise)
        u, v, z = _carry(a, b, xs, ys, w + offset)
        inside = seen & (z > 1e-6) & (u >= 0) & (v >= 0) & (u <= source.shape[1] - 1) & (v <= source.shape[0] - 1)
        correlation = mc / mass / np.sqrt(other * own)
        cost[..., k] = np.where(inside, np.minimum(1 - correlation, np.float32(patch.cap)), np.float32(patch.cap))
    return cost


def _taps(photo: F32, guide: U8, patch: Patch) -> list[tuple[F32, F32, np.float32, np.float32]]:
    """(weight, grey, dx, dy) of every neighbour; those outside the frame weigh nothing."""
    height, width = photo.shape
    colour = guide.astype(np.float32)
    ys, xs = np.mgrid[0:height, 0:width]
    found = []
    for dy in range(-patch.radius, patch.radius + 1, patch.stride):
        for dx in range(-patch.radius, patch.radius + 1, patch.stride):
            y, x = np.clip(ys + dy, 0, height - 1), np.clip(xs + dx, 0, width - 1)
            inside = (ys + dy == y) & (xs + dx == x)
            step = np.abs(colour[y, x] - colour).sum(2) / np.float32(patch.sigma_grey)
            reach = np.float32((dx * dx + dy * dy) / (1.5 * patch.radius**2))
            weight = np.asarray(np.exp(-step - reach) * inside, np.float32)
            found.append((weight, photo[y, x], np.float32(dx), np.float32(dy)))
    return found


def _carry(a: F32, b: F32, xs: F32, ys: F32, w: F32) -> tuple[F32, F32, F32]:
    z = a[2, 0] * xs + a[2, 1] * ys + a[2, 2] + b[2] * w
    with np.errstate(divide="ignore", invalid="ignore"):
        u = (a[0, 0] * xs + a[0, 1] * ys + a[0, 2] + b[0] * w) / z
        v = (a[1, 0] * xs + a[1, 1] * ys + a[1, 2] + b[1] * w) / z
    return u, v, z


def _bilinear(image: F32, u: F32, v: F32) -> F32:
    height, width = image.shape
    u = np.clip(np.nan_to_num(u, nan=0.0), 0, np.float32(width - 1.001)).astype(np.float32)
    v = np.clip(np.nan_to_num(v, nan=0.0), 0, np.float32(height - 1.001)).astype(np.float32)
    iu, iv = u.astype(np.int64), v.astype(np.int64)
    fu, fv = u - iu, v - iv
    top = image[iv, iu] + fu * (image[iv, iu + 1] - image[iv, iu])
    low = image[iv + 1, iu] + fu * (image[iv + 1, iu + 1] - image[iv + 1, iu])
    return np.asarray(top + fv * (low - top), np.float32)
