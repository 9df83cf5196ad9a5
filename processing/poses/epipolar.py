"""Where a point of one image may appear in another: epipolar distances, and the pieces of line that depths leave."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfrig.processing.geometry import relative_pose
from lfrig.processing.model import F64, Camera, Pose

Indices = NDArray[np.int64]


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


@dataclass(frozen=True)
class Segments:
    """Pieces of epipolar line, one per point of the first image: ``start`` float64 [N, 2] px, ``unit`` [N, 2],
    ``length`` [N] px.
    """

    start: F64
    unit: F64
    length: F64

    def shifted(self, shift: F64) -> Segments:
        """All moved by ``shift`` [2] px."""
        return Segments(self.start + shift, self.unit, self.length)

    def offsets(self, rows: Indices, xy: F64) -> F64:
        """Pixels [K, 2] relative to the middle of the segments of ``rows`` [K], float64 [K, 2] px."""
        middle = self.start + self.unit * (self.length / 2)[:, None]
        return xy - middle[rows]

    def contains(self, rows: Indices, xy: F64, margin_px: float) -> NDArray[np.bool_]:
        """Whether pixels [K, 2] lie within a margin of the segments of ``rows`` [K]."""
        x, y = xy[:, 0], xy[:, 1]
        ux, uy = self.unit[:, 0].take(rows), self.unit[:, 1].take(rows)
        off_line = self.start[:, 1] * self.unit[:, 0] - self.start[:, 0] * self.unit[:, 1]
        # Few pixels are near their line: only those are measured along it.
        near = np.flatnonzero(np.abs(y * ux - x * uy - off_line.take(rows)) < margin_px)
        rows = rows[near]
        along = x[near] * ux[near] + y[near] * uy[near] - (self.start * self.unit).sum(1).take(rows)
        inside = np.zeros(len(xy), bool)
        inside[near] = (along > -margin_px) & (along < self.length.take(rows) + margin_px)
        return inside


def epipolar_segments(
    xy: F64, cameras: tuple[Camera, Camera], poses: tuple[Pose, Pose], inverse_depth: tuple[F64, F64]
) -> Segments:
    """Segments in the second image for pixels [N, 2] of the first, between their lowest and highest inverse depth
    ([N] each, 0 = infinity).
    """
    rotation, t = relative_pose(*poses)
    rays = np.c_[(xy - [cameras[0].cx, cameras[0].cy]) / cameras[0].focal_px, np.ones(len(xy))] @ rotation.T
    ends = []
    for w in inverse_depth:
        point = rays + w[:, None] * t
        z = np.maximum(point[:, 2:], 1e-6)
        ends.append(point[:, :2] / z * cameras[1].focal_px + [cameras[1].cx, cameras[1].cy])
    along = ends[1] - ends[0]
    length = np.linalg.norm(along, axis=1)
    return Segments(ends[0], along / np.maximum(length, 1e-12)[:, None], length)
