"""Corners of a light field's centre view and their disparities, by Gauss–Newton over its own border views.

The depth map answers for whole windows; a corner deserves better. Its patch is followed into eight views on the rim
of the aperture, where a disparity has its longest lever, and the one number that moves all eight patches is solved
for (Lucas & Kanade 1981, with the disparity as the only unknown).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lfrig.processing.kernels.corner_disparity import follow_disparities
from lfrig.processing.model import F64, U8, Evidence, LightField
from lfrig.processing.poses.patches import cut, square
from lfrig.processing.poses.picture import Picture, grey8_of, picture_of

MAX_CORNERS = 800
QUALITY = 0.002
"""Weakest corner accepted, as a fraction of the strongest one's smaller eigenvalue (Shi & Tomasi 1994)."""

SPACING_PX = 5
BLOCK_PX = 5

DISPARITY_HALF_PX = 4
DISPARITY_PASSES = 3
RIM = 4
"""Furthest view used, in view steps: the rim of a wide aperture is dark in real light fields."""

ROBUST_GREY = 6.0
MAX_STEP_PX = 0.05
SETTLED_PX = 0.02
MAX_CHANGE_PX = 0.06
"""A corner whose disparity moves further than this from the depth map's is on an edge, or has no disparity."""


@dataclass(frozen=True)
class Corners:
    """Corners of one centre view, strongest first: ``xy`` float64 [N, 2] px; ``disparity`` float64 [N] px per view
    step, NaN where the light field does not tell.
    """

    xy: F64
    disparity: F64

    def __len__(self) -> int:
        return len(self.xy)

    def first(self, count: int) -> Corners:
        """The strongest ones."""
        return Corners(self.xy[:count], self.disparity[:count])


def find_corners(even: U8, limit: int = MAX_CORNERS) -> F64:
    """Corners of a locally normalised image uint8 [H, W] (dim parts have theirs too), [N, 2] px."""
    import cv2

    found = cv2.goodFeaturesToTrack(even, limit, QUALITY, SPACING_PX, blockSize=BLOCK_PX)
    return np.zeros((0, 2)) if found is None else found.reshape(-1, 2).astype(np.float64)


def light_field_corners(
    light_field: LightField, evidence: Evidence, limit: int = MAX_CORNERS, *, picture: Picture | None = None
) -> Corners:
    """Corners of the centre view with their disparities; ``picture`` is that view, where it was prepared already."""
    picture = picture_of(light_field.centre_view) if picture is None else picture
    xy = find_corners(picture.even, limit)
    return Corners(xy, corner_disparities(light_field, evidence, xy, picture))


def rim_views(rows: int, cols: int, centre: tuple[int, int]) -> list[tuple[int, int]]:
    """The (row, col) of the eight views around the centre, as far out as the aperture (or `RIM`) goes."""
    reach = [(max(-RIM, -c), 0, min(RIM, n - 1 - c)) for n, c in zip((rows, cols), centre, strict=True)]
    return [(centre[0] + dr, centre[1] + dc) for dr in reach[0] for dc in reach[1] if dr or dc]


def corner_disparities(light_field: LightField, evidence: Evidence, xy: F64, picture: Picture) -> F64:
    """Disparities of corners [N, 2] px, float64 [N] px per view step; NaN where none is found near the depth map's.
    ``picture`` is the centre view.

    Brightness may differ from view to view (vignetting): each patch is compared without its mean.
    """
    import cv2

    if not len(xy):
        return np.zeros(0)
    at = np.rint(xy).astype(np.int64)
    start = cv2.medianBlur(evidence.disparity, 5)[at[:, 1], at[:, 0]].astype(np.float64)
    known = np.isfinite(start)
    rows, cols = light_field.angular
    centre = light_field.centre_index
    rim = rim_views(rows, cols, centre)
    pictures = np.stack([grey8_of(light_field.views[v]) for v in rim])
    offsets = np.array([(c - centre[1], r - centre[0]) for r, c in rim], np.float64)
    window = square(DISPARITY_HALF_PX)
    reference = cut(picture.detail, xy, window)
    disparity, step = follow_disparities(
        pictures, offsets, (reference.grey, reference.slope_x, reference.slope_y), window, xy,
        np.where(known, start, 0.0), passes=DISPARITY_PASSES, max_step_px=MAX_STEP_PX, robust_grey=ROBUST_GREY,
        threads=1,
    )  # fmt: skip
    good = known & (np.abs(step) < SETTLED_PX) & (np.abs(disparity - start) < MAX_CHANGE_PX)
    return np.where(good, disparity, np.nan)
