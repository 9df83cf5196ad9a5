"""What the pose stage hands on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from lfrig.processing.model import Anchors, Camera, Pose, ScaleFit

PoseMethod = Literal["auto", "lf", "colmap", "given"]
ScaleSource = Literal["poses", "mount", "recorded optics", "gauge"]
"""Where the unit of length came from: given poses, the turntable's mount, recorded baselines and focus distances, or
nowhere (the first source's median depth is 0.5)."""


@dataclass(frozen=True)
class PoseSolution:
    """Poses of sources and target in one frame, and the anchors of every source.

    Attributes
    ----------
    method : str
        ``given``, ``lf`` (light-field-aware, with the rig's prior), ``colmap-turntable`` (structure from motion with
        that prior) or ``colmap`` (without).
    poses, cameras : tuple
        Of the sources, in their order; cameras with refined focal lengths.
    anchors : tuple of Anchors
        Triangulated points of each source, ``depth_m`` along its optical axis.
    angle_residual_deg : tuple of (float or None)
        Solved minus recorded turntable angle of each source; None where no angle was used.
    target_pose, target_camera
        Of the photo.
    metric : bool
        Whether lengths are metres; else they are in a gauge of their own.
    scale_source : str
        Where that scale came from.
    scales : tuple of (ScaleFit or None)
        Each source's ``1/z = a δ + c`` as solved together with the poses; None where light fields took no part.
    """

    method: str
    poses: tuple[Pose, ...]
    cameras: tuple[Camera, ...]
    anchors: tuple[Anchors, ...]
    angle_residual_deg: tuple[float | None, ...]
    target_pose: Pose
    target_camera: Camera
    metric: bool
    scale_source: ScaleSource
    scales: tuple[ScaleFit | None, ...] = ()
