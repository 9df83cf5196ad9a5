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
from lfrig.processing.poses.priors import PhotoPrior, known_camera, neighbours, prior_band_px, with_photo
from lfrig.processing.poses.structure import COARSE_SCHEDULE_PX, Structure, match_again, refine, widened
from lfrig.processing.poses.target import Located, locate_photo, support
from lfrig.processing.poses.tracks import Pair, build_tracks

ENOUGH_FEATURES = 100
LOOSE_DEG = 30.0
FIRST_BAND = 0.008
"""Where coarse poses may still be off, as a fraction of a view's width (4 px at 541)."""

SOLID_SUPPORT = 100
"""A pose near the expected one that so many unguided matches support needs no second look."""


@dataclass(frozen=True)
class Joined:
    """The sources' structure with the photo as one more view, and the photo's unguided matches with each source.

    ``settled`` tells that the views were adjusted together already.
    """

    structure: Structure
    unguided: dict[Pair, Matches]
    settled: bool = False


def join_photo(
    coarse: Structure,
    features: Sequence[Features],
    target: Photo,
    known: PhotoPrior | None,
    guide: Guide,
    monitor: Monitor,
) -> Joined:
    """Find the photo's place among solved sources.

    By resection from their points; where there are none (one source, or sources far apart with the photo between
    them) by adjusting all views together from the expected pose.

    Raises
    ------
    GeometryRefused
        ``photo-no-overlap``.
    """
    own, theirs, last = features[-1], dict(enumerate(features[:-1])), len(features) - 1
    camera = known_camera(target)
    matches = {v: match_features(f, own) for v, f in theirs.items()}
    unguided = {(v, last): m for v, m in matches.items()}
    if known is not None and known.exact:
        agreeing = sum(support(coarse, theirs, own, matches, known.pose, camera).values())
        _judge_given_photo(agreeing, coarse, own, target, monitor)
        return Joined(_with_view(coarse, with_photo(coarse.arrangement, target, known)), unguided)
    located = locate_photo(coarse, theirs, own, matches, camera)
    if known is not None and not (located is not None and _is_solid(located) and _near(located.pose, known)):
        joined = _with_view(coarse, with_photo(coarse.arrangement, target, known))
        near = _expected_matches(joined, coarse, features, guide)
        other = locate_photo(coarse, theirs, own, near, camera)
        located = max((t for t in (located, other) if t is not None), key=lambda t: t.support, default=None)
        if located is None or not _is_solid(located):
            settled = _settle(joined, near, features, guide, monitor)
            agreeing = sum(support(settled, theirs, own, matches, settled.poses[-1], settled.cameras[-1]).values())
            if located is None or agreeing >= located.support:
                gate.refuse_photo(agreeing, target.id)
                return Joined(settled, unguided, True)
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
    return Joined(_started_at(joined, located, camera), unguided)


def _is_solid(located: Located) -> bool:
    return located.support >= SOLID_SUPPORT


def _settle(
    joined: Structure, near: dict[int, Matches], features: Sequence[Features], guide: Guide, monitor: Monitor
) -> Structure:
    """All views adjusted together from the expected pose, by matches near where it expects them."""
    last = len(features) - 1
    arrangement, x = joined.arrangement, joined.parameters
    matches: dict[Pair, Matches] = {(v, last): m for v, m in near.items()}
    inner = [p for p in neighbours(joined.poses) if last not in p]
    band = FIRST_BAND * joined.cameras[0].width
    matches.update(match_again(joined, features, inner, guide, band))
    seen = build_tracks(features, matches)
    return refine(arrangement, x, seen, widened(guide), COARSE_SCHEDULE_PX, monitor)


def _expected_matches(
    joined: Structure, coarse: Structure, features: Sequence[Features], guide: Guide
) -> dict[int, Matches]:
    """Matches of each source with the photo near where the prior expects them."""
    last = len(features) - 1
    bands = {(v, last): prior_band_px(joined.arrangement, v, last) for v in range(last)}
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
