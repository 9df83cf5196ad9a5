"""From white-balanced camera RGB to what is displayed: colour matrix and the sRGB curve."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from lfrig.processing.lenslet.metadata import RawMetadata
from lfrig.processing.model import F32, U8

LUT_SIZE = 1 << 14
"""Steps of linear light: next to black, where the curve is steepest, one is a fifth of an 8-bit step."""
MAX_COEFFICIENT = 8.0
"""Larger ones in a colour matrix are a broken file: they would show nothing but noise."""


def srgb_encode(linear: NDArray[np.floating]) -> NDArray[np.float64]:
    """The sRGB curve (IEC 61966-2-1) of linear light, clipped to 0..1."""
    light = np.clip(np.asarray(linear, np.float64), 0.0, 1.0)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


@cache
def srgb_lut() -> U8:
    """8-bit sRGB of ``LUT_SIZE`` equal steps of linear light 0..1."""
    lut = np.rint(255 * srgb_encode(np.linspace(0, 1, LUT_SIZE))).astype(np.uint8)
    lut.setflags(write=False)  # it is shared
    return lut


def colour_matrix(metadata: RawMetadata) -> F32:
    """White-balanced camera RGB → linear sRGB, float32 [3, 3], neutral kept neutral.

    The rows are scaled to sum to one (rounded matrices miss it by a little, which would tint all greys). The identity
    where there is none, or none that can be meant: rows that sum to nothing or to less, or giant coefficients.
    """
    if metadata.colour_matrix is None:
        return np.eye(3, dtype=np.float32)
    matrix = np.asarray(metadata.colour_matrix, np.float64)
    sums = matrix.sum(1, keepdims=True)
    if not np.isfinite(matrix).all() or (sums < 0.1).any() or np.abs(matrix / sums).max() > MAX_COEFFICIENT:
        return np.eye(3, dtype=np.float32)
    return np.asarray(matrix / sums, np.float32)
