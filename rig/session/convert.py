"""Documents on disk to the nouns of the pipeline."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lfrig.contracts.capture import CameraSpec, CaptureDocument, ExposureSpec, OpticsSpec, PoseSpec
from lfrig.contracts.errors import BadInput
from lfrig.contracts.session import RigSpec
from lfrig.processing.model import U8, Camera, LightField, Optics, Plate, Pose, RigPrior
from lfrig.rig.session.rectify import Rectification, principal_point, rectification

if TYPE_CHECKING:
    from lfrig.processing.lenslet.metadata import RawMetadata

_ROUNDING = 1e-9
"""A rotation that is orthonormal to this is kept bit for bit; one with rounded digits is made exact."""


def to_camera(spec: CameraSpec | None) -> Camera | None:
    """The (rectified) camera; None when its focal length is not known."""
    if spec is None or spec.fx is None:
        return None
    rectified = rectification(spec)
    if rectified is not None:
        return rectified.camera
    return Camera(spec.width, spec.height, spec.fx, *principal_point(spec), spec.sigma_f or 0.0)


def to_pose(spec: PoseSpec | None) -> Pose | None:
    """The pose, its rotation the nearest exact one."""
    if spec is None:
        return None
    rotation = np.array(spec.R, np.float64)
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > _ROUNDING:
        left, _, right = np.linalg.svd(rotation)
        rotation = left @ right
    return Pose(rotation, np.array(spec.t, np.float64), spec.sigma_deg, spec.sigma_m)


def to_optics(spec: OpticsSpec | None) -> Optics:
    """The optics; unknown values stay None, an unknown sigma takes the default."""
    if spec is None:
        return Optics()
    sigma = Optics().sigma_baseline if spec.sigma_baseline is None else spec.sigma_baseline
    return Optics(spec.baseline_m, spec.focus_distance_m, sigma)


def to_rig_prior(rig: RigSpec) -> RigPrior:
    """What the rig knows; an unknown turntable sigma takes the default."""
    sigma = RigPrior().turntable_sigma_deg if rig.turntable_sigma_deg is None else rig.turntable_sigma_deg
    plate = None if rig.plate is None else Plate(rig.plate.radius_m, rig.plate.height_m)
    return RigPrior(to_pose(rig.light_field_mount()), to_pose(rig.target_mount()), sigma, rig.depth_range_m, plate)


def to_light_field(
    capture_id: str, views: U8, document: CaptureDocument, depth_range_m: tuple[float, float] | None = None
) -> LightField:
    """A light field from rectified views and its document; ``depth_range_m`` where the document has none."""
    return LightField(
        id=capture_id,
        views=views,
        camera=to_camera(document.camera),
        optics=to_optics(document.optics),
        pose=to_pose(document.pose),
        turntable_deg=document.turntable_deg,
        depth_range_m=document.depth_range_m or depth_range_m,
    )


def raw_document(
    metadata: RawMetadata, camera: Camera | None, optics: Optics, size: tuple[int, int], **pixels: Any
) -> CaptureDocument:
    """The document of a raw light field with views of ``size`` (width, height); what is not known stays so.

    ``pixels`` are the fields that say where they are (``raw`` or ``views``), and from what.
    """
    known: dict[str, Any] = {}
    if camera is not None:
        f = camera.focal_px
        known = {"fx": f, "fy": f, "cx": camera.cx, "cy": camera.cy, "sigma_f": camera.sigma_focal}
    gains = metadata.white_balance
    return CaptureDocument(
        kind="light_field",
        time=metadata.time,
        camera=CameraSpec(width=size[0], height=size[1], **known),
        optics=OpticsSpec(
            baseline_m=optics.baseline_m, focus_distance_m=optics.focus_distance_m, sigma_baseline=optics.sigma_baseline
        ),
        exposure=ExposureSpec(
            time_s=metadata.exposure_s, iso=metadata.iso,
            white_balance=None if gains is None else (gains[0], (gains[1] + gains[2]) / 2, gains[3]),
        ),
        **pixels,
    )  # fmt: skip


def rectification_for(document: CaptureDocument, width: int, height: int, path: Path) -> Rectification | None:
    """How to rectify pictures of a size; raises `BadInput` when the document's camera has another size."""
    spec = document.camera
    if spec is None:
        return None
    if (spec.width, spec.height) != (width, height):
        raise BadInput(
            f"says {spec.width}×{spec.height} px, but the picture has {width}×{height}",
            path=path, field="camera.width", code="camera-size", remedy="correct camera.width, height, fx, fy, cx, cy",
        )  # fmt: skip
    return rectification(spec)
