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

from lfrig.processing.kernels.bundle import (
    LOCAL,
    Linear,
    Reduced,
    Sightings,
    linearise,
    point_steps,
    reduced_system,
    robust_cost,
    view_table,
)
from lfrig.processing.model import F64, Camera, Pose
from lfrig.processing.poses.arrangement import Arrangement, Line
from lfrig.processing.poses.tracks import Observations
from lfrig.processing.poses.triangulate import pixels_of, stack
from lfrig.processing.skipping import Tally

SETTLED_SIGMAS = 0.1
"""Where a round moves the parameters by less, in standard deviations, what is left to come adds a hundredth to their
variance; single points that still creep out of the tails do not matter."""


class ResidualBlock(Protocol):
    """One kind of measurement."""

    def sightings(self) -> Sightings:
        """What is measured, sorted by point or not."""
        ...


@dataclass(frozen=True)
class Reprojection:
    """Pixels of sightings, with ``sigma_px`` float64 [M]."""

    seen: Observations
    sigma_px: F64

    def sightings(self) -> Sightings:
        """See `ResidualBlock`."""
        return pixels_of(self.seen, self.sigma_px)

    def linearise(
        self, cameras: Sequence[Camera], poses: Sequence[Pose], points: F64, lines: Sequence[Line | None] = ()
    ) -> Linear:
        """Residuals [M, 2] and derivatives [M, 2, 3] at a state."""
        found = linearise(_views(cameras, poses, lines), points, self.sightings())
        return Linear(found.residual[:, :2], found.d_local[:, :2], found.d_inner[:, :2])


@dataclass(frozen=True)
class Disparity:
    """Light-field disparity of points in views that have a line: ``point`` and ``view`` int64 [M], ``disparity`` and
    ``sigma`` float64 [M] px per view step. A light field says nothing across its rays, but how far along.
    """

    point: NDArray[np.int64]
    view: NDArray[np.int64]
    disparity: F64
    sigma: F64

    def sightings(self) -> Sightings:
        """See `ResidualBlock`."""
        measured, inverse_sigma = np.zeros((len(self.point), 3)), np.zeros((len(self.point), 2))
        measured[:, 2], inverse_sigma[:, 1] = self.disparity, 1 / self.sigma
        return Sightings(self.point.astype(np.int32), self.view.astype(np.int32), measured, inverse_sigma)

    def linearise(
        self, cameras: Sequence[Camera], poses: Sequence[Pose], points: F64, lines: Sequence[Line | None] = ()
    ) -> Linear:
        """Residuals [M, 1] and derivatives [M, 1, 3] at a state."""
        found = linearise(_views(cameras, poses, lines), points, self.sightings())
        return Linear(found.residual[:, 2:], found.d_local[:, 2:], found.d_inner[:, 2:])


def _views(cameras: Sequence[Camera], poses: Sequence[Pose], lines: Sequence[Line | None]) -> F64:
    """The views as `lfrig.processing.kernels.bundle` takes them."""
    focal, principal, rotation, translation = stack(cameras, poses)
    table = np.zeros((len(focal), 2))
    for v, line in enumerate(lines):
        if line is not None:
            table[v] = line.baseline_m, line.inverse_focus
    return view_table(rotation, translation, focal, principal, table)


@dataclass(frozen=True)
class Adjustment:
    """Result: parameters, points float64 [N, 3], and robust cost."""

    parameters: F64
    points: F64
    cost: float
    _state: _State

    @property
    def covariance(self) -> F64:
        """Of the parameters, float64 [size, size]; zero where held. Computed when asked for."""
        return self._state.covariance()


