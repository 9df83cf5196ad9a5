"""Sources and the photo to the photo's surface: fusion → surface → refinement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lfrig.processing import confidence as confidence_model
from lfrig.processing.confidence import Clues
from lfrig.processing.continuation import continue_hidden
from lfrig.processing.edges import decide_edges
from lfrig.processing.fusion import fuse, inverse_depth_range
from lfrig.processing.model import F32, U8, Camera, LightFieldRequest, Pose, Source, Surface
from lfrig.processing.options import Settings
from lfrig.processing.plane_fit import Planes
from lfrig.processing.refine import smooth, snap_to_edges
from lfrig.processing.regularise import regularise
from lfrig.processing.skipping import Tally
from lfrig.processing.stages import StageClock
from lfrig.processing.tone import Tone
from lfrig.processing.visibility import count_agreeing, land
from lfrig.processing.wide_baseline import WideMatch, refine_wide


@dataclass(frozen=True)
class Target:
    """What is to be reconstructed: the photo uint8 [H, W, 3], the camera that took it, and its pose."""

    photo: U8
    camera: Camera
    pose: Pose


def reconstruct(
    sources: Sequence[Source],
    target: Target,
    depth_range_m: tuple[float, float] | None,
    request: LightFieldRequest,
    settings: Settings,
    clock: StageClock,
    *,
    threads: int = 0,
) -> Surface:
    """The surface that the photo shows.

    Parameters
    ----------
    depth_range_m : (near, far), optional
        Depths that the rig allows.
    request : LightFieldRequest
        Its disparities are the unit in which the refinement's tolerances are given.

    Raises
    ------
    GeometryRefused
        ``no-overlap``: the sources do not see what the photo shows.
    """
    photo, camera, pose, monitor = target.photo, target.camera, target.pose, clock.monitor
    with clock.stage("fusion", len(sources)) as note:
        limits = inverse_depth_range(sources, camera, pose, depth_range_m)
        volume = fuse(
            sources, camera, pose, limits, settings.fusion, photo=photo, skips=settings.skips, tally=note.tally,
            threads=threads, monitor=monitor,
        )  # fmt: skip
        note.done(volume.inside, "voxels")
        note.skipped(volume.voxels - volume.inside, "voxels")
    with clock.stage("surface", None) as note:
        inverse_depth, peak = regularise(volume, photo, settings.regularise, threads=threads, monitor=monitor)
        note.done(inverse_depth.size, "pixels")
    tones = volume.tones
    del volume
    with clock.stage("refine", None) as note:
        surface, moved = refine(inverse_depth, peak, sources, target, request, settings, threads, note.tally, tones)
        note.done(moved, "pixels moved")
        note.skipped(inverse_depth.size - moved, "pixels moved")
    return surface


def refine(
    fused: F32,
    peak: F32,
    sources: Sequence[Source],
    target: Target,
    request: LightFieldRequest,
    settings: Settings,
    threads: int,
    tally: Tally,
    tones: Sequence[Tone] | None = None,
) -> tuple[Surface, int]:
    """Refine the surface; also the number of pixels that got another value after plane quantisation was taken out."""
    knobs, image, camera, pose = settings.refine, target.photo, target.camera, target.pose
    px = request.baseline_m * camera.focal_px
    skips = settings.skips
    inverse_depth, flat = fused, np.zeros_like(fused)
    planes, match = Planes(fused, flat, flat), WideMatch.none(fused)
    if knobs.smooth:
        planes = smooth(fused, peak, image, px, knobs, threads=threads)
        match = WideMatch.none(planes.value)
        inverse_depth = planes.value
        if settings.wide_baseline.enabled:
            match = refine_wide(
                planes, sources, camera, pose, image, settings.wide_baseline, skips=skips, tally=tally, threads=threads
            )
            inverse_depth = match.inverse_depth
            if settings.continuation.enabled:
                inverse_depth, _ = continue_hidden(
                    match, planes, sources, camera, pose, image, px, settings.continuation, threads=threads
                )
    if settings.edges.enabled:
        inverse_depth, _ = decide_edges(
            inverse_depth, sources, camera, pose, image, px, settings.edges, tones=tones, skips=skips, tally=tally,
            threads=threads,
        )  # fmt: skip
    decided = inverse_depth
    if knobs.snap:
        inverse_depth = snap_to_edges(inverse_depth, image, px, knobs, skips=skips, tally=tally, threads=threads)
    landings = [land(inverse_depth, source, camera, pose, threads=threads) for source in sources]
    clues = Clues(fused, peak, planes, match, decided, inverse_depth, image, sources, landings, camera, pose)
    probability, sigma_px = confidence_model.estimate(clues, px, threads=threads)
    agreeing = count_agreeing(landings, knobs.support_px)
    surface = Surface(inverse_depth, probability, np.asarray(sigma_px / px, np.float32), agreeing)
    return surface, int((inverse_depth != planes.value).sum())
