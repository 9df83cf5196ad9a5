"""What a rig would say of its captures: the truth with drawn errors, and how large those may be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lfrig.bench.poses_scene import PhotoShot, Shot
from lfrig.processing.model import F64, Evidence, LightField, Optics, Photo, Pose, RigPrior
from lfrig.sim.rig import RIG_DEPTH_RANGE_M

ANGLE_SIGMA_DEG = 0.5
ELEVATION_SIGMA_DEG = 1.0
RADIUS_SIGMA = 0.01
FOCAL_SIGMA = 0.025
OPTICS_SIGMA = 0.03
"""Of baseline and focus distance; with the focal length's it makes 4 % of a light field's slope."""


@dataclass(frozen=True, eq=False)
class PoseCase:
    """The inputs of the pose stage, and beside them the truth of every capture.

    ``photo`` is None where the target shows something that the sources do not know.
    """

    sources: list[LightField]
    target: Photo
    prior: RigPrior
    shots: list[Shot]
    photo: PhotoShot | None

    @property
    def evidence(self) -> list[Evidence]:
        """Of every source."""
        return [shot.evidence for shot in self.shots]


def draw_case(
    shots: Sequence[Shot],
    photo: PhotoShot,
    seed: int,
    *,
    photo_expected: bool = False,
    photo_focal: tuple[float, float] | None = None,
) -> PoseCase:
    """A case with errors drawn by ``seed``: every recorded quantity is off by its own sigma times a normal number.

    Parameters
    ----------
    photo_expected : bool
        Record the photo's plate angle and mount too; else its pose is unknown.
    photo_focal : (error, sigma), optional
        The photo's focal length is off by this fraction; drawn like the others by default.
    """
    rng = np.random.default_rng([seed, 20])
    prior = RigPrior(_recorded_mount(shots[0].mount, rng), None, ANGLE_SIGMA_DEG, RIG_DEPTH_RANGE_M)
    sources = [_recorded(f"{k:03d}", shot, rng) for k, shot in enumerate(shots)]
    error, sigma = photo_focal or (FOCAL_SIGMA * float(rng.standard_normal()), FOCAL_SIGMA)
    camera = replace(photo.camera, focal_px=photo.camera.focal_px * (1 + error), sigma_focal=sigma)
    angle_deg = photo.angle_deg + ANGLE_SIGMA_DEG * float(rng.standard_normal())
    mount = _recorded_mount(photo.mount, rng)
    if photo_expected:
        prior = replace(prior, target_from_plate=mount)
    target = Photo("photo", photo.image, camera, None, angle_deg if photo_expected else None)
    return PoseCase(sources, target, prior, list(shots), photo)


def without_rig(case: PoseCase) -> PoseCase:
    """The same captures as imported ones: no turntable, no mount, no depth range; lenses are known as well."""
    sources = [replace(source, turntable_deg=None, depth_range_m=None) for source in case.sources]
    return replace(case, sources=sources, target=replace(case.target, turntable_deg=None), prior=RigPrior())


def _recorded(name: str, shot: Shot, rng: np.random.Generator) -> LightField:
    focal, angle, baseline, focus = rng.standard_normal(4)
    assert shot.optics.baseline_m is not None and shot.optics.focus_distance_m is not None
    return LightField(
        id=name,
        views=shot.views,
        camera=replace(
            shot.camera, focal_px=shot.camera.focal_px * (1 + FOCAL_SIGMA * float(focal)), sigma_focal=FOCAL_SIGMA
        ),
        optics=Optics(
            shot.optics.baseline_m * (1 + OPTICS_SIGMA * float(baseline)),
            shot.optics.focus_distance_m * (1 + OPTICS_SIGMA * float(focus)),
            OPTICS_SIGMA,
        ),
        turntable_deg=shot.angle_deg + ANGLE_SIGMA_DEG * float(angle),
        depth_range_m=RIG_DEPTH_RANGE_M,
    )


def _recorded_mount(mount: Pose, rng: np.random.Generator) -> Pose:
    """The mount with its camera moved along its arc of elevation and along its distance, looking at the same point.

    A `Pose` has one sigma for all directions of its centre: the root mean square of those of arc, distance and side.
    """
    elevation, radius = np.deg2rad(ELEVATION_SIGMA_DEG) * rng.standard_normal(), RADIUS_SIGMA * rng.standard_normal()
    turn = _about(mount.rotation[0], float(elevation))
    rotation = mount.rotation @ turn.T
    centre = (1 + radius) * (turn @ mount.centre)
    distance = float(np.linalg.norm(mount.centre))
    sigma_m = distance * float(np.sqrt((np.deg2rad(ELEVATION_SIGMA_DEG) ** 2 + RADIUS_SIGMA**2) / 3))
    return Pose(rotation, -rotation @ centre, ELEVATION_SIGMA_DEG, sigma_m)


def _about(axis: F64, angle_rad: float) -> F64:
    """Rotation by an angle about a unit vector [3] (Rodrigues)."""
    x, y, z = axis
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle_rad) * skew + (1 - np.cos(angle_rad)) * (skew @ skew), np.float64)
