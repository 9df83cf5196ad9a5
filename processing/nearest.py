"""Which pixel of a set is nearest to each pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfrig.processing.model import F32


@dataclass(frozen=True)
class Nearest:
    """For every pixel the nearest of a set: ``distance`` float32 [H, W] px and ``index`` into the flattened map."""

    distance: F32
    index: NDArray[np.intp]

    @classmethod
    def of(cls, where: NDArray[np.bool_]) -> Nearest:
        """Every pixel is its own nearest, far away, where the set is empty."""
        import cv2

        if not where.any():
            return cls(np.full(where.shape, 1e3, np.float32), np.arange(where.size).reshape(where.shape))
        distance, labels = cv2.distanceTransformWithLabels(
            (~where).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
        )
        # Labels count the pixels of the set from 1, row by row.
        table = np.concatenate([np.zeros(1, np.intp), np.flatnonzero(where)])
        return cls(np.asarray(distance, np.float32), np.take(table, labels))

    def look_up(self, values: F32) -> F32:
        """The value at the nearest pixel of the set, float32 [H, W]."""
        return np.asarray(np.take(values, self.index), np.float32)
