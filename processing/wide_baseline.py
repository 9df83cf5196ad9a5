"""Wide-baseline refinement: the photo against the sources' centre views, in a narrow band around the fused surface.

The photo and a source stand 10–20° apart, a hundred times the baseline of a light field: their match is some 25 times
as precise in depth, but ambiguous. The surface that the light fields gave resolves the ambiguity: it is the middle of
the band, tilts the patches, and says who sees what. Labels are relative to it, about one pixel of the widest source
apart, and aggregated along planes that continue it (`kernels.sgm`, ``shift``). Where no source agrees with the result
or the match is poor, the surface stays as it was.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lfrig.processing.geometry import projection
from lfrig.processing.kernels.band_cost import LEAST_VISIBLE, UNIT, Patch, View, band_cost
from lfrig.processing.kernels.band_peak import U16, band_peak
from lfrig.processing.kernels.sgm import I16, PATHS, aggregate, finest_unit
from lfrig.processing.model import F32, U8, Camera, Pose, Source
from lfrig.processing.plane_fit import Planes
from lfrig.processing.skipping import SKIP_ALL, Skips, Tally
from lfrig.processing.tone import luma
from lfrig.processing.visibility import Mask, count_agreeing, land


@dataclass(frozen=True)
class WideBaselineSettings:
    """Knobs; chosen on the tuning scenes."""

    enabled: bool = True
    labels: int = 16
    small_width: int = 200
    small_labels: int = 32
    """In pictures less wide than that: before a wall that stands still, or at poses that are a little wrong, more of
    their surface lies further from the truth than half of the usual band, and the wider one costs little."""
    step_px: float = 1.0
    """Between labels, in pixels of the source that moves most."""
    radius: int = 4
    stride: int = 2
    sigma_grey: float = 40.0
    noise_floor: float = 1.0
    """Variance [grey levels²] that counts as no texture, beside that of the measured noise."""
    cap: float = 1.0
    p1: float = 0.2
    p2: float = 2.0
    edge_grey: float = 30.0
    margin_px: float = 0.08
    """Slack of the visibility test [px per view step of the source]."""
    support_px: float = 0.06
    accept_cost: float = 0.8
    accept_seen: float = 0.4

    def labels_of(self, width: int) -> int:
        """In a picture so wide [px]."""
        return self.small_labels if width < self.small_width else self.labels

    @property
    def unit(self) -> int:
        """A cost of 1 in fixed point, so that a path's costs fit (`kernels.sgm`)."""
        return min(UNIT, finest_unit(self.cap, self.p1, self.p2))


DEFAULT_WIDE_BASELINE = WideBaselineSettings()
LUMA_NOISE = 0.45
"""Variance of luma from independent noise of variance 1 in R, G and B."""


@dataclass(frozen=True)
class WideMatch:
    """``inverse_depth`` float32 [H, W]; ``cost`` float32 [H, W], 1 − ZNCC of the best label (the cap where nothing was
    compared); ``seen`` float32 [H, W], sources that see the surface; ``accepted`` bool [H, W]. Of the costs aggregated
    along paths, float32 [H, W]: ``margin``, by how much every label beyond ±2 is worse than the best, and
    ``curvature``, by how much the two at ±2 together are.
    """

    inverse_depth: F32
    cost: F32
    seen: F32
    accepted: Mask
    margin: F32
    curvature: F32

    @classmethod
    def none(cls, inverse_depth: F32) -> WideMatch:
        """Of a surface that was not matched."""
        nothing = np.zeros_like(inverse_depth)
        return cls(inverse_depth, nothing + 1, nothing, np.zeros(nothing.shape, bool), nothing, nothing)


