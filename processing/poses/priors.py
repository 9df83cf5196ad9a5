"""What is known of the cameras before any image is looked at: given poses, or the mount and the turntable's angle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lfrig.processing.geometry import rotation_angle_deg, turntable_pose
from lfrig.processing.model import F64, Camera, LightField, Photo, Pose, RigPrior
from lfrig.processing.poses.arrangement import Arrangement, Viewpoint
from lfrig.processing.poses.tracks import Pair

WOBBLE_DEG = 0.02
WOBBLE_M = 0.0002
"""How far a view may lie off the circle of the turntable: bearing play, and the pupil's shift with zoom."""

PUPIL_SHIFT_M = 0.002
SAME_SETTINGS = 0.01
"""A zoom moves the entrance pupil along the axis by millimetres: that much is allowed where recorded focal lengths or
focus distances differ by more than this fraction."""

PAIR_LIMIT_DEG = 46.0
"""Views further apart share next to nothing; up to here their few matches, guided, tie the whole together."""

UNKNOWN_FOCAL_WIDTHS = 1.2
UNKNOWN_FOCAL_SIGMA = 0.3
DEFAULT_DEPTH_RANGE_M = (0.02, 100.0)


def has_turntable_prior(sources: Sequence[LightField], prior: RigPrior) -> bool:
    """Whether every source's pose follows from the rig's mount and its angle."""
    return prior.light_field_from_plate is not None and all(s.turntable_deg is not None for s in sources)


def known_camera(capture: LightField | Photo) -> Camera:
    """The capture's camera; a guess with a wide sigma where it is unknown."""
    if capture.camera is not None:
        return capture.camera
    height, width = (capture.height, capture.width) if isinstance(capture, LightField) else capture.image.shape[:2]
    return Camera.centred(width, height, UNKNOWN_FOCAL_WIDTHS * max(width, height), UNKNOWN_FOCAL_SIGMA)


def given_arrangement(sources: Sequence[LightField]) -> Arrangement:
    """Every source on a mount of its own, at its given pose, free within the pose's sigmas."""
    poses = [s.pose for s in sources]
    assert all(p is not None for p in poses)
    return Arrangement(
        tuple(p for p in poses if p is not None), tuple(Viewpoint(known_camera(s), v) for v, s in enumerate(sources))
    )


def centred_arrangement(sources: Sequence[LightField]) -> tuple[Arrangement, F64]:
    """Given poses moved around the cameras, so that a world whose origin is far away costs no digits; and where that
    middle is [3].
    """
    given = given_arrangement(sources)
    origin = np.mean([p.centre for p in given.mounts], axis=0)
    return recentred_arrangement(given, origin), origin


def recentred_arrangement(arrangement: Arrangement, origin: F64) -> Arrangement:
    """The arrangement in a world whose origin is moved to ``origin`` [3]."""
    return replace(arrangement, mounts=tuple(recentred(m, origin) for m in arrangement.mounts))


def turntable_arrangement(
    sources: Sequence[LightField], prior: RigPrior, pupil_shift_m: float = WOBBLE_M
) -> Arrangement:
    """All sources on one mount in front of the plate, each at its angle.

    ``pupil_shift_m`` is how far zoom and focus may have moved the pupil where the settings differ. Without the light
    fields' word on depth, room for it costs more than it is worth.
    """
    assert prior.light_field_from_plate is not None
    along = pupil_shift_m if settings_differ(sources) else WOBBLE_M
    views = [
        Viewpoint(known_camera(s), 0, s.turntable_deg or 0.0, prior.turntable_sigma_deg, WOBBLE_DEG, WOBBLE_M, along)
        for s in sources
    ]
    return Arrangement((prior.light_field_from_plate,), tuple(views))


def settings_differ(sources: Sequence[LightField]) -> bool:
    """Whether the lens was zoomed or focused between captures, as far as recorded."""
    focals = [s.camera.focal_px / s.width for s in sources if s.camera is not None]
    focus = [s.optics.focus_distance_m for s in sources if s.optics.focus_distance_m is not None]
    return any(len(v) > 1 and max(v) / min(v) > 1 + SAME_SETTINGS for v in (focals, focus))


@dataclass(frozen=True)
class PhotoPrior:
    """Where the photo is expected: ``pose``, and the mount, angle [deg] and its sigma that it follows from."""

    pose: Pose
    mount: Pose
    angle_deg: float = 0.0
    sigma_angle_deg: float = 0.0

    @property
    def exact(self) -> bool:
        """Whether the pose is held."""
        return self.mount.sigma_deg == 0 and self.mount.sigma_m == 0 and self.sigma_angle_deg == 0


