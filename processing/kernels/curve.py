"""A piecewise linear curve, evaluated for every pixel. C++ form: ``curve.cpp``."""

from __future__ import annotations

import numpy as np

from lfrig.contracts.native import load_native
from lfrig.processing.model import F32, F64


def curve(values: F32, x: F64, y: F64, *, threads: int = 0) -> F32:
    """The curve through (``x``, ``y``) at ``values``, straight on beyond its ends.

    Parameters
    ----------
    values : float32, any shape
    x, y : float64 [K]
        At least two points; ``x`` increases.

    Returns
    -------
    float32 of the shape of ``values``. C++ and NumPy differ by rounding.
    """
    if len(x) < 2 or len(x) != len(y) or not (np.diff(x) > 0).all():
        raise ValueError("a curve needs two points or more, from left to right")
    slope = np.diff(y) / np.diff(x)
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        return curve_numpy(values, x, y, slope)
    out = np.empty(values.shape, np.float32)
    # Each piece by its left end; what lies left of all points belongs to the first piece.
    starts = np.column_stack([x[:-1], y[:-1], slope]).astype(np.float32)
    native.curve(np.ascontiguousarray(values, np.float32).reshape(-1), starts, out.reshape(-1), threads)
    return out


def curve_numpy(values: F32, x: F64, y: F64, slope: F64) -> F32:
    """NumPy twin."""
    piece = np.clip(np.searchsorted(x, values, side="right") - 1, 0, len(slope) - 1)
    return np.asarray(y[piece] + slope[piece] * (values - x[piece]), np.float32)
