"""The stages in order: sources and a photo in, a synthesized light field out.

    evidence → poses → scale fit → fusion → surface → refine → synthesis

Each stage is timed and says what it did and what it skipped. `process` is pure: no files, no globals; the same inputs
give the same bytes for any thread count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from lfrig.contracts.errors import BadInput, NotInThisVersion, UsageError
from lfrig.contracts.native import load_native
from lfrig.contracts.progress import Monitor, Notice
from lfrig.contracts.result import StageReport
from lfrig.processing import confidence as confidence_model
from lfrig.processing.agreement import check_agreement
from lfrig.processing.confidence import Clues
from lfrig.processing.continuation import ContinuationSettings, continue_hidden
from lfrig.processing.dpv import DpvSettings, auto_range, light_field_evidence, refuse_constant
from lfrig.processing.edges import EdgeSettings, decide_edges
from lfrig.processing.fusion import FusionSettings, fuse, inverse_depth_range
from lfrig.processing.matching_views import matching_views
from lfrig.processing.model import (
    F32,
    Anchors,
    Camera,
    Evidence,
    LightField,
    LightFieldRequest,
    Photo,
    Pose,
    RigPrior,
    Source,
    Surface,
    SynthesizedLightField,
)
from lfrig.processing.plane_fit import Planes
from lfrig.processing.poses import PoseMethod, PoseSolution, solve_poses
from lfrig.processing.refine import RefineSettings, smooth, snap_to_edges
from lfrig.processing.regularise import RegulariseSettings, regularise
from lfrig.processing.resolution import scale_light_field, scale_photo
from lfrig.processing.scale_fit import ScaleFitSettings, fit_scale
from lfrig.processing.sharpness import warn_of_defocus
from lfrig.processing.stages import StageClock
from lfrig.processing.still import warn_of_still_background
from lfrig.processing.synthesis import SynthesisSettings, render_views
from lfrig.processing.visibility import count_agreeing, land
from lfrig.processing.wide_baseline import WideBaselineSettings, WideMatch, refine_wide

PRESETS = ("fast",)
LATER_PRESETS = ("preview", "balanced", "paper")


@dataclass(frozen=True)
class Settings:
    """The knobs of every stage."""

    dpv: DpvSettings = field(default_factory=DpvSettings)
    scale_fit: ScaleFitSettings = field(default_factory=ScaleFitSettings)
    fusion: FusionSettings = field(default_factory=FusionSettings)
    regularise: RegulariseSettings = field(default_factory=RegulariseSettings)
    refine: RefineSettings = field(default_factory=RefineSettings)
    wide_baseline: WideBaselineSettings = field(default_factory=WideBaselineSettings)
    continuation: ContinuationSettings = field(default_factory=ContinuationSettings)
    edges: EdgeSettings = field(default_factory=EdgeSettings)
    synthesis: SynthesisSettings = field(default_factory=SynthesisSettings)


@dataclass(frozen=True)
class ProcessOptions:
    """A request. ``target_baseline_m`` and ``target_focus_m`` default to the fitted ones of the nearest source;
    ``resolution`` below 1 computes the geometry at that fraction of full size; ``threads`` 0 = all cores.
    """

    preset: str = "fast"
    poses: PoseMethod = "auto"
    target_baseline_m: float | None = None
    target_focus_m: float | None = None
    rows: int = 7
    cols: int = 7
    threads: int = 0
    resolution: float = 1.0
    bit_depth: int = 8
    settings: Settings = field(default_factory=Settings)


@dataclass(frozen=True)
class SourceResult:
    """One source with everything that was found out about it."""

    source: Source
    anchors: Anchors
    angle_residual_deg: float | None = None


@dataclass(frozen=True)
class ProcessResult:
    """The synthesized light field and how it came about."""

    light_field: SynthesizedLightField
    target: Photo
    target_camera: Camera
    target_pose: Pose
    sources: tuple[SourceResult, ...]
    stages: tuple[StageReport, ...]
    notices: tuple[Notice, ...]
    poses_method: str
    metric: bool
    preset: str
    native: bool
    threads: int
    options: dict[str, Any]
    scale_source: str = ""
    """What the unit of length came from (`PoseSolution.scale_source`)."""


def process(
    sources: Sequence[LightField],
    target: Photo,
    prior: RigPrior,
    options: ProcessOptions,
    monitor: Monitor,
    *,
    evidence: Sequence[Evidence] | None = None,
) -> ProcessResult:
    """Turn sources and a photo into a light field.

    Parameters
    ----------
    evidence : sequence of Evidence, optional
        One per source, when already computed from the same views, settings and resolution.

    Raises
    ------
    UsageError
        Options that make no sense or are not in this version.
    BadInput
        No source, or views that cannot be used.
    GeometryRefused
        Poses or scales that cannot be trusted, or no overlap.
    """
    check_options(options)
    if not sources:
        raise BadInput(
            "no source: at least one light field is needed", code="no-source", remedy="ingest a light field first"
        )
    if len(sources) == 1:
        monitor.warn("one-source", "only one source: what it does not see is guessed; shoot at least two")
    clock = StageClock(monitor)
    settings, threads = options.settings, options.threads
    working, photo = list(sources), target
    if options.resolution != 1.0:
        working = [scale_light_field(lf, options.resolution) for lf in sources]
        photo = scale_photo(target, options.resolution)

    with clock.stage("evidence", len(working)) as note:
        if evidence is None:
            evidence = [_evidence_of(lf, prior, settings, threads, monitor) for lf in working]
            note.skipped(sum(1 - e.occlusion_tested for e in evidence) * 100 / len(evidence), "% half-aperture tests")
            note.done(sum(e.occlusion_tested for e in evidence) * 100 / len(evidence))
    with clock.stage("poses", None) as note:
        warn_of_defocus(working, monitor)
        warn_of_still_background(working, monitor)
        solution = solve_poses(working, evidence, photo, prior, options.poses, threads=threads, monitor=monitor)
        note.done(sum(len(a) for a in solution.anchors), "anchors")
    with clock.stage("scale-fit", len(working)) as note:
        ready = _fit_sources(working, evidence, solution, settings, monitor)
        check_agreement(ready, photo, solution.target_camera, solution.target_pose, monitor)
        note.done(sum(s.scale.anchors for s in ready), "anchors")
    request = _request(options, ready, solution)
    camera, pose = solution.target_camera, solution.target_pose
    with clock.stage("fusion", len(ready)) as note:
        limits = inverse_depth_range(ready, camera, pose, _depth_range(working, prior, solution))
        volume = fuse(
            ready, camera, pose, limits, settings.fusion, photo=photo.image8, threads=threads, monitor=monitor
        )
        note.done(volume.inside, "voxels")
        note.skipped(volume.voxels - volume.inside, "voxels")
    with clock.stage("surface", None) as note:
        inverse_depth, peak = regularise(volume, photo.image8, settings.regularise, threads=threads, monitor=monitor)
        note.done(inverse_depth.size, "pixels")
    del volume
    with clock.stage("refine", None) as note:
        surface, moved = _refine(inverse_depth, peak, ready, photo, camera, pose, request, settings, threads, monitor)
        note.done(moved, "pixels moved")
        note.skipped(inverse_depth.size - moved, "pixels moved")
    with clock.stage("synthesis", options.rows * options.cols) as note:
        full_camera = camera
        if options.resolution != 1.0:
            height, width = target.image.shape[:2]
            full_camera = camera.resized(width, height)
            surface = _resize_surface(surface, width, height)
        image = target.image if options.bit_depth == 16 else target.image8
        disparity = request.disparity(surface.inverse_depth, full_camera.focal_px)
        views = render_views(
            image, disparity, options.rows, options.cols, method=settings.synthesis.method,
            settings=settings.synthesis, threads=threads, monitor=monitor,
        )  # fmt: skip
        note.done(options.rows * options.cols - 1, "views")
    made = SynthesizedLightField(views, disparity, surface, request, full_camera)
    return ProcessResult(
        light_field=made, target=target, target_camera=full_camera, target_pose=pose,
        sources=tuple(
            SourceResult(s, a, r)
            for s, a, r in zip(ready, solution.anchors, solution.angle_residual_deg, strict=True)
        ),
        stages=tuple(clock.reports), notices=tuple(monitor.notices), poses_method=solution.method,
        metric=solution.metric, preset=options.preset,
        native=load_native("lfrig.processing.kernels._native") is not None, threads=threads,
        options={"resolution": options.resolution, "poses": options.poses, "bit_depth": options.bit_depth},
        scale_source=solution.scale_source,
    )  # fmt: skip


def check_options(options: ProcessOptions) -> None:
    """Raise `UsageError` for options that make no sense."""
    if options.preset in LATER_PRESETS:
        raise NotInThisVersion(f"preset '{options.preset}'", remedy="use --preset fast")
    if options.preset not in PRESETS:
        raise UsageError(f"unknown preset '{options.preset}'", remedy=f"one of {', '.join(PRESETS)}")
    if not 0.05 <= options.resolution <= 1.0:
        raise UsageError(f"resolution {options.resolution:g} is not in 0.05..1", remedy="1 is full size")
    if options.rows < 1 or options.cols < 1 or options.rows * options.cols > 1024:
        raise UsageError(f"{options.rows}x{options.cols} views cannot be made", remedy="7x7 is usual")
    if options.bit_depth not in (8, 16):
        raise UsageError(f"bit depth {options.bit_depth} is not 8 or 16", remedy="give 8 or 16")
    for name, value in (("baseline", options.target_baseline_m), ("focus", options.target_focus_m)):
        if value is not None and not (np.isfinite(value) and value > 0):
            raise UsageError(f"target {name} {value} m is not a positive length", remedy="give it in metres")


def _evidence_of(
    light_field: LightField, prior: RigPrior, settings: Settings, threads: int, monitor: Monitor
) -> Evidence:
    refuse_constant(light_field)
    views = matching_views(light_field, settings.dpv.clipped_blur_px, threads=threads)
    found = auto_range(light_field, views=views, threads=threads)
    expected = expected_range(light_field, prior)
    if expected is not None:
        lo, hi = max(found[0], expected[0]), min(found[1], expected[1])
        found = (lo, hi) if hi - lo > 0.1 * (found[1] - found[0]) else found
    result = light_field_evidence(light_field, found, settings.dpv, views=views, threads=threads, monitor=monitor)
    monitor.advance()
    return result


def expected_range(light_field: LightField, prior: RigPrior) -> tuple[float, float] | None:
    """Disparities [px per view step] that the recorded optics and depth range allow, with room for their errors."""
    depth = light_field.depth_range_m or prior.depth_range_m
    optics, camera = light_field.optics, light_field.camera
    if depth is None or camera is None or optics.baseline_m is None or optics.focus_distance_m is None:
        return None
    scale = optics.baseline_m * camera.focal_px
    lo, hi = (scale * (1 / z - 1 / optics.focus_distance_m) for z in (depth[1], depth[0]))
    slack = 0.15 * (hi - lo) + 0.1 * scale / optics.focus_distance_m
    return lo - slack, hi + slack


def _fit_sources(
    working: Sequence[LightField],
    evidence: Sequence[Evidence],
    solution: PoseSolution,
    settings: Settings,
    monitor: Monitor,
) -> list[Source]:
    ready = []
    for lf, e, camera, pose, anchors in zip(
        working, evidence, solution.cameras, solution.poses, solution.anchors, strict=True
    ):
        scale = fit_scale(lf, camera, anchors, e, settings.scale_fit, monitor, metric=solution.metric)
        ready.append(Source(lf, camera, pose, e, scale))
        monitor.advance()
    return ready


def _depth_range(working: Sequence[LightField], prior: RigPrior, solution: PoseSolution) -> tuple[float, float] | None:
    """The rig's depth range, only when the result is metric."""
    if not solution.metric:
        return None
    if prior.depth_range_m is not None:
        return prior.depth_range_m
    own = [lf.depth_range_m for lf in working if lf.depth_range_m is not None]
    return (min(r[0] for r in own), max(r[1] for r in own)) if len(own) == len(working) else None


