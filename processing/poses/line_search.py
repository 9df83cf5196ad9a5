"""Lines of light fields whose poses are known: what recorded optics leave open, told by one other view.

Recorded baselines and focus distances are off by percents, which moves a corner by tens of pixels along its epipolar
line. So each corner is compared at all depths that the optics allow, and a robust line through its disparities and the
likeliest depths corrects the recorded one (plane sweep: Collins 1996, over patches).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.errors import GeometryRefused
from lfrig.processing.geometry import rotation_angle_deg
from lfrig.processing.kernels.correlation import shifted_correlations
from lfrig.processing.model import F32, F64, ScaleFit
from lfrig.processing.poses.arrangement import Arrangement, Line
from lfrig.processing.poses.patches import square
from lfrig.processing.poses.picture import Small
from lfrig.processing.poses.priors import PAIR_LIMIT_DEG
from lfrig.processing.poses.sightings import Looks, warps_of
from lfrig.processing.poses.warp_lk import MIN_CORRELATION, Warp
from lfrig.processing.scale_fit import ScalePrior, fit_affine

SEARCHED = 150
"""Corners: a hundred that are off by a few pixels each tell where all are to a fraction of one."""

HALF_PX = 4
STEP_PX = 1.0
"""Of pictures at half size: enough for alignment to take over from."""

MAX_STEPS = 75
MIN_TURN_DEG = 3.0
"""Views closer together tell depths no better than the light field itself."""

MIN_FOUND, MIN_INLIERS = 30, 0.5
MAX_SCATTER_PX = 0.016
"""Of the line, as disparity: true ones have 0.002 to 0.012, those of a pattern that repeats more."""

REACH_SIGMAS = 3.0
DISPARITY_SIGMA_PX = 0.02


def search_lines(
    looks: Looks,
    arrangement: Arrangement,
    x: F64,
    sigmas: Sequence[float],
    depth_range_m: tuple[float, float],
    known: Collection[int] = (),
) -> F64:
    """X with the lines that the nearest view of each light field tells, where it does; those ``known`` stay.

    ``sigmas`` are the relative standard deviations of what is recorded of each light field's optics.
    """
    x, poses, cameras = x.copy(), arrangement.poses(x), arrangement.cameras(x)
    pairs = []
    for v in range(len(looks.reliefs)):
        turns = {i: rotation_angle_deg(poses[v].rotation, p.rotation) for i, p in enumerate(poses) if i != v}
        usable = [i for i, turn in turns.items() if MIN_TURN_DEG < turn < PAIR_LIMIT_DEG]
        if v not in known and usable:
            pairs.append((v, min(usable, key=turns.__getitem__)))
    reliefs = [relief.first(SEARCHED) for relief in looks.reliefs]
    for (v, i), warp in warps_of(reliefs, arrangement, x, pairs, depth_range_m).items():
        recorded = arrangement.views[v].line
        assert recorded is not None
        found = _search(warp, looks.pictures[v].small, looks.pictures[i].small, sigmas[v])
        if found is not None:
            line = Line.of_scale(found, cameras[v], 0.0)
            start = arrangement.log_lines.start + 2 * v
            x[start : start + 2] = np.log(
                [line.baseline_m / recorded.baseline_m, line.inverse_focus / recorded.inverse_focus]
            )
    return x


def _search(warp: Warp, here: Small, there: Small, sigma: float) -> ScaleFit | None:
    """The light field's scale by what another picture shows of its corners; None where that tells too little."""
    scale, corners = warp.scale, warp.relief.corners
    spread = sigma * np.hypot(scale.a * corners.disparity, scale.c) + scale.a * DISPARITY_SIGMA_PX
    expected = scale.a * corners.disparity + scale.c
    ends = np.stack([warp.at(corners.xy, expected + side * REACH_SIGMAS * spread) for side in (-1, 1)])
    told = np.flatnonzero(np.isfinite(ends).all((0, 2)))
    if len(told) < MIN_FOUND:
        return None
    length = np.median(np.hypot(*(ends[1] - ends[0])[told].T)) / there.pixel[0]
    steps = int(np.clip(np.ceil(length / STEP_PX), 4, MAX_STEPS)) | 1
    depths = expected[told] + spread[told] * np.linspace(-REACH_SIGMAS, REACH_SIGMAS, steps)[:, None]
    likeness = _likeness(warp, here, there, told, np.clip(depths, *warp.limits))
    rows, best = np.arange(len(told)), likeness[1:-1].argmax(0) + 1
    peak, before, after = likeness[best, rows], likeness[best - 1, rows], likeness[best + 1, rows]
    found = np.flatnonzero((peak > MIN_CORRELATION) & (peak >= before) & (peak >= after))
    if len(found) < MIN_FOUND:
        return None
    # Between the steps by a parabola: whole steps only, most points would lie on one line exactly.
    bend = np.minimum(before - 2 * peak + after, -1e-6)[found]
    step = (depths[1] - depths[0])[found]
    inverse = depths[best[found], found] + 0.5 * (before - after)[found] / bend * step
    prior = ScalePrior(scale.a, scale.c, sigma * scale.a, sigma * scale.c)
    try:
        fit = fit_affine(corners.disparity[told[found]], inverse, prior)
    except GeometryRefused:
        return None
    told_well = fit.a > 0 and fit.c > 0 and fit.inliers >= MIN_INLIERS and fit.residual < MAX_SCATTER_PX * fit.a
    return fit if told_well else None


def _likeness(warp: Warp, here: Small, there: Small, rows: NDArray[np.intp], depths: F64) -> F32:
    """How alike the patches of corners ``rows`` [N] look at inverse depths [S, N], float32 [S, N]."""
    window = square(HALF_PX)
    ground = warp.relief.ground.take(rows)
    start, affine, _ = warp.points(ground)
    start, at = there.from_full(start), np.rint(here.from_full(ground.xy))
    shifts = there.from_full(warp.at(ground.xy, depths)) - start
    height, width = here.even.shape
    x = np.clip(at[:, :1] + window.dx, 0, width - 1).astype(np.intp)
    y = np.clip(at[:, 1:] + window.dy, 0, height - 1).astype(np.intp)
    # The middle of a pixel of the small picture is not the corner itself. Both pictures have shrunk alike: derivatives
    # are those of the full ones.
    off = (at - here.from_full(ground.xy))[:, :, None] + np.stack([window.dx, window.dy])
    places = start[:, :, None] + affine @ off
    return shifted_correlations(
        here.even[y, x].astype(np.float32), there.even.astype(np.float32), places[:, 0], places[:, 1], shifts,
        threads=1,
    )  # fmt: skip
