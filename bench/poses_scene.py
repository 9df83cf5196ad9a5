"""One scene for the poses benchmark: what the captures really are, shot once, and the disparity evidence that all
priors drawn for them share.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from lfrig.contracts.progress import Monitor
from lfrig.contracts.truth import TruthCapture
from lfrig.processing.dpv import auto_range, light_field_evidence
from lfrig.processing.geometry import turntable_pose
from lfrig.processing.model import F32, U8, Camera, Evidence, LightField, Optics, Pose
from lfrig.rig.session.convert import to_camera, to_optics, to_pose
from lfrig.sim.cache import default_cache_dir
from lfrig.sim.rig import SimulatedCapture, SimulatedRig

PLATE_DEG = (10.0, 45.0, 0.0, 60.0, 15.0, 30.0, 20.0, 40.0, 80.0)
"""Plate angles of the light fields. A shot's zoom, focus and exposure follow from its place in this list, and the
first four are those of `bench.cases`, so that both benchmarks share their renders."""


@dataclass(frozen=True, eq=False)
class Shot:
    """A light field as it truly is: true plate angle, camera, pose and optics, the centre view's true inverse depth
    float32 [H, W] 1/m, and the disparity evidence of its views.
    """

    angle_deg: float
    views: U8
    camera: Camera
    pose: Pose
    optics: Optics
    inverse_depth: F32
    evidence: Evidence

    @property
    def mount(self) -> Pose:
        """The camera's pose to the plate at angle 0."""
        return turntable_pose(self.pose, -self.angle_deg)

    def reseen(self, views: U8, threads: int) -> Shot:
        """The same shot with other pixels, and their own evidence."""
        return replace(self, views=views, evidence=evidence_of(views, threads))


@dataclass(frozen=True, eq=False)
class PhotoShot:
    """A photo as it truly is; ``image`` uint8 [H, W, 3], ``inverse_depth`` float32 [H, W] 1/m."""

    angle_deg: float
    image: U8
    camera: Camera
    pose: Pose
    inverse_depth: F32

    @property
    def mount(self) -> Pose:
        """The camera's pose to the plate at angle 0."""
        return turntable_pose(self.pose, -self.angle_deg)


@dataclass
class SceneShots:
    """The captures of one scene, shot when they are first asked for.

    ``threads`` is handed to renderer and sweep; nothing depends on it. Renders are kept in ``cache_dir`` between
    runs (by default the user's cache), evidence as long as this object lives.
    """

    scene: str
    size: tuple[int, int]
    threads: int = 0
    cache_dir: Path | None = None
    monitor: Monitor = field(default_factory=Monitor)
    _shots: dict[float, Shot] = field(default_factory=dict)
    _photos: dict[float, PhotoShot] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.rig = SimulatedRig(
            self.scene, *self.size, poses="given", threads=self.threads, cache_dir=self.cache_dir or default_cache_dir()
        )

    def light_field(self, plate_deg: float) -> Shot:
        """The light field with the plate commanded to an angle of `PLATE_DEG`."""
        if plate_deg not in self._shots:
            capture = self.rig.shoot_light_field(PLATE_DEG.index(plate_deg), plate_deg, self.monitor)
            camera, pose, angle_deg = _state(capture.truth.record)
            self._shots[plate_deg] = Shot(
                angle_deg, capture.pixels, camera, pose, replace(to_optics(capture.truth.record.optics)),
                _inverse(capture), evidence_of(capture.pixels, self.threads),
            )  # fmt: skip
            self.monitor.advance(0)
        return self._shots[plate_deg]

    def photo(self, plate_deg: float) -> PhotoShot:
        """The photo with the plate commanded to any angle."""
        if plate_deg not in self._photos:
            capture = self.rig.shoot_photo(0, plate_deg, self.monitor, truth_views=False)
            camera, pose, angle_deg = _state(capture.truth.record)
            self._photos[plate_deg] = PhotoShot(angle_deg, capture.pixels, camera, pose, _inverse(capture))
            self.monitor.advance(0)
        return self._photos[plate_deg]


def evidence_of(views: U8, threads: int) -> Evidence:
    """Disparity evidence of views [rows, cols, H, W, 3], as the pipeline would find it without recorded optics."""
    light_field = LightField("shot", views)
    return light_field_evidence(light_field, auto_range(light_field, threads=threads), threads=threads)


def _state(record: TruthCapture) -> tuple[Camera, Pose, float]:
    camera, pose = to_camera(record.camera), to_pose(record.pose)
    assert camera is not None and pose is not None and record.turntable_deg is not None
    return camera, pose, record.turntable_deg


def _inverse(capture: SimulatedCapture) -> F32:
    return np.asarray(1.0 / capture.truth.depth_m.astype(np.float64), np.float32)
