"""The photo joins the sources: located, checked, and made the last view of their arrangement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lfrig.contracts.progress import Monitor
from lfrig.processing.geometry import rotation_angle_deg
from lfrig.processing.model import F64, Camera, Photo, Pose
from lfrig.processing.poses import gate
from lfrig.processing.poses.arrangement import Arrangement
from lfrig.processing.poses.features import Features
from lfrig.processing.poses.guide import Guide
from lfrig.processing.poses.matching import Matches, match_features
from lfrig.processing.poses.priors import PhotoPrior, known_camera, prior_band_px, with_photo
from lfrig.processing.poses.structure import Structure
from lfrig.processing.poses.target import Located, locate_photo, support

ENOUGH_FEATURES = 100
LOOSE_DEG = 30.0
SOLID_SUPPORT = 100
"""A pose near the expected one that so many unguided matches support needs no second look."""


@dataclass(frozen=True)
class Joined:
    """The sources' structure with the photo as one more view, and how many of each source's matches with it agree."""

    structure: Structure
    agreeing: dict[int, int]


def join_photo(
    coarse: Structure,
    features: Sequence[Features],
    target: Photo,
    known: PhotoPrior | None,
    guide: Guide,
    monitor: Monitor,
) -> Joined:
    """Locate the photo against solved sources, by matches near where it is expected and by unguided ones.

    Raises
    ------
    GeometryRefused
        ``photo-no-overlap``.
    """
    own, theirs = features[-1], dict(enumerate(features[:-1]))
    camera = known_camera(target)
    matches = {v: match_features(f, own) for v, f in theirs.items()}
    if known is not None and known.exact:
        agreeing = support(coarse, theirs, own, matches, known.pose, camera)
        _judge_given_photo(sum(agreeing.values()), coarse, own, target, monitor)
        return Joined(_with_view(coarse, with_photo(coarse.arrangement, target, known)), agreeing)
    located = locate_photo(coarse, theirs, own, matches, camera, None if known is None else known.pose)
    solid = located is not None and located.support >= SOLID_SUPPORT
    if known is not None and not (solid and located is not None and _near(located.pose, known)):
        near = _expected_matches(coarse, features, with_photo(coarse.arrangement, target, known), guide)
        other = locate_photo(coarse, theirs, own, near, camera, known.pose)
        located = max((t for t in (located, other) if t is not None), key=lambda t: t.support, default=None)
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
    joined = _with_view(coarse, with_photo(coarse.arrangement, target, known))
    return Joined(_started_at(joined, located, camera), located.agreeing)


def _expected_matches(
    coarse: Structure, features: Sequence[Features], joint: Arrangement, guide: Guide
) -> dict[int, Matches]:
    """Matches of each source with the photo near where the prior expects them."""
    joined = _with_view(coarse, joint)
    last = len(features) - 1
    bands = {(v, last): prior_band_px(joint, v, last) for v in range(last)}
    found = guide.matches(joined.cameras, joined.poses, features, guide.intervals(features, coarse), bands)
    return {v: m for (v, _), m in found.items()}


def _with_view(coarse: Structure, joint: Arrangement) -> Structure:
    return replace(coarse, arrangement=joint, parameters=extended(coarse, joint))


def _started_at(joined: Structure, located: Located, recorded: Camera) -> Structure:
    joint = joined.arrangement
    start = joint.start_at(joined.parameters, len(joint.views) - 1, located.pose)
    start[joint.log_focals.stop - 1] = np.log(located.camera.focal_px / recorded.focal_px)
    return replace(joined, parameters=start)


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


def extended(structure: Structure, joint: Arrangement) -> F64:
    """The structure's parameters in an arrangement with more mounts and views after its own."""
    old, x = structure.arrangement, np.zeros(joint.size)
    x[: 6 * len(old.mounts)] = structure.parameters[: 6 * len(old.mounts)]
    for v in range(len(old.views)):
        x[joint.turns.start + v] = structure.parameters[old.turns.start + v]
        x[joint.wobble(v)] = structure.parameters[old.wobble(v)]
        x[joint.log_focals.start + v] = structure.parameters[old.log_focals.start + v]
    return x
