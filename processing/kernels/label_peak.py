"""The best label of aggregated costs, to a fraction, and how distinct it is. C++ form: ``label_peak.cpp``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lfrig.contracts.native import load_native
from lfrig.processing.kernels.sgm import I16, INACTIVE, U16, Penalties, aggregate_u16, optional_i16
from lfrig.processing.model import F32, U8

REACH = 2
"""Labels on either side of the best that count as the same."""


@dataclass(frozen=True)
class LabelPeak:
    """Float32 [H, W] each: ``label``, where a parabola through the least cost and its neighbours has its bottom;
    ``margin``, by how much every label beyond ±2 is worse than the best (0 where there is none); ``curvature``, by how
    much the two at ±2 together are. All are 0 where no label is active.
    """

    label: F32
    margin: F32
    curvature: F32


def label_peak(total: U16, scale: float, *, threads: int = 0) -> LabelPeak:
    """Peak of each pixel's costs.

    Parameters
    ----------
    total : uint16 [H, W, D]
        Aggregated costs (`aggregate_u16`); 65535 before and behind the active labels of a pixel.
    scale : float
        Of margin and curvature, per unit of the costs: 1 / (8 · unit) gives the mean of the paths.

    Returns
    -------
    LabelPeak
        The same bits for any thread count; C++ and NumPy differ by rounding.
    """
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        return _label_peak_numpy(total, scale)
    peak = _empty(total.shape)
    native.label_peak(np.ascontiguousarray(total), scale, peak.label, peak.margin, peak.curvature, threads)
    return peak


def sgm_label_peak(
    cost: U16,
    guide: U8,
    p1: float,
    p2: float,
    edge_grey: float,
    scale: float,
    *,
    span: I16 | None = None,
    shift: I16 | None = None,
    threads: int = 0,
) -> LabelPeak:
    """The same as `label_peak` of `aggregate_u16`, whose sums are read as they are finished and never kept."""
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        return _label_peak_numpy(aggregate_u16(cost, guide, p1, p2, edge_grey, span=span, shift=shift), scale)
    if guide.shape[:2] != cost.shape[:2]:
        raise ValueError(f"shapes do not match: cost {cost.shape}, guide {guide.shape}")
    penalties = Penalties.of(guide, p1, p2, edge_grey, threads=threads)
    peak = _empty(cost.shape)
    native.sgm_label_peak(
        np.ascontiguousarray(cost), penalties.jump, optional_i16(shift), optional_i16(span), penalties.step,
        penalties.cap, scale, np.empty(cost.shape, np.uint16), peak.label, peak.margin, peak.curvature, threads,
    )  # fmt: skip
    return peak


def _empty(shape: tuple[int, ...]) -> LabelPeak:
    return LabelPeak(*(np.empty(shape[:2], np.float32) for _ in range(3)))


def _label_peak_numpy(total: U16, scale: float) -> LabelPeak:
    """NumPy twin of `label_peak`."""
    active = total < INACTIVE
    labels = np.arange(total.shape[2])
    best = total.argmin(2)
    first, last = active.argmax(2), total.shape[2] - 1 - active[..., ::-1].argmax(2)

    def cost_at(step: int) -> F32:
        at = np.clip(best + step, first, last)[..., None]
        return np.asarray(np.take_along_axis(total, at, 2)[..., 0], np.float32)

    before, least, after = cost_at(-1), cost_at(0), cost_at(1)
    bend = before + after - 2 * least
    inner = (best > first) & (best < last) & (bend > 0)
    offset = np.where(inner, 0.5 * (before - after) / np.where(inner, bend, 1), 0)
    other = np.where(np.abs(labels - best[..., None]) > REACH, total, INACTIVE).min(2)
    margin = np.where(other < INACTIVE, (other - least) * np.float32(scale), 0)
    curvature = (cost_at(-REACH) + cost_at(REACH) - 2 * least) * np.float32(scale)
    some = active.any(2)
    return LabelPeak(*(np.where(some, found, 0).astype(np.float32) for found in (best + offset, margin, curvature)))
