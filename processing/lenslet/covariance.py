"""How alike a scene is at two points some distance apart: what the decoder's weights are optimal for."""

from __future__ import annotations

import numpy as np

from lfrig.processing.model import F64


def matern(distance: F64, reach: float) -> F64:
    """Matérn covariance of smoothness 5/2, 1 at distance 0; ``reach`` in the unit of the distance."""
    d = np.sqrt(5) * distance / reach
    return np.asarray((1 + d + d * d / 3) * np.exp(-d))
