"""How far solved poses, focal lengths, anchors and scales are from the truth, what no image can tell left out.

Structure from motion knows the world up to a rotation, a shift and a scale; those are fitted and taken out, the scale
is reported beside.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from lfrig.bench.poses_priors import PoseCase
from lfrig.bench.poses_scene import PhotoShot, Shot
from lfrig.contracts.progress import Monitor
from lfrig.processing.geometry import project_points, rotation_angle_deg, world_points
from lfrig.processing.model import F64, Anchors, Camera, Pose, Source
from lfrig.processing.poses import PoseSolution
from lfrig.processing.scale_fit import DEFAULT_SCALE_FIT, fit_scale

GRID_PX = 12
BORDER_PX = 8
OUTLIER = 0.02
"""An anchor further from its true depth than this fraction is an outlier."""


@dataclass(frozen=True)
class Alignment:
    """``X_solved = scale · rotation · X_true + shift``: the best similarity over the sources."""

    rotation: F64
    scale: float
    shift: F64

    @classmethod
    def between(cls, solved: Sequence[Pose], true: Sequence[Pose]) -> Alignment:
        """Rotation from the cameras' rotations (chordal mean), scale and shift from their centres."""
        total = np.sum([s.rotation.T @ t.rotation for s, t in zip(solved, true, strict=True)], axis=0)
        left, _, right = np.linalg.svd(total)
        rotation = left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right
        ours = np.array([pose.centre for pose in solved])
        theirs = np.array([pose.centre for pose in true]) @ rotation.T
        a, b = theirs - theirs.mean(0), ours - ours.mean(0)
        scale = float((a * b).sum() / (a * a).sum()) if len(solved) > 1 else 1.0
        return cls(rotation, scale, ours.mean(0) - scale * theirs.mean(0))

    def pose(self, solved: Pose) -> Pose:
        """A solved pose in the true world, in metres."""
        rotation = solved.rotation @ self.rotation
        centre = self.rotation.T @ (solved.centre - self.shift) / self.scale
        return Pose(rotation, -rotation @ centre)


def pose_figures(solution: PoseSolution, case: PoseCase) -> dict[str, Any]:
    """Errors of the sources: rotation [°] over all pairs, centres [mm], focal lengths and scale [%], anchors, and the
    photo's figures where its truth is known.
    """
    true = [shot.pose for shot in case.shots]
    alignment = Alignment.between(solution.poses, true)
    aligned = [alignment.pose(pose) for pose in solution.poses]
    inside, outside = zip(
        *(_depth_errors(a, s, alignment.scale) for a, s in zip(solution.anchors, case.shots, strict=True)), strict=True
    )
    depth = np.concatenate(inside)
    figures = {
        "rotation_deg": relative_rotation_error_deg(solution.poses, true),
        "centre_mm": 1000 * max(float(np.linalg.norm(a.centre - t.centre)) for a, t in zip(aligned, true, strict=True)),
        "scale_pct": 100 * (alignment.scale - 1),
        "focal_pct": max(_focal_pct(c, s.camera) for c, s in zip(solution.cameras, case.shots, strict=True)),
        "anchors": min(len(a) for a in solution.anchors),
        "depth_pct": 100 * float(np.median(depth)) if len(depth) else float("nan"),
        "outliers_pct": 100 * float(np.mean(np.concatenate(outside) > OUTLIER)) if len(depth) else float("nan"),
        "angle_residual_deg": [r for r in solution.angle_residual_deg if r is not None],
        "method": solution.method,
        "metric": solution.metric,
    }
    return figures if case.photo is None else figures | photo_figures(solution, case.photo, case.shots, alignment)


def photo_figures(
    solution: PoseSolution, photo: PhotoShot, shots: Sequence[Shot], alignment: Alignment
) -> dict[str, Any]:
    """Errors of the photo in the frame of its sources, and the transfer error [px]: how far from the true place in a
    source a pixel of the photo with its true depth is looked for, median over pixels, worst source.
    """
    pose = alignment.pose(solution.target_pose)
    return {
        "photo_rotation_deg": rotation_angle_deg(pose.rotation, photo.pose.rotation),
        "photo_centre_mm": 1000 * float(np.linalg.norm(pose.centre - photo.pose.centre)),
        "photo_focal_pct": _focal_pct(solution.target_camera, photo.camera),
        "transfer_px": _transfer_px(solution, photo, shots, alignment),
    }


