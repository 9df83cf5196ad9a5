"""Evidence of all sources in the target's frustum: the fused volume.

Each target voxel (x, y, w_k) is looked up in every source by the exact projective map (`kernels/fusion.py`). Evidence
is pooled as a floored log-opinion pool with a visibility test against each source's own surface, and planes behind
strong nearer evidence are lowered (first-surface rule). The switches reach the paper's printed form: ``mapping
"literal"`` (target plane taken for the source's) and ``pool "mean"``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lfrig.contracts.errors import GeometryRefused
from lfrig.contracts.progress import Monitor
from lfrig.processing.geometry import project, projection
from lfrig.processing.kernels.fusion import Pool, add_evidence, first_surface
from lfrig.processing.model import F32, Camera, Pose, Source


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
    threads: int = 0,
    monitor: Monitor | None = None,
) -> FusedVolume:
    """Fuse the sources' evidence in the frustum of the camera ``camera`` at ``pose``.

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
    elif settings.first_surface:
        neutral = -len(sources) * float(np.log(settings.planes))
        first_surface(
            volume, neutral, _gap_planes(sources, dw, settings), settings.surface_tau, settings.surface_beta,
            settings.surface_cap, threads=threads,
        )  # fmt: skip
    return FusedVolume(volume, (w0, dw), log_pool, inside, volume.size * len(sources))


def _gap_planes(sources: Sequence[Source], dw: float, settings: FusionSettings) -> int:
    """``surface_gap_px`` in planes: the width of a peak is a matter of the sources' pixels, whatever the planes are."""
    plane_px = dw / float(np.median([abs(source.scale.a) for source in sources]))
    return int(np.clip(round(settings.surface_gap_px / plane_px), 1, settings.planes - 1))


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
