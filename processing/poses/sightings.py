"""Every light field's corners in every other view: what matching by depth yields, as sightings for the adjustment."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from lfrig.contracts.progress import Monitor
from lfrig.processing.geometry import rotation_angle_deg
from lfrig.processing.kernels.patches import with_slopes
from lfrig.processing.model import F32, F64, U8, Evidence, LightField, Photo, Pose
from lfrig.processing.poses.arrangement import Arrangement
from lfrig.processing.poses.corners import grey_of, light_field_corners
from lfrig.processing.poses.patches import normalised
from lfrig.processing.poses.structure import FINE_SCALE_PX
from lfrig.processing.poses.tracks import Observations, Pair
from lfrig.processing.poses.warp_lk import Picture, Relief, Station, Warp, follow

SMOOTH_SIGMA_PX = 1.5
UNLIKENESS = 0.03
"""1 − ρ up to which an aligned patch counts as a good one."""


@dataclass(frozen=True)
class Looks:
    """What matching needs of every view: ``pictures`` of all, the photo's last, and ``reliefs`` of the sources."""

    pictures: tuple[Picture, ...]
    reliefs: tuple[Relief, ...]


def look_at(sources: Sequence[LightField], evidence: Sequence[Evidence], target: Photo, monitor: Monitor) -> Looks:
    """Prepare all pictures, corners and disparities."""
    pictures, reliefs = [], []
    for source, seen in zip(sources, evidence, strict=True):
        pictures.append(_picture(source.centre_view))
        reliefs.append(Relief(light_field_corners(source, seen), smoothed(seen.disparity)))
        monitor.advance()
    return Looks((*pictures, _picture(target.image8)), tuple(reliefs))


def _picture(image: U8) -> Picture:
    grey = grey_of(image)
    return Picture(with_slopes(grey), normalised(grey))


def smoothed(disparity: F32) -> F32:
    """The depth map as a surface to warp by: without specks, float32 [H, W]."""
    import cv2

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
    """Sightings, and for every (light field, other view) how many corners were found there, of how many expected."""

    seen: Observations
    found: dict[Pair, int]
    tried: dict[Pair, int]

    def fraction(self, pair: Pair) -> float:
        """Share of the corners found."""
        return self.found.get(pair, 0) / max(self.tried.get(pair, 0), 1)

    def fractions(self) -> dict[Pair, float]:
        """All of them."""
        return {pair: self.fraction(pair) for pair in self.found}

    @property
    def total(self) -> int:
        """Corners found in all views together."""
        return sum(self.found.values())


def follow_all(
    looks: Looks,
    arrangement: Arrangement,
    x: F64,
    pairs: Sequence[Pair],
    depth_range_m: tuple[float, float],
    *,
    flow: Collection[Pair] = (),
    limit: int | None = None,
) -> Followed:
    """Follow the corners of the first view of each (directed) pair into the second; with ``flow`` where the prediction
    may be poor. ``limit`` takes the strongest corners only.
    """
    cameras, poses, lines = arrangement.cameras(x), arrangement.poses(x), arrangement.lines(x)
    stations = [Station(c, p) for c, p in zip(cameras, poses, strict=True)]
    limits = 1 / depth_range_m[1], 1 / depth_range_m[0]
    tables, found, tried = [], {}, {}
    for j, relief in enumerate(looks.reliefs):
        line = lines[j]
        others = [i for k, i in pairs if k == j]
        if line is None or not others:
            continue
        if limit is not None:
            relief = relief.first(limit)
        places = np.full((len(relief.corners), len(poses), 2), np.nan)
        places[:, j] = relief.corners.xy
        likeness = np.ones(places.shape[:2])
        for i in others:
            warp = Warp(relief, line.scale(cameras[j]), stations[j], stations[i], limits)
            sighted = follow(warp, looks.pictures[j], looks.pictures[i], flow=(j, i) in flow)
            places[:, i], likeness[:, i] = sighted.xy, sighted.likeness
            found[j, i], tried[j, i] = sighted.count, sighted.expected
        tables.append((j, places, coarseness_of(likeness), relief.corners.disparity))
    return Followed(_observations(tables), found, tried)


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
