"""Anchors: the solved points that each source's scale is fitted to, the doubtful ones left out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.errors import GeometryRefused
from lfrig.processing.model import F64, Anchors, Evidence, LightField
from lfrig.processing.poses.structure import Structure, coarseness
from lfrig.processing.poses.triangulate import ray_angle_deg, reproject
from lfrig.processing.scale_fit import fit_affine

MAX_DEPTH_SIGMA = 0.01
"""Points whose depth is expected to be worse than this (relative) carry no scale."""

MIN_CONFIDENCE = 0.5
DISAGREE_SIGMAS = 6.0
DISAGREE_PX = 0.12
MIN_JUDGES = 30


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
        wrong = contradicted(seen.xy[rows], depth[rows], evidence[v])
        good[seen.point[rows[wrong]]] = False
    anchors = []
    for v in range(sources):
        rows = np.flatnonzero((seen.view == v) & good[seen.point])
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


def contradicted(xy: F64, depth_m: F64, evidence: Evidence) -> NDArray[np.bool_]:
    """Which points [N] lie where a confident disparity says otherwise, by a robust line through all of them.

    The pixel and its eight neighbours are asked, and one that agrees is enough: keypoints sit on edges. Fewer than
    `MIN_JUDGES` confident points judge nobody.
    """
    height, width = evidence.disparity.shape
    x = np.clip(np.rint(xy[:, 0]).astype(np.int64), 1, width - 2)
    y = np.clip(np.rint(xy[:, 1]).astype(np.int64), 1, height - 2)
    sure = (evidence.confidence[y, x] > MIN_CONFIDENCE) & np.isfinite(evidence.disparity[y, x])
    nothing = np.zeros(len(xy), bool)
    if sure.sum() < MIN_JUDGES:
        return nothing
    inverse = 1 / depth_m
    try:
        line = fit_affine(evidence.disparity[y, x][sure].astype(np.float64), inverse[sure])
    except GeometryRefused:
        return nothing
    if line.a <= 0:
        return nothing
    limit = max(DISAGREE_SIGMAS * line.residual, DISAGREE_PX * line.a)
    around = np.stack([evidence.disparity[y + dy, x + dx] for dy in (-1, 0, 1) for dx in (-1, 0, 1)])
    apart = np.abs(line.a * around.astype(np.float64) + line.c - inverse)
    return np.asarray(sure & ~(np.nan_to_num(apart, nan=np.inf).min(0) < limit), np.bool_)


def metric_scale(
    anchors: Sequence[Anchors], sources: Sequence[LightField], evidence: Sequence[Evidence]
) -> float | None:
    """Metres per gauge unit, from the slopes of the sources whose baseline is recorded; None when none tells.

    ``1/z = a δ + c`` with a = 1/(bF) in metres; the median of the sources' ratios.
    """
    ratios = []
    for own, source, seen in zip(anchors, sources, evidence, strict=True):
        if source.optics.baseline_m is None or source.camera is None or len(own) < MIN_JUDGES:
            continue
        height, width = seen.disparity.shape
        x = np.clip(np.rint(own.xy[:, 0]).astype(np.int64), 0, width - 1)
        y = np.clip(np.rint(own.xy[:, 1]).astype(np.int64), 0, height - 1)
        sure = (seen.confidence[y, x] > MIN_CONFIDENCE) & np.isfinite(seen.disparity[y, x])
        if sure.sum() < MIN_JUDGES:
            continue
        line = fit_affine(seen.disparity[y, x][sure].astype(np.float64), 1 / own.depth_m[sure])
        if line.a > 0:
            ratios.append(line.a * source.optics.baseline_m * source.camera.focal_px)
    return float(np.median(ratios)) if ratios else None
