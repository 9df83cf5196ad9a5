"""Normal equations of a bundle adjustment, its points eliminated by their Schur complement; Cauchy weights.

Triggs et al., "Bundle adjustment: a modern synthesis", 1999. C++ form: ``bundle.cpp``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.native import load_native
from lfrig.processing.model import F64

LOCAL = 9
"""Parameters that a residual of one view sees: rotation (3) and translation (3) applied on the left, and the logarithms
of focal length, baseline and inverse focus distance."""

CAUCHY = 2.0
"""A residual of this many sigmas has half the weight of a small one."""

NEAR = 1e-6
POINTS_PER_CHUNK = 32


@dataclass(frozen=True)
class Sightings:
    """What is measured of points in views, sorted by point; a point may be listed more than once per view.

    ``point``, ``view`` int32 [M]; ``measured`` float64 [M, 3]: pixel x, y and disparity; ``inverse_sigma`` float64
    [M, 2]: of the pixel and of the disparity, 0 where that is not measured.
    """

    point: NDArray[np.int32]
    view: NDArray[np.int32]
    measured: F64
    inverse_sigma: F64

    def __len__(self) -> int:
        return len(self.point)

    def sorted(self) -> Sightings:
        """The same in order of points."""
        order = np.argsort(self.point, kind="stable")
        return Sightings(self.point[order], self.view[order], self.measured[order], self.inverse_sigma[order])


@dataclass(frozen=True)
class Linear:
    """Residuals [M, 3] (x, y, disparity) in sigmas, and derivatives [M, 3, 3] of each by the point in the camera's
    frame, and by the logarithms of focal length, baseline and inverse focus distance; all float64.
    """

    residual: F64
    d_local: F64
    d_inner: F64


@dataclass(frozen=True)
class Reduced:
    """Schur complement in the views' local parameters float64 [9 V, 9 V], its right side [9 V], and what restores the
    points: per point the Cholesky factor L of its own system (00 10 11 20 21 22) and L⁻¹ times its right side [N, 9].
    """

    system: F64
    right: F64
    factors: F64


def view_table(rotation: F64, translation: F64, focal: F64, principal: F64, line: F64) -> F64:
    """Views as the kernels take them, float64 [V, 17]: R by rows, t, focal length, principal point, and ``line``
    [V, 2], baseline and inverse focus distance (0 where there is none).
    """
    return np.ascontiguousarray(np.c_[rotation.reshape(-1, 9), translation, focal, principal, line], np.float64)


def linearise(views: F64, points: F64, seen: Sightings) -> Linear:
    """Residuals and derivatives of M sightings at a state of views [V, 17] and points [N, 3]."""
    v, (pixel, told) = views[seen.view], seen.inverse_sigma.T
    focal, baseline, focus = v[:, 12], v[:, 15], v[:, 16]
    local = _local(v, points[seen.point])
    # Behind the camera the projection is meaningless: held just in front, its residual is huge and loses weight.
    inverse = 1 / np.maximum(local[:, 2], NEAR)
    slope = local[:, :2] * inverse[:, None]
    residual, d_local, d_inner = np.zeros((len(v), 3)), np.zeros((len(v), 3, 3)), np.zeros((len(v), 3, 3))
    residual[:, :2] = (slope * focal[:, None] + v[:, 13:15] - seen.measured[:, :2]) * pixel[:, None]
    scale = focal * inverse * pixel
    d_local[:, 0, 0] = d_local[:, 1, 1] = scale
    d_local[:, :2, 2] = -slope * scale[:, None]
    d_inner[:, :2, 0] = slope * (focal * pixel)[:, None]
    steep = focal * baseline * told
    expected = steep * (inverse - focus)
    residual[:, 2] = (focal * baseline * (inverse - focus) - seen.measured[:, 2]) * told
    d_local[:, 2, 2] = -steep * inverse**2
    d_inner[:, 2] = np.stack([expected, expected, -steep * focus], 1)
    return Linear(residual, d_local, d_inner)


def triangulate(views: F64, seen: Sightings, count: int, passes: int = 3) -> F64:
    """World points float64 [count, 3] from their pixels, linear in the points and reweighted by depth (Hartley &
    Zisserman, 12.2).

    Points that no two rays determine come out far away or behind a camera; those that are not seen are 0.
    """
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        return triangulate_numpy(views, seen, count, passes)
    points = np.zeros((count, 3))
    views, _, *rest = _arguments(views, points, seen)
    native.bundle_triangulate(views, *rest, passes, points)
    return points


def robust_cost(views: F64, points: F64, seen: Sightings) -> float:
    """Sum of 4 ln(1 + r²/4) over pixels and disparities."""
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        return robust_cost_numpy(views, points, seen)
    return float(native.bundle_cost(*_arguments(views, points, seen)))


def reduced_system(views: F64, points: F64, seen: Sightings, damping: float) -> Reduced:
    """Weighted normal equations at a state, without the points.

    Parameters
    ----------
    views : float64 [V, 17]
        See `view_table`.
    points : float64 [N, 3]
        In the world [m].
    damping : float
        Levenberg–Marquardt: added to the diagonals of the points' own systems, relative to them.
    """
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        return reduced_system_numpy(views, points, seen, damping)
    size = len(views) * LOCAL
    found = Reduced(np.zeros((size, size)), np.zeros(size), np.zeros((len(points), 9)))
    native.bundle_reduce(*_arguments(views, points, seen), damping, found.system, found.right, found.factors)
    return found


def point_steps(views: F64, points: F64, seen: Sightings, reduced: Reduced, local_steps: F64) -> F64:
    """Steps of the points float64 [N, 3] that go with steps of the views' local parameters [9 V]; same state."""
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        return point_steps_numpy(views, points, seen, reduced, local_steps)
    out = np.zeros((len(points), 3))
    native.bundle_restore(
        *_arguments(views, points, seen), reduced.factors, np.ascontiguousarray(local_steps, np.float64), out
    )
    return out


