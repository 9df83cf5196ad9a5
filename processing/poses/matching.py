"""Which features of two images show the same point: mutual nearest neighbours with a ratio test, inside a gate."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfrig.processing.geometry import relative_pose
from lfrig.processing.model import F64, Camera, Pose
from lfrig.processing.poses.features import DESCRIPTOR_LENGTH, Features

Matches = NDArray[np.int64]
"""[M, 2]: rows of the first and of the second image's features."""

RATIO = 0.85
GUIDED_DISTANCE = 0.35
"""Squared distance of unit descriptors that a guided match may have: inside a small gate there is hardly a rival for
the ratio test to tell a false match by (true ones: 90 % below 0.4; false ones: 75 % above)."""

GUIDED_LOG_SCALE = 0.6
"""Largest difference of the logarithms of keypoint scales in a guided match."""


def match_features(first: Features, second: Features) -> Matches:
    """Mutual nearest neighbours in descriptor space whose runner-up is clearly worse."""
    return _match(first, second, None)


def match_inside(first: Features, second: Features, allowed: NDArray[np.bool_]) -> Matches:
    """The same where ``allowed`` bool [N1, N2] limits the search, with bounds on distance and change of scale."""
    ratio = np.abs(np.log(first.scale)[:, None] - np.log(second.scale)[None, :])
    return _match(first, second, allowed & (ratio < GUIDED_LOG_SCALE))


def _match(first: Features, second: Features, allowed: NDArray[np.bool_] | None) -> Matches:
    if not len(first) or not len(second):
        return np.zeros((0, 2), np.int64)
    a, b = first.descriptor, second.descriptor
    # All entries are integers below 2**24: float32 holds these sums exactly, in whatever order they are formed.
    squared = (a * a).sum(1)[:, None] + (b * b).sum(1)[None, :] - 2 * (a @ b.T)
    if allowed is not None:
        squared[~allowed] = np.inf
    rows = np.arange(len(first))
    best = squared.argmin(1)
    distance = squared[rows, best]
    mutual = squared.argmin(0)[best] == rows
    # The runner-up must lie elsewhere: another orientation of the same keypoint is no rival.
    squared[second.place[None, :] == second.place[best][:, None]] = np.inf
    limit = RATIO**2 * squared.min(1)
    if allowed is not None:
        limit = np.minimum(limit, GUIDED_DISTANCE * DESCRIPTOR_LENGTH**2)
    keep = mutual & (distance < limit)
    matches = np.c_[first.place[rows[keep]], second.place[best[keep]]]
    return _one_to_one(matches, distance[keep])


def _one_to_one(matches: Matches, distance: NDArray[np.float32]) -> Matches:
    """Keep the closest match of every position; order by the first image."""
    order = np.argsort(distance, kind="stable")
    matches = matches[order]
    for column in (0, 1):
        _, first = np.unique(matches[:, column], return_index=True)
        matches = matches[np.sort(first)]
    return matches[np.lexsort((matches[:, 1], matches[:, 0]))]


def fundamental_matrix(first: Camera, first_pose: Pose, second: Camera, second_pose: Pose) -> F64:
    """F [3, 3] with ``x2ᵀ F x1 = 0`` for homogeneous pixels (Hartley & Zisserman, 9.2)."""
    rotation, t = relative_pose(first_pose, second_pose)
    cross = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
    inverse = np.linalg.inv
    return np.asarray(inverse(second.matrix).T @ cross @ rotation @ inverse(first.matrix), np.float64)


def sampson_distance(fundamental: F64, first_xy: F64, second_xy: F64) -> F64:
    """First-order distance [px] of matched pixels [M, 2] to their epipolar geometry (Hartley & Zisserman, 11.4.3)."""
    one = np.ones((len(first_xy), 1))
    line2 = np.c_[first_xy, one] @ fundamental.T
    line1 = np.c_[second_xy, one] @ fundamental
    algebraic = (np.c_[second_xy, one] * line2).sum(1)
    slope = line2[:, 0] ** 2 + line2[:, 1] ** 2 + line1[:, 0] ** 2 + line1[:, 1] ** 2
    return np.asarray(np.abs(algebraic) / np.sqrt(np.maximum(slope, 1e-30)), np.float64)


def epipolar_gate(
    first: Features,
    second: Features,
    cameras: tuple[Camera, Camera],
    poses: tuple[Pose, Pose],
    inverse_depth: tuple[F64, F64],
    band_px: float,
) -> NDArray[np.bool_]:
    """Pairs [N1, N2] that may show one point: within ``band_px`` of the piece of epipolar line that the lowest and
    highest inverse depth of each feature of the first image ([N1] each) leave it.
    """
    rotation, t = relative_pose(*poses)
    rays = np.c_[(first.xy - [cameras[0].cx, cameras[0].cy]) / cameras[0].focal_px, np.ones(len(first))]
    ends = []
    for w in inverse_depth:
        point = rays @ rotation.T + w[:, None] * t
        z = np.maximum(point[:, 2:], 1e-6)
        ends.append(point[:, :2] / z * cameras[1].focal_px + [cameras[1].cx, cameras[1].cy])
    start, along = ends[0], ends[1] - ends[0]
    length = np.linalg.norm(along, axis=1)
    unit = along / np.maximum(length, 1e-9)[:, None]
    # Both coordinates of (x − start) in the frame of the line are affine in x; float32 is exact enough for a gate.
    x, y = second.xy.astype(np.float32).T
    ux, uy = unit.astype(np.float32).T[:, :, None]
    offset_across = (start[:, 1] * unit[:, 0] - start[:, 0] * unit[:, 1]).astype(np.float32)[:, None]
    gate = np.abs(y * ux - x * uy - offset_across) < band_px
    middle = ((start * unit).sum(1) + length / 2).astype(np.float32)[:, None]
    gate &= np.abs(x * ux + y * uy - middle) < (length / 2 + band_px).astype(np.float32)[:, None]
    return np.asarray(gate, np.bool_)
