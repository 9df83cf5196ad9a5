"""Points and poses together: match, triangulate, adjust, and match again where the solved geometry says to look."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.progress import Monitor
from lfrig.processing.model import F64, Camera, Pose
from lfrig.processing.poses.adjust import Reprojection, adjust
from lfrig.processing.poses.arrangement import Arrangement
from lfrig.processing.poses.guide import Guide
from lfrig.processing.poses.matching import Gallery, Matches
from lfrig.processing.poses.tracks import Observations, Pair, build_tracks
from lfrig.processing.poses.triangulate import ray_angle_from, reproject, reproject_into, triangulate, views_of

FINE_SCALE_PX = 2.0
"""Up to this keypoint scale SIFT's position error is constant; beyond, it grows in proportion (measured)."""

COARSE_SCHEDULE_PX = (16.0, 4.0, 1.0)
NOISE_BOUNDS_PX = (0.04, 1.0)
REJECT_SIGMAS = 4.0
MIN_RAY_ANGLE_DEG = 2.0
BAND_SIGMAS = 8.0
START_NOISE_PX = 0.25
ROUGH_TOLERANCE = 1e-3
FINE_TOLERANCE = 1e-5


@dataclass(frozen=True)
class Structure:
    """Solved geometry: parameters of an arrangement, sightings, their points [N, 3], and how well they agree.

    ``noise_px`` is the robust standard deviation of one coordinate of a fine-scale keypoint.
    """

    arrangement: Arrangement
    parameters: F64
    seen: Observations
    points: F64
    noise_px: float
    covariance: F64

    @property
    def poses(self) -> tuple[Pose, ...]:
        """Camera pose of every view."""
        return self.arrangement.poses(self.parameters)

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """Camera of every view."""
        return self.arrangement.cameras(self.parameters)


def coarseness(seen: Observations) -> F64:
    """Position error of each sighting relative to a fine-scale keypoint's [M]."""
    return np.maximum(1.0, seen.scale / FINE_SCALE_PX)


def common_points(structure: Structure) -> F64:
    """How many points each two views share, float64 [V, V]."""
    seen = structure.seen
    shows = np.zeros((seen.count, len(structure.arrangement.views)))
    shows[seen.point, seen.view] = 1
    return np.asarray(shows.T @ shows, np.float64)


def noise_of(residual: F64, seen: Observations) -> float:
    """Robust standard deviation [px] of one coordinate, corrected for what the points absorbed (degrees of freedom)."""
    if not len(seen):
        return NOISE_BOUNDS_PX[1]
    squared = (residual**2).sum(1) / coarseness(seen) ** 2
    spare = max(2 * len(seen) - 3 * seen.count, 1) / (2 * len(seen))
    # The median of a squared 2-D residual with 2·spare degrees of freedom is about its mean times 0.69 … 0.45.
    return float(np.clip(np.sqrt(np.median(squared) / (2 * spare * 0.6)), *NOISE_BOUNDS_PX))


def gate_sightings(
    cameras: Sequence[Camera],
    poses: Sequence[Pose],
    seen: Observations,
    points: F64,
    noise_px: float,
    depth_range_m: tuple[float, float],
) -> NDArray[np.bool_]:
    """Sightings [M] that fit: small residual, depth in range, and a point whose rays meet at a usable angle."""
    return gate_in(views_of(cameras, poses), seen, points, noise_px, depth_range_m)


def gate_in(
    views: F64, seen: Observations, points: F64, noise_px: float, depth_range_m: tuple[float, float]
) -> NDArray[np.bool_]:
    """The same, in views [V, 17] (see `bundle.view_table`)."""
    residual, depth = reproject_into(views, seen, points)
    error = np.hypot(*residual.T) / coarseness(seen)
    near, far = depth_range_m
    good = (error < REJECT_SIGMAS * noise_px) & (depth > near) & (depth < far)
    centres = -np.einsum("vab,va->vb", views[:, :9].reshape(-1, 3, 3), views[:, 9:12])
    return np.asarray(good & (ray_angle_from(centres, seen, points) > MIN_RAY_ANGLE_DEG)[seen.point], np.bool_)


def refine(
    arrangement: Arrangement,
    start: F64,
    seen: Observations,
    depth_range_m: tuple[float, float],
    noise_schedule_px: Sequence[float],
    monitor: Monitor,
) -> Structure:
    """Triangulate and adjust with a falling noise level, so that a poor start loses its outliers step by step.

    After the schedule the level is what the residuals say.
    """
    x = start
    result = None
    noise = noise_schedule_px[0]
    points = triangulate(arrangement.cameras(x), arrangement.poses(x), seen)
    for level in (*noise_schedule_px, None):
        if level is None:
            residual, _ = reproject(arrangement.cameras(x), arrangement.poses(x), seen, points)
            noise = noise_of(residual, seen)
        else:
            noise = level
        good = gate_sightings(arrangement.cameras(x), arrangement.poses(x), seen, points, noise, depth_range_m)
        seen, kept = seen.keep(good)
        points = points[kept]
        if not seen.count:
            break
        blocks = [Reprojection(seen, noise * coarseness(seen))]
        rough = level is not None
        result = adjust(arrangement, x, points, blocks, tolerance=ROUGH_TOLERANCE if rough else FINE_TOLERANCE)
        x, points = result.parameters, result.points
        monitor.advance(0)
    covariance = np.zeros((arrangement.size, arrangement.size)) if result is None else result.covariance
    return Structure(arrangement, x, seen, points, noise, covariance)


def widened(guide: Guide) -> tuple[float, float]:
    """Depths that points may have while poses are still rough."""
    return guide.depth_range[0] / 1.5, guide.depth_range[1] * 1.5


def match_again(
    structure: Structure,
    features: Gallery,
    pairs: Sequence[Pair],
    guide: Guide,
    band_px: float,
    *,
    vote: bool = False,
) -> dict[Pair, Matches]:
    """Matches where the solved geometry and the light fields say to look: more of them, and fewer false ones."""
    intervals = guide.intervals(features, structure)
    bands = dict.fromkeys(pairs, band_px)
    return guide.matches(structure.cameras, structure.poses, features, intervals, bands, vote=vote)


def complete(first: Structure, features: Gallery, pairs: Sequence[Pair], guide: Guide, monitor: Monitor) -> Structure:
    """Match again in the first solution's geometry, adjust once more, and keep what fits."""
    band = max(1.0, BAND_SIGMAS * first.noise_px)
    seen = build_tracks(features, match_again(first, features, pairs, guide, band))
    start = max(first.noise_px, START_NOISE_PX)
    final = refine(first.arrangement, first.parameters, seen, guide.depth_range, (start,), monitor)
    good = gate_sightings(final.cameras, final.poses, final.seen, final.points, final.noise_px, guide.depth_range)
    seen, kept = final.seen.keep(good)
    return replace(final, seen=seen, points=final.points[kept])
