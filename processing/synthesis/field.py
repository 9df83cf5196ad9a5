"""The disparity field of an output view, on the grid of that view.

Copying the centre's disparity instead costs 3 dB. The z-buffered field carries every surface point to the output view
and keeps the nearest; pixels whose surface the photo does not show (disoccluded) take the background's disparity.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfrig.processing.kernels.view_field import fill_holes, fixed_point, z_buffered_field
from lfrig.processing.model import F32
from lfrig.processing.synthesis.settings import DEFAULT_SYNTHESIS, Method, SynthesisSettings

HOLE_ROUNDS = 8
"""Of the yardsticks, whose results stay what they were: wider holes take the median disparity."""


def view_offsets(rows: int, cols: int) -> list[tuple[float, float]]:
    """(dr, dc) of every view from the centre of the grid, row-major."""
    return [(r - (rows - 1) / 2, c - (cols - 1) / 2) for r in range(rows) for c in range(cols)]


def view_field(
    disparity: F32, dr: float, dc: float, method: Method = "z_buffer", settings: SynthesisSettings = DEFAULT_SYNTHESIS
) -> tuple[F32, NDArray[np.bool_]]:
    """Disparity on the grid of the output view at offset (dr, dc), and which of its pixels the photo does not show.

    Returns
    -------
    field : float32 [H, W], hidden : bool [H, W]
    """
    if method == "fixed_point":
        return fixed_point(disparity, disparity.copy(), dr, dc, 6, np.inf), np.zeros(disparity.shape, bool)
    return z_buffered_field(disparity, dr, dc, settings.match_px, settings.hidden_px, HOLE_ROUNDS)


def fill_nan(disparity: F32) -> F32:
    """Unknown disparities replaced by the lowest known one of their neighbourhood, growing: the far side."""
    return fill_holes(np.where(np.isfinite(disparity), disparity, -np.inf).astype(np.float32), rounds=10_000)
