"""Light field → disparity evidence (the DPV): how likely each disparity is at each pixel of the centre view.

A photo-consistency sweep over all views with truncated absolute differences, semi-global aggregation, and a softmax
whose temperature and penalties follow the measured noise. The paper reads the DPV from EPI slopes (after Chen et al.
2018); this sweep replaces it at the same module boundary.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.errors import BadInput
from lfrig.contracts.progress import Monitor
from lfrig.processing.kernels.plane_cost import grey_views, plane_cost
from lfrig.processing.kernels.sgm import aggregate
from lfrig.processing.kernels.softmax import softmax_peak
from lfrig.processing.model import F32, U8, Evidence, LightField
from lfrig.processing.plain_areas import DEFAULT_PLAIN, PlainSettings, blend_plain_cost, find_plain_areas
from lfrig.processing.tone import NO_TEXTURE_GREY, SATURATED_GREY, blurred


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
    """Blur of the views where they clip; 0 = none (see `_soften_clipped`). 1.5 is a little better in large
    clipped areas and worse beside small ones."""
    noise_share: float = 0.8
    """How fast penalties grow, and the temperature rises, per grey level of noise."""


DEFAULT_DPV = DpvSettings()
NOISE_PER_FLOOR = 1.37
CLEAN_FLOOR_GREY = 0.4


def light_field_evidence(
    light_field: LightField,
    disparity_range: tuple[float, float],
    settings: DpvSettings = DEFAULT_DPV,
    *,
    threads: int = 0,
    monitor: Monitor | None = None,
) -> Evidence:
    """Disparity evidence of one light field.

    Parameters
    ----------
    disparity_range : (lo, hi)
        Disparities to consider [px per view step]; see `auto_range`.

    Returns
    -------
    Evidence
        On the grid of the centre view.

    Raises
    ------
    BadInput
        The views are constant: there is nothing to match.
    """
    refuse_constant(light_field)
    first, step, planes = plane_grid(disparity_range, settings)
    grey, centre, offsets = _split_views(light_field, settings.clipped_blur_px)
    cost = plane_cost(
        grey, centre, offsets, first, step, planes, settings.truncation_grey, threads=threads, monitor=monitor
    )
    noise = noise_of_cost(cost)
    swell = 1.0 + settings.noise_share * noise
    smooth = partial(
        aggregate, guide=light_field.centre_view, p1=settings.p1_grey * swell, p2=settings.p2_grey * swell,
        edge_grey=settings.edge_grey, threads=threads, monitor=monitor,
    )  # fmt: skip
    plain = None
    if settings.plain.enabled:
        plain = find_plain_areas(grey, centre, offsets, noise, settings.plain)
        blend_plain_cost(cost, plain, first, step, settings.inverse_temperature / swell, settings.plain.cap_grey)
    total = smooth(cost)
    tested = 0.0
    if settings.occlusion_aware:
        edges = disparity_steps(total.argmin(2) * np.float32(step), settings)
        tested = float(edges.mean())
        if tested:
            sweep = partial(
                plane_cost, centre=centre, first=first, step=step, planes=planes,
                truncation=settings.truncation_grey, active=edges, threads=threads, monitor=monitor,
            )  # fmt: skip
            halves = [offsets[:, 0] < 0, offsets[:, 0] > 0, offsets[:, 1] < 0, offsets[:, 1] > 0]
            for half in halves:
                part = sweep(np.ascontiguousarray(grey[half]), offsets=offsets[half])
                cost[edges] = np.minimum(cost[edges], part[edges] + np.float32(settings.occlusion_bias_grey))
            total = smooth(cost)
    del cost
    probability, index, confidence = softmax_peak(
        total, settings.inverse_temperature / swell, settings.window, threads=threads
    )
    disparity = np.asarray(first + step * index, np.float32)
    return Evidence(probability, (first, step), disparity, confidence, noise, len(offsets) + 1, tested)


def disparity_steps(disparity: F32, settings: DpvSettings) -> NDArray[np.bool_]:
    """Pixels near a disparity step, bool [H, W].

    There a background pixel is hidden from the views of one side, and the mean over all views prefers the
    foreground's plane, which fattens edges; the best half of the aperture sees the pixel unhidden. Elsewhere halves
    only add noise (on weak texture they ruin the match), so the test is kept to these pixels.
    """
    import cv2

    size = 2 * settings.occlusion_radius + 1
    window = np.ones((size, size), np.uint8)
    spread = cv2.dilate(disparity, window) - cv2.erode(disparity, window)
    return np.asarray(spread > settings.occlusion_gap_px)


def plane_grid(disparity_range: tuple[float, float], settings: DpvSettings) -> tuple[float, float, int]:
    """(first, step, count) of planes that cover ``disparity_range`` at about ``plane_step_px``.

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
    return lo, (hi - lo) / (count - 1), count


