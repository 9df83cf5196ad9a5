"""Points from their sightings in cameras whose poses are known."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lfrig.processing.kernels import bundle
from lfrig.processing.model import F64, Camera, Pose
from lfrig.processing.poses.tracks import Observations


def triangulate(cameras: Sequence[Camera], poses: Sequence[Pose], seen: Observations, passes: int = 3) -> F64:
    """World points float64 [count, 3] of sightings; see `lfrig.processing.kernels.bundle.triangulate`."""
    if not len(seen):
        return np.zeros((0, 3))
    focal, principal, rotation, translation = stack(cameras, poses)
    views = bundle.view_table(rotation, translation, focal, principal, np.zeros((len(focal), 2)))
    return bundle.triangulate(views, pixels_of(seen, np.ones(len(seen))), seen.count, passes)


def pixels_of(seen: Observations, sigma_px: F64) -> bundle.Sightings:
    """The pixels of sightings, with their sigmas [M], as the kernels take them."""
    none = np.zeros(len(seen))
    return bundle.Sightings(
        seen.point.astype(np.int32), seen.view.astype(np.int32), np.c_[seen.xy, none], np.c_[1 / sigma_px, none]
    )


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
    focal, principal, rotation, translation = stack(cameras, poses)
    local = np.einsum("mab,mb->ma", rotation[seen.view], points[seen.point]) + translation[seen.view]
    depth = local[:, 2]
    safe = np.where(np.abs(depth) < 1e-9, 1e-9, depth)
    pixel = local[:, :2] / safe[:, None] * focal[seen.view, None] + principal[seen.view]
    return pixel - seen.xy, depth


def ray_angle_deg(poses: Sequence[Pose], seen: Observations, points: F64) -> F64:
    """Widest angle [deg] between the rays that meet in each point, float64 [count]."""
    centre = np.stack([p.centre for p in poses])
    ray = points[seen.point] - centre[seen.view]
    ray /= np.maximum(np.linalg.norm(ray, axis=1, keepdims=True), 1e-12)
    table = np.full((seen.count, len(poses), 3), np.nan)
    table[seen.point, seen.view] = ray
    widest = np.zeros(seen.count)
    for i in range(len(poses)):
        for j in range(i):
            # The chord is exact for small angles, where arccos is not.
            chord = np.linalg.norm(table[:, i] - table[:, j], axis=1)
            angle = 2 * np.arcsin(np.clip(chord / 2, 0, 1))
            widest = np.fmax(widest, angle)
    return np.asarray(np.rad2deg(widest), np.float64)
