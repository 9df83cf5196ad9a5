"""Evidence of all sources in the target's frustum: the fused volume.

Each target voxel (x, y, w_k) is looked up in every source by the exact projective map (`kernels/fusion.py`). Evidence
is pooled as a floored log-opinion pool with a visibility test against each source's own surface, and planes behind
strong nearer evidence are lowered (first-surface rule). The photo's colours, compared with the sources' at every voxel
that the light fields leave in play, refute rays that would end in empty space or behind a surface. The switches reach
the paper's printed form: ``mapping "literal"`` (target plane taken for the source's) and ``pool "mean"``.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lfrig.contracts.errors import GeometryRefused
from lfrig.contracts.progress import Monitor
from lfrig.processing.geometry import project, projection
from lfrig.processing.kernels.fusion import (
    U16,
    ColourTerm,
    CostScale,
    Pool,
    SourceVolume,
    SurfaceRule,
    fuse_volume,
)
from lfrig.processing.kernels.occupancy import occupancy
from lfrig.processing.model import F32, U8, Camera, Pose, Source
from lfrig.processing.skipping import SKIP_ALL, Skips, Tally
from lfrig.processing.sources import usual_noise, usual_slope, usual_step
from lfrig.processing.tone import Tone, fit_tone, marked
from lfrig.processing.visibility import carry


@dataclass(frozen=True)
class FusionSettings:
    """Knobs of the fusion; chosen on the tuning scenes."""

    planes: int = 128
    """At most."""
    plane_share: float = 0.65
    """Distance of two planes, as a share of that of the sources' own: finer ones tell nothing new (switch
    ``planes``)."""
    min_planes: int = 80
    """Which that may leave, where so many were asked for."""
    mapping: str = "exact"
    """``exact`` or ``literal`` (the paper as printed)."""
    pool: str = "log"
    """``log`` or ``mean``."""
    visibility: bool = True
    first_surface: bool = True
    floor_share: float = 0.05
    margin_px: float = 0.06
    """Slack of the visibility test [px per view step of the source]."""
    surface_gap_px: float = 0.1
    """Planes this much nearer [px per view step of the sources] are another surface, not the flank of this one."""
    surface_tau: float = 2.0
    surface_beta: float = 4.0
    surface_cap: float = 10.0
    colour: bool = True
    """Compare the photo's colours with the sources' at every voxel (log pool only)."""
    colour_weight: float = 1.5
    colour_noise_share: float = 0.2
    """How fast that weight falls per grey level of noise: colours must not outshout light fields that noise weakens."""
    colour_range_px: float = 1.1
    """Where all depths span less than this of the sources' disparity (small pictures), light fields tell depths apart
    less well, and the weight falls with its square: a texture that repeats would win."""
    colour_sigma_grey: float = 10.0
    colour_cap: float = 3.0
    colour_reach: float = 6.0
    """Colours are compared at voxels whose evidence lies no further than this below their ray's best: what the light
    fields refute needs no second opinion. [log evidence]"""
    colour_unknown: float = 1.0
    """What a voxel is charged that no source shows: less than a clear mismatch, more than a match."""
    colour_blur_px: float = 1.2
    """Planes are 2–3 px apart in a source 15–20° away: finer detail would fall between them."""
    level_share: float = 8.0
    """Probability counts as none where it stays below so many times the floor: up to 8 no pixel's error changes, at 80
    the mean does by 2 %."""
    cost_unit: float = 1 / 117
    """Log evidence per count of the volume."""
    cost_cap: float = 20.0
    """What the volume's costs are capped at [log evidence]."""
    min_overlap: float = 0.02
    """Refuse when fewer of the target's pixels than this share lie in any source's frame."""


DEFAULT_FUSION = FusionSettings()


@dataclass(frozen=True)
class FusedVolume:
    """``cost`` uint16 [H, W, N]: how far each plane's log evidence lies below that of the ray's best plane, in units of
    ``unit``, capped; ``best`` float32 [H, W]: log evidence of that plane; ``planes`` (w0, dw) in 1/m, nearer last;
    ``inside`` and ``voxels`` count (voxel, source) pairs inside the sources' frames and in all.
    """

    cost: U16
    best: F32
    unit: float
    planes: tuple[float, float]
    inside: int
    voxels: int
    cap: float = np.inf
    """What costs are capped at [log evidence]."""
    plane_px: float | None = None
    """Distance of two planes [px per view step of the sources]; None = not known."""
    tones: tuple[Tone, ...] | None = None
    """Of the sources against the photo, where colours were compared."""

    @classmethod
    def of_evidence(cls, evidence: F32, planes: tuple[float, float], unit: float = 1 / 1024) -> FusedVolume:
        """The volume of given log evidence [H, W, N]."""
        best = evidence.max(2)
        cost = np.minimum(np.rint((best[..., None] - evidence) / np.float32(unit)), 65535).astype(np.uint16)
        return cls(cost, best, unit, planes, 0, evidence.size)

    @property
    def evidence(self) -> F32:
        """Log evidence float32 [H, W, N]; made anew at each use, twice the size of ``cost``."""
        evidence = self.cost * np.float32(-self.unit)
        evidence += self.best[..., None]
        return evidence


