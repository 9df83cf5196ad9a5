"""Disparity of plain, softly shaded areas: the gradient constraint of a light field, in least squares.

Where nothing but shading changes, views differ by less than a grey level. Absolute differences of 8-bit values are
then biased towards zero disparity, where equal values meet equal ones; squares of blurred views are not: rounding
averages out as dither, and shading of 0.05 grey levels per pixel still gives disparity to 0.01 px. With the blurred
views B_v at offsets (r, c) and the gradient (gx, gy) of the centre view,

    B_v − B_0 = δ (c·gx + r·gy),   so   δ = (gx Σ c B_v + gy Σ r B_v) / (gx² Σ c² + gy² Σ r²),

two weighted sums of the views (Adelson & Wang, PAMI 1992). Errors of even order cancel between opposite views. It
holds away from edges only, where no occlusion mixes into the blur, and where the shading is straight over the distance
that the views move: both are tested, the second by how well all views fit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfrig.processing.kernels.grey import GreyViews, as_grey
from lfrig.processing.kernels.plain_cost import blend_plain, difference_power, view_moments
from lfrig.processing.kernels.plane_cost import COST_UNIT, PlaneGrid
from lfrig.processing.model import F32
from lfrig.processing.patch import slopes
from lfrig.processing.tone import blurred

I16 = NDArray[np.int16]
U16 = NDArray[np.uint16]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class PlainSettings:
    """Knobs; grey levels of 0..255."""

    enabled: bool = True
    blur_px: float = 2.0
    window_px: float = 1.75
    """Standard deviation of the window over which the constraint is solved (on clean views)."""
    growth: float = 0.2
    """How fast blur and window grow per grey level of noise."""
    clearance_px: int = 6
    """Distance kept from edges."""
    edge_grey: float = 0.8
    """Gradient per pixel, lightly blurred, up to which nothing is an edge (on clean views)."""
    edge_per_noise: float = 1.0
    """How much higher that limit is per grey level of noise."""
    noise_grey: float = 0.05
    """Standard deviation of the blurred views on clean views: what rounding leaves."""
    reach: float = 0.7
    """Shift between the outermost views and the centre, in blurs, up to which shading counts as straight."""
    misfit: float = 2.0
    """Up to this multiple of the noise variance, views may differ from the constraint."""
    cap_grey: float = 0.7
    """The most that a plane is charged [grey levels of matching cost]."""
    gain: float = 0.5


DEFAULT_PLAIN = PlainSettings()
NOISE_THROUGH_BLUR = 0.14
"""Share of white noise that a Gaussian blur of 2 px leaves; it falls with the blur."""


@dataclass(frozen=True)
class PlainAreas:
    """``disparity`` float32 [H, W] px per view step; ``precision`` float32 [H, W] 1/px²; ``weight`` float32 [H, W],
    0..1, how far a pixel is plain.
    """

    disparity: F32
    precision: F32
    weight: F32

    def halved(self) -> PlainAreas:
        """On views of half size, in their pixels."""
        height, width = (max(1, n // 2) for n in self.weight.shape)
        parts = (self.disparity * np.float32(0.5), self.precision * np.float32(4), self.weight)
        return PlainAreas(*(np.ascontiguousarray(part[::2, ::2][:height, :width], np.float32) for part in parts))


def find_plain_areas(
    views: GreyViews, half: GreyViews, noise: float, settings: PlainSettings, *, threads: int = 0
) -> PlainAreas:
    """Solve the gradient constraint at every pixel, and say where it may be trusted.

    Parameters
    ----------
    views, half : GreyViews
        The views, and the same at half size.
    noise : float
        Standard deviation of the views' noise [grey levels].
    """
    own = as_grey(views.images[views.centre])
    weight = _plainness(own, noise, settings)
    if not weight.any():
        return PlainAreas(np.zeros_like(own), np.zeros_like(own), weight)
    swell = 1 + settings.growth * noise
    blur, window = swell * settings.blur_px, swell * settings.window_px
    gx, gy = slopes(blurred(own, blur))
    solved = _near(weight > 0, window)
    moments = view_moments(views, _near(solved, blur), threads=threads)
    by_row, by_column = (blurred(sums, blur) for sums in moments)
    offsets = views.offsets[views.others()]
    rows, columns = (float((offsets[:, i] ** 2).sum()) for i in (0, 1))
    cross = float((offsets[:, 0] * offsets[:, 1]).sum())
    numerator = blurred(gx * by_column + gy * by_row, window)
    denominator = blurred(columns * gx**2 + 2 * cross * gx * gy + rows * gy**2, window)
    disparity: F32 = np.asarray(numerator / np.maximum(denominator, np.float32(1e-9)), np.float32)
    sigma2 = settings.noise_grey**2 + (NOISE_THROUGH_BLUR * 2 / blur * noise) ** 2
    precision: F32 = np.asarray(denominator * np.float32(settings.gain / sigma2), np.float32)
    power = difference_power(half, blur / 2, _at_half_size(solved, half), threads=threads)
    total = _at_full_size(blurred(power, window / 2), own.shape)
    left: F32 = np.asarray((total - disparity**2 * denominator) / np.float32(len(offsets)), np.float32)
    weight *= np.clip(2 - left / np.float32(2 * settings.misfit * sigma2), 0, 1)
    shift = np.abs(disparity) * np.float32(np.abs(offsets).max() / (settings.reach * blur))
    weight *= np.clip(2 - shift, 0, 1)
    return PlainAreas(disparity, precision, weight)


def blend_plain_cost(
    cost: U16,
    grid: PlaneGrid,
    plain: PlainAreas,
    inverse_temperature: float,
    cap_grey: float,
    *,
    span: I16 | None = None,
    threads: int = 0,
) -> None:
    """Replace the cost of plain pixels, in place: uint16 [H, W, D], `COST_UNIT` per grey level.

    ``inverse_temperature`` is per grey level of aggregated cost.
    """
    steepness: F32 = plain.precision * np.float32(COST_UNIT / (2 * inverse_temperature))
    blend_plain(
        cost, grid, plain.disparity, steepness, plain.weight, cap_grey * COST_UNIT, span=span, threads=threads
    )  # fmt: skip


def _near(area: Mask, blur: float) -> Mask:
    """What a Gaussian blur of the area reads, bool [H, W]."""
    import cv2

    size = 2 * int(np.ceil(4 * blur) + 1) + 1
    return np.asarray(cv2.dilate(area.view(np.uint8), np.ones((size, size), np.uint8))).view(np.bool_)


def _at_half_size(area: Mask, half: GreyViews) -> Mask:
    """An area that spans several pixels, bool [H/2, W/2], and a pixel beyond."""
    import cv2

    part = np.ascontiguousarray(area[::2, ::2][: half.height, : half.width]).view(np.uint8)
    return np.asarray(cv2.dilate(part, np.ones((3, 3), np.uint8))).view(np.bool_)


def _at_full_size(image: F32, shape: tuple[int, ...]) -> F32:
    """An image of half size at full size; an odd last row or column repeats its neighbour."""
    import cv2

    doubled = cv2.resize(image, None, fx=2, fy=2, interpolation=cv2.INTER_LINEAR)[: shape[0], : shape[1]]
    below, right = shape[0] - doubled.shape[0], shape[1] - doubled.shape[1]
    return np.asarray(cv2.copyMakeBorder(doubled, 0, below, 0, right, cv2.BORDER_REPLICATE), np.float32)


def _plainness(own: F32, noise: float, settings: PlainSettings) -> F32:
    """1 where no gradient within the clearance exceeds the threshold, falling to 0 at twice the threshold."""
    import cv2

    light = blurred(own, 1.0)
    gx, gy = slopes(light)
    size = 2 * settings.clearance_px + 1
    steepest = cv2.dilate(np.hypot(gx, gy), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)))
    threshold = settings.edge_grey + settings.edge_per_noise * noise
    return np.asarray(np.clip(2 - steepest / np.float32(threshold), 0, 1), np.float32)
