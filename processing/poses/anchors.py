"""Anchors: the solved points that each source's scale is fitted to, the doubtful ones left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfrig.processing.model import F64, Anchors, Camera, Evidence, LightField
from lfrig.processing.poses.guide import inverse_depth_interval, scale_line
from lfrig.processing.poses.structure import Structure, coarseness
from lfrig.processing.poses.triangulate import ray_angle_deg, reproject

MAX_DEPTH_SIGMA = 0.01
"""Points whose depth is expected to be worse than this (relative) carry no scale."""

ENOUGH_CONFIRMED = 300
"""With so many points that a third view confirms, the others are not needed: nearly every false match (5 % of those
seen twice, 30 % on texture that repeats) is seen only twice.
"""


SCALE_SIGMAS = 5.0
LINE_SIGMA = 0.03
"""Relative error of a line fitted to a light field's disparities (its pixels share their systematic errors)."""


def collect_anchors(structure: Structure, sources: int, evidence: Sequence[Evidence]) -> tuple[Anchors, ...]:
    """Anchors of the first ``sources`` views.

    A point that the light field of any source contradicts is nobody's anchor: a wrong match along the epipolar line
    (repeating texture) is invisible to reprojection, but not to a source's own disparity.
    """
    seen = structure.seen
    _, depth = reproject(structure.cameras, structure.poses, seen, structure.points)
    good = _depth_sigma(structure) < MAX_DEPTH_SIGMA
    for v in range(sources):
        rows = np.flatnonzero((seen.view == v) & good[seen.point])
        # What light fields took part in has hardly a wrong point left.
        wrong = contradicted(seen.xy[rows], depth[rows], evidence[v], quick=seen.disparity is not None)
        good[seen.point[rows[wrong]]] = False
    sightings = np.bincount(seen.point, minlength=seen.count)
    anchors = []
    for v in range(sources):
        rows = np.flatnonzero((seen.view == v) & good[seen.point])
        confirmed = rows[sightings[seen.point[rows]] >= 3]
        # Where light fields took part they have confirmed every point.
        if seen.disparity is None and len(confirmed) >= ENOUGH_CONFIRMED:
            rows = confirmed
        anchors.append(Anchors(seen.xy[rows], depth[rows], structure.points[seen.point[rows]]))
    return tuple(anchors)


def _depth_sigma(structure: Structure) -> F64:
    """Expected relative error of each point's depth, from its widest pair of rays [count]."""
    seen = structure.seen
    angle = np.deg2rad(ray_angle_deg(structure.poses, seen, structure.points))
    focal = np.array([c.focal_px for c in structure.cameras])[seen.view]
    coarse = np.zeros(seen.count)
    np.maximum.at(coarse, seen.point, coarseness(seen) / focal)
    return np.asarray(np.sqrt(2) * structure.noise_px * coarse / np.maximum(np.tan(angle), 1e-9), np.float64)


def contradicted(xy: F64, depth: F64, evidence: Evidence, *, quick: bool = False) -> NDArray[np.bool_]:
    """Which points [N] lie where a confident disparity says otherwise, by a robust line through all of them."""
    line = scale_line(xy, depth, evidence, quick=quick)
    if line is None:
        return np.zeros(len(xy), bool)
    low, high = inverse_depth_interval(xy, evidence, line)
    return np.asarray((1 / depth < low) | (1 / depth > high), np.bool_)


@dataclass(frozen=True)
class ScaleEstimate:
    """Metres per gauge unit by one recorded length of a source (``of`` names it), and its relative sigma."""

    source: int
    of: str
    metres: float
    sigma: float


def scale_estimates(
    anchors: Sequence[Anchors], cameras: Sequence[Camera], sources: Sequence[LightField], evidence: Sequence[Evidence]
) -> list[ScaleEstimate]:
    """What every recorded baseline and focus distance says of the scale.

    ``1/z = a δ + c`` with a = 1/(bF) and c = 1/z_f in metres; ``cameras`` are the solved ones.
    """
    found = []
    for v, (own, source, seen) in enumerate(zip(anchors, sources, evidence, strict=True)):
        line = scale_line(own.xy, own.depth_m, seen)
        if line is None:
            continue
        baseline, focus = source.optics.baseline_m, source.optics.focus_distance_m
        sigma = float(np.hypot(source.optics.sigma_baseline, LINE_SIGMA))
        if baseline is not None and source.camera is not None:
            found.append(ScaleEstimate(v, "baseline", line.a * baseline * cameras[v].focal_px, sigma))
        if focus is not None and line.c > 0:
            found.append(ScaleEstimate(v, "focus distance", line.c * focus, sigma))
    return found


def common_scale(estimates: Sequence[ScaleEstimate]) -> float:
    """The median of the estimates."""
    return float(np.median([e.metres for e in estimates]))


def furthest_estimate(estimates: Sequence[ScaleEstimate]) -> ScaleEstimate | None:
    """The one that is furthest beyond `SCALE_SIGMAS` of the median; None when all agree."""
    scale = common_scale(estimates)
    excess = [abs(np.log(e.metres / scale)) / e.sigma for e in estimates]
    worst = int(np.argmax(excess))
    return estimates[worst] if excess[worst] > SCALE_SIGMAS else None
