"""Bundle adjustment with priors: Levenberg–Marquardt, points eliminated by their Schur complement, Cauchy weights.

Triggs et al., "Bundle adjustment: a modern synthesis", 1999. For a handful of cameras and some thousand points the
reduced system is tiny, and what matters is that *every* parameter of the rig has its prior: an adjustment without
them loses metric scale (4–6 %) and cannot refine focal lengths.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lfrig.processing.model import F64, Camera, Pose
from lfrig.processing.poses.arrangement import LOCAL, Arrangement, Line
from lfrig.processing.poses.tracks import Observations
from lfrig.processing.poses.triangulate import stack

POINTS_PER_CHUNK = 32

CAUCHY = 2.0
"""A residual of this many sigmas has half the weight of a small one."""


@dataclass(frozen=True)
class Linear:
    """A block of residuals at one state, M sightings of k numbers each, in units of their sigma.

    ``point`` and ``view`` int64 [M]; ``residual`` float64 [M, k]; ``d_local`` float64 [M, k, 3], by the point in the
    camera's frame; ``d_inner`` float64 [M, k, 3], by the logarithms of focal length, baseline and inverse focus
    distance.
    """

    point: NDArray[np.int64]
    view: NDArray[np.int64]
    residual: F64
    d_local: F64
    d_inner: F64


class ResidualBlock(Protocol):
    """One kind of measurement."""

    def linearise(
        self, cameras: Sequence[Camera], poses: Sequence[Pose], points: F64, lines: Sequence[Line | None] = ()
    ) -> Linear:
        """Residuals and derivatives at a state."""
        ...


@dataclass(frozen=True)
class Reprojection:
    """Pixels of sightings, with ``sigma_px`` float64 [M]."""

    seen: Observations
    sigma_px: F64

    def linearise(
        self, cameras: Sequence[Camera], poses: Sequence[Pose], points: F64, lines: Sequence[Line | None] = ()
    ) -> Linear:
        """See `ResidualBlock`."""
        view = self.seen.view
        focal, principal, rotation, translation = stack(cameras, poses)
        local = np.einsum("mab,mb->ma", rotation[view], points[self.seen.point]) + translation[view]
        # Behind the camera the projection is meaningless: held just in front, its residual is huge and loses weight.
        inverse = 1 / np.maximum(local[:, 2], 1e-6)
        f = focal[view]
        slope = local[:, :2] * inverse[:, None]
        residual = (slope * f[:, None] + principal[view] - self.seen.xy) / self.sigma_px[:, None]
        scale = f * inverse / self.sigma_px
        d_local = np.zeros((len(view), 2, 3))
        d_local[:, 0, 0] = d_local[:, 1, 1] = scale
        d_local[:, :, 2] = -slope * scale[:, None]
        d_inner = np.zeros((len(view), 2, 3))
        d_inner[:, :, 0] = slope * (f / self.sigma_px)[:, None]
        return Linear(self.seen.point, view, residual, d_local, d_inner)


@dataclass(frozen=True)
class Disparity:
    """Light-field disparity of points in views that have a line: ``point`` and ``view`` int64 [M], ``disparity`` and
    ``sigma`` float64 [M] px per view step. A light field says nothing across its rays, but how far along.
    """

    point: NDArray[np.int64]
    view: NDArray[np.int64]
    disparity: F64
    sigma: F64

    def linearise(
        self, cameras: Sequence[Camera], poses: Sequence[Pose], points: F64, lines: Sequence[Line | None] = ()
    ) -> Linear:
        """See `ResidualBlock`."""
        view = self.view
        focal, _, rotation, translation = stack(cameras, poses)
        depth = np.einsum("mb,mb->m", rotation[view, 2], points[self.point]) + translation[view, 2]
        inverse = 1 / np.maximum(depth, 1e-6)
        slope = (focal * [0.0 if line is None else line.baseline_m for line in lines])[view] / self.sigma
        offset = np.array([0.0 if line is None else line.inverse_focus for line in lines])[view]
        expected = slope * (inverse - offset)
        d_local = np.zeros((len(view), 1, 3))
        d_local[:, 0, 2] = -slope * inverse**2
        d_inner = np.stack([expected, expected, -slope * offset], 1)[:, None, :]
        return Linear(self.point, view, (expected - self.disparity / self.sigma)[:, None], d_local, d_inner)


@dataclass(frozen=True)
class Adjustment:
    """Result: parameters, points float64 [N, 3], robust cost, and the parameters' covariance [size, size]."""

    parameters: F64
    points: F64
    cost: float
    covariance: F64