def fuse(
    sources: Sequence[Source],
    camera: Camera,
    pose: Pose,
    inverse_depth_range: tuple[float, float],
    settings: FusionSettings = DEFAULT_FUSION,
    *,
    photo: U8 | None = None,
    threads: int = 0,
    monitor: Monitor | None = None,
    skips: Skips = SKIP_ALL,
    tally: Tally | None = None,
) -> FusedVolume:
    """Fuse the sources' evidence in the frustum of the camera ``camera`` at ``pose``.

    Parameters
    ----------
    photo : uint8 [H, W, 3], optional
        What the camera saw; without it colours are not compared.

    Raises
    ------
    GeometryRefused
        ``no-overlap``: no source sees what the target sees.
    """
    w0, w1 = inverse_depth_range
    planes = _plane_count(sources, w1 - w0, settings) if skips.planes else settings.planes
    if tally is not None:
        tally.add("planes", planes, settings.planes - planes, "planes")
    dw = (w1 - w0) / (planes - 1)
    shape = (camera.height, camera.width, planes)
    log_pool = settings.pool == "log"
    margin = settings.margin_px if settings.visibility else None
    pool = Pool(log_pool, settings.mapping == "literal", settings.floor_share, margin)
    level = int(65535 * settings.level_share * settings.floor_share / planes)
    ready = []
    for source in sources:
        tables = occupancy(source.evidence.probability, source.evidence.disparity, level, threads=threads)
        way = projection(camera, pose, source.camera, source.pose)
        ready.append(SourceVolume(source.evidence, source.scale, way, tables))
        if monitor:
            monitor.advance()
    colour = with_mask = tones = None
    if log_pool and settings.colour and photo is not None:
        rough = _rough_surface(ready, shape, (w0, dw), pool, threads)
        with_mask = marked(photo, settings.colour_blur_px)
        ready, tones = _with_colours(ready, sources, with_mask, rough, (camera, pose), settings)
        colour = _colour_term(sources, w1 - w0, settings)
    rule = SurfaceRule(
        _gap_planes(sources, dw, planes, settings), settings.surface_tau, settings.surface_beta, settings.surface_cap
    )
    start = time.process_time()
    fused = fuse_volume(
        ready, shape, (w0, dw), pool, photo=with_mask, colour=colour,
        surface=rule if log_pool and settings.first_surface else None,
        scale=CostScale(settings.cost_unit, settings.cost_cap),
        skip_bricks=skips.bricks, skip_sources=skips.sources, threads=threads,
    )  # fmt: skip
    if tally is not None:
        spent_s = time.process_time() - start
        tally.add("bricks", fused.sampled, fused.empty, "bricks", spent_s)
        tally.add("sources", fused.sampled, fused.unseen, "bricks", spent_s)
    voxels = shape[0] * shape[1] * shape[2]
    if fused.inside < settings.min_overlap * voxels:
        raise GeometryRefused(
            "the sources do not see what the target photo sees",
            code="no-overlap",
            remedy="choose sources nearer to the target's direction, or check the poses",
        )
    return FusedVolume(
        fused.cost, fused.best, settings.cost_unit, (w0, dw), fused.inside, voxels * len(sources), settings.cost_cap,
        _plane_px(sources, dw), tones,
    )  # fmt: skip


PLANES_AT_ONCE = 16
"""Fits the vectors of the kernels: 82 planes cost more than 96."""
TONE_STRIDE = 8
"""The colours' tone is fitted on every this many pixels."""