def _request(options: ProcessOptions, ready: Sequence[Source], solution: PoseSolution) -> LightFieldRequest:
    """The light field to make; unset optics are the fitted ones of the source nearest by direction (ties: lower id)."""
    baseline, focus = options.target_baseline_m, options.target_focus_m
    if baseline is None or focus is None:
        target = solution.target_pose
        nearest = min(ready, key=lambda s: (-round(float(s.pose.direction @ target.direction), 9), s.light_field.id))
        baseline = baseline or 1 / (nearest.scale.a * nearest.camera.focal_px)
        focus = focus or (1 / nearest.scale.c if nearest.scale.c > 1e-6 else 1e6)
    return LightFieldRequest(baseline, focus, options.rows, options.cols)


def _refine(
    inverse_depth: F32,
    peak: F32,
    ready: Sequence[Source],
    photo: Photo,
    camera: Camera,
    pose: Pose,
    request: LightFieldRequest,
    settings: Settings,
    threads: int,
    monitor: Monitor,
) -> tuple[Surface, int]:
    """Refine the surface; also the number of pixels that got another value after plane quantisation was taken out."""
    knobs, image = settings.refine, photo.image8
    px = request.baseline_m * camera.focal_px
    fused, flat = inverse_depth, np.zeros_like(inverse_depth)
    planes, match = Planes(fused, flat, flat), WideMatch.none(fused)
    if knobs.smooth:
        planes = smooth(inverse_depth, peak, image, px, knobs)
        match = WideMatch.none(planes.value)
        inverse_depth = planes.value
        if settings.wide_baseline.enabled:
            match = refine_wide(
                planes, ready, camera, pose, image, settings.wide_baseline, threads=threads, monitor=monitor
            )
            inverse_depth = match.inverse_depth
            if settings.continuation.enabled:
                inverse_depth, _ = continue_hidden(match, planes, ready, camera, pose, image, px, settings.continuation)
    if settings.edges.enabled:
        inverse_depth, _ = decide_edges(inverse_depth, ready, camera, pose, image, px, settings.edges)
    decided = inverse_depth
    if knobs.snap:
        inverse_depth = snap_to_edges(inverse_depth, image, px, knobs)
    landings = [land(inverse_depth, source, camera, pose) for source in ready]
    clues = Clues(fused, peak, planes, match, decided, inverse_depth, image, ready, landings, camera, pose)
    probability, sigma_px = confidence_model.estimate(clues, px)
    agreeing = count_agreeing(landings, knobs.support_px)
    surface = Surface(inverse_depth, probability, np.asarray(sigma_px / px, np.float32), agreeing)
    return surface, int((inverse_depth != planes.value).sum())


def _resize_surface(surface: Surface, width: int, height: int) -> Surface:
    import cv2

    def resized(a: F32, mode: int) -> F32:
        return np.asarray(cv2.resize(a, (width, height), interpolation=mode))

    return replace(
        surface,
        inverse_depth=resized(surface.inverse_depth, cv2.INTER_LINEAR),
        confidence=resized(surface.confidence, cv2.INTER_LINEAR),
        sigma=resized(surface.sigma, cv2.INTER_LINEAR),
        seen=resized(surface.seen, cv2.INTER_NEAREST),
    )
