"""Poses from images alone, in a frame and scale of their own: mapped, then adjusted with loose priors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lfrig.contracts.errors import GeometryRefused
from lfrig.contracts.progress import Monitor
from lfrig.processing.model import Camera, Evidence, LightField, Photo, Pose
from lfrig.processing.poses import gate
from lfrig.processing.poses.arrangement import Arrangement, Viewpoint
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
    mapped = map_incrementally(cameras, features, matches, monitor)
    _refuse_missing(mapped, names, matches, features)
    arrangement = _loose_arrangement(mapped, cameras)
    seen = build_tracks(features, {p: matches[p] for p in neighbours(arrangement.mounts)})
    limits = (MEDIAN_DEPTH / DEPTH_SPAN, MEDIAN_DEPTH * DEPTH_SPAN)
    scaled = _in_gauge(arrangement, features, matches)
    first = refine(scaled, np.zeros(scaled.size), seen, limits, SCHEDULE_PX, monitor)
    poses = first.poses
    gate.refuse_identical_poses(poses[:-1], [s.id for s in sources], MEDIAN_DEPTH)
    agreement = gate.measure_agreement(first, features, matches)
    gate.refuse_photo(agreement.agreeing[-1], target.id)
    gate.refuse_lonely_views(agreement, [s.id for s in sources])
    gate.refuse_unstable_views(agreement, [s.id for s in sources])
    return complete(first, features, neighbours(poses), Guide(sources, evidence, limits, False), monitor)


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
