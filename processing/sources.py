"""What the sources of one session usually are like."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lfrig.processing.model import Source


def usual_noise(sources: Sequence[Source]) -> float:
    """Median noise of their views [grey levels]."""
    return float(np.median([source.evidence.noise_sigma for source in sources]))


def usual_slope(sources: Sequence[Source]) -> float:
    """Median of 1/m per px per view step: one of their px in inverse depth."""
    return float(np.median([abs(source.scale.a) for source in sources]))


def usual_step(sources: Sequence[Source]) -> float:
    """Median distance of the planes of their evidence [px per view step]."""
    return float(np.median([source.evidence.planes_px[1] for source in sources]))
