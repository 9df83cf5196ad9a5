"""Where the photo was taken: hypotheses from its matches with the sources' points, and the one that most of them fit.

A repeating texture can hold a wrong pose with every inlier of its own (a shift by one period), so several are kept
and compared by how many matches of *all* sources agree with each, tracked or not.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfrig.processing.geometry import project_points
from lfrig.processing.model import F64, Camera, Pose
from lfrig.processing.poses.epipolar import fundamental_matrix, sampson_distance
from lfrig.processing.poses.features import Features
from lfrig.processing.poses.matching import Matches
from lfrig.processing.poses.structure import Structure

GATE = 0.006
"""Residual that a hypothesis may leave, as a fraction of the photo's width (3 px at 541)."""

MIN_RESECTION = 8
MAX_HYPOTHESES = 3
UNKNOWN_FOCAL_SIGMA = 0.2
FOCAL_LADDER = tuple(float(1.25**k) for k in range(-3, 4))


@dataclass(frozen=True)
class Located:
    """A hypothesis: the photo's pose and camera, and how many matches with each source agree with it."""

    pose: Pose
    camera: Camera
    agreeing: dict[int, int]

    @property
    def support(self) -> int:
        """All of them."""
        return sum(self.agreeing.values())


@dataclass(frozen=True)
class Resection:
    """Points and where the photo seems to show them: ``world`` float64 [K, 3], ``xy`` float64 [K, 2] px."""

    world: F64
    xy: F64


def correspondences(structure: Structure, features: Features, matches: Mapping[int, Matches]) -> Resection:
    """Solved points that the photo's matches with source v (rows of v, rows of the photo) lead to."""
    world, xy = [np.zeros((0, 3))], [np.zeros((0, 2))]
    for view, pairs in matches.items():
        point = point_of_feature(structure, view, pairs[:, 0])
        known = point >= 0
        world.append(structure.points[point[known]])
        xy.append(features.xy[pairs[known, 1]])
    return Resection(np.concatenate(world), np.concatenate(xy))


def point_of_feature(structure: Structure, view: int, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Index of the point that each feature of a view belongs to, −1 = none."""
    own = structure.seen.view == view
    feature, point = structure.seen.feature[own], structure.seen.point[own]
    size = int(max(feature.max(initial=-1), rows.max(initial=-1))) + 1
    table = np.full(size, -1, np.int64)
    table[feature] = point
    return table[rows]


def locate_photo(
    structure: Structure,
    source_features: Mapping[int, Features],
    features: Features,
    matches: Mapping[int, Matches],
    camera: Camera,
) -> list[Located]:
    """Possible poses of the photo, the best supported first.

    A camera whose focal length is unknown (a wide sigma) is tried at several.
    """
    known = correspondences(structure, features, matches)
    candidates: list[tuple[Pose, Camera]] = []
    for trial in _cameras(camera):
        rest = known
        for _ in range(MAX_HYPOTHESES):
            found = _resect(rest, trial)
            if found is None:
                break
            candidates.append((found[0], trial))
            rest = _subset(rest, ~found[1])
    located = [
        Located(pose, trial, support(structure, source_features, features, matches, pose, trial))
        for pose, trial in candidates
    ]
    return sorted(located, key=lambda h: -h.support)


def support(
    structure: Structure,
    source_features: Mapping[int, Features],
    features: Features,
    matches: Mapping[int, Matches],
    pose: Pose,
    camera: Camera,
) -> dict[int, int]:
    """Matches with each source that agree with a pose: by reprojection where the point is known, else by
    epipolar distance.
    """
    cameras, poses = structure.cameras, structure.poses
    gate = GATE * camera.width
    agreeing = {}
    for view, pairs in matches.items():
        xy = features.xy[pairs[:, 1]]
        fundamental = fundamental_matrix(cameras[view], poses[view], camera, pose)
        error = sampson_distance(fundamental, source_features[view].xy[pairs[:, 0]], xy)
        point = point_of_feature(structure, view, pairs[:, 0])
        known = point >= 0
        error[known] = _residual(Resection(structure.points[point[known]], xy[known]), camera, pose)
        agreeing[view] = int((error < gate).sum())
    return agreeing


def _cameras(camera: Camera) -> list[Camera]:
    if camera.sigma_focal < UNKNOWN_FOCAL_SIGMA:
        return [camera]
    return [replace(camera, focal_px=camera.focal_px * step) for step in FOCAL_LADDER]


def _subset(known: Resection, keep: NDArray[np.bool_]) -> Resection:
    return Resection(known.world[keep], known.xy[keep])


def _residual(known: Resection, camera: Camera, pose: Pose) -> F64:
    """Distance [px] of each point's projection from where the photo shows it; infinite behind the camera."""
    pixel, depth = project_points(camera, pose, known.world)
    return np.asarray(np.where(depth > 0, np.linalg.norm(pixel - known.xy, axis=1), np.inf), np.float64)


def _resect(known: Resection, camera: Camera) -> tuple[Pose, NDArray[np.bool_]] | None:
    """Pose by three points inside RANSAC and Levenberg–Marquardt on its inliers; and which points those are.

    AP3P: Ke & Roumeliotis, CVPR 2017. Three points, as few as there can be: false matches cost it the fewest draws.
    """
    import cv2

    if len(known.world) < MIN_RESECTION:
        return None
    # OpenCV works around the origin: points far from it (a world offset) would cost it its digits.
    middle = np.median(known.world, axis=0)
    world, gate = known.world - middle, GATE * camera.width
    try:
        ok, turn, shift, inliers = cv2.solvePnPRansac(
            world, known.xy, camera.matrix, None, iterationsCount=1000, reprojectionError=gate, confidence=0.9999,
            flags=cv2.SOLVEPNP_AP3P,
        )  # fmt: skip
    except cv2.error:
        return None
    if not ok or inliers is None or len(inliers) < MIN_RESECTION:
        return None
    rows = inliers.reshape(-1)
    for _ in range(2):
        turn, shift = cv2.solvePnPRefineLM(world[rows], known.xy[rows], camera.matrix, None, turn, shift)
        rotation = np.asarray(cv2.Rodrigues(turn)[0], np.float64)
        translation = np.asarray(shift, np.float64).reshape(3)
        if not np.isfinite(translation).all():
            return None
        pose = Pose(rotation, translation - rotation @ middle)
        inside = _residual(known, camera, pose) < gate
        if inside.sum() < MIN_RESECTION:
            return None
        rows = np.flatnonzero(inside)
    return pose, inside