def _arguments(views: F64, points: F64, seen: Sightings) -> tuple[np.ndarray, ...]:
    return (
        np.ascontiguousarray(views, np.float64), np.ascontiguousarray(points, np.float64),
        np.ascontiguousarray(seen.point, np.int32), np.ascontiguousarray(seen.view, np.int32),
        np.ascontiguousarray(seen.measured, np.float64), np.ascontiguousarray(seen.inverse_sigma, np.float64),
    )  # fmt: skip


def _check(views: F64, count: int, seen: Sightings) -> None:
    for index, total in ((seen.view, len(views)), (seen.point, count)):
        if ((index < 0) | (index >= total)).any():
            raise ValueError("bundle: index out of range")
    if (np.diff(seen.point) < 0).any():
        raise ValueError("bundle: not sorted by point")


def triangulate_numpy(views: F64, seen: Sightings, count: int, passes: int) -> F64:
    """NumPy twin of `triangulate`."""
    _check(views, count, seen)
    points = np.zeros((count, 3))
    v = views[seen.view]
    rotation, shift, focal = v[:, :9].reshape(-1, 3, 3), v[:, 9:12], v[:, 12]
    # Each sighting gives two equations  (R[:2] − n R[2]) X = n t[2] − t[:2]  with n the normalised pixel.
    n = (seen.measured[:, :2] - v[:, 13:15]) / focal[:, None]
    rows = rotation[:, :2] - n[:, :, None] * rotation[:, 2][:, None, :]
    right = n * shift[:, 2:] - shift[:, :2]
    weight = focal
    for _ in range(passes):
        weighted = rows * weight[:, None, None] ** 2
        normal, known = np.zeros((count, 3, 3)), np.zeros((count, 3))
        np.add.at(normal, seen.point, np.einsum("mra,mrb->mab", weighted, rows))
        np.add.at(known, seen.point, np.einsum("mra,mr->ma", weighted, right))
        # A trace-relative ridge keeps parallel rays solvable without moving the others.
        ridge = 1e-12 * np.trace(normal, axis1=1, axis2=2) + 1e-30
        points = np.linalg.solve(normal + ridge[:, None, None] * np.eye(3), known[..., None])[..., 0]
        depth = np.einsum("ma,ma->m", rotation[:, 2], points[seen.point]) + shift[:, 2]
        weight = focal / np.maximum(np.abs(depth), NEAR)
    return np.asarray(points, np.float64)


def robust_cost_numpy(views: F64, points: F64, seen: Sightings) -> float:
    """NumPy twin of `robust_cost`."""
    _check(views, len(points), seen)
    squared = _squared(linearise(views, points, seen).residual)
    return float((CAUCHY**2 * np.log1p(squared / CAUCHY**2)).sum())


