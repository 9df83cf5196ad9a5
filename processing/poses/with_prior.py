"""Poses from a prior (given, or mount and turntable): matched, adjusted together with the photo, and checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lfrig.contracts.errors import GeometryRefused
from lfrig.contracts.progress import Monitor
from lfrig.processing.geometry import rotation_angle_deg
from lfrig.processing.model import F64, LightField, Photo, Pose, RigPrior
from lfrig.processing.poses import gate
from lfrig.processing.poses.arrangement import Arrangement
from lfrig.processing.poses.features import Features
from lfrig.processing.poses.matching import Matches, match_features
from lfrig.processing.poses.priors import (
    PhotoPrior,
    depth_limits,
    given_arrangement,
    known_camera,
    neighbours,
    photo_prior,
    recentred,
    turntable_arrangement,
    with_photo,
)
from lfrig.processing.poses.structure import Structure, complete, refine
from lfrig.processing.poses.target import Located, locate_photo, support
from lfrig.processing.poses.tracks import Pair, build_tracks

COARSE_SCHEDULE_PX = (16.0, 4.0, 1.0)
JOINT_SCHEDULE_PX = (4.0, 1.0)
ENOUGH_FEATURES = 100
LOOSE_DEG = 30.0
FLIP_GAIN = 3


def solve_with_prior(
    kind: str,
    sources: Sequence[LightField],
    features: Sequence[Features],
    target: Photo,
    prior: RigPrior,
    monitor: Monitor,
) -> Structure:
    """Structure of the sources (first views) and the photo (last view), in the frame of the prior.

    ``kind`` is ``given`` or ``colmap-turntable``; ``features`` hold the photo's last.
    """
    names = [s.id for s in sources]
    arrangement = given_arrangement(sources) if kind == "given" else turntable_arrangement(sources, prior)
    # Given poses are moved around the cameras, so that a world whose origin is far away costs no digits; the turntable
    # has its axis at the origin already.
    origin = None
    if kind == "given":
        origin = np.mean([p.centre for p in arrangement.mounts], axis=0)
        arrangement = _moved(arrangement, origin)
    limits = depth_limits(sources, prior)
    expected = arrangement.poses(np.zeros(arrangement.size))
    gate.refuse_identical_poses(expected, names, limits[0])
    matches = {(i, j): match_features(features[i], features[j]) for i, j in neighbours(expected)}
    gate.refuse_duplicates(expected, features, matches, names)

    still = not (arrangement.sigmas() > 0).any()
    schedule: tuple[float, ...] = (1.0,) if still else COARSE_SCHEDULE_PX
    start = np.zeros(arrangement.size)
    coarse = refine(arrangement, start, build_tracks(features[:-1], matches), _widened(limits), schedule, monitor)
    photo_matches = {v: match_features(features[v], features[-1]) for v in range(len(sources))}
    known = photo_prior(target, prior, origin)
    joint, start = _join_photo(coarse, features, photo_matches, target, known, monitor)

    poses = joint.poses(start)
    last = len(sources)
    every: dict[Pair, Matches] = {
        (i, j): photo_matches[i] if j == last else matches.get((i, j), _empty()) for i, j in neighbours(poses)
    }
    every = {p: m if len(m) else match_features(features[p[0]], features[p[1]]) for p, m in every.items()}
    schedule = (1.0,) if not (joint.sigmas() > 0).any() else JOINT_SCHEDULE_PX
    first = refine(joint, start, build_tracks(features, every), _widened(limits), schedule, monitor)
    if kind != "given":
        _check_turntable(first, coarse, features, matches, every, sources, prior, limits, monitor)
    final = complete(first, features, list(every), limits, monitor)
    if origin is None:
        return final
    return replace(final, arrangement=_moved(final.arrangement, -origin), points=final.points + origin)


def _join_photo(
    coarse: Structure,
    features: Sequence[Features],
    matches: dict[int, Matches],
    target: Photo,
    known: PhotoPrior | None,
    monitor: Monitor,
) -> tuple[Arrangement, F64]:
    """The arrangement with the photo as its last view, and parameters to start from."""
    source_features = dict(enumerate(features[:-1]))
    camera = known_camera(target)
    if known is not None and known.exact:
        count = support(coarse, source_features, features[-1], matches, known.pose, camera)
        _judge_given_photo(count, coarse, features[-1], target, monitor)
        joint = with_photo(coarse.arrangement, target, known)
        return joint, extended(coarse, joint)
    expected = None if known is None else known.pose
    located = locate_photo(coarse, source_features, features[-1], matches, camera, expected)
    gate.refuse_photo(0 if located is None else located.support, target.id)
    assert located is not None
    if known is None or not _near(located.pose, known):
        if known is not None:
            turn = rotation_angle_deg(located.pose.rotation, known.pose.rotation)
            monitor.warn(
                "photo-pose-corrected",
                f"photo {target.id}: the images turn it {turn:.1f}° away from where the rig expects it; the images "
                "are believed",
            )
        known = _nothing_known(located)
    joint = with_photo(coarse.arrangement, target, known)
    start = joint.start_at(extended(coarse, joint), len(joint.views) - 1, located.pose)
    start[joint.log_focals.stop - 1] = np.log(located.camera.focal_px / camera.focal_px)
    return joint, start


def _nothing_known(located: Located) -> PhotoPrior:
    """The photo where its matches put it, all but free."""
    reach = float(np.linalg.norm(located.pose.translation)) + 1.0
    pose = replace(located.pose, sigma_deg=LOOSE_DEG, sigma_m=reach)
    return PhotoPrior(pose, pose)


def _near(pose: Pose, known: PhotoPrior) -> bool:
    """Whether a located pose may be the expected one with the errors that its prior admits."""
    turn = rotation_angle_deg(pose.rotation, known.pose.rotation)
    reach = float(np.linalg.norm(known.pose.translation))
    angle = np.hypot(known.mount.sigma_deg, known.sigma_angle_deg)
    step = float(np.linalg.norm(pose.centre - known.pose.centre))
    limit = 6 * (known.mount.sigma_m + np.deg2rad(angle) * reach) + 0.02 * reach
    return bool(turn < 6 * angle + 1.0 and step < limit)


def _judge_given_photo(count: int, coarse: Structure, features: Features, target: Photo, monitor: Monitor) -> None:
    """A photo with a trusted pose: refused when it ought to match and does not, warned of when it cannot tell."""
    if count >= gate.MIN_PHOTO_MATCHES:
        return
    if len(features) >= ENOUGH_FEATURES and coarse.seen.count >= gate.GOOD_ANCHORS:
        gate.refuse_photo(count, target.id)
    monitor.warn(
        "photo-unverified",
        f"photo {target.id}: only {count} points of the sources are found in it; its recorded pose is used unchecked",
    )


def _check_turntable(
    first: Structure,
    coarse: Structure,
    features: Sequence[Features],
    matches: dict[Pair, Matches],
    every: dict[Pair, Matches],
    sources: Sequence[LightField],
    prior: RigPrior,
    limits: tuple[float, float],
    monitor: Monitor,
) -> None:
    names = [s.id for s in sources]
    counts = [int(n) for n in first.seen.per_view(len(first.poses))[: len(sources)]]
    recorded = np.array([v.angle_deg for v in coarse.arrangement.views])
    if min(counts) < gate.MIN_VIEW_MATCHES:
        _refuse_flipped(coarse, features, matches, limits, monitor)
    gate.refuse_lonely_views(counts, every, names)
    turns = np.rad2deg(first.parameters[first.arrangement.turns])[: len(sources)]
    gate.check_angles(turns, recorded, prior.turntable_sigma_deg, names, monitor)


def _refuse_flipped(
    coarse: Structure,
    features: Sequence[Features],
    matches: dict[Pair, Matches],
    limits: tuple[float, float],
    monitor: Monitor,
) -> None:
    """Say so when the angles would fit with the other sign."""
    before = coarse.arrangement
    flipped = replace(before, views=tuple(replace(v, angle_deg=-v.angle_deg) for v in before.views))
    seen = build_tracks(features[:-1], matches)
    other = refine(flipped, np.zeros(flipped.size), seen, _widened(limits), COARSE_SCHEDULE_PX, monitor)
    if len(other.seen) > FLIP_GAIN * max(len(coarse.seen), gate.MIN_VIEW_MATCHES):
        raise GeometryRefused(
            "the turntable angles fit the images only with the opposite sign",
            code="turntable-direction",
            remedy="turntable_deg counts counter-clockwise seen from above: invert the recorded angles",
        )


def extended(structure: Structure, joint: Arrangement) -> F64:
    """The structure's parameters in an arrangement with more mounts and views after its own."""
    old, x = structure.arrangement, np.zeros(joint.size)
    x[: 6 * len(old.mounts)] = structure.parameters[: 6 * len(old.mounts)]
    for v in range(len(old.views)):
        x[joint.turns.start + v] = structure.parameters[old.turns.start + v]
        x[joint.wobble(v)] = structure.parameters[old.wobble(v)]
        x[joint.log_focals.start + v] = structure.parameters[old.log_focals.start + v]
    return x


def _widened(limits: tuple[float, float]) -> tuple[float, float]:
    """Depths that points may have while poses are still rough."""
    return limits[0] / 1.5, limits[1] * 1.5


def _empty() -> Matches:
    return np.zeros((0, 2), np.int64)


def _moved(arrangement: Arrangement, origin: F64) -> Arrangement:
    """The arrangement in a world whose origin is moved to ``origin`` [3]."""
    return replace(arrangement, mounts=tuple(recentred(m, origin) for m in arrangement.mounts))
