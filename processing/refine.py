"""Surface → better surface: plane fits that take plane quantisation out, and a snap to the photo's edges."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from lfrig.processing.kernels.edge_snap import edge_snap
from lfrig.processing.kernels.plane_fit import local_planes
from lfrig.processing.model import F32, U8
from lfrig.processing.plane_fit import Planes
from lfrig.processing.skipping import SKIP_ALL, Skips, Tally


@dataclass(frozen=True)
class RefineSettings:
    """Knobs; inverse depths are relative to the target's disparity scale (px per view step)."""

    smooth: bool = True
    smooth_radius: int = 6
    smooth_strides: tuple[int, ...] = (2, 3)
    """Of the plane fits, one after the other [px]: a quarter and a ninth of the neighbours do as well as all."""
    smooth_sigma_px: float = 0.028
    smooth_sigma_grey: float = 40.0
    support_px: float = 0.06
    """A source supports the surface when its own disparity agrees this well."""
    snap: bool = True
    snap_radius: int = 3
    snap_threshold_px: float = 0.0175
    snap_search: int = 5
    """How far away the value may be that a pixel takes [px]."""
    snap_sigma_grey: float = 25.5
    snap_median: int = 3
    """Side of the median that takes single odd pixels out after the snap; 0 or 1 = none."""


SMOOTH_RIDGE = 20.0
"""Pulls slopes to 0 where few neighbours count, of fits to every pixel; the sums of the others are smaller."""

DEFAULT_REFINE = RefineSettings()


def smooth(
    inverse_depth: F32, peak: F32, photo: U8, px_per_inverse: float, settings: RefineSettings, *, threads: int = 0
) -> Planes:
    """Rounds of bilateral plane fits: the surface without plane quantisation, steps kept, and its slopes.

    ``px_per_inverse`` is b·F of the requested light field [px·m].
    """
    everywhere = np.ones(inverse_depth.shape, bool)
    weight = peak**2 + np.float32(1e-3)
    planes = None
    for stride in settings.smooth_strides:
        value = inverse_depth if planes is None else planes.value
        v, gx, gy, _ = local_planes(
            value, weight, photo, everywhere, radius=settings.smooth_radius, stride=stride,
            sigma_value=settings.smooth_sigma_px / px_per_inverse, sigma_grey=settings.smooth_sigma_grey,
            ridge=SMOOTH_RIDGE / stride**2, threads=threads,
            slopes=None if planes is None else (planes.slope_x, planes.slope_y),
        )  # fmt: skip
        planes = Planes(*(part.reshape(inverse_depth.shape) for part in (v, gx, gy)))
    assert planes is not None
    return planes


def snap_to_edges(
    inverse_depth: F32,
    photo: U8,
    px_per_inverse: float,
    settings: RefineSettings,
    *,
    skips: Skips = SKIP_ALL,
    tally: Tally | None = None,
    threads: int = 0,
) -> F32:
    """Pixels that disagree with the weighted median of their neighbourhood take a neighbour's value near to it.

    Edges are left ragged by single pixels, which a small plain median takes back. Where all values of a window are
    within the threshold of each other there is nothing to ask.
    """
    import cv2

    threshold = settings.snap_threshold_px / px_per_inverse
    start = time.process_time()
    rough = np.ones(inverse_depth.shape, bool)
    if skips.certain:
        window = np.ones((2 * settings.snap_radius + 1,) * 2, np.uint8)
        rough = np.asarray(cv2.dilate(inverse_depth, window) - cv2.erode(inverse_depth, window) > threshold)
    out = edge_snap(
        inverse_depth, photo, rough, radius=settings.snap_radius,
        search=settings.snap_search, sigma_grey=settings.snap_sigma_grey, threshold=threshold,
        per_step=1e-3 * float(inverse_depth.max() - inverse_depth.min()), threads=threads,
    )  # fmt: skip
    if tally is not None:
        done = int(rough.sum())
        tally.add("certain", done, rough.size - done, "pixels near edges", time.process_time() - start)
    return out if settings.snap_median < 3 else np.asarray(cv2.medianBlur(out, settings.snap_median), np.float32)
