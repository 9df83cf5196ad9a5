"""Every light field's corners in every other view: what matching by depth yields, as sightings for the adjustment."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType

import numpy as np

from lfrig.contracts.progress import Monitor
from lfrig.processing.geometry import rotation_angle_deg
from lfrig.processing.model import F32, F64, Evidence, LightField, Photo, Pose
from lfrig.processing.poses.arrangement import Arrangement
from lfrig.processing.poses.corners import light_field_corners
from lfrig.processing.poses.picture import Picture, picture_of
from lfrig.processing.poses.structure import FINE_SCALE_PX
from lfrig.processing.poses.tracks import Observations, Pair
from lfrig.processing.poses.warp_lk import Relief, Sighted, Station, Warp, follow
from lfrig.processing.poses.work import PoseWork

SMOOTH_SIGMA_PX = 1.5
UNLIKENESS = 0.03
"""1 − ρ up to which an aligned patch counts as a good one."""


@dataclass(frozen=True)
class Looks:
    """What matching needs of every view: ``pictures`` of all, the photo's last, and ``reliefs`` of the sources."""

    pictures: tuple[Picture, ...]
    reliefs: tuple[Relief, ...]


def look_at(
    sources: Sequence[LightField], evidence: Sequence[Evidence], target: Photo, work: PoseWork, monitor: Monitor
) -> Looks:
    """Prepare all pictures, corners and disparities; what ``work`` knows of a capture is not made again."""
    pictures, reliefs = [], []
    for source, seen in zip(sources, evidence, strict=True):
        picture = work.once("picture", (source.views,), partial(picture_of, source.centre_view))
        pictures.append(picture)
        reliefs.append(work.once("relief", (source.views, seen), partial(relief_of, source, seen, picture)))
        monitor.advance()
    pictures.append(work.once("picture", (target.image,), partial(picture_of, target.image8)))
    return Looks(tuple(pictures), tuple(reliefs))


def relief_of(source: LightField, evidence: Evidence, picture: Picture) -> Relief:
    """Corners and surface of one light field; ``picture`` is its centre view."""
    return Relief(light_field_corners(source, evidence, picture=picture), smoothed(evidence.disparity))


def smoothed(disparity: F32) -> F32:
    """The depth map as a surface to warp by: without specks, float32 [H, W]."""
    import cv2

    filled = disparity
    if not np.isfinite(disparity).all():
        filled = np.where(np.isfinite(disparity), disparity, np.nanmedian(disparity)).astype(np.float32)
    return np.asarray(cv2.GaussianBlur(cv2.medianBlur(filled, 5), (0, 0), SMOOTH_SIGMA_PX))


def directed_pairs(poses: Sequence[Pose], sources: int, limit_deg: float) -> list[Pair]:
    """(light field, other view) up to an angle apart."""
    return [
        (j, i)
        for j in range(sources)
        for i in range(len(poses))
        if i != j and rotation_angle_deg(poses[i].rotation, poses[j].rotation) <= limit_deg
    ]


@dataclass(frozen=True)
class Followed:
    """Sightings, and what they were made from: where the corners of each (light field, other view) were found."""

    seen: Observations
    by_pair: dict[Pair, Sighted]

    def fraction(self, pair: Pair) -> float:
        """Share of the corners found."""
        sighted = self.by_pair.get(pair)
        return 0.0 if sighted is None else sighted.fraction

    def fractions(self) -> dict[Pair, float]:
        """All of them."""
        return {pair: self.fraction(pair) for pair in self.by_pair}

    @property
    def total(self) -> int:
        """Corners found in all views together."""
        return sum(sighted.count for sighted in self.by_pair.values())


def follow_all(
    looks: Looks,
    arrangement: Arrangement,
    x: F64,
    pairs: Sequence[Pair],
    depth_range_m: tuple[float, float],
    *,
    flow: Collection[Pair] = (),
    limit: int | None = None,
    known: Mapping[Pair, Sighted] = MappingProxyType({}),
) -> Followed:
    """Follow the corners of the first view of each (directed) pair into the second; with ``flow`` where the prediction
    may be poor. ``limit`` takes the strongest corners only; what is ``known`` of a pair is kept where it still holds.
    """
    reliefs = looks.reliefs if limit is None else [relief.first(limit) for relief in looks.reliefs]
    warps = warps_of(reliefs, arrangement, x, pairs, depth_range_m)
    tables, by_pair = [], {}
    for j, relief in enumerate(reliefs):
        others = [i for k, i in warps if k == j]
        if not others:
            continue
        places = np.full((len(relief.corners), len(arrangement.views), 2), np.nan)
        places[:, j] = relief.corners.xy
        likeness = np.ones(places.shape[:2])
        for i in others:
            pair = j, i
            sighted = follow(
                warps[pair], looks.pictures[j], looks.pictures[i], flow=pair in flow, before=known.get(pair)
            )
            places[:, i], likeness[:, i] = sighted.xy, sighted.likeness
            by_pair[pair] = sighted
        tables.append((j, places, coarseness_of(likeness), relief.corners.disparity))
    return Followed(_observations(tables), by_pair)


def warps_of(
    reliefs: Sequence[Relief],
    arrangement: Arrangement,
    x: F64,
    pairs: Sequence[Pair],
    depth_range_m: tuple[float, float],
) -> dict[Pair, Warp]:
    """From light fields that have a line into other views, by (directed) pair."""
    cameras, poses, lines = arrangement.cameras(x), arrangement.poses(x), arrangement.lines(x)
    stations = [Station(c, p) for c, p in zip(cameras, poses, strict=True)]
    limits = 1 / depth_range_m[1], 1 / depth_range_m[0]
    return {
        (j, i): Warp(reliefs[j], line.scale(cameras[j]), stations[j], stations[i], limits)
        for j, i in pairs
        if (line := lines[j]) is not None
    }


def coarseness_of(likeness: F64) -> F64:
    """Position error of an aligned patch relative to that of a good one: what the patches differ by moves their best
    fit in proportion. A residual of standardised patches is √(2 (1 − ρ)).
    """
    return np.sqrt(np.maximum(1 - likeness, UNLIKENESS) / UNLIKENESS)


def _observations(tables: Sequence[tuple[int, F64, F64, F64]]) -> Observations:
    """Sightings of corners that were found anywhere, by view: places [N, V, 2] (NaN = not), their coarseness [N, V],
    and disparities [N].
    """
    parts, first = [], 0
    for own, places, coarse, disparity in tables:
        seen = np.isfinite(places[:, :, 0])
        rows = np.flatnonzero(seen.sum(1) > 1)
        row, view = np.nonzero(seen[rows])
        told = np.where(view == own, disparity[rows[row]], np.nan)
        feature = np.where(view == own, rows[row], -1)
        scale = FINE_SCALE_PX * coarse[rows[row], view]
        parts.append((first + row, view, feature, places[rows[row], view], scale, told))
        first += len(rows)
    if not parts:
        none = np.zeros(0, np.int64)
        return Observations(none, none, none, np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    return Observations(*(np.concatenate(p) for p in zip(*parts, strict=True)))