def _rough_surface(
    sources: Sequence[SourceVolume],
    shape: tuple[int, int, int],
    planes: tuple[float, float],
    pool: Pool,
    threads: int,
) -> F32:
    """Inverse depth [1/m] of the light fields' best plane on every `TONE_STRIDE`-th pixel."""
    wider = np.diag([TONE_STRIDE, TONE_STRIDE, 1.0])
    sparse = [replace(s, projection=(s.projection[0] @ wider, s.projection[1])) for s in sources]
    height, width = (-(-n // TONE_STRIDE) for n in shape[:2])
    cost = fuse_volume(sparse, (height, width, shape[2]), planes, pool, threads=threads).cost
    return np.asarray(planes[0] + planes[1] * cost.argmin(2), np.float32)


def _with_colours(
    ready: Sequence[SourceVolume],
    sources: Sequence[Source],
    photo: U8,
    rough: F32,
    target: tuple[Camera, Pose],
    settings: FusionSettings,
) -> tuple[list[SourceVolume], tuple[Tone, ...]]:
    """The sources with their centre views in the tone of the photo, uint8 [H, W, 4] as from `marked`; and the tones."""
    import cv2

    own = photo[::TONE_STRIDE, ::TONE_STRIDE, :3].astype(np.float32)
    found, tones = [], []
    for volume, source in zip(ready, sources, strict=True):
        image = marked(source.light_field.centre_view, settings.colour_blur_px)
        u, v, _, inside = carry(rough, source, *target, stride=TONE_STRIDE)
        seen = cv2.remap(image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        tone = fit_tone(own, seen[..., :3].astype(np.float32), inside)
        found.append(replace(volume, colour=tone.apply_marked(image)))
        tones.append(tone)
    return found, tuple(tones)


def _colour_term(sources: Sequence[Source], length: float, settings: FusionSettings) -> ColourTerm:
    weight = settings.colour_weight / (1 + settings.colour_noise_share * usual_noise(sources))
    weight *= min(1.0, length / usual_slope(sources) / settings.colour_range_px) ** 2
    return ColourTerm(
        weight, settings.colour_sigma_grey, settings.colour_cap, settings.colour_unknown, settings.colour_reach
    )


def _plane_count(sources: Sequence[Source], length: float, settings: FusionSettings) -> int:
    """Planes that a range of inverse depths [1/m] needs to be as fine as the sources' own planes."""
    step = settings.plane_share * usual_slope(sources) * usual_step(sources)
    wanted = PLANES_AT_ONCE * round((length / step + 1) / PLANES_AT_ONCE)
    return min(settings.planes, max(settings.min_planes, wanted))


def _gap_planes(sources: Sequence[Source], dw: float, planes: int, settings: FusionSettings) -> int:
    """``surface_gap_px`` in planes: the width of a peak is a matter of the sources' pixels, whatever the planes are."""
    return max(1, min(round(settings.surface_gap_px / _plane_px(sources, dw)), planes - 1))


def _plane_px(sources: Sequence[Source], dw: float) -> float:
    """Distance of two planes in px per view step of the sources (the median one)."""
    return dw / usual_slope(sources)


def inverse_depth_range(
    sources: Sequence[Source],
    camera: Camera,
    pose: Pose,
    depth_range_m: tuple[float, float] | None,
    *,
    stride: int = 4,
) -> tuple[float, float]:
    """The range of inverse depths [1/m] that the target can see, from the sources' own surfaces.

    Confident pixels of each source are carried into the target; the range holds all but 0.3 % of them on each side,
    with a margin, inside the rig's depth range when that is known.

    Raises
    ------
    GeometryRefused
        ``no-overlap``: no surface of any source falls into the target's frame.
    """
    found = []
    for source in sources:
        ys, xs = np.mgrid[0 : source.camera.height : stride, 0 : source.camera.width : stride]
        w = source.scale.inverse_depth(source.evidence.disparity[::stride, ::stride])
        good = (source.evidence.confidence[::stride, ::stride] > 0.5) & (w > 0)
        matrix, offset = projection(source.camera, source.pose, camera, pose)
        u, v, there = project(matrix, offset, xs[good].astype(np.float32), ys[good].astype(np.float32), w[good])
        seen = (u >= 0) & (v >= 0) & (u <= camera.width - 1) & (v <= camera.height - 1) & (there > 0)
        found.append(there[seen])
    everything = np.concatenate(found) if found else np.empty(0, np.float32)
    if len(everything) < 50:
        raise GeometryRefused(
            "no surface of any source lies in the target photo's view",
            code="no-overlap",
            remedy="choose sources nearer to the target's direction, or check the poses",
        )
    lo, hi = (float(q) for q in np.quantile(everything, [0.003, 0.997]))
    slack = 0.06 * (hi - lo) + 0.02 * hi
    lo, hi = max(lo - slack, 1e-3 * hi), hi + slack
    if depth_range_m is not None:
        near, far = 1 / depth_range_m[0], 1 / depth_range_m[1]
        clipped = max(lo, 0.97 * far), min(hi, 1.03 * near)
        if clipped[1] - clipped[0] > 0.05 * (hi - lo):
            lo, hi = clipped
    return lo, hi