def adjust(
    arrangement: Arrangement,
    start: F64,
    points: F64,
    blocks: Sequence[ResidualBlock],
    *,
    max_iterations: int = 25,
    tolerance: float = 1e-5,
    until_settled: bool = False,
    tally: Tally | None = None,
) -> Adjustment:
    """Most probable parameters and points, from a start that is close enough.

    Parameters
    ----------
    tolerance : float
        A round that lowers the cost by less than this fraction is the last.
    until_settled : bool
        Also stop when a round has moved no parameter by `SETTLED_SIGMAS` of its standard deviation.
    """
    problem = _Problem(arrangement, _merged(blocks))
    x, damping = start.copy(), 1e-4
    state = problem.at(x, points)
    rounds = 0
    while rounds < max_iterations:
        rounds += 1
        step, point_step, length = state.solve(damping)
        trial = x.copy()
        trial[problem.free] += step
        tried = problem.at(trial, state.points + point_step)
        if tried.cost < state.cost:
            gain = state.cost - tried.cost
            x, state = trial, tried
            damping = max(damping / 10, 1e-10)
            if gain < tolerance * state.cost or (until_settled and length < SETTLED_SIGMAS):
                break
        else:
            damping *= 10
            if damping > 1e6 or (until_settled and length < SETTLED_SIGMAS):
                break
    if tally is not None:
        tally.add("adjustment", rounds, max_iterations - rounds, "rounds")
    return Adjustment(x, state.points, state.cost, state)


def _merged(blocks: Sequence[ResidualBlock]) -> Sightings:
    """All blocks' sightings in order of points."""
    parts = [block.sightings() for block in blocks]
    if len(parts) == 1:
        return parts[0].sorted()
    return Sightings(
        np.concatenate([p.point for p in parts]), np.concatenate([p.view for p in parts]),
        np.concatenate([p.measured for p in parts]), np.concatenate([p.inverse_sigma for p in parts]),
    ).sorted()  # fmt: skip


class _Problem:
    """What does not change from round to round."""

    def __init__(self, arrangement: Arrangement, seen: Sightings) -> None:
        self.arrangement, self.seen = arrangement, seen
        self.sigma = arrangement.sigmas()
        self.free = np.flatnonzero(self.sigma > 0)
        self.full_sigma = np.where(self.sigma > 0, self.sigma, 1.0)

    def at(self, x: F64, points: F64) -> _State:
        """The problem at parameters and points."""
        return _State(self, x, points)


class _State:
    """The problem at one state; its normal equations are formed when asked for."""

    def __init__(self, problem: _Problem, x: F64, points: F64) -> None:
        self.problem, self.x, self.points = problem, x, points
        self.views, self.derivative = problem.arrangement.linearise(x)
        self.cost = robust_cost(self.views, points, problem.seen)
        self.cost += problem.arrangement.prior_cost(x, problem.sigma)

    def solve(self, damping: float) -> tuple[F64, F64, float]:
        """Damped step of the free parameters and of the points; and the longest step of a parameter, in standard
        deviations that the damped system leaves it.
        """
        reduced, free = self._reduced(damping), self.problem.free
        chain = self._chain()
        longest = 0.0
        if len(free):
            precision = self._precision()
            hessian = chain.T @ reduced.system @ chain + np.diag(precision)
            hessian[np.diag_indices(len(free))] *= 1 + damping
            step = np.asarray(-np.linalg.solve(hessian, chain.T @ reduced.right + precision * self.x[free]), np.float64)
            longest = float(np.sqrt(step @ hessian @ step))
        else:
            step = np.zeros(0)
        moved = point_steps(self.views, self.points, self.problem.seen, reduced, chain @ step)
        return step, moved, longest

    def covariance(self) -> F64:
        """Covariance of all parameters (zero where held), points marginalised."""
        size, free = self.problem.arrangement.size, self.problem.free
        table = np.zeros((size, size))
        if len(free):
            chain = self._chain()
            hessian = chain.T @ self._reduced(0.0).system @ chain + np.diag(self._precision())
            table[np.ix_(free, free)] = np.linalg.inv(hessian)
        return table

    def _reduced(self, damping: float) -> Reduced:
        return reduced_system(self.views, self.points, self.problem.seen, damping)

    def _chain(self) -> F64:
        """Motion of the local parameters [L V] with the free ones."""
        return np.asarray(self.derivative.reshape(len(self.views) * LOCAL, -1)[:, self.problem.free], np.float64)

    def _precision(self) -> F64:
        weight = self.problem.arrangement.precision(self.x, self.problem.full_sigma)
        return np.asarray(weight[self.problem.free], np.float64)
