"""Surface → better surface: support by the sources, unseen areas from the far side, a snap to the photo's edges.

The wide-baseline refinement (slanted bilateral ZNCC of the photo against the sources' centre views, in a narrow band
around this surface) takes its place between `smooth` and `edges.decide_edges`; it needs what they share: the surface,
its slopes, and which source sees what.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfrig.processing.geometry import project, projection
from lfrig.processing.model import F32, U8, Camera, Pose, Source
from lfrig.processing.plane_fit import local_planes


@dataclass(frozen=True)
class RefineSettings:
    """Knobs; inverse depths are relative to the target's disparity scale (px per view step)."""

    smooth: bool = True
    smooth_radius: int = 5
    smooth_sigma_px: float = 0.028
    smooth_sigma_grey: float = 40.0
    far_side_fill: bool = False
    """Off by default: since surfaces come from SGM and edges are tested, it loses on the tuning scenes (it won where a
    pixel took its own best plane)."""
    support_px: float = 0.06
    """A source supports the surface when its own disparity agrees this well."""
    low_confidence: float = 0.15
    low_peak: float = 0.3
    fill_radius: int = 24
    fill_stride: int = 3
    fill_gap_px: float = 0.17
    """Near and far neighbours this far apart count as two surfaces; the far one is continued."""
    fill_window: int = 49
    fill_sigma_grey: float = 25.0
    snap: bool = True
    snap_radius: int = 3
    snap_threshold_px: float = 0.0175
    snap_sigma_grey: float = 25.5
    snap_median: int = 3
    """Side of the median that takes single odd pixels out after the snap; 0 or 1 = none."""


DEFAULT_REFINE = RefineSettings()


def support(
    inverse_depth: F32, sources: Sequence[Source], camera: Camera, pose: Pose, settings: RefineSettings
) -> tuple[F32, NDArray[np.bool_]]:
    """How many sources see each surface point and agree with it.

    Returns
    -------
    agreeing : float32 [H, W]
    in_view : bool [H, W], inside at least one source's frame.
    """
    import cv2

    ys, xs = np.mgrid[0 : camera.height, 0 : camera.width].astype(np.float32)
    agreeing = np.zeros(inverse_depth.shape, np.float32)
    in_view = np.zeros(inverse_depth.shape, bool)
    for source in sources:
        u, v, w = project(*projection(camera, pose, source.camera, source.pose), xs, ys, inverse_depth)
        u, v = np.nan_to_num(u, nan=-9e3), np.nan_to_num(v, nan=-9e3)
        own = cv2.remap(
            source.evidence.disparity, u, v, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=1e3
        )
        agreeing += np.abs(source.scale.disparity(w) - own) < settings.support_px
        in_view |= (u >= 0) & (v >= 0) & (u <= source.camera.width - 1) & (v <= source.camera.height - 1)
    return agreeing, in_view


def smooth(inverse_depth: F32, peak: F32, photo: U8, px_per_inverse: float, settings: RefineSettings) -> F32:
    """Two rounds of bilateral plane fits: the surface without plane quantisation, steps kept.

    ``px_per_inverse`` is b·F of the requested light field [px·m].
    """
    everywhere = np.ones(inverse_depth.shape, bool)
    surface, slopes = inverse_depth, None
    for _ in range(2):
        v, gx, gy, _ = local_planes(
            surface, peak**2 + np.float32(1e-3), photo, everywhere, radius=settings.smooth_radius,
            sigma_value=settings.smooth_sigma_px / px_per_inverse, sigma_grey=settings.smooth_sigma_grey, ridge=20.0,
            slopes=slopes,
        )  # fmt: skip
        surface = v.reshape(surface.shape)
        slopes = gx.reshape(surface.shape), gy.reshape(surface.shape)
    return surface


def fill_unseen(
    inverse_depth: F32,
    confidence: F32,
    unseen: NDArray[np.bool_],
    photo: U8,
    px_per_inverse: float,
    limits: tuple[float, float],
    settings: RefineSettings,
) -> F32:
    """Continue the surface into pixels that no source saw, from the far side where near and far meet.

    What a source cannot see beside an object is what the object hides, so it belongs to the surface behind. Planes
    are extrapolated from confident neighbours within ``fill_radius``; ``limits`` bound the result [1/m].
    """
    import cv2

    if not unseen.any():
        return inverse_depth
    window = np.ones((settings.fill_window, settings.fill_window), np.uint8)
    trusted = confidence > 0.2
    lowest = cv2.erode(np.where(trusted, inverse_depth, np.float32(1e9)), window)
    highest = cv2.dilate(np.where(trusted, inverse_depth, np.float32(-1e9)), window)
    two_surfaces = (highest - lowest) * px_per_inverse > settings.fill_gap_px
    ceiling = np.where(two_surfaces, 0.5 * (lowest + highest), np.float32(np.inf)).astype(np.float32)
    v, _, _, strength = local_planes(
        inverse_depth, confidence + np.float32(1e-6), photo, unseen, radius=settings.fill_radius,
        stride=settings.fill_stride, sigma_value=1e6, sigma_grey=settings.fill_sigma_grey, ridge=400.0, ceiling=ceiling,
    )  # fmt: skip
    out = inverse_depth.copy()
    out[unseen] = np.where(strength > 1e-3, np.clip(v, *limits), out[unseen])
    return out


def snap_to_edges(inverse_depth: F32, photo: U8, px_per_inverse: float, settings: RefineSettings) -> F32:
    """Pixels that disagree with the weighted median of their neighbourhood take a neighbour's value near to it.

    The weighted median runs on 8-bit values, so it only decides; values always come from the map, without its steps.
    Edges are left ragged by single pixels, which a small plain median takes back.
    """
    import cv2

    lo, hi = float(inverse_depth.min()), float(inverse_depth.max())
    if hi - lo <= 0:
        return inverse_depth
    coded = np.uint8(np.clip((inverse_depth - lo) / (hi - lo) * 255 + 0.5, 0, 255))
    # The filter clusters colours with OpenCV's global random state: the same seed gives the same bytes.
    cv2.setRNGSeed(0)
    median = cv2.ximgproc.weightedMedianFilter(
        np.ascontiguousarray(photo), coded, settings.snap_radius, settings.snap_sigma_grey
    )
    wanted = lo + (hi - lo) * median.astype(np.float32) / 255
    threshold = settings.snap_threshold_px / px_per_inverse + 0.5 * (hi - lo) / 255
    bad = np.abs(inverse_depth - wanted) > threshold
    ys, xs = np.nonzero(bad)
    best, distance = wanted[bad], np.full(len(ys), 1e9, np.float32)
    reach = 5
    for dy in range(-reach, reach + 1):
        for dx in range(-reach, reach + 1):
            y, x = np.clip(ys + dy, 0, bad.shape[0] - 1), np.clip(xs + dx, 0, bad.shape[1] - 1)
            value = inverse_depth[y, x]
            off = np.abs(value - wanted[bad]) + 1e-3 * (abs(dx) + abs(dy)) * np.float32(hi - lo)
            closer = off < distance
            best = np.where(closer, value, best)
            distance = np.where(closer, off, distance)
    out = inverse_depth.copy()
    out[bad] = best
    return out if settings.snap_median < 3 else np.asarray(cv2.medianBlur(out, settings.snap_median), np.float32)
