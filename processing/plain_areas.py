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

from lfrig.processing.model import F32, F64
from lfrig.processing.patch import slopes
from lfrig.processing.tone import blurred


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


def find_plain_areas(
    grey: NDArray[np.int16], centre: NDArray[np.int16], offsets: F64, noise: float, settings: PlainSettings
) -> PlainAreas:
    """Solve the gradient constraint at every pixel, and say where it may be trusted.

    Parameters
    ----------
    grey : int16 [V, H, W]
        Views without the centre, grey × 64.
    centre : int16 [H, W]
    offsets : float64 [V, 2]
        (dr, dc) of the views.
    noise : float
        Standard deviation of the views' noise [grey levels].
    """
    import cv2

    own: F32 = np.asarray(centre / np.float32(64), np.float32)
    swell = 1 + settings.growth * noise
    blur, window = swell * settings.blur_px, swell * settings.window_px
    soft = blurred(own, blur)
    gx, gy = slopes(soft)
    by_row, by_column = np.zeros_like(own), np.zeros_like(own)
    power = np.zeros_like(_half(own))
    for (dr, dc), view in zip(offsets, grey, strict=True):
        difference: F32 = np.asarray(view / np.float32(64) - own, np.float32)
        by_row += np.float32(dr) * difference
        by_column += np.float32(dc) * difference
        power += blurred(_half(difference), blur / 2) ** 2
    by_row, by_column = blurred(by_row, blur), blurred(by_column, blur)
    rows, columns = (float((offsets[:, i] ** 2).sum()) for i in (0, 1))
    cross = float((offsets[:, 0] * offsets[:, 1]).sum())
    numerator = blurred(gx * by_column + gy * by_row, window)
    denominator = blurred(columns * gx**2 + 2 * cross * gx * gy + rows * gy**2, window)
    disparity: F32 = np.asarray(numerator / np.maximum(denominator, np.float32(1e-9)), np.float32)
    sigma2 = settings.noise_grey**2 + (NOISE_THROUGH_BLUR * 2 / blur * noise) ** 2
    precision: F32 = np.asarray(denominator * np.float32(settings.gain / sigma2), np.float32)
    total = cv2.resize(blurred(power, window / 2), own.shape[::-1], interpolation=cv2.INTER_LINEAR)
    left: F32 = np.asarray((total - disparity**2 * denominator) / np.float32(len(grey)), np.float32)
    fits = np.clip(2 - left / np.float32(2 * settings.misfit * sigma2), 0, 1)
    shift = np.abs(disparity) * np.float32(np.abs(offsets).max() / (settings.reach * blur))
    fits *= np.clip(2 - shift, 0, 1)
    return PlainAreas(disparity, precision, np.asarray(fits * _plainness(own, noise, settings), np.float32))


def blend_plain_cost(
    cost: F32, plain: PlainAreas, first: float, step: float, inverse_temperature: float, cap: float
) -> None:
    """Replace the cost of plain pixels, in place: float32 [H, W, D], grey levels; planes ``first + step·k``."""
    ys, xs = np.nonzero(plain.weight > 0)
    planes = np.float32(first) + np.float32(step) * np.arange(cost.shape[2], dtype=np.float32)
    rows = 65536
    for i in range(0, len(ys), rows):
        at = ys[i : i + rows], xs[i : i + rows]
        away = (planes - plain.disparity[at][:, None]) ** 2
        charge = np.minimum(
            away * (plain.precision[at] / np.float32(2 * inverse_temperature))[:, None], np.float32(cap)
        )
        w = plain.weight[at][:, None]
        cost[at] = (1 - w) * cost[at] + w * charge


def _plainness(own: F32, noise: float, settings: PlainSettings) -> F32:
    """1 where no gradient within the clearance exceeds the threshold, falling to 0 at twice the threshold."""
    import cv2

    light = blurred(own, 1.0)
    gx, gy = slopes(light)
    size = 2 * settings.clearance_px + 1
    steepest = cv2.dilate(np.hypot(gx, gy), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)))
    threshold = settings.edge_grey + settings.edge_per_noise * noise
    return np.asarray(np.clip(2 - steepest / np.float32(threshold), 0, 1), np.float32)


def _half(image: F32) -> F32:
    """At half size, each pixel the mean of four."""
    import cv2

    size = max(1, image.shape[1] // 2), max(1, image.shape[0] // 2)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.float32)
