"""The pose stage: choose what to trust, solve sources and photo together, gate, and hand on poses and anchors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial

import numpy as np

from lfrig.contracts.errors import BadInput, GeometryRefused, UsageError
from lfrig.contracts.progress import Monitor
from lfrig.processing.model import F64, Anchors, Evidence, LightField, Photo, Pose, RigPrior
from lfrig.processing.poses import gate
from lfrig.processing.poses.anchors import collect_anchors, common_scale, scale_estimates
from lfrig.processing.poses.confirm import confirmation, is_photo_tied, refuse_untied_photo
from lfrig.processing.poses.features import extract_features, no_features
from lfrig.processing.poses.guide import Guide
from lfrig.processing.poses.join_photo import is_near
from lfrig.processing.poses.light_fields import Effort
from lfrig.processing.poses.matching import Gallery
from lfrig.processing.poses.priors import depth_limits, has_turntable_prior, photo_prior
from lfrig.processing.poses.sightings import look_at
from lfrig.processing.poses.solution import PoseMethod, PoseSolution, ScaleSource
from lfrig.processing.poses.structure import Structure
from lfrig.processing.poses.task import FindFeatures, Task
from lfrig.processing.poses.with_given import solve_given
from lfrig.processing.poses.with_light_fields import solve_with_light_fields, solved_scales
from lfrig.processing.poses.with_prior import solve_with_prior
from lfrig.processing.poses.without_prior import solve_without_prior
from lfrig.processing.poses.work import PoseWork
from lfrig.processing.skipping import SKIP_ALL, Skips, Tally
from lfrig.processing.threads import opencv_threads

QUICK_SIZE = 0.5
"""Pictures of this size are enough to find out roughly where a photo was taken, at a quarter of the cost."""


def solve_poses(
    sources: Sequence[LightField],
    evidence: Sequence[Evidence],
    target: Photo,
    prior: RigPrior,
    method: PoseMethod,
    *,
    threads: int,
    monitor: Monitor,
    work: PoseWork | None = None,
    skips: Skips = SKIP_ALL,
    tally: Tally | None = None,
) -> PoseSolution:
    """Poses of sources and photo in one frame, refined focal lengths, and anchors.

    Parameters
    ----------
    evidence : sequence of Evidence
        One per source; its disparity weeds out anchors that the light field contradicts.
    method : {"auto", "given", "colmap", "lf"}
        ``auto``: given poses when every source has one; else by the light fields when every source has an angle and the
        mount is known; else structure from motion. ``lf`` and ``colmap``: those two even where poses are given, the
        latter with the turntable's prior where there is one.
    threads : int
        0 = all cores. The result does not depend on it.
    work : PoseWork, optional
        What earlier solves found out about the same captures, and then this one; with it, a new target or source costs
        little more than itself.

    Raises
    ------
    BadInput
        ``given`` without a pose for every source, ``lf`` without mount or angles, or no source.
    GeometryRefused
        Identical poses, duplicate captures, too few matches, contradicted turntable angles, no overlap with the photo.
    """
    kind = choose_method(sources, target, prior, method)
    memory = PoseWork() if work is None or not skips.unchanged else work
    memory.begin()
    with opencv_threads(threads), monitor.task("poses", len(sources) + 2):
        features = _lazy_features(sources, target, memory, monitor, 1.0)
        if kind in ("lf", "given"):
            looks = look_at(sources, evidence, target, memory, monitor)
            quick = _lazy_features(sources, target, memory, monitor, QUICK_SIZE)
            effort = Effort(monitor, skips, tally)
            task = Task(sources, evidence, target, prior, looks, features, quick, effort, memory)
            if kind == "lf":
                kind, structure = solve_with_light_fields(task, monitor)
            else:
                structure = solve_given(task, monitor)
        elif kind == "colmap":
            structure = solve_without_prior(sources, evidence, features(range(len(sources))), target, monitor)
        else:
            structure = solve_with_prior(kind, sources, evidence, features(range(len(sources))), target, prior, monitor)
        known = photo_prior(target, prior)
        if kind != "colmap" and (known is None or not is_near(structure.poses[-1], known)):
            guide = Guide(sources, evidence, depth_limits(sources, prior), True)
            asked = partial(is_photo_tied, structure, sources, evidence, target, guide)
            if not memory.once("tied", (structure,), asked):
                refuse_untied_photo(confirmation(structure, sources, evidence, target, guide), target.id)
        monitor.advance()
        return _solution(kind, structure, sources, evidence, target, monitor)


def _lazy_features(
    sources: Sequence[LightField], target: Photo, work: PoseWork, monitor: Monitor, size: float
) -> FindFeatures:
    """SIFT features of views at a fraction of their size, the photo's last, found when first asked for."""

    @cache
    def found(wanted: tuple[int, ...]) -> Gallery:
        features = []
        for v, picture in enumerate((*(s.centre_view for s in sources), target.image8)):
            held = sources[v].views if v < len(sources) else target.image
            if v in wanted or v == len(sources):
                one = work.once(f"features at {size:g}", (held,), partial(extract_features, picture, size=size))
                monitor.advance(0)
            else:
                one = no_features()
            features.append(one)
        return Gallery(features)

    return lambda views: found(tuple(views))


