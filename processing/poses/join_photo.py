"""The photo joins solved sources by resection, when its prior is unknown or wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lfrig.contracts.progress import Monitor
from lfrig.processing.geometry import rotation_angle_deg
from lfrig.processing.model import Photo, Pose
from lfrig.processing.poses import gate
from lfrig.processing.poses.arrangement import Arrangement
from lfrig.processing.poses.features import Features
from lfrig.processing.poses.matching import Matches
from lfrig.processing.poses.priors import PhotoPrior, known_camera, with_photo
from lfrig.processing.poses.structure import Structure
from lfrig.processing.poses.target import Located, locate_photo
from lfrig.processing.poses.tracks import Pair

LOOSE_DEG = 30.0
ENOUGH_FEATURES = 100


def locate(
    coarse: Structure, features: Sequence[Features], unguided: dict[Pair, Matches], target: Photo
) -> Located | None:
    """The photo's best supported pose against solved sources (`locate_photo`); ``features`` hold the photo's last."""
    last = len(features) - 1
    matches = {i: m for (i, j), m in unguided.items() if j == last}
    theirs = dict(enumerate(features[:-1]))
    found = locate_photo(coarse, theirs, features[-1], matches, known_camera(target))
    return found[0] if found else None


def join_located(
    coarse: Structure, located: Located, target: Photo, known: PhotoPrior | None, monitor: Monitor
) -> Structure:
    """The sources' structure with the photo as its last view, starting where it was located.

    Its prior is kept where the two can be reconciled; else it is dropped with a warning.
    """
    if known is None or not is_near(located.pose, known):
        if known is not None:
            turn = rotation_angle_deg(located.pose.rotation, known.pose.rotation)
            monitor.warn(
                "photo-pose-corrected",
                f"photo {target.id}: the images turn it {turn:.1f}° away from where the rig expects it; the images "
                "are believed",
            )
        known = _nothing_known(located)
    joined = with_view(coarse, with_photo(coarse.arrangement, target, known))
    joint = joined.arrangement
    start = joint.start_at(joined.parameters, len(joint.views) - 1, located.pose)
    start[joint.log_focals.stop - 1] = np.log(located.camera.focal_px / known_camera(target).focal_px)
    return replace(joined, parameters=start)


def with_view(coarse: Structure, joint: Arrangement) -> Structure:
    """The structure in an arrangement with more mounts and views after its own, which nothing has been seen by yet."""
    old, x = coarse.arrangement, np.zeros(joint.size)
    x[: 6 * len(old.mounts)] = coarse.parameters[: 6 * len(old.mounts)]
    for v in range(len(old.views)):
        x[joint.turns.start + v] = coarse.parameters[old.turns.start + v]
        x[joint.wobble(v)] = coarse.parameters[old.wobble(v)]
        x[joint.log_focals.start + v] = coarse.parameters[old.log_focals.start + v]
    lines = coarse.parameters[old.log_lines]
    x[joint.log_lines][: len(lines)] = lines
    return replace(coarse, arrangement=joint, parameters=x)


def _nothing_known(located: Located) -> PhotoPrior:
    """The photo where its matches put it, all but free."""
    reach = float(np.linalg.norm(located.pose.translation)) + 1.0
    pose = replace(located.pose, sigma_deg=LOOSE_DEG, sigma_m=reach)
    return PhotoPrior(pose, pose)


def is_near(pose: Pose, known: PhotoPrior) -> bool:
    """Whether a located pose may be the expected one with the errors that its prior admits."""
    turn = rotation_angle_deg(pose.rotation, known.pose.rotation)
    reach = float(np.linalg.norm(known.pose.translation))
    angle = np.hypot(known.mount.sigma_deg, known.sigma_angle_deg)
    step = float(np.linalg.norm(pose.centre - known.pose.centre))
    limit = 6 * (known.mount.sigma_m + np.deg2rad(angle) * reach) + 0.02 * reach
    return bool(turn < 6 * angle + 1.0 and step < limit)


def refuse_or_doubt(
    agreeing: int, structure: Structure, features: Features, known: PhotoPrior | None, target: Photo, monitor: Monitor
) -> None:
    """A photo that too few matches tie to the sources is refused; one with a trusted pose is only warned of when it
    cannot tell (no texture).
    """
    if agreeing >= gate.MIN_PHOTO_MATCHES:
        return
    if known is None or not known.exact:
        gate.refuse_photo(agreeing, target.id)
    if len(features) >= ENOUGH_FEATURES and structure.seen.count >= gate.GOOD_ANCHORS:
        gate.refuse_photo(agreeing, target.id)
    monitor.warn(
        "photo-unverified",
        f"photo {target.id}: only {agreeing} points of the sources are found in it; its recorded pose is used "
        "unchecked",
    )
