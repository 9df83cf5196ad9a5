"""Cameras of the simulator: a pinhole whose centre may step off its axis, as the views of a light field do.

View (r, c) has its centre of projection at ((c − c0) b, (r − r0) b, 0) in the camera's frame and the same principal
point for points at the focus distance, so a point at (x, y) of the centre view is at (x − (c − c0) δ, y − (r − r0) δ)
with δ = b F (1/z − 1/z_f).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lfrig.contracts.capture import CameraSpec, OpticsSpec, PoseSpec
from lfrig.sim.scene import F64


@dataclass(frozen=True, eq=False)
class SimCamera:
    """True state of a camera at a shot.

    ``rotation``, ``translation``: X_c = R X + t with the world (plate at angle 0) in metres, float64 [3, 3] and [3].
    ``focal_px``, ``cx``, ``cy`` in px; ``baseline_m`` between adjacent views; ``focus_m`` the focus distance.
    """

    width: int
    height: int
    focal_px: float
    baseline_m: float
    focus_m: float
    rotation: F64
    translation: F64

    @property
    def cx(self) -> float:
        """Principal point, x [px]."""
        return (self.width - 1) / 2

    @property
    def cy(self) -> float:
        """Principal point, y [px]."""
        return (self.height - 1) / 2

    @property
    def centre(self) -> F64:
        """Centre of projection of the centre view in the world [3]."""
        return np.asarray(-self.rotation.T @ self.translation)

    def on_plate_at(self, angle_deg: float) -> SimCamera:
        """The same still camera, seen from the plate's frame when the plate stands at ``angle_deg``."""
        return replace(self, rotation=self.rotation @ rotation_z(np.deg2rad(angle_deg)))

    def record(self) -> F64:
        """The camera as the renderers take it, float64 [17]."""
        return np.array(
            [*self.rotation.ravel(), *self.centre, self.focal_px, self.cx, self.cy, self.baseline_m, self.focus_m]
        )

    def camera_spec(self, *, fx: float | None = None, sigma_f: float | None = None) -> CameraSpec:
        """Intrinsics for a document; ``fx`` replaces the true focal length."""
        f = self.focal_px if fx is None else fx
        return CameraSpec(width=self.width, height=self.height, fx=f, fy=f, cx=self.cx, cy=self.cy, sigma_f=sigma_f)

    def optics_spec(self) -> OpticsSpec:
        """The true baseline and focus distance."""
        return OpticsSpec(baseline_m=self.baseline_m, focus_distance_m=self.focus_m, sigma_baseline=0.0)

    def pose_spec(self, *, sigma_deg: float = 0.0, sigma_m: float = 0.0) -> PoseSpec:
        """The pose for a document."""
        return pose_spec(self.rotation, self.translation, sigma_deg=sigma_deg, sigma_m=sigma_m)


def pose_spec(rotation: F64, translation: F64, *, sigma_deg: float = 0.0, sigma_m: float = 0.0) -> PoseSpec:
    """A `PoseSpec` of arrays [3, 3] and [3]."""
    return PoseSpec(
        R=tuple(tuple(float(v) for v in row) for row in rotation),  # type: ignore[arg-type]
        t=tuple(float(v) for v in translation),  # type: ignore[arg-type]
        sigma_deg=sigma_deg,
        sigma_m=sigma_m,
    )


def rotation_z(angle_rad: float) -> F64:
    """Rotation about +z, float64 [3, 3]."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def rotation_vector(vector_rad: F64) -> F64:
    """Rotation about ``vector_rad`` by its length (Rodrigues), float64 [3, 3]."""
    angle = float(np.linalg.norm(vector_rad))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector_rad / angle
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * (skew @ skew))


def look_at(centre: F64, point: F64) -> tuple[F64, F64]:
    """(R, t) of an upright camera at ``centre`` that looks at ``point``; world z is up, image y down."""
    forward = (point - centre) / np.linalg.norm(point - centre)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.array([right, np.cross(forward, right), forward])
    return rotation, -rotation @ centre


def view_offsets(rows: int, cols: int) -> F64:
    """(r − r0, c − c0) of every view, row-major, float64 [rows·cols, 2]."""
    r, c = np.meshgrid(np.arange(rows) - (rows - 1) / 2, np.arange(cols) - (cols - 1) / 2, indexing="ij")
    return np.stack([r.ravel(), c.ravel()], -1)
