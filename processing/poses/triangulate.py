"""Points from their sightings in cameras whose poses are known."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lfrig.processing.kernels import bundle
from lfrig.processing.model import F64, Camera, Pose
from lfrig.processing.poses.tracks import Observations


def triangulate(cameras: Sequence[Camera], poses: Sequence[Pose], seen: Observations, passes: int = 3) -> F64:
    """World points float64 [count, 3] of sightings; see `lfrig.processing.kernels.bundle.triangulate`."""
    return triangulate_from(views_of(cameras, poses), seen, passes)


def triangulate_from(views: F64, seen: Observations, passes: int = 3) -> F64:
    """The same, from views [V, 17] (see `bundle.view_table`)."""
    if not len(seen):
        return np.zeros((0, 3))
    return bundle.triangulate(views, pixels_of(seen, np.ones(len(seen))), seen.count, passes)


def views_of(cameras: Sequence[Camera], poses: Sequence[Pose]) -> F64:
    """Cameras and poses as the kernels take them, float64 [V, 17], without lines."""
    focal, principal, rotation, translation = stack(cameras, poses)
    return bundle.view_table(rotation, translation, focal, principal, np.zeros((len(focal), 2)))


def pixels_of(seen: Observations, sigma_px: F64) -> bundle.Sightings:
    """The pixels of sightings, with their sigmas [M], as the kernels take them."""
    measured, inverse_sigma = np.zeros((len(seen), 3)), np.zeros((len(seen), 2))
    measured[:, :2], inverse_sigma[:, 0] = seen.xy, 1 / sigma_px
    return bundle.Sightings(seen.point.astype(np.int32), seen.view.astype(np.int32), measured, inverse_sigma)


def stack(cameras: Sequence[Camera], poses: Sequence[Pose]) -> tuple[F64, F64, F64, F64]:
    """Focal lengths [V], principal points [V, 2], rotations [V, 3, 3], translations [V, 3]."""
    return (
        np.array([c.focal_px for c in cameras]),
        np.array([[c.cx, c.cy] for c in cameras]),
        np.stack([p.rotation for p in poses]),
        np.stack([p.translation for p in poses]),
    )


def reproject(cameras: Sequence[Camera], poses: Sequence[Pose], seen: Observations, points: F64) -> tuple[F64, F64]:
    """Residuals float64 [M, 2] px (projection − sighting) and depths [M]."""
    return reproject_into(views_of(cameras, poses), seen, points)


def reproject_into(views: F64, seen: Observations, points: F64) -> tuple[F64, F64]:
    """The same, into views [V, 17] (see `bundle.view_table`)."""
    own = views[seen.view]
    local = np.einsum("mab,mb->ma", own[:, :9].reshape(-1, 3, 3), points[seen.point]) + own[:, 9:12]
    depth = local[:, 2]
    safe = np.where(np.abs(depth) < 1e-9, 1e-9, depth)
    pixel = local[:, :2] * (own[:, 12] / safe)[:, None] + own[:, 13:15]
    return pixel - seen.xy, depth


def ray_angle_deg(poses: Sequence[Pose], seen: Observations, points: F64) -> F64:
    """Widest angle [deg] between the rays that meet in each point, float64 [count]."""
    return ray_angle_from(np.stack([p.centre for p in poses]), seen, points)


def ray_angle_from(centres: F64, seen: Observations, points: F64) -> F64:
    """The same, by the cameras' centres [V, 3]."""
    ray = points[seen.point] - centres[seen.view]
    ray /= np.maximum(np.sqrt((ray * ray).sum(1, keepdims=True)), 1e-12)
    table = np.full((len(centres), seen.count, 3), np.nan)
    table[seen.view, seen.point] = ray
    widest = np.zeros(seen.count)
    for i in range(len(centres)):
        for j in range(i):
            apart = table[i] - table[j]
            widest = np.fmax(widest, np.einsum("na,na->n", apart, apart))
    # The chord is exact for small angles, where arccos is not.
    return np.asarray(np.rad2deg(2 * np.arcsin(np.clip(np.sqrt(widest) / 2, 0, 1))), np.float64)
