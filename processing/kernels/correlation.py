"""Patches correlated with what another picture shows in some places around theirs. C++ form: ``correlation.cpp``."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.native import load_native
from lfrig.processing.model import F32
from lfrig.processing.patch import correlation


def shifted_correlations(
    patches: F32,
    picture: F32,
    u: NDArray[np.floating],
    v: NDArray[np.floating],
    shifts: NDArray[np.floating],
    *,
    threads: int = 0,
) -> F32:
    """Zero-mean normalised cross-correlation of patches with another picture, in each of some places.

    Parameters
    ----------
    patches : float32 [N, P]
        Grey values, P ≤ 256.
    picture : float32 [H, W]
        Grey; sampled bilinearly, its border reflected.
    u, v : float32 [N, P]
        Where the picture shows the patches' pixels [px].
    shifts : float32 [S, N, 2]
        By which each patch is moved, x and y [px].

    Returns
    -------
    float32 [S, N]
        0 for plain patches. The same bits for any thread count; C++ and NumPy differ by rounding.
    """
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        return shifted_correlations_numpy(patches, picture, u, v, shifts)
    out = np.empty((len(shifts), len(patches)), np.float32)
    native.correlation(*(np.ascontiguousarray(a, np.float32) for a in (patches, picture, u, v, shifts)), out, threads)
    return out


@np.errstate(over="ignore", invalid="ignore")
def shifted_correlations_numpy(
    patches: F32,
    picture: F32,
    u: NDArray[np.floating],
    v: NDArray[np.floating],
    shifts: NDArray[np.floating],
) -> F32:
    """NumPy twin of `shifted_correlations`."""
    if not patches.shape[1] or not picture.size:
        raise ValueError("correlation: empty")
    u, v, moves = (np.asarray(a, np.float32) for a in (u, v, shifts[..., None]))
    found = [correlation(patches, _sampled(picture, u + move[:, 0], v + move[:, 1])) for move in moves]
    return np.asarray(found, np.float32).reshape(len(shifts), len(patches))


def _sampled(picture: F32, u: NDArray[np.floating], v: NDArray[np.floating]) -> F32:
    """Bilinear values at places of any shape; the border is reflected."""
    height, width = picture.shape
    x, y = (np.clip(np.where(np.isnan(c), -n, c), -n, 2 * n).astype(np.float32) for c, n in ((u, width), (v, height)))
    i, j = np.floor(x), np.floor(y)
    fx, fy = x - i, y - j
    left, right = (_reflected(i.astype(np.int64) + k, width) for k in (0, 1))
    upper, lower = (_reflected(j.astype(np.int64) + k, height) for k in (0, 1))
    top = picture[upper, left] + fx * (picture[upper, right] - picture[upper, left])
    low = picture[lower, left] + fx * (picture[lower, right] - picture[lower, left])
    return np.asarray(top + fy * (low - top), np.float32)


def _reflected(index: NDArray[np.int64], size: int) -> NDArray[np.int64]:
    """Where rows or columns beyond the border are found again."""
    index = np.where(index < 0, -1 - index, index)
    return np.clip(np.where(index >= size, 2 * size - 1 - index, index), 0, size - 1)
