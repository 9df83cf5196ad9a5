"""Poses from images alone, in a frame and scale of their own: mapped, then adjusted with loose priors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lfrig.contracts.errors import GeometryRefused
from lfrig.contracts.progress import Monitor
from lfrig.processing.model import Camera, Evidence, LightField, Photo, Pose
from lfrig.processing.poses import gate
from lfrig.processing.poses.anchors import collect_anchors, furthest_estimate, scale_estimates
from lfrig.processing.poses.arrangement import Arrangement, Viewpoint
from lfrig.processing.poses.confirm import confirmation
from lfrig.processing.poses.features import Features
from lfrig.processing.poses.guide import Guide
from lfrig.processing.poses.mapping import Mapped, map_incrementally
from lfrig.processing.poses.matching import Gallery, Matches
from lfrig.processing.poses.priors import known_camera, neighbours
from lfrig.processing.poses.structure import Structure, complete, refine
from lfrig.processing.poses.tracks import Pair, build_tracks
from lfrig.processing.poses.triangulate import reproject, triangulate

SCHEDULE_PX = (8.0, 2.0, 1.0)
LOOSE_DEG = 10.0
MEDIAN_DEPTH = 0.5
"""The gauge: the median point of the first source lies here."""

DEPTH_SPAN = 8.0


def solve_without_prior(
    sources: Sequence[LightField],
    evidence: Sequence[Evidence],
    features: Gallery,
    target: Photo,
    monitor: Monitor,
) -> Structure:
    """Structure of the sources and, as its last view, the photo."""
    names = [*(f"capture {s.id}" for s in sources), f"photo {target.id}"]
    cameras = [*(known_camera(s) for s in sources), known_camera(target)]
    count = len(cameras)
    matches: dict[Pair, Matches] = {(i, j): features.match(i, j) for j in range(count) for i in range(j)}
    candidates = map_incrementally(cameras, features, matches, monitor)
    mapped = candidates[0].views if candidates else {}
    _refuse_missing(mapped, names, matches, features)
    guide = Guide(sources, evidence, (MEDIAN_DEPTH / DEPTH_SPAN, MEDIAN_DEPTH * DEPTH_SPAN), False)
    refusal: GeometryRefused | None = None
    for candidate in candidates:
        if len(candidate.views) < len(mapped):
            break
        arrangement = _loose_arrangement(candidate.views, cameras)
        try:
            # After a refusal, only what the pictures confirm is good enough.
            return _checked(arrangement, features, matches, guide, target, refusal is not None, monitor)
        except GeometryRefused as found:
            # What is wrong with the likeliest one is what the operator is told.
            refusal = refusal or found
    assert refusal is not None
    raise refusal


def _checked(
    arrangement: Arrangement,
    features: Gallery,
    matches: dict[Pair, Matches],
    guide: Guide,
    target: Photo,
    strict: bool,
    monitor: Monitor,
) -> Structure:
    """What a mapping comes to when all matches are used; refused where pictures contradict it, or,
    if ``strict``, where the light fields cannot confirm it.
    """
    ids = [s.id for s in guide.sources]
    seen = build_tracks(features, {p: matches[p] for p in neighbours(arrangement.mounts)})
    scaled = _in_gauge(arrangement, features, matches)
    first = refine(scaled, np.zeros(scaled.size), seen, guide.depth_range, SCHEDULE_PX, monitor)
    poses = first.poses
    gate.refuse_identical_poses(poses[:-1], ids, MEDIAN_DEPTH)
    agreement = gate.measure_agreement(first, features, matches)
    gate.refuse_photo(agreement.agreeing[-1], target.id)
    gate.refuse_lonely_views(agreement, ids)
    gate.refuse_unstable_views(agreement, ids)
    final = complete(first, features, neighbours(poses), guide, monitor)
    gate.refuse_bent_lenses(final, ids)
    _refuse_contradicting_optics(final, guide)
    confirmed = confirmation(final, guide.sources, guide.evidence, target, guide)
    groups = confirmed.tied_groups() if confirmed else [[v] for v in range(len(poses))] if strict else []
    gate.refuse_scattered_views(groups, [*(f"capture {i}" for i in ids), f"photo {target.id}"])
    return final


def _refuse_contradicting_optics(final: Structure, guide: Guide) -> None:
    """Refuse depths that make recorded baselines and focus distances contradict each other: what is solved is then no
    scaled copy of what was there.
    """
    sources = guide.sources
    anchors = collect_anchors(final, len(sources), guide.evidence)
    estimates = scale_estimates(anchors, final.cameras, sources, guide.evidence)
    outlier = furthest_estimate(estimates) if estimates else None
    if outlier is not None:
        gate.refuse_optics(sources[outlier.source].id, outlier.of)


def _refuse_missing(
    mapped: Mapped, names: Sequence[str], matches: dict[Pair, Matches], features: Sequence[Features]
) -> None:
    """Refuse when a view was not registered: the photo by its own code, as it is the one to be raised."""
    photo = len(names) - 1
    missing = [v for v in range(len(names)) if v not in mapped]
    if not missing:
        return
    if missing == [photo]:
        gate.refuse_photo(0, names[photo].split(" ", 1)[1])
    most = max((len(m) for pair, m in matches.items() if missing[0] in pair), default=0)
    raise GeometryRefused(
        f"{names[missing[0]]}: structure from motion finds no place for it (at most {most} matches with another view)",
        code="not-registered",
        remedy="record the turntable's angles and mount, or poses; or leave it out with --sources",
    )


def _loose_arrangement(mapped: Mapped, recorded: Sequence[Camera]) -> Arrangement:
    """Every view free around where it was mapped, the first one held; focal lengths keep their recorded priors."""
    poses = [mapped[v][0] for v in range(len(recorded))]
    anchor = poses[0]
    reach = max(float(np.linalg.norm(p.centre - anchor.centre)) for p in poses)
    mounts, views = [], []
    for v, pose in enumerate(poses):
        # The first view's pose and everybody's loose translations are the gauge; they bias nothing else.
        loose = pose if v == 0 else replace(pose, sigma_deg=LOOSE_DEG, sigma_m=reach)
        relative = loose.rotation @ anchor.rotation.T
        mounts.append(Pose(relative, pose.rotation @ (anchor.centre - pose.centre), loose.sigma_deg, loose.sigma_m))
        mapped_camera = mapped[v][1]
        camera = recorded[v]
        if mapped_camera.focal_px != camera.focal_px:
            camera = replace(mapped_camera, sigma_focal=camera.sigma_focal)
        views.append(Viewpoint(camera, v))
    return Arrangement(tuple(mounts), tuple(views))


def _in_gauge(arrangement: Arrangement, features: Sequence[Features], matches: dict[Pair, Matches]) -> Arrangement:
    """The arrangement scaled so that the first view's median point lies at `MEDIAN_DEPTH`."""
    seen = build_tracks(features, matches)
    zero = np.zeros(arrangement.size)
    cameras, poses = arrangement.cameras(zero), arrangement.poses(zero)
    points = triangulate(cameras, poses, seen)
    residual, depth = reproject(cameras, poses, seen, points)
    good = (seen.view == 0) & (depth > 0) & (np.linalg.norm(residual, axis=1) < 4)
    scale = MEDIAN_DEPTH / float(np.median(depth[good])) if good.any() else 1.0
    mounts = tuple(replace(m, translation=m.translation * scale, sigma_m=m.sigma_m * scale) for m in arrangement.mounts)
    return replace(arrangement, mounts=mounts)