def refine_wide(
    surface: Planes,
    sources: Sequence[Source],
    camera: Camera,
    pose: Pose,
    photo: U8,
    settings: WideBaselineSettings = DEFAULT_WIDE_BASELINE,
    *,
    skips: Skips = SKIP_ALL,
    tally: Tally | None = None,
    threads: int = 0,
) -> WideMatch:
    """Refine a surface.

    Parameters
    ----------
    surface : Planes
        Inverse depth [1/m] and its slopes per pixel, float32 [H, W] each.
    photo : uint8 [H, W, 3]
    """
    step = settings.step_px / pixels_per_inverse_depth(surface.value, sources, camera, pose)
    visible = [land(surface.value, s, camera, pose, threads=threads).visible(settings.margin_px) for s in sources]
    seen = np.asarray(np.sum(visible, axis=0), np.float32)
    unit = settings.unit
    cost = _cost(surface, visible, sources, camera, pose, photo, step, settings, skips, tally, threads)
    total = aggregate(
        cost, photo, unit * settings.p1, unit * settings.p2, settings.edge_grey, shift=label_shifts(surface, step),
        threads=threads,
    )  # fmt: skip
    label, best, margin, curvature = band_peak(cost, total, threads=threads)
    best /= np.float32(unit)
    moved = surface.value + np.float32(step) * (label - np.float32(cost.shape[2] // 2))
    there = [land(moved, s, camera, pose, threads=threads) for s in sources]
    agreeing = count_agreeing(there, settings.support_px)
    accepted = (agreeing > 0) & (seen > settings.accept_seen) & (best < settings.accept_cost)
    inverse_depth = np.where(accepted, moved, surface.value).astype(np.float32)
    of_path = np.float32(1 / (PATHS * unit))
    return WideMatch(inverse_depth, best, seen, accepted, margin * of_path, curvature * of_path)


def _cost(
    surface: Planes,
    visible: Sequence[F32],
    sources: Sequence[Source],
    camera: Camera,
    pose: Pose,
    photo: U8,
    step: float,
    settings: WideBaselineSettings,
    skips: Skips,
    tally: Tally | None,
    threads: int,
) -> U16:
    """Mean over the sources that see a pixel, uint16 [H, W, K] in 1 / ``settings.unit``; the cap where none does."""
    views = [
        View(
            luma(source.light_field.centre_view), weight, projection(camera, pose, source.camera, source.pose),
            settings.noise_floor + LUMA_NOISE * source.evidence.noise_sigma**2,
        )
        for source, weight in zip(sources, visible, strict=True)
    ]  # fmt: skip
    patch = Patch(settings.radius, settings.stride, settings.sigma_grey, settings.cap)
    start = time.process_time()
    cost = band_cost(
        luma(photo), photo, views, (surface.value, surface.slope_x, surface.slope_y), step,
        settings.labels_of(photo.shape[1]), patch,
        least_visible=LEAST_VISIBLE if skips.sources else -1.0, unit=settings.unit, threads=threads,
    )  # fmt: skip
    if tally is not None:
        whole = len(views) * surface.value.size
        asked = sum(int((weight > LEAST_VISIBLE).sum()) for weight in visible) if skips.sources else whole
        tally.add("sources", asked, whole - asked, "pixels matched with a source", time.process_time() - start)
    return cost


def pixels_per_inverse_depth(inverse_depth: F32, sources: Sequence[Source], camera: Camera, pose: Pose) -> float:
    """How far [px] a surface point at the photo's centre moves in the source where it moves most, per 1/m."""
    middle = np.full((1, 1), np.median(inverse_depth), np.float64)
    delta = 1e-3 * abs(float(middle[0, 0])) + 1e-9
    x, y = np.full((1, 1), camera.cx), np.full((1, 1), camera.cy)
    fastest = 1e-9
    for source in sources:
        matrix, offset = projection(camera, pose, source.camera, source.pose)
        ends = [matrix @ [x[0, 0], y[0, 0], 1.0] + offset * w for w in (middle[0, 0], middle[0, 0] + delta)]
        if min(end[2] for end in ends) > 1e-9:
            shift = ends[1][:2] / ends[1][2] - ends[0][:2] / ends[0][2]
            fastest = max(fastest, float(np.hypot(*shift)) / delta)
    return fastest


def label_shifts(surface: Planes, step: float) -> I16:
    """Which label of a neighbour continues the plane of a pixel's label, int16 [4, H, W] (see `kernels.sgm`)."""
    w, gx, gy = surface.value, surface.slope_x, surface.slope_y
    out = np.zeros((4, *w.shape), np.int16)
    ahead, back = slice(1, None), slice(None, -1)
    steps = (
        ((slice(None), back), (slice(None), ahead), 1, 0),
        ((back, slice(None)), (ahead, slice(None)), 0, 1),
        ((back, back), (ahead, ahead), 1, 1),
        ((back, ahead), (ahead, back), -1, 1),
    )
    for k, (here, there, dx, dy) in enumerate(steps):
        continued = w[here] + 0.5 * ((gx[here] + gx[there]) * dx + (gy[here] + gy[there]) * dy)
        out[k][here] = np.clip(np.rint((continued - w[there]) / np.float32(step)), -9999, 9999)
    return out