def choose_method(sources: Sequence[LightField], target: Photo, prior: RigPrior, method: PoseMethod) -> str:
    """``given``, ``lf``, ``colmap-turntable`` or ``colmap``."""
    if method not in ("auto", "lf", "given", "colmap"):
        raise UsageError(f"unknown pose method '{method}'", remedy="one of auto, lf, given, colmap")
    if not sources:
        raise BadInput("no source: at least one light field is needed", code="no-source", remedy="ingest one")
    missing = [s.id for s in sources if s.pose is None]
    if method == "given" and missing:
        raise BadInput(
            "has no pose, and --poses given was asked for", path=f"capture {missing[0]}", field="pose",
            code="pose-missing", remedy="record its pose, or use --poses auto",
        )  # fmt: skip
    alone = len(sources) == 1 and photo_prior(target, prior) is None
    if method == "given" and alone:
        raise GeometryRefused(
            f"capture {sources[0].id} is the only source and photo {target.id} has no pose: nothing ties the two "
            "to one scale",
            code="one-source-no-photo-pose",
            remedy="give the photo's pose, add a source, or use --poses colmap",
        )
    if method in ("auto", "given") and not missing and not alone:
        return "given"
    if not has_turntable_prior(sources, prior) or alone:
        if method == "lf":
            raise _no_prior_for_light_fields(sources, prior, target)
        return "colmap"
    return "colmap-turntable" if method == "colmap" else "lf"


def _no_prior_for_light_fields(sources: Sequence[LightField], prior: RigPrior, target: Photo) -> BadInput:
    """Why --poses lf cannot be: what is missing."""
    missing = next((s.id for s in sources if s.turntable_deg is None), None)
    if prior.light_field_from_plate is None:
        path, what = "session", "the rig's light-field camera has no camera_from_plate"
    elif missing is not None:
        path, what = f"capture {missing}", "has no turntable_deg"
    else:
        path, what = f"photo {target.id}", "has no pose and there is one source only"
    return BadInput(
        f"{what}, and --poses lf starts from what the rig knows", path=path, code="no-turntable-prior",
        remedy="record it, or use --poses auto",
    )  # fmt: skip


def _solution(
    kind: str,
    structure: Structure,
    sources: Sequence[LightField],
    evidence: Sequence[Evidence],
    target: Photo,
    monitor: Monitor,
) -> PoseSolution:
    """The last gates, and everything in the form that the pipeline wants."""
    count = len(sources)
    names = [s.id for s in sources]
    arrangement, x = structure.arrangement, structure.parameters
    sigmas = np.array([v.camera.sigma_focal for v in arrangement.views])
    gate.warn_of_focals(x[arrangement.log_focals], sigmas, [*names, target.id], monitor)
    anchors = collect_anchors(structure, count, evidence)
    gate.warn_of_few_anchors([len(a) for a in anchors], names, monitor)
    gate.warn_of_wide_steps(structure.poses, [*names, target.id], monitor)
    poses = with_sigmas(structure)
    origin: ScaleSource = "poses" if kind == "given" else "mount"
    if kind == "colmap":
        estimates = scale_estimates(anchors, structure.cameras, sources, evidence)
        origin = "recorded optics" if estimates else "gauge"
        if not estimates:
            monitor.warn("no-scale", "no pose, mount or baseline is recorded: lengths are in arbitrary units")
        else:
            scale = common_scale(estimates)
            poses = [replace(p, translation=p.translation * scale, sigma_m=p.sigma_m * scale) for p in poses]
            anchors = tuple(Anchors(a.xy, a.depth_m * scale, a.world * scale) for a in anchors)
    turned = np.rad2deg(x[arrangement.turns])
    by_angle = kind in ("lf", "colmap-turntable")
    residual = [float(turned[v]) if by_angle else None for v in range(count)]
    cameras = structure.cameras
    return PoseSolution(
        kind, tuple(poses[:count]), cameras[:count], anchors, tuple(residual), poses[count], cameras[count],
        origin != "gauge", origin, solved_scales(structure, count),
    )  # fmt: skip


def with_sigmas(structure: Structure) -> list[Pose]:
    """Poses with the standard deviations that the adjustment leaves them (gauge included)."""
    chain: F64 = structure.arrangement.local_derivative(structure.parameters)
    out = []
    for pose, table in zip(structure.poses, chain, strict=True):
        variance = np.einsum("ka,ab,kb->k", table[:6], structure.covariance, table[:6])
        sigma = np.sqrt(np.maximum(variance, 0))
        out.append(Pose(pose.rotation, pose.translation, float(np.rad2deg(sigma[:3].max())), float(sigma[3:].max())))
    return out
