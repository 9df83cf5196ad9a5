"""Noise of the views, from how well they match at best."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfrig.processing.kernels.plane_cost import COST_UNIT
from lfrig.processing.kernels.softmax import summarise

NOISE_PER_FLOOR = 1.37
CLEAN_FLOOR_GREY = 0.4
EVERY = 4
"""Of rows and columns, the ones that are asked: their floor is that of all to 0.02 grey levels."""
NOISE_PER_HALF = 1.7
"""Noise of views, as measured, per noise of the same at half size: a pixel there is the mean of four, but matched with
less interpolation (measured at 2 to 10 grey levels)."""


def noise_of_cost(
    cost: NDArray[np.uint16],
    *,
    span: NDArray[np.int16] | None = None,
    edges: NDArray[np.bool_] | None = None,
    threads: int = 0,
) -> float:
    """Noise standard deviation [grey levels] from the floor of the matching cost [H, W, D], outside ``edges``.

    Where the right plane is among the candidates the views differ by noise alone; the tenth percentile over the image
    of the best plane's cost avoids edges and wrong planes. On views with known noise this floor is σ/1.37 above a
    clean floor of about 0.4 (interpolation and the box average part of the noise away, the best of many planes is
    lower still).
    """
    lowest = summarise(cost, span=span, every=EVERY, threads=threads).lowest
    if edges is not None and not edges.all():
        lowest = lowest[~edges[::EVERY, ::EVERY]]
    rank = lowest.size // 10
    floor = float(np.partition(lowest, rank, axis=None)[rank]) / COST_UNIT
    return NOISE_PER_FLOOR * float(np.sqrt(max(0.0, floor**2 - CLEAN_FLOOR_GREY**2)))
