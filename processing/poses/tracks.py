"""Pairwise matches joined into tracks: the observations of one point in several images."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfrig.processing.model import F64
from lfrig.processing.poses.features import Features
from lfrig.processing.poses.matching import Matches

Pair = tuple[int, int]


@dataclass(frozen=True)
class Observations:
    """Sightings of points, sorted by point: ``point``, ``view``, ``feature`` int64 [M]; ``xy`` float64 [M, 2] px;
    ``scale`` float64 [M] px; ``disparity`` float64 [M] px per view step, NaN where no light field tells, or None where
    none tells of any. Every point is seen at least twice, and at most once per view.
    """

    point: NDArray[np.int64]
    view: NDArray[np.int64]
    feature: NDArray[np.int64]
    xy: F64
    scale: F64
    disparity: F64 | None = None

    def __len__(self) -> int:
        return len(self.point)

    @property
    def count(self) -> int:
        """Number of points."""
        return int(self.point[-1]) + 1 if len(self.point) else 0

    @property
    def starts(self) -> NDArray[np.int64]:
        """First row of every point [count]."""
        return np.searchsorted(self.point, np.arange(self.count))

    def keep(self, rows: NDArray[np.bool_]) -> tuple[Observations, NDArray[np.int64]]:
        """The kept rows of points that still have two sightings, points renumbered; and which points those are."""
        sightings = np.bincount(self.point[rows], minlength=self.count)
        rows = rows & (sightings >= 2)[self.point]
        kept, point = np.unique(self.point[rows], return_inverse=True)
        disparity = None if self.disparity is None else self.disparity[rows]
        point = point.reshape(-1).astype(np.int64)
        return (
            Observations(point, self.view[rows], self.feature[rows], self.xy[rows], self.scale[rows], disparity),
            kept,
        )


def build_tracks(features: Sequence[Features], matches: Mapping[Pair, Matches]) -> Observations:
    """Join matches transitively. A match that would put two features of one image into a track is left out.

    Pairs are joined in the order of the mapping: put the trustworthy ones (small steps) first.
    """
    offset = np.concatenate([[0], np.cumsum([len(f) for f in features])])
    parent: dict[int, int] = {}
    members: dict[int, dict[int, int]] = {}

    def root(node: int) -> int:
        while parent[node] != node:
            parent[node] = parent[parent[node]]
            node = parent[node]
        return node

    for (i, j), pairs in matches.items():
        for a, b in pairs.tolist():
            ends = []
            for view, row in ((i, a), (j, b)):
                node = int(offset[view]) + row
                if node not in parent:
                    parent[node], members[node] = node, {view: row}
                ends.append(root(node))
            keep, gone = sorted(ends)
            if keep == gone or members[keep].keys() & members[gone].keys():
                continue
            parent[gone] = keep
            members[keep].update(members.pop(gone))
    rows = [
        (point, view, row)
        for point, seen in enumerate(members[r] for r in sorted(members) if len(members[r]) > 1)
        for view, row in sorted(seen.items())
    ]
    table = np.array(rows, np.int64).reshape(-1, 3)
    xy, scale = np.zeros((len(table), 2)), np.zeros(len(table))
    for view, f in enumerate(features):
        own = table[:, 1] == view
        xy[own], scale[own] = f.xy[table[own, 2]], f.scale[table[own, 2]]
    return Observations(table[:, 0], table[:, 1], table[:, 2], xy, scale)