def photo_prior(target: Photo, prior: RigPrior, origin: F64 | None = None) -> PhotoPrior | None:
    """From the photo's pose, else from its mount and plate angle; None = unknown.

    With an ``origin`` [3] the pose is that of a world moved there, and the turntable's axis is lost: the angle's
    uncertainty goes into the pose's.
    """
    if target.pose is not None:
        pose = target.pose
    elif prior.target_from_plate is not None and target.turntable_deg is not None:
        mount, sigma = prior.target_from_plate, prior.turntable_sigma_deg
        pose = turntable_pose(mount, target.turntable_deg)
        if origin is None:
            return PhotoPrior(pose, mount, target.turntable_deg, sigma)
        swing = np.deg2rad(sigma) * float(np.linalg.norm(mount.translation))
        pose = replace(
            pose, sigma_deg=float(np.hypot(pose.sigma_deg, sigma)), sigma_m=float(np.hypot(pose.sigma_m, swing))
        )
    else:
        return None
    if origin is not None:
        pose = recentred(pose, origin)
    return PhotoPrior(pose, pose)


def with_photo(arrangement: Arrangement, target: Photo, known: PhotoPrior) -> Arrangement:
    """The arrangement and the photo as its last view, on a mount of its own."""
    view = Viewpoint(known_camera(target), len(arrangement.mounts), known.angle_deg, known.sigma_angle_deg)
    return Arrangement((*arrangement.mounts, known.mount), (*arrangement.views, view))


def neighbours(poses: Sequence[Pose], limit_deg: float = PAIR_LIMIT_DEG) -> list[Pair]:
    """Pairs (i < j) worth matching, closest first: all within the limit, and for every view its nearest."""
    angles = {
        (i, j): rotation_angle_deg(poses[i].rotation, poses[j].rotation) for j in range(len(poses)) for i in range(j)
    }
    nearest = {
        min((p for p in angles if v in p), key=lambda p: (angles[p], p)) for v in range(len(poses)) if len(poses) > 1
    }
    chosen = [p for p in angles if angles[p] <= limit_deg or p in nearest]
    return sorted(chosen, key=lambda p: (round(angles[p], 6), p))


def depth_limits(sources: Sequence[LightField], prior: RigPrior) -> tuple[float, float]:
    """Depths [m] that points may have, with some slack around what the rig or the captures say."""
    ranges = [s.depth_range_m for s in sources if s.depth_range_m is not None]
    if prior.depth_range_m is not None:
        near, far = prior.depth_range_m
    elif ranges and len(ranges) == len(sources):
        near, far = min(r[0] for r in ranges), max(r[1] for r in ranges)
    else:
        return DEFAULT_DEPTH_RANGE_M
    return 0.8 * near, 1.25 * far


def recentred(pose: Pose, origin: F64) -> Pose:
    """The pose for a world whose origin is moved to ``origin`` [3]."""
    return Pose(pose.rotation, pose.rotation @ (origin - pose.centre), pose.sigma_deg, pose.sigma_m)


BAND_SIGMAS = 3.0
MIN_BAND_PX = 2.0
SWING = 0.3
"""Distance of a scene's points from the plate's axis, as a fraction of the camera's distance."""


def prior_band_px(arrangement: Arrangement, i: int, j: int) -> float:
    """How far [px] from where the prior poses and depths expect it a point of view i may appear in view j.

    Views on one mount share its error: only what differs between them after turning by the angle matters.
    """
    zero = np.zeros(arrangement.size)
    poses = arrangement.poses(zero)
    views = [arrangement.views[i], arrangement.views[j]]
    mounts = [arrangement.mounts[v.mount] for v in views]
    turn = np.deg2rad(rotation_angle_deg(poses[i].rotation, poses[j].rotation))
    baseline = float(np.linalg.norm(poses[i].centre - poses[j].centre))
    distance = baseline / max(2 * np.sin(turn / 2), 0.2)
    if views[0].mount == views[1].mount:
        share = [2 * np.sin(turn / 2)]
        mounts = mounts[:1]
    else:
        share = [1.0, 1.0]
    squared = 0.0
    for mount, part in zip(mounts, share, strict=True):
        squared += (part * np.deg2rad(mount.sigma_deg)) ** 2 + (part * mount.sigma_m / max(distance, 1e-9)) ** 2
    for view in views:
        squared += (SWING * np.deg2rad(view.sigma_angle_deg)) ** 2 + (view.camera.sigma_focal * SWING / 2) ** 2
    band = BAND_SIGMAS * views[1].camera.focal_px * np.sqrt(squared)
    return float(np.clip(band, MIN_BAND_PX, views[1].camera.width))
