"""What each light field's own disparity says of the depth of a keypoint: where to look for it in the other views.

A match may be anywhere along its epipolar line; the light field knows to a few percent where. On a texture that
repeats this is what tells one period from the next.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.errors import GeometryRefused
from lfrig.processing.model import F32, F64, Camera, Evidence, LightField, Pose, ScaleFit
from lfrig.processing.poses.epipolar import Indices, Segments, epipolar_segments
from lfrig.processing.poses.features import DESCRIPTOR_LENGTH, Features
from lfrig.processing.poses.matching import (
    GUIDED_DISTANCE,
    Candidates,
    Gallery,
    Matches,
    match_candidates,
    similar_scale,
)
from lfrig.processing.poses.priors import known_camera
from lfrig.processing.poses.tracks import Pair
from lfrig.processing.poses.triangulate import reproject
from lfrig.processing.scale_fit import fit_affine

if TYPE_CHECKING:
    from lfrig.processing.poses.structure import Structure

MIN_CONFIDENCE = 0.5
MIN_JUDGES, ENOUGH_JUDGES = 30, 200
"""Points that a line through disparities and depths needs; what a quick one takes at least."""

QUICK_ITERATIONS = 8

MIN_INLIERS = 0.5
TOLERANCE_SIGMAS = 3.0
TOLERANCE_PX = 0.04
"""Half-width [px of disparity] of what counts as agreement, beyond the fit's own scatter."""

OPTICS_TOLERANCE = 0.1
"""A line from recorded optics is off by this fraction of an inverse depth at most (three sigmas of each part)."""

OPTICS_MISMATCH = 0.2
"""A fitted line further than this from the recorded optics was fitted to false matches."""


MIN_REACH_PX = 6
VOTE_SCALE = 0.1
VOTE_BLUR = 0.05
VOTE_SIGNIFICANCE = 6.0
VOTED_BAND = 0.25
"""Votes: scale of descriptor distances; blur and width left to search, as fractions of the reach; standard deviations
by which the winner must stand out.
"""


@dataclass(frozen=True)
class Judged:
    """Disparities around keypoints: lowest and highest of the pixel and its eight neighbours (keypoints sit on
    edges), the pixel's own, float64 [N] each, and whether it is confident.
    """

    low: F64
    high: F64
    own: F64
    sure: NDArray[np.bool_]


def disparity_around(xy: F64, evidence: Evidence) -> Judged:
    """Read the evidence at pixels [N, 2]."""
    height, width = evidence.disparity.shape
    x = np.clip(np.rint(xy[:, 0]).astype(np.int64), 1, width - 2)
    y = np.clip(np.rint(xy[:, 1]).astype(np.int64), 1, height - 2)
    around = np.stack([evidence.disparity[y + dy, x + dx] for dy in (-1, 0, 1) for dx in (-1, 0, 1)])
    around = around.astype(np.float64)
    sure = (evidence.confidence[y, x] > MIN_CONFIDENCE) & np.isfinite(around).all(0)
    around = np.where(sure, around, 0.0)
    return Judged(around.min(0), around.max(0), around[4], np.asarray(sure, np.bool_))


