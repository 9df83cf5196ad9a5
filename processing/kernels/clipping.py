"""Blur of grey views around clipped pixels. C++ form: ``clipping.cpp``."""

from __future__ import annotations

import numpy as np

from lfrig.contracts.native import load_native
from lfrig.processing.kernels.grey import GreyViews, with_margin
from lfrig.processing.model import F32, U8

SHARE_BLUR_PX = 1.0
"""Blur of the transition between what is blurred and what is not."""


def soften_clipped(grey: GreyViews, views: U8, limit: int, blur_px: float, reach_px: int, *, threads: int = 0) -> None:
    """Blur views within ``reach_px`` of pixels all of whose channels are at least ``limit``, in place.

    Parameters
    ----------
    grey : GreyViews
        Their margins follow.
    views : uint8 [V, H, W, 3]
        The same views in colour.
    blur_px : float
        Standard deviation.
    """
    import cv2

    shape = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach_px + 1,) * 2)
    soft, share = _taps(blur_px), _taps(SHARE_BLUR_PX)
    native = load_native("lfrig.processing.kernels._native")
    if native is not None:
        half_widths = (shape.sum(1, dtype=np.int32) - 1) // 2
        native.soften_clipped(
            np.ascontiguousarray(views), grey.padded, grey.pad, limit, half_widths, soft, share, threads
        )
        return
    for picture, image, padded in zip(views, grey.images, grey.padded, strict=True):
        clipped = cv2.inRange(picture, (limit,) * 3, (255,) * 3)
        if clipped.any():
            near: F32 = (cv2.dilate(clipped, shape) > 0).astype(np.float32)
            own: F32 = image.astype(np.float32)
            own += _blurred(near, share) * (_blurred(own, soft) - own)
            padded[...] = with_margin((own + np.float32(0.5)).astype(np.int16)[None], grey.pad)[0]


def _taps(sigma: float) -> F32:
    """A Gaussian's weights out to four standard deviations, float32 [2r + 1]."""
    import cv2

    size = 2 * min(32, max(1, round(4 * sigma))) + 1
    return np.ascontiguousarray(cv2.getGaussianKernel(size, sigma, cv2.CV_32F)[:, 0])


def _blurred(image: F32, taps: F32) -> F32:
    import cv2

    return np.asarray(cv2.sepFilter2D(image, cv2.CV_32F, taps, taps, borderType=cv2.BORDER_REPLICATE))
