"""Where an image can be recognised again: SIFT keypoints with sub-pixel positions and RootSIFT descriptors.

SIFT: Lowe, IJCV 2004; RootSIFT: Arandjelović & Zisserman, CVPR 2012.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfrig.processing.model import F32, F64, U8

MAX_FEATURES = 2000
CONTRAST_THRESHOLD = 0.004
DESCRIPTOR_LENGTH = 512


@dataclass(frozen=True)
class Features:
    """Keypoints of one image, in order of their position in OpenCV's list.

    ``xy`` float64 [N, 2] px, integer pixel centres; ``scale`` float64 [N] px, the keypoint's Gaussian sigma;
    ``descriptor`` float32 [N, 128] RootSIFT, rounded to integers so that every dot product is exact and no thread
    count or BLAS can change a match; ``place`` int64 [N], the first row with the same position (SIFT lists a
    keypoint once per dominant orientation).
    """

    xy: F64
    scale: F64
    descriptor: F32
    place: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.xy)


def extract_features(image: U8, limit: int = MAX_FEATURES, *, size: float = 1.0) -> Features:
    """SIFT features of an RGB image uint8 [H, W, 3], the ``limit`` strongest; ``size`` below 1 looks at the picture
    shrunk to that fraction. Positions and scales are in pixels of the image itself.
    """
    import cv2

    grey = cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY)
    full = grey.shape
    if size < 1:
        shape = max(1, round(size * full[1])), max(1, round(size * full[0]))
        grey, limit = cv2.resize(grey, shape, interpolation=cv2.INTER_AREA), max(1, round(size * size * limit))
    zoom = np.array([full[1] / grey.shape[1], full[0] / grey.shape[0]])
    # The precise upscale maps pixel x to 2x; without it OpenCV's positions are biased.
    sift = cv2.SIFT.create(limit, 3, CONTRAST_THRESHOLD, 10, 1.6, enable_precise_upscale=True)
    keypoints, descriptor = sift.detectAndCompute(grey, None)
    if not keypoints:
        return no_features()
    xy = (np.array([k.pt for k in keypoints], np.float64) + 0.5) * zoom - 0.5
    scale = np.array([k.size for k in keypoints], np.float64) / 2 * zoom.mean()
    root = np.sqrt(descriptor / np.maximum(descriptor.sum(1, keepdims=True), 1e-9))
    _, first, inverse = np.unique(xy, axis=0, return_index=True, return_inverse=True)
    place = first[inverse.reshape(-1)].astype(np.int64)
    return Features(xy, scale, np.rint(root * DESCRIPTOR_LENGTH).astype(np.float32), place)


def no_features() -> Features:
    """None at all."""
    return Features(np.zeros((0, 2)), np.zeros(0), np.zeros((0, 128), np.float32), np.zeros(0, np.int64))
