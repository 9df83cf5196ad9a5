"""Patches around points, how alike two of them are, and how a picture slopes."""

from __future__ import annotations

import numpy as np

from lfrig.processing.model import F32, F64


def patch_window(radius: int) -> F32:
    """Offsets (x, y) of a square patch's pixels from its middle, float32 [1, P, 2]."""
    return np.stack(np.meshgrid(*[np.arange(-radius, radius + 1, dtype=np.float32)] * 2), -1).reshape(1, -1, 2)


def correlation(a: F32, b: F32) -> F64:
    """Zero-mean normalised cross-correlation of patches [N, P], float64 [N]; 0 for plain ones."""
    a, b = a - a.mean(1, keepdims=True), b - b.mean(1, keepdims=True)
    scale = np.sqrt((a * a).sum(1) * (b * b).sum(1))
    return np.asarray((a * b).sum(1) / np.maximum(scale, 1e-3), np.float64)


def slopes(picture: F32) -> tuple[F32, F32]:
    """Horizontal and vertical derivative (Sobel) [grey/px], float32 [H, W]."""
    import cv2

    return (
        np.asarray(cv2.Sobel(picture, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8)),
        np.asarray(cv2.Sobel(picture, cv2.CV_32F, 0, 1, ksize=3, scale=1 / 8)),
    )
