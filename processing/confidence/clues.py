"""What the stages hand on for judging a surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lfrig.processing.model import F32, U8, Camera, Pose, Source
from lfrig.processing.plane_fit import Planes
from lfrig.processing.sources import usual_slope
from lfrig.processing.visibility import Landing
from lfrig.processing.wide_baseline import WideMatch


@dataclass(frozen=True)
class Clues:
    """The surface on its way through the stages, and what it was judged by.

    Inverse depths float32 [H, W] in 1/m: ``fused`` after the regularisation, ``planes`` after smoothing, ``match``
    after the wide-baseline refinement, ``decided`` after the edge test, ``surface`` at the end. ``peak`` float32 [H, W]
    is the share of the regularised evidence at the best plane, ``photo`` uint8 [H, W, 3]; ``landings`` say where the
    final surface lies in each of the ``sources``.
    """

    fused: F32
    peak: F32
    planes: Planes
    match: WideMatch
    decided: F32
    surface: F32
    photo: U8
    sources: Sequence[Source]
    landings: Sequence[Landing]
    camera: Camera
    pose: Pose

    @property
    def unit(self) -> float:
        """1/m per px per view step of the sources: errors are a matter of their pixels, whatever is asked for."""
        return usual_slope(self.sources)

    @property
    def scale_sigma(self) -> float:
        """Relative standard deviation of the scale that all poses share, from the position the rig leaves open."""
        sigma_m = np.median([*(source.pose.sigma_m for source in self.sources), self.pose.sigma_m])
        return float(sigma_m * abs(np.median(self.surface)))
