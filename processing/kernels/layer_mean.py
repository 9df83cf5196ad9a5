"""Means over windows, of neighbours on the pixel's own layer. C++ form: ``layer_mean.cpp``."""

from __future__ import annotations

import numpy as np

from lfrig.contracts.native import load_native
from lfrig.processing.model import F32


def layer_mean(values: F32, layer: F32, *, sigma: float, window: int, stride: int = 2, threads: int = 0) -> F32:
    """Mean over every ``stride``-th pixel of a window; each counts exp(−(difference of ``layer`` / ``sigma``)²).

    Parameters
    ----------
    values, layer : float32 [H, W]
        Finite; they go on beyond the frame as they are at its rim.
    window : int
        Side of the window [px], odd.

    Returns
    -------
    float32 [H, W]
    """
    if values.shape != layer.shape:
        raise ValueError(f"shapes do not match: values {values.shape}, layer {layer.shape}")
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        return layer_mean_numpy(values, layer, sigma, window, stride)
    out = np.empty(values.shape, np.float32)
    values, layer = (np.ascontiguousarray(part, np.float32) for part in (values, layer))
    native.layer_mean(values, layer, sigma, window // 2, stride, out, threads)
    return out


def layer_mean_numpy(values: F32, layer: F32, sigma: float, window: int, stride: int) -> F32:
    """NumPy twin."""
    height, width = values.shape
    reach = window // 2
    padded_values, padded_layer = (np.pad(part, reach, mode="edge") for part in (values, layer))
    total, mass = np.zeros_like(values), np.zeros_like(values)
    for dy in range(0, 2 * reach + 1, stride):
        for dx in range(0, 2 * reach + 1, stride):
            there = (slice(dy, dy + height), slice(dx, dx + width))
            weight = np.exp(-(((padded_layer[there] - layer) / np.float32(sigma)) ** 2))
            total += weight * padded_values[there]
            mass += weight
    return np.asarray(total / np.maximum(mass, np.float32(1e-6)), np.float32)