def scale_line(xy: F64, depth: F64, evidence: Evidence, *, quick: bool = False) -> ScaleFit | None:
    """Robust line ``1/z = a δ + c`` through solved points seen at ``xy``; None when they do not carry one.

    ``quick`` fits it to some of the points in few iterations: good enough where hardly a point is wrong.
    """
    judged = disparity_around(xy, evidence)
    if judged.sure.sum() < MIN_JUDGES:
        return None
    rows, iterations = np.flatnonzero(judged.sure), 50
    if quick:
        rows, iterations = rows[:: max(1, len(rows) // ENOUGH_JUDGES)], QUICK_ITERATIONS
    try:
        line = fit_affine(judged.own[rows], 1 / depth[rows], iterations=iterations)
    except GeometryRefused:
        return None
    return line if line.a > 0 and line.inliers >= MIN_INLIERS else None


def inverse_depth_interval(xy: F64, evidence: Evidence, line: ScaleFit) -> tuple[F64, F64]:
    """Lowest and highest inverse depth [N] that a light field admits at keypoints; ∓∞ where it is not confident."""
    judged = disparity_around(xy, evidence)
    slack = max(TOLERANCE_SIGMAS * line.residual, TOLERANCE_PX * line.a)
    low = np.where(judged.sure, line.a * judged.low + line.c - slack, -np.inf)
    return low, np.where(judged.sure, line.a * judged.high + line.c + slack, np.inf)


@dataclass(frozen=True)
class Guide:
    """The light fields as guides. The first views are theirs; further views (the photo) have nothing to say.

    ``metric`` tells whether the structure's lengths are metres, so that recorded optics can stand in for a fit.
    """

    sources: Sequence[LightField]
    evidence: Sequence[Evidence]
    depth_range: tuple[float, float]
    metric: bool

    def informed(self, view: int) -> bool:
        """Whether a view is a light field."""
        return view < len(self.sources)

    def recorded_line(self, view: int) -> ScaleFit | None:
        """Scale of a light field by its recorded optics, with a wide tolerance; None when unknown."""
        source = self.sources[view]
        baseline, focus = source.optics.baseline_m, source.optics.focus_distance_m
        if not self.metric or baseline is None or focus is None:
            return None
        slope, offset = 1 / (baseline * known_camera(source).focal_px), 1 / focus
        return ScaleFit(slope, offset, OPTICS_TOLERANCE * offset / TOLERANCE_SIGMAS, form="optics")

    def fitted_line(self, structure: Structure, view: int) -> ScaleFit | None:
        """Scale of a light field in the structure's lengths: fitted to its points, else recorded."""
        own = structure.seen.view == view
        _, depth = reproject(structure.cameras, structure.poses, structure.seen, structure.points)
        fitted = scale_line(structure.seen.xy[own], depth[own], self.evidence[view]) if own.any() else None
        recorded = self.recorded_line(view)
        if recorded is None or fitted is None:
            return fitted or recorded
        pairs = ((fitted.a, recorded.a), (fitted.c, recorded.c))
        return fitted if all(abs(f / r - 1) < OPTICS_MISMATCH for f, r in pairs) else recorded

    def intervals(self, features: Sequence[Features], structure: Structure | None = None) -> list[tuple[F64, F64]]:
        """Lowest and highest inverse depth [N] of every view's features: by a structure's fits, or before there is
        one by the recorded optics.
        """
        lowest, highest = 1 / self.depth_range[1], 1 / self.depth_range[0]
        out = []
        for view, f in enumerate(features):
            line = None
            if self.informed(view):
                line = self.recorded_line(view) if structure is None else self.fitted_line(structure, view)
            if line is None:
                out.append((np.full(len(f), lowest), np.full(len(f), highest)))
                continue
            low, high = inverse_depth_interval(f.xy, self.evidence[view], line)
            out.append((np.clip(low, lowest, highest), np.clip(high, lowest, highest)))
        return out

    def matches(
        self,
        cameras: Sequence[Camera],
        poses: Sequence[Pose],
        features: Gallery,
        intervals: Sequence[tuple[F64, F64]],
        bands_px: Mapping[Pair, float],
        *,
        vote: bool = False,
    ) -> dict[Pair, Matches]:
        """Matches of the pairs where the geometry, give or take a band, and the light fields say to look.

        With ``vote`` the band is first narrowed around the shift that most candidates agree on (`common_shift`).
        """
        found = {}
        for (i, j), band in bands_px.items():
            a, b = features[i], features[j]
            there = epipolar_segments(a.xy, (cameras[i], cameras[j]), (poses[i], poses[j]), intervals[i])
            candidates = features.likely(i, j)
            candidates = candidates.keep(there.contains(candidates.rows, b.xy[candidates.columns], band))
            candidates = candidates.keep(similar_scale(a, b, candidates))
            if vote and self.informed(i):
                candidates = _voted(candidates, there, b.xy, candidates.rows, candidates.columns, band)
            if self.informed(j):
                back = epipolar_segments(b.xy, (cameras[j], cameras[i]), (poses[j], poses[i]), intervals[j])
                candidates = candidates.keep(back.contains(candidates.columns, a.xy[candidates.rows], band))
                if vote:
                    candidates = _voted(candidates, back, a.xy, candidates.columns, candidates.rows, band)
            found[i, j] = match_candidates(a, b, candidates, GUIDED_DISTANCE)
        return found


def _voted(
    candidates: Candidates, segments: Segments, xy: F64, rows: Indices, columns: Indices, band_px: float
) -> Candidates:
    """The candidates near the common shift, where there is one that stands out."""
    shift = common_shift(segments.offsets(rows, xy[columns]), rows, candidates.squared, band_px)
    if shift is None:
        return candidates
    window = max(VOTED_BAND * band_px, MIN_REACH_PX / 2)
    return candidates.keep(segments.shifted(shift).contains(rows, xy[columns], window))


def common_shift(offsets: F64, rows: Indices, squared: F32, reach_px: float) -> F64 | None:
    """Shift [2] px that candidate matches have in common, relative to where their depth and the prior expect them.

    What is wrong with the poses of a prior moves a whole image by about the same amount. Every feature has one vote,
    spread over its candidates by the likeness of their descriptors: false candidates scatter, true ones pile up,
    even on texture that repeats, where its borders and flaws break the tie. None when no pile stands out.

    Parameters
    ----------
    offsets : float64 [K, 2]
        Of candidates from their expected positions, px; those beyond ``reach_px`` do not vote.
    rows : int64 [K]
        The feature that each belongs to.
    squared : float32 [K]
        Squared distances of descriptors.
    """
    import cv2

    reach = int(np.ceil(reach_px))
    near = (np.abs(offsets) <= reach).all(1)
    if near.sum() < MIN_JUDGES or reach < MIN_REACH_PX:
        return None
    cell, rows = np.rint(offsets[near]).astype(np.int64) + reach, rows[near]
    likeness = np.exp(-squared[near].astype(np.float64) / (VOTE_SCALE * DESCRIPTOR_LENGTH**2))
    vote = likeness / np.maximum(np.bincount(rows, likeness)[rows], 1e-12)
    size = 2 * reach + 1
    votes = np.bincount(cell[:, 1] * size + cell[:, 0], vote, minlength=size * size).reshape(size, size)
    votes = cv2.GaussianBlur(votes, (0, 0), max(1.0, VOTE_BLUR * reach), borderType=cv2.BORDER_CONSTANT)
    peak = np.unravel_index(int(votes.argmax()), votes.shape)
    if votes[peak] < VOTE_SIGNIFICANCE * votes.std() + votes.mean():
        return None
    return np.array([peak[1] - reach, peak[0] - reach], np.float64)
