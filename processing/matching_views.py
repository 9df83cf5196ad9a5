"""The views of a light field as matching sees them: grey, at full and half size, softened where they clip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lfrig.contracts.errors import BadInput
from lfrig.processing.kernels.clipping import soften_clipped
from lfrig.processing.kernels.grey import GreyViews, grey_views, halved
from lfrig.processing.kernels.plane_cost import MARGIN
from lfrig.processing.model import LightField
from lfrig.processing.tone import NO_TEXTURE_GREY, SATURATED_GREY

LIMIT_PX = 4.0
"""Disparities [px per view step] up to which a light field is searched unless a range is given."""
CLIPPED_REACH_PX = 3
"""How far from a clipped pixel the views are softened: over the strokes between clipped areas."""


@dataclass(frozen=True)
class MatchingViews:
    """Grey views with margins for disparities up to ``limit_px``; ``half`` at half size."""

    full: GreyViews
    half: GreyViews
    limit_px: float


def matching_views(
    light_field: LightField, clipped_blur_px: float, *, limit_px: float = LIMIT_PX, threads: int = 0
) -> MatchingViews:
    """Grey views of a light field; ``clipped_blur_px`` is the blur where they clip (0 = none).

    Clipping comes after the lens and the pixel have filtered the light, and puts frequencies back that the grid cannot
    carry. Interpolated between pixels, such strokes match worse than unmoved: disparity is drawn to zero, where nothing
    is interpolated, by more than what the true plane wins. Only where all channels clip: where one does, luma keeps its
    shape, and large bright squares that repeat lose what little tells them apart.

    Raises
    ------
    BadInput
        The centre view is constant (a lens cap, a uniform wall): there is nothing to match.
    """
    _refuse_constant(light_field)
    colour = light_field.views.reshape(-1, *light_field.views.shape[2:])
    row, column = light_field.centre_index
    offsets = light_field.offsets().reshape(-1, 2)
    reach = limit_px * float(np.abs(offsets).max())
    full = grey_views(
        colour, offsets, row * light_field.angular[1] + column, int(np.ceil(reach)) + MARGIN, threads=threads
    )
    if clipped_blur_px > 0:
        soften_clipped(full, colour, SATURATED_GREY, clipped_blur_px, CLIPPED_REACH_PX, threads=threads)
    return MatchingViews(full, halved(full, int(np.ceil(reach / 2)) + MARGIN, threads=threads), limit_px)


def _refuse_constant(light_field: LightField) -> None:
    import cv2

    if float(cv2.meanStdDev(light_field.centre_view)[1].max()) < NO_TEXTURE_GREY:
        raise BadInput(
            "the centre view is constant: nothing can be matched in it",
            path=light_field.id,
            field="views",
            code="constant-image",
            remedy="check the exposure and the lens cap, or leave this capture out",
        )