def adjust(
    arrangement: Arrangement,
    start: F64,
    points: F64,
    blocks: Sequence[ResidualBlock],
    *,
    max_iterations: int = 25,
    tolerance: float = 1e-5,
) -> Adjustment:
    """Most probable parameters and points, from a start that is close enough."""
    sigma = arrangement.sigmas()
    free = np.flatnonzero(sigma > 0)
    x, damping = start.copy(), 1e-4
    system = _System(arrangement, x, points, blocks)
    cost = system.cost
    for _ in range(max_iterations):
        step, point_step = system.solve(x, free, sigma, damping)
        trial = x.copy()
        trial[free] += step
        trial_points = points + point_step
        trial_system = _System(arrangement, trial, trial_points, blocks)
        if trial_system.cost < cost:
            gain = cost - trial_system.cost
            x, points, system, cost = trial, trial_points, trial_system, trial_system.cost
            damping = max(damping / 10, 1e-10)
            if gain < tolerance * cost:
                break
        else:
            damping *= 10
            if damping > 1e6:
                break
    return Adjustment(x, points, cost, system.covariance(x, free, sigma))


class _System:
    """The linearised problem at one state."""

    def __init__(self, arrangement: Arrangement, x: F64, points: F64, blocks: Sequence[ResidualBlock]) -> None:
        self.arrangement, self.x, self.points = arrangement, x, points
        self.poses = arrangement.poses(x)
        cameras = arrangement.cameras(x)
        lines = arrangement.lines(x)
        self.linear = [block.linearise(cameras, self.poses, points, lines) for block in blocks]
        squared = [(part.residual**2).sum(1) for part in self.linear]
        self.weight = [1 / (1 + s / CAUCHY**2) for s in squared]
        self.cost = sum(float((CAUCHY**2 * np.log1p(s / CAUCHY**2)).sum()) for s in squared)
        self.cost += arrangement.prior_cost(x, arrangement.sigmas())

    def _normal(self) -> tuple[F64, F64, F64, F64, F64]:
        """Weighted normal equations in local parameters and points.

        U [V, L, L], its right side [V, L]; P [N, 3, 3], its right side [N, 3]; mixed W [N, V, L, 3].
        """
        views, n = len(self.poses), len(self.points)
        u, gu = np.zeros((views, LOCAL, LOCAL)), np.zeros((views, LOCAL))
        p, gp = np.zeros((n, 3, 3)), np.zeros((n, 3))
        mixed = np.zeros((n, views, LOCAL, 3))
        for part, weight in zip(self.linear, self.weight, strict=True):
            for v in range(views):
                rows = np.flatnonzero(part.view == v)
                point = part.point[rows]
                turned = self.points[point] @ self.poses[v].rotation.T + self.poses[v].translation
                d_local = part.d_local[rows]
                d_view = np.concatenate([_cross(turned, d_local), d_local, part.d_inner[rows]], axis=2)
                d_point = d_local @ self.poses[v].rotation
                weighted = d_view * weight[rows, None, None]
                u[v] += np.einsum("mka,mkb->ab", weighted, d_view)
                gu[v] += np.einsum("mka,mk->a", weighted, part.residual[rows])
                # A point is seen at most once per view and block: plain indexing adds nothing twice.
                p[point] += np.einsum("mka,mkb->mab", d_point * weight[rows, None, None], d_point)
                gp[point] += np.einsum("mka,mk->ma", d_point * weight[rows, None, None], part.residual[rows])
                mixed[point, v] += np.einsum("mka,mkb->mab", weighted, d_point)
        return u, gu, p, gp, mixed

    def _reduced(self, damping: float) -> tuple[F64, F64, F64, F64, F64]:
        """Schur complement in local parameters [L V, L V], its right side, and what restores the points."""
        u, gu, p, gp, mixed = self._normal()
        views, n = len(self.poses), len(self.points)
        diagonal = np.einsum("naa->na", p)
        diagonal *= 1 + damping
        diagonal += 1e-12 * diagonal.sum(1, keepdims=True) + 1e-30
        inverse: F64 = np.asarray(np.linalg.inv(p), np.float64)
        flat = mixed.reshape(n, views * LOCAL, 3)
        carried = flat @ inverse
        schur = -_outer_sum(carried, flat)
        for v in range(views):
            own = slice(v * LOCAL, (v + 1) * LOCAL)
            schur[own, own] += u[v]
        right: F64 = gu.reshape(-1) - np.einsum("nab,nb->a", carried, gp)
        return schur, right, inverse, gp, flat

    def solve(self, x: F64, free: NDArray[np.intp], sigma: F64, damping: float) -> tuple[F64, F64]:
        """Damped step of the free parameters and of the points."""
        schur, right, inverse, gp, flat = self._reduced(damping)
        chain = self.arrangement.local_derivative(x).reshape(-1, self.arrangement.size)[:, free]
        if len(free):
            precision = self._precision(x, free, sigma)
            hessian = chain.T @ schur @ chain + np.diag(precision)
            hessian[np.diag_indices(len(free))] *= 1 + damping
            step: F64 = np.asarray(-np.linalg.solve(hessian, chain.T @ right + precision * x[free]), np.float64)
        else:
            step = np.zeros(0)
        moved = np.einsum("nab,a->nb", flat, chain @ step)
        return step, np.asarray(-np.einsum("nab,nb->na", inverse, gp + moved), np.float64)

    def covariance(self, x: F64, free: NDArray[np.intp], sigma: F64) -> F64:
        """Covariance of all parameters (zero where held), points marginalised."""
        table = np.zeros((self.arrangement.size, self.arrangement.size))
        if len(free):
            schur = self._reduced(0.0)[0]
            chain = self.arrangement.local_derivative(x).reshape(-1, self.arrangement.size)[:, free]
            hessian = chain.T @ schur @ chain + np.diag(self._precision(x, free, sigma))
            table[np.ix_(free, free)] = np.linalg.inv(hessian)
        return table

    def _precision(self, x: F64, free: NDArray[np.intp], sigma: F64) -> F64:
        full = np.where(sigma > 0, sigma, 1.0)
        return np.asarray(self.arrangement.precision(x, full)[free], np.float64)


def _outer_sum(left: F64, right: F64) -> F64:
    """Σ over points of ``left[n] @ right[n].T``, float64 [a, b] from [N, a, 3] and [N, b, 3].

    Summed in chunks too small for BLAS to thread, then over chunks: one order whatever the number of threads.
    """
    n, a = left.shape[:2]
    chunks = -(-n // POINTS_PER_CHUNK)
    padded = np.zeros((2, chunks * POINTS_PER_CHUNK, a, 3))
    padded[0, :n], padded[1, :n] = left, right
    stacked = padded.transpose(0, 1, 3, 2).reshape(2, chunks, POINTS_PER_CHUNK * 3, a)
    return np.asarray((stacked[0].transpose(0, 2, 1) @ stacked[1]).sum(0), np.float64)


def _cross(point: F64, derivative: F64) -> F64:
    """P × ∂r/∂p, the derivative by a rotation: ω × p moves r by (p × ∂r/∂p)·ω. [M, k, 3] from [M, 3] and [M, k, 3]."""
    x, y, z = (point[:, None, i] for i in range(3))
    a, b, c = (derivative[:, :, i] for i in range(3))
    return np.stack([y * c - z * b, z * a - x * c, x * b - y * a], axis=2)