def relative_rotation_error_deg(solved: Sequence[Pose], true: Sequence[Pose]) -> float:
    """Largest error of the rotation between two captures [°]; no frame enters."""
    pairs = combinations(range(len(true)), 2)
    errors = [
        rotation_angle_deg(solved[i].rotation @ solved[j].rotation.T, true[i].rotation @ true[j].rotation.T)
        for i, j in pairs
    ]
    return max(errors, default=0.0)


def slope_error_pct(ready: Sequence[Source], shots: Sequence[Shot], alignment: Alignment) -> float:
    """Largest error of a source's fitted slope a = 1/(bF) in ``1/z = a δ + c`` [%]."""
    errors = []
    for source, shot in zip(ready, shots, strict=True):
        assert shot.optics.baseline_m is not None
        true = 1 / (shot.optics.baseline_m * shot.camera.focal_px)
        errors.append(abs(100 * (source.scale.a * alignment.scale / true - 1)))
    return max(errors, default=0.0)


def fitted_sources(solution: PoseSolution, case: PoseCase, monitor: Monitor) -> list[Source]:
    """The sources with their scales, as the pipeline fits them next.

    Raises
    ------
    GeometryRefused
        The anchors of a source carry no scale.
    """
    parts = zip(case.sources, case.shots, solution.cameras, solution.poses, solution.anchors, strict=True)
    return [
        Source(
            source, camera, pose, shot.evidence,
            fit_scale(source, camera, anchors, shot.evidence, DEFAULT_SCALE_FIT, monitor, metric=solution.metric),
        )
        for source, shot, camera, pose, anchors in parts
    ]  # fmt: skip


def _focal_pct(found: Camera, true: Camera) -> float:
    return 100 * abs(found.focal_px / true.focal_px - 1)


def _depth_errors(anchors: Anchors, shot: Shot, scale: float) -> tuple[F64, F64]:
    """Relative depth errors of anchors [N]: against the true depth at the point, and against the likeliest of its nine
    pixels (anchors sit on edges, where the depth next to them may be theirs).
    """
    import cv2

    if not len(anchors):
        return np.zeros(0), np.zeros(0)
    x, y = anchors.xy.astype(np.float32).T
    there = cv2.remap(shot.inverse_depth, x[None], y[None], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[0]
    ours = anchors.depth_m / scale
    height, width = shot.inverse_depth.shape
    cols = np.clip(np.rint(x).astype(int), 1, width - 2)
    rows = np.clip(np.rint(y).astype(int), 1, height - 2)
    around = np.stack([shot.inverse_depth[rows + j, cols + i] for j in (-1, 0, 1) for i in (-1, 0, 1)])
    return np.abs(ours * there - 1), np.abs(ours * around - 1).min(0)


def _transfer_px(solution: PoseSolution, photo: PhotoShot, shots: Sequence[Shot], alignment: Alignment) -> float:
    height, width = photo.inverse_depth.shape
    ys, xs = np.mgrid[BORDER_PX : height - BORDER_PX : GRID_PX, BORDER_PX : width - BORDER_PX : GRID_PX]
    xy, depth = np.c_[xs.ravel(), ys.ravel()].astype(np.float64), 1.0 / photo.inverse_depth[ys, xs].ravel()
    seen = np.isfinite(depth)
    xy, depth = xy[seen], depth[seen].astype(np.float64)
    true = world_points(photo.camera, photo.pose, xy, depth)
    ours = world_points(solution.target_camera, solution.target_pose, xy, depth * alignment.scale)
    errors = []
    for shot, camera, pose in zip(shots, solution.cameras, solution.poses, strict=True):
        there, _ = project_points(shot.camera, shot.pose, true)
        found, _ = project_points(camera, pose, ours)
        inside = ((there >= 0) & (there < [camera.width, camera.height])).all(1)
        if inside.any():
            errors.append(float(np.median(np.linalg.norm(found - there, axis=1)[inside])))
    return max(errors, default=0.0)