def reduced_system_numpy(views: F64, points: F64, seen: Sightings, damping: float) -> Reduced:
    """NumPy twin of `reduced_system`."""
    count, n = len(views), len(points)
    derivative, by_point, weight, residual = _weighted(views, points, seen)
    blocks, own = np.zeros((count, LOCAL, LOCAL)), np.zeros((n, 3, 3))
    right, own_right, mixed = np.zeros((count, LOCAL)), np.zeros((n, 3)), np.zeros((n, count, LOCAL, 3))
    by_view = derivative * weight[:, :, None]
    np.add.at(blocks, seen.view, np.einsum("mka,mkb->mab", by_view, derivative))
    np.add.at(right, seen.view, np.einsum("mka,mk->ma", by_view, residual))
    np.add.at(own, seen.point, np.einsum("mka,mkb->mab", by_point * weight[:, :, None], by_point))
    np.add.at(own_right, seen.point, np.einsum("mka,mk->ma", by_point * weight[:, :, None], residual))
    np.add.at(mixed, (seen.point, seen.view), np.einsum("mka,mkb->mab", by_view, by_point))
    diagonal = np.einsum("naa->na", own)
    diagonal *= 1 + damping
    diagonal += 1e-12 * diagonal.sum(1, keepdims=True) + 1e-30
    factor = np.linalg.cholesky(own)
    half = np.linalg.solve(factor, mixed.reshape(n, count * LOCAL, 3).transpose(0, 2, 1))
    y = np.linalg.solve(factor, own_right[:, :, None])[:, :, 0]
    system = -_outer_sum(half)
    for v in range(count):
        part = slice(v * LOCAL, (v + 1) * LOCAL)
        system[part, part] += blocks[v]
    packed = factor[:, [0, 1, 1, 2, 2, 2], [0, 0, 1, 0, 1, 2]]
    return Reduced(system, right.reshape(-1) - np.einsum("nka,nk->a", half, y), np.c_[packed, y])


def point_steps_numpy(views: F64, points: F64, seen: Sightings, reduced: Reduced, local_steps: F64) -> F64:
    """NumPy twin of `point_steps`."""
    derivative, by_point, weight, _ = _weighted(views, points, seen)
    along = np.einsum("mka,ma->mk", derivative, local_steps.reshape(-1, LOCAL)[seen.view]) * weight
    moved = np.zeros((len(points), 3))
    np.add.at(moved, seen.point, np.einsum("mk,mka->ma", along, by_point))
    factor = np.zeros((len(points), 3, 3))
    factor[:, [0, 1, 1, 2, 2, 2], [0, 0, 1, 0, 1, 2]] = reduced.factors[:, :6]
    factor[~factor.any((1, 2))] = np.eye(3)
    total = np.linalg.solve(factor, moved[:, :, None]) + reduced.factors[:, 6:, None]
    return np.asarray(-np.linalg.solve(factor.transpose(0, 2, 1), total)[:, :, 0], np.float64)


def _local(v: F64, points: F64) -> F64:
    """Points [M, 3] in the frames of their views [M, 17]."""
    return np.asarray(np.einsum("mab,mb->ma", v[:, :9].reshape(-1, 3, 3), points) + v[:, 9:12], np.float64)


def _squared(residual: F64) -> F64:
    """Squared lengths [M, 2] of the residuals in pixels and in disparity."""
    return np.stack([(residual[:, :2] ** 2).sum(1), residual[:, 2] ** 2], 1)


def _weighted(views: F64, points: F64, seen: Sightings) -> tuple[F64, F64, F64, F64]:
    """Derivatives by the view's local parameters [M, 3, 9] and by the point in the world [M, 3, 3]; weights [M, 3] and
    residuals [M, 3].
    """
    _check(views, len(points), seen)
    linear = linearise(views, points, seen)
    rotation = views[seen.view, :9].reshape(-1, 3, 3)
    local = _local(views[seen.view], points[seen.point])
    # ω × p moves r by (p × ∂r/∂p)·ω.
    turning = np.cross(local[:, None, :], linear.d_local)
    derivative = np.concatenate([turning, linear.d_local, linear.d_inner], axis=2)
    weight = (1 / (1 + _squared(linear.residual) / CAUCHY**2))[:, [0, 0, 1]]
    return derivative, linear.d_local @ rotation, weight, linear.residual


def _outer_sum(half: F64) -> F64:
    """Σ over points of ``half[n].T @ half[n]``, float64 [A, A] from [N, 3, A].

    Summed in chunks too small for BLAS to thread, then over chunks: one order whatever the number of threads.
    """
    n, _, a = half.shape
    chunks = -(-n // POINTS_PER_CHUNK)
    padded = np.zeros((chunks * POINTS_PER_CHUNK, 3, a))
    padded[:n] = half
    stacked = padded.reshape(chunks, POINTS_PER_CHUNK * 3, a)
    return np.asarray((stacked.transpose(0, 2, 1) @ stacked).sum(0), np.float64)
