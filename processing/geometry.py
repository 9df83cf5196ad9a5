"""Rigid transforms and projections. Everything is formed in float64; cameras are `Camera`, poses `Pose`.

Numerics: the relative pose is formed before anything is rounded to float32, so a world whose origin is far away
(1e7 m) costs nothing (docs: 10-algorithm, "Numerics to keep").
"""

from __future__ import annotations

import math

import numpy as np

from lfrig.processing.model import F32, F64, Camera, Pose


def turn_deg(first: float | None, second: float | None) -> float:
    """The turn between two plate angles, in 0..180 degrees; infinite when one is unknown."""
    if first is None or second is None:
        return math.inf
    return abs((first - second + 180.0) % 360.0 - 180.0)


def rotation_z(angle_rad: float) -> F64:
    """Rotation about +z by ``angle_rad``, float64 [3, 3]."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def turntable_pose(camera_from_plate: Pose, angle_deg: float) -> Pose:
    """Pose of a still camera in the plate frame at plate angle 0, when the plate stands at ``angle_deg``.

    The plate turns counter-clockwise seen from above (+z), so the camera sees ``X_c = R0 Rz(φ) X + t0``.
    """
    rotation = camera_from_plate.rotation @ rotation_z(np.deg2rad(angle_deg))
    return Pose(rotation, camera_from_plate.translation, camera_from_plate.sigma_deg, camera_from_plate.sigma_m)


def relative_pose(target: Pose, source: Pose) -> tuple[F64, F64]:
    """(R, t) with ``X_source = R X_target + t``, float64; formed from centres so that world offsets cancel."""
    rotation = source.rotation @ target.rotation.T
    # R_s (C_t − C_s): both centres carry the world offset, their difference does not.
    return rotation, source.rotation @ (target.centre - source.centre)


def projection(target: Camera, target_pose: Pose, source: Camera, source_pose: Pose) -> tuple[F64, F64]:
    """Where a target pixel at inverse depth w lies in the source.

    Returns ``(A, b)``, float64 [3, 3] and [3]: with ``p = A (x, y, 1) + b w`` the source pixel is
    ``(p0/p2, p1/p2)`` and its inverse depth there is ``w / p2`` (p2 = z_source / z_target).
    """
    rotation, translation = relative_pose(target_pose, source_pose)
    return source.matrix @ rotation @ np.linalg.inv(target.matrix), source.matrix @ translation


def project(matrix: F64, offset: F64, xs: F32, ys: F32, inverse_depth: F32) -> tuple[F32, F32, F32]:
    """Apply `projection` to arrays: source x, source y [px], inverse depth in the source [1/m]; all float32.

    Points behind the source get NaN.
    """
    a, b = matrix.astype(np.float32), offset.astype(np.float32)
    z = a[2, 0] * xs + a[2, 1] * ys + a[2, 2] + b[2] * inverse_depth
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = np.where(z > 1e-6, np.float32(1) / z, np.float32(np.nan)).astype(np.float32)
    u = (a[0, 0] * xs + a[0, 1] * ys + a[0, 2] + b[0] * inverse_depth) * scale
    v = (a[1, 0] * xs + a[1, 1] * ys + a[1, 2] + b[1] * inverse_depth) * scale
    return u, v, inverse_depth * scale


def world_points(camera: Camera, pose: Pose, xy: F64, depth_m: F64) -> F64:
    """Back-project pixels [N, 2] at depths [N] to world points [N, 3]."""
    rays = np.c_[(xy - [camera.cx, camera.cy]) / camera.focal_px, np.ones(len(xy))]
    return np.asarray((rays * depth_m[:, None] - pose.translation) @ pose.rotation, np.float64)


def project_points(camera: Camera, pose: Pose, world: F64) -> tuple[F64, F64]:
    """Project world points [N, 3] to pixels [N, 2] and depths [N]."""
    local = world @ pose.rotation.T + pose.translation
    return local[:, :2] / local[:, 2:] * camera.focal_px + [camera.cx, camera.cy], local[:, 2]


def rotation_angle_deg(a: F64, b: F64) -> float:
    """Angle between two rotations [deg]."""
    # atan2 of the skew part: exact near zero, where arccos of the trace loses half the digits.
    r = a.T @ b
    skew = np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    return float(np.rad2deg(np.arctan2(np.linalg.norm(skew), np.trace(r) - 1.0)))
