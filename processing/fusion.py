"""Evidence of all sources in the target's frustum: the fused volume.

Each target voxel (x, y, w_k) is looked up in every source by the exact projective map (`kernels/fusion.py`). Evidence
is pooled as a floored log-opinion pool with a visibility test against each source's own surface, and planes behind
strong nearer evidence are lowered (first-surface rule). The photo's colours, compared with the sources' at every voxel,
refute rays that would end in empty space or behind a surface. The switches reach the paper's printed form: ``mapping
"literal"`` (target plane taken for the source's) and ``pool "mean"``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lfrig.contracts.errors import GeometryRefused
from lfrig.contracts.progress import Monitor
from lfrig.processing.geometry import project, projection
from lfrig.processing.kernels.colour_evidence import ColourTerm, add_colour_evidence
from lfrig.processing.kernels.fusion import Pool, add_evidence, first_surface
from lfrig.processing.model import F32, U8, Camera, Pose, Source
from lfrig.processing.sources import usual_noise, usual_slope
from lfrig.processing.tone import Tone, blurred, fit_tone, saturation
from lfrig.processing.visibility import carry


@dataclass(frozen=True)
class FusionSettings:
    """Knobs of the fusion; chosen on the tuning scenes."""

    planes: int = 128
    mapping: str = "exact"
    """``exact`` or ``literal`` (the paper as printed)."""
    pool: str = "log"
    """``log`` or ``mean``."""
    visibility: bool = True
    first_surface: bool = True
    floor_share: float = 0.05
    margin_px: float = 0.06
    """Slack of the visibility test [px per view step of the source]."""
    surface_gap_px: float = 0.08
    """Planes this much nearer [px per view step of the sources] are another surface, not the flank of this one."""
    surface_tau: float = 2.0
    surface_beta: float = 4.0
    surface_cap: float = 10.0
    colour: bool = True
    """Compare the photo's colours with the sources' at every voxel (log pool only)."""
    colour_weight: float = 1.5
    colour_noise_share: float = 0.2
    """How fast that weight falls per grey level of noise: colours must not outshout light fields that noise weakens."""
    colour_plane_px: float = 0.0074
    """Where a plane is less than this of the sources' disparity (small pictures), light fields say less per plane, and
    the weight falls with its square: a texture that repeats would win."""
    colour_sigma_grey: float = 10.0
    colour_cap: float = 3.0
    colour_unknown: float = 1.0
    """What a voxel is charged that no source shows: less than a clear mismatch, more than a match."""
    colour_blur_px: float = 1.2
    """Planes are 2–3 px apart in a source 15–20° away: finer detail would fall between them."""
    min_overlap: float = 0.02
    """Refuse when fewer of the target's pixels than this share lie in any source's frame."""


DEFAULT_FUSION = FusionSettings()


@dataclass(frozen=True)
class FusedVolume:
    """``evidence`` float32 [H, W, N], log scale for the log pool, probability for the mean pool; ``planes`` (w0, dw)
    in 1/m, nearer last; ``inside`` and ``voxels`` count (voxel, source) pairs inside the sources' frames and in all.
    """

    evidence: F32
    planes: tuple[float, float]
    is_log: bool
    inside: int
    voxels: int


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
    dw = (w1 - w0) / (settings.planes - 1)
    shape = (camera.height, camera.width, settings.planes)
    log_pool = settings.pool == "log"
    pool = Pool(log_pool, settings.visibility, settings.mapping == "literal", settings.floor_share)
    volume = np.zeros(shape, np.float32)
    mass = None if log_pool else np.zeros(shape, np.float32)
    inside = 0
    for source in sources:
        matrix, offset = projection(camera, pose, source.camera, source.pose)
        inside += add_evidence(
            volume, mass, source.evidence, source.scale, matrix, offset, (w0, dw), pool,
            margin_px=settings.margin_px, threads=threads, monitor=monitor,
        )  # fmt: skip
        if monitor:
            monitor.advance()
    if inside < settings.min_overlap * volume.size:
        raise GeometryRefused(
            "the sources do not see what the target photo sees",
            code="no-overlap",
            remedy="choose sources nearer to the target's direction, or check the poses",
        )
    if mass is not None:
        volume /= np.maximum(mass, np.float32(1e-6))
    elif settings.colour and photo is not None:
        _add_colours(volume, photo, sources, (camera, pose), (w0, dw), settings, threads)
    if log_pool and settings.first_surface:
        neutral = -len(sources) * float(np.log(settings.planes))
        first_surface(
            volume, neutral, _gap_planes(sources, dw, settings), settings.surface_tau, settings.surface_beta,
            settings.surface_cap, threads=threads,
        )  # fmt: skip
    return FusedVolume(volume, (w0, dw), log_pool, inside, volume.size * len(sources))


def _add_colours(
    volume: F32,
    photo: U8,
    sources: Sequence[Source],
    target: tuple[Camera, Pose],
    planes: tuple[float, float],
    settings: FusionSettings,
    threads: int,
) -> None:
    """Add what the colours of the photo and of every source's centre view say, in place."""
    noise = usual_noise(sources)
    weight = settings.colour_weight / (1 + settings.colour_noise_share * noise)
    weight *= min(1.0, _plane_px(sources, planes[1]) / settings.colour_plane_px) ** 2
    term = ColourTerm(
        weight, settings.colour_sigma_grey, settings.colour_cap, settings.colour_unknown, settings.margin_px
    )
    blur = settings.colour_blur_px
    own = blurred(photo, blur)
    rough = np.asarray(planes[0] + planes[1] * volume[::TONE_STRIDE, ::TONE_STRIDE].argmax(2), np.float32)
    with_mask = np.dstack([own, saturation(photo, blur)])
    for source in sources:
        view = source.light_field.centre_view
        colour = blurred(view, blur)
        tone = _tone_at(rough, own, colour, source, target)
        image = np.dstack([tone.apply(colour), saturation(view, blur)])
        add_colour_evidence(
            volume, with_mask, image, source.evidence.disparity, source.scale,
            projection(*target, source.camera, source.pose), planes, term, threads=threads,
        )  # fmt: skip


TONE_STRIDE = 3


def _tone_at(rough: F32, own: F32, colour: F32, source: Source, target: tuple[Camera, Pose]) -> Tone:
    """Tone of a source from its colours at a rough surface [1/m] on every `TONE_STRIDE`-th pixel."""
    import cv2

    u, v, _, inside = carry(rough, source, *target, stride=TONE_STRIDE)
    found = cv2.remap(colour, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return fit_tone(own[::TONE_STRIDE, ::TONE_STRIDE], np.asarray(found, np.float32), inside)


def _gap_planes(sources: Sequence[Source], dw: float, settings: FusionSettings) -> int:
    """``surface_gap_px`` in planes: the width of a peak is a matter of the sources' pixels, whatever the planes are."""
    return int(np.clip(round(settings.surface_gap_px / _plane_px(sources, dw)), 1, settings.planes - 1))


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
