"""Knobs of the disparity evidence of one light field, and the planes that it is computed on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lfrig.contracts.errors import BadInput
from lfrig.processing.kernels.plane_cost import PlaneGrid
from lfrig.processing.plain_areas import DEFAULT_PLAIN, PlainSettings
from lfrig.processing.plane_search import DEFAULT_SEARCH, Matching, SearchSettings


@dataclass(frozen=True)
class DpvSettings:
    """Knobs of the sweep; grey levels are of 0..255. Chosen on the tuning scenes (docs/benchmarks.md)."""

    plane_step_px: float = 0.022
    min_planes: int = 16
    max_planes: int = 160
    truncation_grey: float = 23.0
    p1_grey: float = 0.15
    p2_grey: float = 3.0
    edge_grey: float = 12.0
    inverse_temperature: float = 4.0
    """Softmax sharpness per grey level of aggregated cost, on clean views."""
    window: int = 3
    """Half width, in planes, of the regression around the peak."""
    occlusion_aware: bool = True
    occlusion_gap_px: float = 0.3
    """A disparity step of this size within ``occlusion_radius`` pixels asks for the half-aperture test."""
    occlusion_radius: int = 4
    occlusion_bias_grey: float = 0.25
    """What a half of the aperture must be better than all of it: keeps noise from choosing halves."""
    plain: PlainSettings = DEFAULT_PLAIN
    clipped_blur_px: float = 1.0
    """Blur of the views where they clip; 0 = none (see `matching_views`). 1.5 is a little better in large
    clipped areas and worse beside small ones."""
    noise_share: float = 0.8
    """How fast penalties grow, and the temperature rises, per grey level of noise."""
    search: SearchSettings = DEFAULT_SEARCH
    quiet_grey: float = 1.0
    """Noise up to which the star of views is as good as all of them."""

    def matching(self, step_px: float) -> Matching:
        """How costs of planes ``step_px`` apart are matched."""
        return Matching(
            self.truncation_grey, self.p1_grey, self.p2_grey, self.edge_grey, step_px, self.inverse_temperature,
            self.noise_share,
        )  # fmt: skip


DEFAULT_DPV = DpvSettings()


def plane_grid(disparity_range: tuple[float, float], settings: DpvSettings) -> PlaneGrid:
    """Planes that cover ``disparity_range`` at about ``plane_step_px``.

    Raises
    ------
    BadInput
        The range is empty, reversed or not finite.
    """
    lo, hi = map(float, disparity_range)
    if not (np.isfinite([lo, hi]).all() and lo < hi):
        raise BadInput(
            f"disparity range {lo:g}:{hi:g} is empty", field="disparity-range", remedy="give LO:HI with LO < HI"
        )
    count = int(np.clip(np.ceil((hi - lo) / settings.plane_step_px) + 1, settings.min_planes, settings.max_planes))
    return PlaneGrid(lo, (hi - lo) / (count - 1), count)
