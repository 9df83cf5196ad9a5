"""Poses by the light fields' own depth: corners warped into the neighbours, then one adjustment with disparities.

Two passes. In the first the strongest corners are followed into the neighbours only, by optical flow in the warped
picture, and what the priors got wrong is solved for; in the second all corners go into every view within reach, and
land within a pixel of where they are predicted. Each capture's scale (1/z = a δ + c) comes out with the poses.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from lfrig.contracts.progress import Monitor
from lfrig.processing.geometry import rotation_angle_deg
from lfrig.processing.kernels.bundle import NEAR
from lfrig.processing.model import F64, LightField, Pose
from lfrig.processing.poses.adjust import Disparity, Reprojection, ResidualBlock, adjust
from lfrig.processing.poses.arrangement import Arrangement, Line
from lfrig.processing.poses.priors import PAIR_LIMIT_DEG
from lfrig.processing.poses.sightings import Followed, Looks, directed_pairs, follow_all
from lfrig.processing.poses.structure import (
    FINE_TOLERANCE,
    NOISE_BOUNDS_PX,
    ROUGH_TOLERANCE,
    Structure,
    coarseness,
    common_points,
    gate_in,
    noise_of,
)
from lfrig.processing.poses.tracks import Observations, Pair
from lfrig.processing.poses.triangulate import reproject_into, triangulate_from
from lfrig.processing.poses.warp_lk import Sighted
from lfrig.processing.skipping import SKIP_ALL, Skips, Tally

FLOW_CORNERS = 250
MAX_FLOW_STEP_DEG = 36.0
DISPARITY_SIGMA_PX = 0.012
REJECT_DISPARITY = 5.0
OPTICS_FLOOR = 0.005
ENOUGH_POINTS = 15
MAX_ITERATIONS = 12
MAX_ROUNDS = 4
SETTLED_DEG = 0.03
"""Rotations that change by less move no prediction by a pixel."""

ROUND_CORNERS, ROUND_WIDTH = 300, 500
"""So many of each light field, of views so wide, place the views to a tenth of what `SETTLED_DEG` asks for."""

LOST_FRACTION = 0.15
ENOUGH_SHARED = 100

FLOW_SCHEDULE = ((16.0, 0.06), (4.0, 0.06), (1.2, 0.02), (0.4, 0.012))
ALIGN_SCHEDULE = ((0.5, 0.012),)
"""Noise levels [px] and [px of disparity], falling, before the residuals say what the noise is."""


Known = Mapping[Pair, Sighted]
NOTHING_KNOWN: Known = MappingProxyType({})


@dataclass(frozen=True)
class Effort:
    """What goes with every solve: progress, what may be left out, and where that is counted."""

    monitor: Monitor
    skips: Skips = SKIP_ALL
    tally: Tally | None = None


def recorded_line(source: LightField, captures: int) -> Line | None:
    """Line of a capture by its recorded optics; None where they are not recorded.

    All captures are off by the same calibration, while the adjustment takes their errors as independent: the sigma is
    widened so that 2 values of each capture *together* say no more of the metric scale than one of them does. What
    ties captures to each other is measured, and needs no prior.
    """
    baseline, focus = source.optics.baseline_m, source.optics.focus_distance_m
    if baseline is None or focus is None:
        return None
    return Line(baseline, 1 / focus, optics_sigma(source) * float(np.sqrt(2 * captures)))


def optics_sigma(source: LightField) -> float:
    """Relative standard deviation of a recorded baseline or focus distance."""
    return max(OPTICS_FLOOR, source.optics.sigma_baseline)


def with_lines(arrangement: Arrangement, lines: Sequence[Line | None]) -> Arrangement:
    """The arrangement whose first views have these lines."""
    views = list(arrangement.views)
    for v, line in enumerate(lines):
        views[v] = replace(views[v], line=line)
    return replace(arrangement, views=tuple(views))


def adjust_light_fields(
    arrangement: Arrangement,
    start: F64,
    seen: Observations,
    depth_range_m: tuple[float, float],
    schedule: Sequence[tuple[float, float]],
    effort: Effort,
) -> Structure:
    """Triangulate, and adjust by reprojection and disparity with falling noise levels; at last by the noise found."""
    x, result, noise = start, None, NOISE_BOUNDS_PX[1]
    views = arrangement.linearise(x)[0]
    points = triangulate_from(views, seen)
    for level in (*schedule, None):
        if level is None:
            noise, sigma = noise_of(reproject_into(views, seen, points)[0], seen), DISPARITY_SIGMA_PX
        else:
            noise, sigma = level
        good = gate_in(views, seen, points, noise, depth_range_m)
        good &= ~_contradicted(views, seen, points, REJECT_DISPARITY * sigma)[seen.point]
        seen, kept = seen.keep(good)
        points = points[kept]
        if seen.count < ENOUGH_POINTS:
            break
        blocks: list[ResidualBlock] = [Reprojection(seen, noise * coarseness(seen))]
        told = _told(seen)
        blocks.append(Disparity(seen.point[told], seen.view[told], _disparity(seen)[told], np.full(len(told), sigma)))
        result = adjust(
            arrangement, x, points, blocks, max_iterations=MAX_ITERATIONS,
            tolerance=FINE_TOLERANCE if level is None else ROUGH_TOLERANCE, until_settled=effort.skips.adjustment,
            tally=effort.tally,
        )  # fmt: skip
        x, points = result.parameters, result.points
        views = arrangement.linearise(x)[0]
        effort.monitor.advance(0)
    covariance = np.zeros((arrangement.size, arrangement.size)) if result is None else result.covariance
    return Structure(arrangement, x, seen, points, noise, covariance)


def _disparity(seen: Observations) -> F64:
    return np.full(len(seen), np.nan) if seen.disparity is None else seen.disparity


def _told(seen: Observations) -> np.ndarray:
    return np.flatnonzero(np.isfinite(_disparity(seen)))


def disparity_residual(views: F64, seen: Observations, points: F64) -> F64:
    """Expected minus found disparity of every sighting [M] px, NaN where none was found; views [V, 17] as of
    `bundle.view_table`.
    """
    out = np.full(len(seen), np.nan)
    told = _told(seen)
    own = views[seen.view[told]]
    depth = np.einsum("ma,ma->m", own[:, 6:9], points[seen.point[told]]) + own[:, 11]
    out[told] = own[:, 12] * own[:, 15] * (1 / np.maximum(depth, NEAR) - own[:, 16]) - _disparity(seen)[told]
    return out


def _contradicted(views: F64, seen: Observations, points: F64, limit_px: float) -> np.ndarray:
    """Which points [count] lie where their own light field says otherwise."""
    wrong = np.zeros(seen.count, bool)
    wrong[seen.point[np.abs(disparity_residual(views, seen, points)) > limit_px]] = True
    return wrong


def widest_link_deg(poses: Sequence[Pose]) -> float:
    """The widest step of the chain that joins all views by their smallest steps (minimum spanning tree)."""
    joined, rest, widest = {0}, set(range(1, len(poses))), 0.0
    while rest:
        angle, nearest = min(
            (rotation_angle_deg(poses[a].rotation, poses[b].rotation), b) for a in joined for b in sorted(rest)
        )
        widest = max(widest, angle)
        joined.add(nearest)
        rest.discard(nearest)
    return widest


def first_pass(
    looks: Looks,
    arrangement: Arrangement,
    x: F64,
    depth_range_m: tuple[float, float],
    effort: Effort,
    placed: Collection[int] = (),
    known: Known = NOTHING_KNOWN,
) -> Structure | None:
    """Follow by flow into the neighbours and solve; None where steps are too wide for it, optics unknown, or
    hardly a corner of some view is found. Views that are ``placed`` need no flow among each other, and ``known`` are
    pairs that were followed already.
    """
    poses = arrangement.poses(x)
    widest = widest_link_deg(poses)
    if widest > MAX_FLOW_STEP_DEG or any(arrangement.views[v].line is None for v in range(len(looks.reliefs))):
        return None
    pairs = directed_pairs(poses, len(looks.reliefs), 1.05 * widest)
    flow = [(j, i) for j, i in pairs if not (i in placed and j in placed)]
    followed = follow_all(looks, arrangement, x, pairs, depth_range_m, flow=flow, limit=FLOW_CORNERS, known=known)
    if followed.seen.count < ENOUGH_POINTS:
        return None
    solved = adjust_light_fields(arrangement, x, followed.seen, depth_range_m, FLOW_SCHEDULE, effort)
    counts = np.bincount(solved.seen.view, minlength=len(poses))
    return solved if counts.min() >= ENOUGH_POINTS else None


@dataclass(frozen=True)
class Aligned:
    """What the second pass made: the solution, the sightings it rests on, and what ``part`` of all corners it took."""

    structure: Structure
    followed: Followed
    part: float = 1.0


def second_pass(
    looks: Looks, rough: Structure, depth_range_m: tuple[float, float], effort: Effort, known: Known = NOTHING_KNOWN
) -> Aligned:
    """Align all corners in every view within reach of a solution that a fraction of them has settled (`settle`)."""
    placed = settle(looks, rough, depth_range_m, effort, known)
    settled = placed.structure
    arrangement, x = settled.arrangement, settled.parameters
    pairs = directed_pairs(settled.poses, len(looks.reliefs), PAIR_LIMIT_DEG)
    followed = follow_all(looks, arrangement, x, pairs, depth_range_m, known={**placed.followed.by_pair, **known})
    solved = adjust_light_fields(arrangement, x, followed.seen, depth_range_m, ALIGN_SCHEDULE, effort)
    return Aligned(solved, followed)


def settle(
    looks: Looks, rough: Structure, depth_range_m: tuple[float, float], effort: Effort, known: Known = NOTHING_KNOWN
) -> Aligned:
    """Align the strongest corners in every view within reach of a rough solution, and solve again; until that moves
    little.

    Pairs that hardly share a point are followed by flow once more: the first pass need not have seen them. ``known``
    are pairs that were followed already.
    """
    solved, lost = rough, set[Pair]()
    pairs = directed_pairs(rough.poses, len(looks.reliefs), PAIR_LIMIT_DEG)
    corners = sum(len(relief.corners) for relief in looks.reliefs)
    # A corner places a view the worse the smaller the pictures are: as many more are needed for the same precision.
    limit = round(ROUND_CORNERS * max(1.0, ROUND_WIDTH / looks.reliefs[0].disparity.shape[1]) ** 2)
    part = sum(min(len(relief.corners), limit) for relief in looks.reliefs) / max(corners, 1)
    for _ in range(MAX_ROUNDS):
        before = solved.poses
        followed = follow_all(
            looks, solved.arrangement, solved.parameters, pairs, depth_range_m, flow=lost, limit=limit,
            known=known,
        )  # fmt: skip
        known = {**known, **followed.by_pair}
        solved = adjust_light_fields(
            solved.arrangement, solved.parameters, followed.seen, depth_range_m, ALIGN_SCHEDULE, effort
        )
        again = bool(lost) or _moved_deg(before, solved.poses) > SETTLED_DEG
        shared = common_points(solved)
        # A pair that flow has just failed for is let go.
        lost = {p for p in pairs if shared[p] < part * ENOUGH_SHARED and followed.fraction(p) < LOST_FRACTION} - lost
        if not (again or lost):
            break
    return Aligned(solved, followed, part)


def _moved_deg(before: Sequence[Pose], after: Sequence[Pose]) -> float:
    """Largest change of a view's rotation relative to the first one's."""
    return max(
        rotation_angle_deg(a.rotation @ before[0].rotation.T, b.rotation @ after[0].rotation.T)
        for a, b in zip(before, after, strict=True)
    )
