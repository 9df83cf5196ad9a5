"""One view as alignment and flow look at it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lfrig.processing.kernels.patches import with_slopes
from lfrig.processing.model import F32, F64, U8
from lfrig.processing.poses.patches import normalised


@dataclass(frozen=True)
class Picture:
    """One view: ``detail`` float32 [H, W, 4], grey and its slopes (`with_slopes`), and ``even`` uint8 [H, W], the same
    locally normalised.
    """

    detail: F32
    even: NDArray[np.uint8]

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width) [px]."""
        return self.even.shape[0], self.even.shape[1]

    @cached_property
    def small(self) -> Small:
        """At half size."""
        import cv2

        height, width = self.shape
        size = max(1, width // 2), max(1, height // 2)
        even = cv2.resize(self.even, size, interpolation=cv2.INTER_AREA)
        return Small(np.asarray(even, np.uint8), (width / size[0], height / size[1]))


@dataclass(frozen=True)
class Small:
    """A picture at half size: ``even`` uint8 [h, w], and the size of its pixels in those of the full one."""

    even: NDArray[np.uint8]
    pixel: tuple[float, float]

    @property
    def to_full(self) -> F64:
        """[3, 3]: homogeneous pixels of this picture as pixels of the full one."""
        x, y = self.pixel
        return np.array([[x, 0, (x - 1) / 2], [0, y, (y - 1) / 2], [0, 0, 1]])

    def full(self, xy: F64) -> F64:
        """Points [N, 2] of this picture in the full one."""
        return np.asarray((xy + 0.5) * self.pixel - 0.5, np.float64)

    def from_full(self, xy: F64) -> F64:
        """The reverse of `full`."""
        return np.asarray((xy + 0.5) / self.pixel - 0.5, np.float64)


def grey_of(image: U8) -> F32:
    """Grey image float32 [H, W] of RGB uint8 [H, W, 3]."""
    return grey8_of(image).astype(np.float32)


def grey8_of(image: U8) -> U8:
    """The same as uint8."""
    import cv2

    return np.asarray(cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY), np.uint8)


def picture_of(image: U8) -> Picture:
    """Prepare a view uint8 [H, W, 3]."""
    grey = grey_of(image)
    return Picture(with_slopes(grey), normalised(grey))
