"""The stages in order: sources and a photo in, a synthesized light field out.

    evidence → poses → scale fit → fusion → surface → refine → synthesis

Each stage is timed and says what it did and what it skipped. `process` is pure: no files, no globals; the same inputs
give the same bytes for any thread count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from lfrig.contracts.errors import BadInput
from lfrig.contracts.native import load_native
from lfrig.contracts.progress import Monitor, Notice
from lfrig.contracts.result import StageReport
from lfrig.processing.agreement import check_agreement
from lfrig.processing.model import (
    Anchors,
    Camera,
    Evidence,
    Image,
    LightField,
    LightFieldRequest,
    Photo,
    Pose,
    RigPrior,
    Source,
    Surface,
    SynthesizedLightField,
)
from lfrig.processing.options import ProcessOptions, check_options
from lfrig.processing.plate import Box, crop_photo, crop_to_plate, paste_surface, photo_box, uncrop_camera
from lfrig.processing.poses import PoseSolution, PoseWork, solve_poses
from lfrig.processing.prepare import find_evidence, fit_sources, metric_depth_range
from lfrig.processing.reconstruct import Target, reconstruct
from lfrig.processing.resolution import scale_light_field, scale_photo, scale_surface
from lfrig.processing.reuse import EvidenceStore
from lfrig.processing.sharpness import warn_of_defocus
from lfrig.processing.stages import StageClock
from lfrig.processing.still import warn_of_still_background
from lfrig.processing.synthesis import render_views


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
    store: EvidenceStore | None = None,
) -> ProcessResult:
    """Turn sources and a photo into a light field.

    Parameters
    ----------
    evidence : sequence of Evidence, optional
        One per source, when already computed from the same views, settings and resolution.
    store : EvidenceStore, optional
        Where evidence of the same content may be found, and is kept.

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
    clock = StageClock(monitor, options.threads)
    settings, threads, resolution = options.knobs, options.threads, options.geometry_resolution
    working, photo = [scale_light_field(lf, resolution) for lf in sources], scale_photo(target, resolution)
    box = None
    with clock.stage("evidence", len(working)) as note:
        if evidence is None:
            if settings.skips.plate:
                working, box = crop_to_plate(working, prior, note.tally), photo_box(photo, prior)
            evidence = find_evidence(
                working, prior, settings, store=store, threads=threads, monitor=monitor, tally=note.tally
            )
            note.skipped(sum(1 - e.occlusion_tested for e in evidence) * 100 / len(evidence), "% half-aperture tests")
            note.done(sum(e.occlusion_tested for e in evidence) * 100 / len(evidence))
    geometry = find_geometry(working, photo, evidence, prior, options, clock, box=box)
    solution, camera, surface = geometry.solution, geometry.camera, geometry.surface
    if resolution != 1.0:
        height, width = target.image.shape[:2]
        camera, surface = camera.resized(width, height), scale_surface(surface, width, height)
    image = target.image if options.bit_depth == 16 else target.image8
    made = synthesize(image, surface, camera, geometry.request, options, clock)
    return ProcessResult(
        light_field=made, target=target, target_camera=camera, target_pose=solution.target_pose,
        sources=tuple(
            SourceResult(s, a, r)
            for s, a, r in zip(geometry.sources, solution.anchors, solution.angle_residual_deg, strict=True)
        ),
        stages=tuple(clock.reports), notices=tuple(monitor.notices), poses_method=solution.method,
        metric=solution.metric, preset=options.preset,
        native=load_native("lfrig.processing.kernels._native") is not None, threads=threads,
        options={"resolution": resolution, "poses": options.poses, "bit_depth": options.bit_depth},
        scale_source=solution.scale_source,
    )  # fmt: skip


@dataclass(frozen=True)
class Geometry:
    """Where everything stands, and the surface of the whole photo with the ``camera`` that sees it; the light field
    that is asked for.
    """

    solution: PoseSolution
    sources: list[Source]
    request: LightFieldRequest
    camera: Camera
    surface: Surface


