"""Simulated cases: sources, a photo, what the rig knows, and the truth, in memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lfrig.contracts.progress import Monitor
from lfrig.contracts.truth import TruthCapture, TruthDocument
from lfrig.processing.model import Camera, LightField, LightFieldRequest, Photo, Pose, RigPrior
from lfrig.rig.session.convert import to_camera, to_light_field, to_pose, to_rig_prior
from lfrig.rig.truth import CaptureTruth
from lfrig.sim.cache import default_cache_dir
from lfrig.sim.rig import Poses, SimulatedCapture
from lfrig.sim.scene import Scene
from lfrig.sim.scenes import REPORTING, TUNING
from lfrig.sim.shoot import shoot

if TYPE_CHECKING:
    from lfrig.processing.options import ProcessOptions

FULL, MEDIUM, SMALL = (541, 376), (270, 188), (135, 94)

TARGET_DEG = 25.0
"""Plate angle of the photo: the scenes are composed for 0–60°."""

NEAR_DEG = (10.0, 45.0)
"""Two sources, 15° to one side of the target and 20° to the other: both ends of the usual step."""

FAR_DEG = (0.0, 60.0)
"""Two more, one step further out."""


@dataclass(frozen=True, eq=False)
class Case:
    """One scene, shot: the inputs of the pipeline and what is true of the target.

    ``cameras`` holds the true camera and pose of every capture by its id.
    """

    scene: str
    sources: list[LightField]
    target: Photo
    prior: RigPrior
    truth: CaptureTruth
    cameras: dict[str, tuple[Camera, Pose]]

    @property
    def request(self) -> LightFieldRequest:
        """The light field that the truth holds."""
        baseline_m, focus_m = self.truth.baseline_m, self.truth.focus_distance_m
        assert baseline_m is not None and focus_m is not None
        rows, cols = (7, 7) if self.truth.views is None else self.truth.views.shape[:2]
        return LightFieldRequest(baseline_m, focus_m, rows, cols)

    def options(self, **changes: object) -> ProcessOptions:
        """Options that ask for the light field of the truth, with ``changes``."""
        from lfrig.processing.options import ProcessOptions

        wanted = self.request
        options = ProcessOptions(
            target_baseline_m=wanted.baseline_m, target_focus_m=wanted.focus_distance_m,
            rows=wanted.rows, cols=wanted.cols,
        )  # fmt: skip
        return replace(options, **changes)  # type: ignore[arg-type]

    def without_views(self) -> Case:
        """The same without the true views: what a process of its own needs."""
        return replace(self, truth=replace(self.truth, views=None))

    def with_sources(self, count: int) -> Case:
        """The same with the first ``count`` sources only."""
        return replace(self, sources=self.sources[:count])


def scene_names(half: str = "reporting", scenes: Sequence[str] | None = None) -> list[str]:
    """The scenes of a half of the library (``reporting`` or ``tuning``), or the named ones."""
    return list(scenes) if scenes else list(REPORTING if half == "reporting" else TUNING)


def shoot_case(
    scene: str | Scene,
    size: tuple[int, int],
    *,
    poses: Poses = "given",
    angles_deg: Sequence[float] = (*NEAR_DEG, *FAR_DEG),
    target_deg: float = TARGET_DEG,
    noise_sigma: float = 0.0,
    seed: int = 0,
    truth_views: bool = True,
    threads: int = 0,
    cache_dir: Path | None = None,
    monitor: Monitor | None = None,
) -> Case:
    """Shoot a scene of the library, or another; renders are kept between runs in ``cache_dir`` (by default the user's
    cache).

    The pixels do not depend on ``poses``: ``given`` records exact poses and focal lengths, ``prior`` leaves
    both to be found from what the rig knows.
    """
    session = shoot(
        scene, *size, angles_deg, target_deg, seed=seed, noise_sigma=noise_sigma, poses=poses,
        truth_views=truth_views, threads=threads, cache_dir=cache_dir or default_cache_dir(), monitor=monitor,
    )  # fmt: skip
    target = session.target
    return Case(
        scene=scene if isinstance(scene, str) else scene.name,
        sources=[
            to_light_field(name, session.captures[name].pixels, session.captures[name].document)
            for name in session.source_ids
        ],
        target=_photo(session.target_id, target),
        prior=to_rig_prior(session.rig),
        truth=_truth(session.target_id, target, session.truth),
        cameras={name: _camera(record) for name, record in session.truth.captures.items()},
    )


def _photo(name: str, capture: SimulatedCapture) -> Photo:
    document = capture.document
    return Photo(name, capture.pixels, to_camera(document.camera), to_pose(document.pose), document.turntable_deg)


def _camera(record: TruthCapture) -> tuple[Camera, Pose]:
    camera, pose = to_camera(record.camera), to_pose(record.pose)
    assert camera is not None and pose is not None
    return camera, pose


def _truth(name: str, capture: SimulatedCapture, truth: TruthDocument) -> CaptureTruth:
    record = truth.captures[name]
    assert record.camera.fx is not None
    return CaptureTruth(
        id=name,
        inverse_depth=np.asarray(1.0 / capture.truth.depth_m.astype(np.float64), np.float32),
        focal_px=record.camera.fx,
        baseline_m=record.optics.baseline_m,
        focus_distance_m=record.optics.focus_distance_m,
        views=capture.truth.views,
        noise_sigma=record.noise_sigma,
    )
