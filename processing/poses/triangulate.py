"""Points from their sightings in cameras whose poses are known."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lfrig.processing.model import F64, Camera, Pose
from lfrig.processing.poses.tracks import Observations


def triangulate(cameras: Sequence[Camera], poses: Sequence[Pose], seen: Observations, passes: int = 3) -> F64:
    """World points float64 [count, 3], linear in the points and reweighted by depth (Hartley & Zisserman, 12.2).

    Points that no two rays determine come out far away or behind a camera; the gates drop them.
    """
    if not len(seen):
        return np.zeros((0, 3))
    focal, principal, rotation, translation = stack(cameras, poses)
    view = seen.view
    # Each sighting gives two equations  (R[:2] − n R[2]) X = n t[2] − t[:2]  with n the normalised pixel.
    n = (seen.xy - principal[view]) / focal[view, None]
    rows = rotation[view, :2] - n[:, :, None] * rotation[view, 2][:, None, :]
    right = n * translation[view, 2][:, None] - translation[view, :2]
    weight = focal[view].copy()
    points = np.zeros((seen.count, 3))
    for _ in range(passes):
        weighted = rows * weight[:, None, None] ** 2
        normal = np.add.reduceat(np.einsum("mra,mrb->mab", weighted, rows), seen.starts)
        right_side = np.add.reduceat(np.einsum("mra,mr->ma", weighted, right), seen.starts)
        # A trace-relative ridge keeps parallel rays solvable without moving the others.
        ridge = 1e-12 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        points = np.linalg.solve(normal + ridge, right_side[..., None])[..., 0]
        depth = np.einsum("ma,ma->m", rotation[view, 2], points[seen.point]) + translation[view, 2]
        weight = focal[view] / np.maximum(np.abs(depth), 1e-6)
    return np.asarray(points, np.float64)


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
