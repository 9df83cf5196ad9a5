"""Pixels that disagree with the weighted median of their neighbourhood take a neighbour's value near to it.

Weights fall with the squared colour distance (Zhang, Xu & Jia, CVPR 2014). The median decides and says what is wanted,
but the value comes from the map. C++ form: ``edge_snap.cpp``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.native import load_native
from lfrig.processing.model import F32, U8

RUN = 64
"""Pixels of a line that are looked at together."""


def edge_snap(
    values: F32,
    guide: U8,
    at: NDArray[np.bool_],
    *,
    radius: int,
    search: int,
    sigma_grey: float,
    threshold: float,
    per_step: float,
    threads: int = 0,
) -> F32:
    """Snap a map to the edges of a picture.

    Parameters
    ----------
    values : float32 [H, W]
        NaN takes no part.
    guide : uint8 [H, W, 3]
    at : bool [H, W]
        Pixels that may need it; the work is done for runs of `RUN` pixels that hold one.
    radius, search : int
        Of the median, and of the neighbours whose value a pixel may take [px].
    sigma_grey : float
        Colour distance (Euclidean, RGB) at which a neighbour counts exp(−1/2).
    threshold : float
        A pixel stays that is this near to the median, in units of the values.
    per_step : float
        What a pixel of distance counts beside a difference to the median, in units of the values.

    Returns
    -------
    float32 [H, W]
    """
    if guide.shape != (*values.shape, 3) or at.shape != values.shape:
        raise ValueError(f"shapes do not match: values {values.shape}, guide {guide.shape}, at {at.shape}")
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        return edge_snap_numpy(values, guide, at, radius, search, sigma_grey, threshold, per_step)
    out = np.empty(values.shape, np.float32)
    native.edge_snap(
        np.ascontiguousarray(values, np.float32), np.ascontiguousarray(guide), np.ascontiguousarray(at).view(np.uint8),
        radius, search, sigma_grey, threshold, per_step, out, threads,
    )  # fmt: skip
    return out


def edge_snap_numpy(
    values: F32,
    guide: U8,
    at: NDArray[np.bool_],
    radius: int,
    search: int,
    sigma_grey: float,
    threshold: float,
    per_step: float,
) -> F32:
    """NumPy twin."""
    height, width = values.shape
    wanted = np.pad(at, ((0, 0), (0, -width % RUN))).reshape(height, -1, RUN).any(2).repeat(RUN, 1)[:, :width]
    ys, xs = np.nonzero(wanted)
    near, weight = _window(values, guide, ys, xs, radius, sigma_grey)
    off = near - values[ys, xs]
    half = 0.5 * (weight * ~np.isnan(off)).sum(0)
    bad = np.maximum((weight * (off < -threshold)).sum(0), (weight * (off > threshold)).sum(0)) > half
    ys, xs, near, weight = ys[bad], xs[bad], near[:, bad], weight[:, bad] * ~np.isnan(near[:, bad])
    order = np.argsort(near, axis=0)
    passed = np.cumsum(np.take_along_axis(weight, order, 0), axis=0)
    at_half = np.argmax(passed >= 0.5 * passed[-1], axis=0)
    median = np.take_along_axis(near, np.take_along_axis(order, at_half[None], 0), 0)[0]
    out = values.copy()
    best, least = median.copy(), np.full(len(ys), np.inf, np.float32)
    for dy in range(-search, search + 1):
        for dx in range(-search, search + 1):
            value = values[np.clip(ys + dy, 0, height - 1), np.clip(xs + dx, 0, width - 1)]
            away = np.abs(value - median) + np.float32(per_step) * np.float32(abs(dx) + abs(dy))
            best = np.where(away < least, value, best)
            least = np.fmin(away, least)
    out[ys, xs] = best
    return out


def _window(
    values: F32, guide: U8, ys: NDArray[np.intp], xs: NDArray[np.intp], radius: int, sigma_grey: float
) -> tuple[F32, F32]:
    """Values and weights of the neighbours of M pixels, float32 [(2 radius + 1)², M]; NaN beyond the frame."""
    padded = np.pad(values, radius, constant_values=np.nan)
    colour = np.pad(guide.astype(np.float32), ((radius, radius), (radius, radius), (0, 0)))
    own = colour[ys + radius, xs + radius]
    near, weight = [], []
    for dy in range(2 * radius + 1):
        for dx in range(2 * radius + 1):
            near.append(padded[ys + dy, xs + dx])
            square = ((colour[ys + dy, xs + dx] - own) ** 2).sum(1)
            weight.append(np.exp(-square * np.float32(0.5 / sigma_grey**2)))
    return np.asarray(near, np.float32), np.asarray(weight, np.float32)
