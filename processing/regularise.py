"""Fused evidence → surface: semi-global matching on the volume, then a windowed mean around the best plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lfrig.contracts.progress import Monitor
from lfrig.processing.fusion import FusedVolume
from lfrig.processing.kernels.sgm import aggregate
from lfrig.processing.model import F32, U8


@dataclass(frozen=True)
class RegulariseSettings:
    """Knobs of the regularisation, in units of log evidence; chosen on the tuning scenes."""

    method: str = "sgm"
    """``sgm`` or ``none``."""
    regression: str = "window"
    """``window`` (±window planes around the peak) or ``soft-argmax`` (all planes, as printed in the paper)."""
    window: int = 3
    cap: float = 20.0
    p1: float = 4.0
    p2: float = 50.0
    edge_grey: float = 30.0
    sharpness: float = 2.0
    """Log evidence per unit of the paths' mean."""


DEFAULT_REGULARISE = RegulariseSettings()


def regularise(
    volume: FusedVolume,
    photo: U8,
    settings: RegulariseSettings = DEFAULT_REGULARISE,
    *,
    threads: int = 0,
    monitor: Monitor | None = None,
) -> tuple[F32, F32]:
    """Surface from the fused volume.

    Parameters
    ----------
    photo : uint8 [H, W, 3]
        The target; its edges allow depth steps.

    Returns
    -------
    inverse_depth : float32 [H, W], 1/m
    peak : float32 [H, W], 0..1
        Share of the evidence within the window around the best plane.
    """
    w0, dw = volume.planes
    if settings.method == "none":
        index, peak = _regress(volume.evidence, settings)
        return np.asarray(w0 + dw * index, np.float32), peak
    cost = np.minimum(volume.cost * np.float32(volume.unit), np.float32(settings.cap))
    total = aggregate(cost, photo, settings.p1, settings.p2, settings.edge_grey, threads=threads, monitor=monitor)
    del cost
    total *= np.float32(-settings.sharpness)
    index, peak = _regress(total, settings)
    return np.asarray(w0 + dw * index, np.float32), peak


def _regress(evidence: F32, settings: RegulariseSettings) -> tuple[F32, F32]:
    """Mean plane index and peak mass, float32 [H, W] each; rows in blocks to bound memory.

    The window lies around the peak between planes and fades at its ends: where two planes are equally good, rounding
    decides which is the best, but not what comes out.
    """
    height, width, planes = evidence.shape
    index, peak = np.empty((height, width), np.float32), np.empty((height, width), np.float32)
    labels = np.arange(planes, dtype=np.float32)
    rows = max(1, 2_000_000 // (width * planes))
    for y in range(0, height, rows):
        block = evidence[y : y + rows]
        p = np.exp(block - block.max(2, keepdims=True))
        p /= np.maximum(p.sum(2, keepdims=True), np.float32(1e-20))
        away = np.abs(labels - _peak(block)[..., None])
        near = np.clip(np.float32(settings.window + 0.5) - away, 0, 1)
        peak[y : y + rows] = (p * near).sum(2)
        if settings.regression == "window":
            p *= near
        index[y : y + rows] = (p @ labels) / np.maximum(p.sum(2), np.float32(1e-20))
    return index, peak


def _peak(evidence: F32) -> F32:
    """Where a parabola through the logarithms of the best plane and its neighbours has its top, float32 [H, W]."""
    last = evidence.shape[2] - 1
    best = evidence.argmax(2)
    before, at, after = (
        np.take_along_axis(evidence, np.clip(best + d, 0, last)[..., None], 2)[..., 0] for d in (-1, 0, 1)
    )
    bend = 2 * at - before - after
    inner = (best > 0) & (best < last) & (bend > 0)
    offset = np.where(inner, 0.5 * (after - before) / np.where(inner, bend, 1), 0)
    return np.asarray(best + offset, np.float32)
