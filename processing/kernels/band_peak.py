"""The best label of every pixel of an aggregated band, and how distinct it is. C++ form: ``band_peak.cpp``."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.native import load_native
from lfrig.processing.model import F32

U16 = NDArray[np.uint16]


def band_peak(cost: U16, total: U16, *, reach: int = 2, threads: int = 0) -> tuple[F32, F32, F32, F32]:
    """Read a band.

    Parameters
    ----------
    cost, total : uint16 [H, W, K]
        Before and after the aggregation; at most 256 labels.
    reach : int
        Labels on either side that belong to the best one.

    Returns
    -------
    float32 [H, W] each: ``label`` of the least total (of equal ones the first), to a fraction by a parabola; ``least``
    of the costs; ``margin``, by how much the totals of all labels beyond ± reach are worse than the best, 0 where
    there are none; ``curvature``, by how much the two at ± reach together are.
    """
    if cost.shape != total.shape:
        raise ValueError(f"shapes do not match: cost {cost.shape}, total {total.shape}")
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        return band_peak_numpy(cost, total, reach)
    out = np.empty((4, *cost.shape[:2]), np.float32)
    native.band_peak(np.ascontiguousarray(cost), np.ascontiguousarray(total), reach, out, threads)
    return out[0], out[1], out[2], out[3]


def band_peak_numpy(cost: U16, total: U16, reach: int) -> tuple[F32, F32, F32, F32]:
    """NumPy twin."""
    last = total.shape[2] - 1
    best = total.argmin(2)

    def at(label: NDArray[np.intp]) -> NDArray[np.int64]:
        return np.take_along_axis(total, np.clip(label, 0, last)[..., None], 2)[..., 0].astype(np.int64)

    before, here, after = at(best - 1), at(best), at(best + 1)
    bend = before - 2 * here + after
    inner = (best > 0) & (best < last) & (bend > 0)
    offset = np.where(inner, (0.5 * (before - after)).astype(np.float32) / np.maximum(bend, 1).astype(np.float32), 0)
    away = np.abs(np.arange(last + 1) - best[..., None]) > reach
    margin = np.where(away.any(2), np.where(away, total.astype(np.int64), 2**16).min(2) - here, 0)
    curvature = at(best - reach) + at(best + reach) - 2 * here
    label = best.astype(np.float32) + offset.astype(np.float32)
    return label, cost.min(2).astype(np.float32), margin.astype(np.float32), curvature.astype(np.float32)
