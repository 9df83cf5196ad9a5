"""The fused evidence's surface: costs in fixed point, and the mean around each peak.

Semi-global matching runs on the costs (`kernels.sgm`); each pixel's sums are read as soon as they are finished and
never kept. C++ form: ``surface.cpp``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.native import load_native
from lfrig.processing.kernels.sgm import I16, INACTIVE, U16, Penalties, aggregate, optional_i16
from lfrig.processing.model import F32, U8


@dataclass(frozen=True)
class PeakMean:
    """How a surface is read from scores: ``sharpness``, log evidence per unit of the sums; ``window`` in labels on
    either side of the peak; ``all_labels``: the mean is over all of them, not over the window.
    """

    sharpness: float
    window: int
    all_labels: bool = False


def evidence_cost(evidence: F32, unit: float, cap: float, *, threads: int = 0) -> U16:
    """How far each label's evidence is below the pixel's best, in fixed point.

    Parameters
    ----------
    evidence : float32 [H, W, N]
        Log evidence; what is not a number counts as the cap.
    unit : float
        Of the costs, per unit of log evidence.
    cap : float
        In units of log evidence.

    Returns
    -------
    uint16 [H, W, N]
        The same bits natively and in NumPy.
    """
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        return _evidence_cost_numpy(evidence, unit, cap)
    cost = np.empty(evidence.shape, np.uint16)
    native.evidence_cost(np.ascontiguousarray(evidence, np.float32), unit, unit * cap, cost, threads)
    return cost


def _evidence_cost_numpy(evidence: F32, unit: float, cap: float) -> U16:
    """NumPy twin of `evidence_cost`."""
    finite = np.where(np.isnan(evidence), np.float32(-np.inf), evidence)
    top = np.maximum(finite.max(2, keepdims=True), np.finfo(np.float32).min)
    with np.errstate(invalid="ignore", over="ignore"):
        below = (top - finite) * np.float32(unit)
    below = np.where(below < np.float32(unit * cap), below, np.float32(unit * cap))
    return np.asarray(below + np.float32(0.5), np.uint16)


def sgm_surface(
    cost: U16,
    guide: U8,
    p1: float,
    p2: float,
    edge_grey: float,
    mean: PeakMean,
    *,
    span: I16 | None = None,
    threads: int = 0,
) -> tuple[F32, F32]:
    """Semi-global matching and the mean label around each pixel's best; see `aggregate` for the parameters.

    The window lies around the peak between labels and fades at its ends: where two labels are equally good, rounding
    decides which is the best, but not what comes out.

    Returns
    -------
    index : float32 [H, W], the mean label; 0 where no label is active
    peak : float32 [H, W], 0..1, the share of the mass within the window around the best label
        The same bits for any thread count; C++ and NumPy differ by rounding.
    """
    if guide.shape[:2] != cost.shape[:2]:
        raise ValueError(f"shapes do not match: cost {cost.shape}, guide {guide.shape}")
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        total = aggregate(cost, guide, p1, p2, edge_grey, span=span, threads=threads)
        return peak_mean(total, mean)
    penalties = Penalties.of(guide, p1, p2, edge_grey, threads=threads)
    index, peak = (np.empty(cost.shape[:2], np.float32) for _ in range(2))
    native.sgm_surface(
        np.ascontiguousarray(cost), penalties.jump, optional_i16(span), penalties.step, penalties.cap,
        mean.sharpness, mean.window, mean.all_labels, np.empty(cost.shape, np.uint16), index, peak, threads,
    )  # fmt: skip
    return index, peak


def peak_mean(total: U16, mean: PeakMean) -> tuple[F32, F32]:
    """Mean label and peak mass of aggregated costs uint16 [H, W, N], float32 [H, W] each; see `sgm_surface`."""
    index, peak = np.empty(total.shape[:2], np.float32), np.empty(total.shape[:2], np.float32)
    for rows in _blocks(total.shape):
        block = total[rows]
        active = block < INACTIVE
        some = np.asarray(active.any(2))
        scores = np.where(active | ~some[..., None], block * np.float32(-mean.sharpness), np.float32(-np.inf))
        index[rows], peak[rows] = (np.where(some, found, 0) for found in mean_of_scores(scores, mean))
    return index, peak


def mean_of_scores(scores: F32, mean: PeakMean) -> tuple[F32, F32]:
    """Mean label and peak mass of log evidence float32 [H, W, N]; ``mean.sharpness`` is not used."""
    index, peak = np.empty(scores.shape[:2], np.float32), np.empty(scores.shape[:2], np.float32)
    labels = np.arange(scores.shape[2], dtype=np.float32)
    for rows in _blocks(scores.shape):
        block = scores[rows]
        p = np.exp(block - block.max(2, keepdims=True))
        p /= np.maximum(p.sum(2, keepdims=True), np.float32(1e-20))
        near = np.clip(np.float32(mean.window + 0.5) - np.abs(labels - _top(block)[..., None]), 0, 1)
        peak[rows] = np.minimum((p * near).sum(2), 1)
        if not mean.all_labels:
            p *= near
        index[rows] = (p @ labels) / np.maximum(p.sum(2), np.float32(1e-20))
    return index, peak


def _blocks(shape: tuple[int, ...]) -> list[slice]:
    """Rows in blocks, to bound memory."""
    rows = max(1, 2_000_000 // (shape[1] * shape[2]))
    return [slice(y, y + rows) for y in range(0, shape[0], rows)]


def _top(scores: F32) -> F32:
    """Where a parabola through the best label and its neighbours has its top, float32 [H, W]."""
    last = scores.shape[2] - 1
    best: NDArray[np.intp] = scores.argmax(2)
    before, at, after = (
        np.take_along_axis(scores, np.clip(best + d, 0, last)[..., None], 2)[..., 0] for d in (-1, 0, 1)
    )
    inner = (best > 0) & (best < last) & np.isfinite(before) & np.isfinite(after)
    with np.errstate(invalid="ignore"):
        slope, bend = after - before, 2 * at - before - after
    inner &= bend > 0
    offset = 0.5 * np.where(inner, slope, 0) / np.where(inner, bend, 1)
    return np.asarray(best + offset, np.float32)