def auto_range(light_field: LightField, *, limit_px: float = 4.0, threads: int = 0) -> tuple[float, float]:
    """The disparities that occur in a light field, found by a coarse sweep at half size.

    Pixels vote where the best plane is clearly better than the average; the range holds 99 % of the votes on
    each side and a margin.

    Returns
    -------
    (lo, hi) [px per view step]
    """
    import cv2

    refuse_constant(light_field)
    grey, centre, offsets = _split_views(light_field)
    size = (max(8, light_field.width // 2), max(8, light_field.height // 2))
    small = np.stack([cv2.resize(view, size, interpolation=cv2.INTER_AREA) for view in grey])
    small_centre = cv2.resize(centre, size, interpolation=cv2.INTER_AREA)
    ratio = size[0] / light_field.width
    step = 0.06
    planes = int(2 * limit_px * ratio / step) + 1
    cost = plane_cost(small, small_centre, offsets, -limit_px * ratio, step, planes, 23.0, threads=threads)
    best = cost.argmin(2)
    margin = cost.mean(2) - cost.min(2)
    votes = margin > np.maximum(1.0, np.quantile(margin, 0.5))
    if votes.sum() < 20:
        return -limit_px / 4, limit_px / 4
    lo, hi = np.quantile(best[votes], [0.005, 0.995])
    slack = 3 + 0.05 * (hi - lo)
    to_px = step / ratio
    return (
        max(-limit_px, float((lo - slack) * to_px - limit_px)),
        min(limit_px, float((hi + slack) * to_px - limit_px)),
    )


def refuse_constant(light_field: LightField) -> None:
    """Raise `BadInput` when no view has any structure (a lens cap, a uniform wall)."""
    if float(light_field.centre_view.std(axis=(0, 1)).max()) < NO_TEXTURE_GREY:
        raise BadInput(
            "the centre view is constant: nothing can be matched in it",
            path=light_field.id,
            field="views",
            code="constant-image",
            remedy="check the exposure and the lens cap, or leave this capture out",
        )


def noise_of_cost(cost: F32) -> float:
    """Noise standard deviation [grey levels] from the floor of the matching cost.

    Where the right plane is among the candidates the views differ by noise alone; the tenth percentile over the image
    of the best plane's cost avoids edges and wrong planes. On views with known noise this floor is σ/1.37 above a
    clean floor of about 0.4 (interpolation and the box average part of the noise away, the best of many planes is
    lower still).
    """
    floor = float(np.quantile(cost[::2, ::2].min(axis=2), 0.1))
    return NOISE_PER_FLOOR * float(np.sqrt(max(0.0, floor**2 - CLEAN_FLOOR_GREY**2)))


def _split_views(
    light_field: LightField, clipped_blur_px: float = 0.0
) -> tuple[NDArray[np.int16], NDArray[np.int16], NDArray[np.float64]]:
    """Grey views without the centre int16 [V, H, W], the centre's [H, W], offsets float64 [V, 2]."""
    grey = grey_views(light_field.views)
    if clipped_blur_px > 0:
        _soften_clipped(grey, light_field.views, clipped_blur_px)
    r0, c0 = light_field.centre_index
    centre = r0 * light_field.angular[1] + c0
    keep = np.arange(len(grey)) != centre
    return np.ascontiguousarray(grey[keep]), grey[centre], light_field.offsets().reshape(-1, 2)[keep]


CLIPPED_REACH_PX = 3
"""How far from a clipped pixel the views are softened: over the strokes between clipped areas."""


def _soften_clipped(grey: NDArray[np.int16], views: U8, blur_px: float) -> None:
    """Blur views int16 [V, H, W] where pixels clip, in place.

    Clipping comes after the lens and the pixel have filtered the light, and puts frequencies back that the grid cannot
    carry. Interpolated between pixels, such strokes match worse than unmoved: disparity is drawn to zero, where nothing
    is interpolated, by more than what the true plane wins. Only where all channels clip: where one does, luma keeps its
    shape, and large bright squares that repeat lose what little tells them apart.
    """
    import cv2

    size = 2 * CLIPPED_REACH_PX + 1
    window = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    for view, picture in zip(grey, views.reshape(-1, *views.shape[-3:]), strict=True):
        clipped = cv2.inRange(picture, (SATURATED_GREY,) * 3, (255,) * 3)
        if clipped.any():
            share = blurred(np.asarray(cv2.dilate(clipped, window) > 0, np.float32), 1.0)
            own: F32 = view.astype(np.float32)
            own += share * (blurred(own, blur_px) - own)
            view[...] = np.rint(own).astype(np.int16)
