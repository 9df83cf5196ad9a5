"""How much poorer photo and sources match than noise and rounding explain."""

from __future__ import annotations

import numpy as np

from lfrig.processing.model import F32, U8
from lfrig.processing.tone import luma
from lfrig.processing.wide_baseline import DEFAULT_WIDE_BASELINE, LUMA_NOISE


def excess_cost(cost: F32, variance: F32, noise_sigma: float) -> F32:
    """By how much a match is poorer than noise and rounding explain, 0..1 float32 [H, W]; 0 where they explain half.

    Of texture with a measured variance v, which noise of variance n is part of, `band_cost` finds a correlation of
    (v − n) / (v + f) at best, with the variance f that counts as no texture.
    """
    noise = np.float32(LUMA_NOISE * noise_sigma**2)
    floor = np.float32(DEFAULT_WIDE_BASELINE.noise_floor) + noise
    expected = np.clip((noise + floor) / np.maximum(variance + floor, np.float32(1e-6)), 0, 1)
    excess = np.maximum(cost - expected, 0) / np.maximum(1 - expected, np.float32(1e-6))
    return np.asarray(np.where(expected < 0.5, excess, 0), np.float32)


def local_variance(photo: U8, window: int) -> F32:
    """Variance of luma over a window [grey levels²], float32 [H, W]."""
    import cv2

    grey = luma(photo)
    grey -= grey.mean()
    mean, square = (cv2.blur(part, (window, window)) for part in (grey, grey * grey))
    return np.asarray(square - mean * mean, np.float32)