def find_geometry(
    light_fields: Sequence[LightField],
    photo: Photo,
    evidence: Sequence[Evidence],
    prior: RigPrior,
    options: ProcessOptions,
    clock: StageClock,
    *,
    box: Box | None = None,
    work: PoseWork | None = None,
) -> Geometry:
    """All stages between evidence and synthesis.

    ``box`` is the part of the photo that is looked at; ``work`` remembers what earlier calls found out about the same
    captures.

    Raises
    ------
    GeometryRefused
        Poses or scales that cannot be trusted, or no overlap.
    """
    shown = crop_photo(photo, box)
    solution, sources = _locate(light_fields, shown, evidence, prior, options, clock, work)
    camera, pose = solution.target_camera, solution.target_pose
    request = wanted_light_field(options, sources, pose)
    surface = reconstruct(
        sources, Target(shown.image8, camera, pose), metric_depth_range(light_fields, prior, solution), request,
        options.knobs, clock, threads=options.threads,
    )  # fmt: skip
    height, width = photo.image.shape[:2]
    camera, surface = uncrop_camera(camera, box, width, height), paste_surface(surface, box, width, height)
    return Geometry(solution, sources, request, camera, surface)


def _locate(
    light_fields: Sequence[LightField],
    photo: Photo,
    evidence: Sequence[Evidence],
    prior: RigPrior,
    options: ProcessOptions,
    clock: StageClock,
    work: PoseWork | None,
) -> tuple[PoseSolution, list[Source]]:
    """Where everything stands, and to what scale: the stages ``poses`` and ``scale-fit``."""
    monitor = clock.monitor
    with clock.stage("poses", None) as note:
        warn_of_defocus(light_fields, monitor, work)
        warn_of_still_background(light_fields, monitor, work)
        solution = solve_poses(
            light_fields, evidence, photo, prior, options.poses, work=work, skips=options.knobs.skips,
            tally=note.tally, threads=options.threads, monitor=monitor,
        )  # fmt: skip
        note.done(sum(len(a) for a in solution.anchors), "anchors")
    with clock.stage("scale-fit", len(light_fields)) as note:
        ready = fit_sources(light_fields, evidence, solution, options.knobs, monitor)
        check_agreement(ready, photo, solution.target_camera, solution.target_pose, monitor, work)
        note.done(sum(s.scale.anchors for s in ready), "anchors")
    return solution, ready


def synthesize(
    image: Image,
    surface: Surface,
    camera: Camera,
    request: LightFieldRequest,
    options: ProcessOptions,
    clock: StageClock,
) -> SynthesizedLightField:
    """The views of a photo with a known surface of its size: the stage ``synthesis``."""
    knobs = options.knobs
    with clock.stage("synthesis", request.rows * request.cols) as note:
        disparity = request.disparity(surface.inverse_depth, camera.focal_px)
        views = render_views(
            image, disparity, request.rows, request.cols, method=knobs.synthesis.method,
            settings=knobs.synthesis, skips=knobs.skips, tally=note.tally, threads=options.threads,
            monitor=clock.monitor,
        )  # fmt: skip
        note.done(request.rows * request.cols - 1, "views")
    return SynthesizedLightField(views, disparity, surface, request, camera)


def wanted_light_field(options: ProcessOptions, sources: Sequence[Source], target: Pose) -> LightFieldRequest:
    """The light field to make; unset optics are the fitted ones of the source nearest by direction (ties: lower id)."""
    baseline, focus = options.target_baseline_m, options.target_focus_m
    if baseline is None or focus is None:
        nearest = min(sources, key=lambda s: (-round(float(s.pose.direction @ target.direction), 9), s.light_field.id))
        baseline = baseline or 1 / (nearest.scale.a * nearest.camera.focal_px)
        focus = focus or (1 / nearest.scale.c if nearest.scale.c > 1e-6 else 1e6)
    return LightFieldRequest(baseline, focus, options.rows, options.cols)
