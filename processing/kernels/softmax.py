"""Softmax of a cost volume, and the windowed mean around its peak. C++ form: ``softmax.cpp``."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.native import load_native
from lfrig.processing.model import F32


def softmax_peak(
    cost: F32, inverse_temperature: float, window: int, *, threads: int = 0
) -> tuple[NDArray[np.uint16], F32, F32]:
    """Softmax of −cost along the last axis, and the peak's windowed mean.

    The mean is taken over ±``window`` planes around the peak: over all planes, a uniform floor of 20 % would pull it
    by 4 planes.

    Parameters
    ----------
    cost : float32 [H, W, D]
        Finite.

    Returns
    -------
    probability uint16 [H, W, D] (65535 = 1), peak index float32 [H, W], confidence float32 [H, W] (mass at the peak).
        The same bits for any thread count; C++ and NumPy differ by rounding.
    """
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        return softmax_peak_numpy(cost, inverse_temperature, window)
    probability = np.empty(cost.shape, np.uint16)
    index, confidence = (np.empty(cost.shape[:2], np.float32) for _ in range(2))
    native.softmax_peak(
        np.ascontiguousarray(cost, np.float32), inverse_temperature, window, probability, index, confidence, threads
    )
    return probability, index, confidence


def softmax_peak_numpy(cost: F32, inverse_temperature: float, window: int) -> tuple[NDArray[np.uint16], F32, F32]:
    """NumPy twin of `softmax_peak`."""
    height, width, planes = cost.shape
    probability = np.empty(cost.shape, np.uint16)
    index = np.empty((height, width), np.float32)
    confidence = np.empty((height, width), np.float32)
    labels = np.arange(planes, dtype=np.float32)
    rows = max(1, 2_000_000 // (width * planes))
    for y in range(0, height, rows):
        block = cost[y : y + rows]
        p = np.exp((block.min(2, keepdims=True) - block) * np.float32(inverse_temperature))
        p /= p.sum(2, keepdims=True)
        probability[y : y + rows] = (p * np.float32(65535) + np.float32(0.5)).astype(np.uint16)
        near = np.abs(labels - p.argmax(2)[..., None]) <= window
        p *= near
        mass = p.sum(2)
        confidence[y : y + rows] = np.minimum(mass, 1)
        index[y : y + rows] = (p @ labels) / mass
    return probability, index, confidence
