"""What a rig would write down of its cameras: the truth with errors of the sizes that it states beside."""

from __future__ import annotations

import numpy as np

from lfrig.contracts.capture import CameraSpec, ExposureSpec, OpticsSpec, PoseSpec
from lfrig.sim.optics import SimCamera, pose_spec, rotation_vector
from lfrig.sim.scene import F64
from lfrig.sim.tone import Exposure

MOUNT_SIGMA_DEG = 0.5
MOUNT_SIGMA_M = 0.0045
FOCAL_SIGMA = 0.02
OPTICS_SIGMA = 0.03


def recorded_mount(rotation: F64, translation: F64, rng: np.random.Generator) -> PoseSpec:
    """A mount as measured with a ruler."""
    centre = -rotation.T @ translation + MOUNT_SIGMA_M * rng.standard_normal(3)
    wrong = rotation_vector(np.deg2rad(MOUNT_SIGMA_DEG) * rng.standard_normal(3)) @ rotation
    return pose_spec(wrong, -wrong @ centre, sigma_deg=MOUNT_SIGMA_DEG, sigma_m=MOUNT_SIGMA_M)


def recorded_camera(camera: SimCamera, rng: np.random.Generator | None) -> CameraSpec:
    """Intrinsics as the lens reports them; exact without ``rng``."""
    if rng is None:
        return camera.camera_spec(sigma_f=0.0)
    error = FOCAL_SIGMA * float(np.clip(rng.standard_normal(), -2, 2))
    return camera.camera_spec(fx=camera.focal_px * (1 + error), sigma_f=FOCAL_SIGMA)


def recorded_optics(camera: SimCamera, rng: np.random.Generator) -> OpticsSpec:
    """Baseline and focus distance as the lens reports them."""
    error = OPTICS_SIGMA * np.clip(rng.standard_normal(2), -2, 2)
    return OpticsSpec(
        baseline_m=camera.baseline_m * (1 + float(error[0])),
        focus_distance_m=camera.focus_m * (1 + float(error[1])),
        sigma_baseline=OPTICS_SIGMA,
    )


def recorded_exposure(exposure: Exposure) -> ExposureSpec:
    """Settings as they were."""
    return ExposureSpec(time_s=0.01 * exposure.gain, iso=100.0, white_balance=exposure.white_balance)
