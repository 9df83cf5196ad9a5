"""Which pixels are scored: all but a border, and among them depth edges and textureless areas."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.errors import BadInput
from lfrig.processing.model import F32, U8

Mask = NDArray[np.bool_]

BORDER_PX = 15
"""Pixels at the frame's border that are not scored: half of a matching window plus the reach of a corner
view."""

EDGE_JUMP = 0.02
"""A depth discontinuity is a step of more than this fraction of the depth between adjacent pixels. A plane
reaches that only when it is tilted by more than 87° (focal length 1045 px; 79° at a quarter of the size), so
slants are not edges, and a step below it is less than 0.03 px of disparity at bF = 0.70 px·m and half a
metre."""

EDGE_RADIUS_PX = 3
"""Pixels this close (chessboard distance) to a depth discontinuity are edge pixels."""

TEXTURE_SIGMA_PX = 1.0
TEXTURE_WINDOW_PX = 9
TEXTURELESS_GRADIENT = 2.0
"""Textureless: the root mean square gradient of the luma, smoothed by a Gaussian of `TEXTURE_SIGMA_PX`, over
a window of `TEXTURE_WINDOW_PX`² is below this many grey levels (of 255) per pixel: one grey level of noise
then moves a match between two pixels by half a pixel or more."""


def inner_region(shape: tuple[int, int], border_px: int = BORDER_PX) -> tuple[slice, slice]:
    """The rows and columns of an [H, W] frame without its border.

    Raises
    ------
    BadInput
        Nothing is left.
    """
    if min(shape) <= 2 * border_px:
        raise BadInput(
            f"a {shape[1]}×{shape[0]} frame has nothing left inside a border of {border_px} px",
            field="border_px", remedy="score larger pictures, or a narrower border",
        )  # fmt: skip
    return slice(border_px, shape[0] - border_px), slice(border_px, shape[1] - border_px)


def depth_edges(inverse_depth: F32, *, jump: float = EDGE_JUMP, radius_px: int = EDGE_RADIUS_PX) -> Mask:
    """Pixels within ``radius_px`` of a depth discontinuity.

    Parameters
    ----------
    inverse_depth : float32 [H, W]
        True inverse depth in any unit (only ratios count); 0 = infinitely far, NaN = unknown (no edge by
        itself).
    jump : float
        Smallest relative step |w₁ − w₂| / max(w₁, w₂) between 4-neighbours that is a discontinuity.

    Returns
    -------
    bool [H, W]
    """
    import cv2

    steps = np.zeros(inverse_depth.shape, np.uint8)
    for axis in (0, 1):
        first = [slice(None), slice(None)]
        second = [slice(None), slice(None)]
        first[axis], second[axis] = slice(None, -1), slice(1, None)
        a, b = inverse_depth[tuple(first)], inverse_depth[tuple(second)]
        with np.errstate(invalid="ignore"):
            found = np.abs(a - b) > jump * np.maximum(a, b)
        # Both sides of the step are at distance 0 of it.
        steps[tuple(first)] |= found
        steps[tuple(second)] |= found
    size = 2 * radius_px + 1
    return np.asarray(cv2.dilate(steps, np.ones((size, size), np.uint8)) > 0)


def textureless(image: U8, *, gradient: float = TEXTURELESS_GRADIENT) -> Mask:
    """Pixels around which the picture hardly changes (see `TEXTURELESS_GRADIENT`).

    Parameters
    ----------
    image : uint8 [H, W, 3] RGB
        The photo; a noise-free one where there is one, because noise looks like texture.
    gradient : float
        Threshold in grey levels per pixel.

    Returns
    -------
    bool [H, W]
    """
    import cv2

    luma = cv2.GaussianBlur(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32), (0, 0), TEXTURE_SIGMA_PX)
    # Central differences; Sobel of aperture 1 has no smoothing across and a factor of 2.
    dx = cv2.Sobel(luma, cv2.CV_32F, 1, 0, ksize=1, scale=0.5)
    dy = cv2.Sobel(luma, cv2.CV_32F, 0, 1, ksize=1, scale=0.5)
    mean_square = cv2.boxFilter(dx * dx + dy * dy, -1, (TEXTURE_WINDOW_PX, TEXTURE_WINDOW_PX))
    return np.asarray(mean_square < gradient**2)
