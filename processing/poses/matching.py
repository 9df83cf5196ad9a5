"""Which features of two images show the same point: mutual nearest neighbours whose runner-up is clearly worse."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfrig.processing.model import F32
from lfrig.processing.poses.epipolar import Indices
from lfrig.processing.poses.features import DESCRIPTOR_LENGTH, Features

Matches = NDArray[np.int64]
"""[M, 2]: rows of the first and of the second image's features."""

RATIO = 0.85
GUIDED_DISTANCE = 0.35
"""Squared distance of unit descriptors that a guided match may have: inside a small gate there is hardly a rival for
the ratio test to tell a false match by (true ones: 90 % below 0.4; false ones: 75 % above)."""

GUIDED_LOG_SCALE = 0.6
"""Largest difference of the logarithms of keypoint scales in a guided match."""


def match_features(first: Features, second: Features) -> Matches:
    """Match all with all."""
    if not len(first) or not len(second):
        return np.zeros((0, 2), np.int64)
    squared = _squared_distances(first, second)
    rows = np.arange(len(first))
    best = squared.argmin(1)
    distance = squared[rows, best]
    mutual = squared.argmin(0)[best] == rows
    # The runner-up must lie elsewhere: another orientation of the same keypoint is no rival.
    group = np.argsort(second.place, kind="stable")
    place = second.place[group]
    twins = np.searchsorted(place, second.place[best]), np.searchsorted(place, second.place[best], side="right")
    for step in range(int((twins[1] - twins[0]).max())):
        more = twins[0] + step < twins[1]
        squared[rows[more], group[twins[0][more] + step]] = np.inf
    keep = mutual & (distance < RATIO**2 * squared.min(1))
    matches = np.c_[first.place[rows[keep]], second.place[best[keep]]]
    return _one_to_one(matches, distance[keep])


@dataclass(frozen=True)
class Candidates:
    """Pairs that may match: ``rows`` (sorted) of the first, ``columns`` of the second image's features, and the
    ``squared`` distances of their descriptors, float32, all [K].
    """

    rows: Indices
    columns: Indices
    squared: F32

    def keep(self, which: NDArray[np.bool_]) -> Candidates:
        """Some of them."""
        return Candidates(self.rows[which], self.columns[which], self.squared[which])


def candidate_pairs(first: Features, second: Features, rows: Indices, columns: Indices) -> Candidates:
    """Candidates among pairs (``rows`` sorted), those of similar scale."""
    similar = np.abs(np.log(first.scale[rows] / second.scale[columns])) < GUIDED_LOG_SCALE
    rows, columns = rows[similar], columns[similar]
    if not len(rows):
        return Candidates(rows, columns, np.zeros(0, np.float32))
    return Candidates(rows, columns, _squared_distances(first, second)[rows, columns])


def match_candidates(first: Features, second: Features, candidates: Candidates) -> Matches:
    """Match among candidates only, with a bound on the distance."""
    rows, columns, squared = candidates.rows, candidates.columns, candidates.squared
    if not len(rows):
        return np.zeros((0, 2), np.int64)
    # Best and runner-up of every row, then the best of every column.
    starts = np.flatnonzero(np.r_[True, rows[1:] != rows[:-1]])
    least = np.repeat(np.minimum.reduceat(squared, starts), np.diff(np.r_[starts, len(rows)]))
    chosen = np.flatnonzero(squared == least)
    chosen = chosen[np.unique(rows[chosen], return_index=True)[1]]
    best = np.full(len(first), -1, np.int64)
    best[rows[chosen]] = columns[chosen]
    rival = np.where(second.place[columns] == second.place[best[rows]], np.float32(np.inf), squared)
    runner_up = np.minimum.reduceat(rival, starts)
    column_best: F32 = np.full(len(second), np.inf, np.float32)
    np.minimum.at(column_best, columns, squared)
    distance = squared[chosen]
    limit = np.minimum(RATIO**2 * runner_up, GUIDED_DISTANCE * DESCRIPTOR_LENGTH**2)
    keep = (distance < limit) & (distance <= column_best[columns[chosen]])
    chosen = chosen[keep]
    return _one_to_one(np.c_[first.place[rows[chosen]], second.place[columns[chosen]]], distance[keep])


def _squared_distances(first: Features, second: Features) -> F32:
    """Between all descriptors [N1, N2]. Every entry is an integer below 2**24: float32 holds the sums exactly, in
    whatever order they are formed.
    """
    a, b = first.descriptor, second.descriptor
    squared = a @ b.T
    squared *= -2
    squared += (a * a).sum(1)[:, None]
    squared += (b * b).sum(1)[None, :]
    return np.asarray(squared, np.float32)


def _one_to_one(matches: Matches, distance: F32) -> Matches:
    """Keep the closest match of every position; order by the first image."""
    order = np.argsort(distance, kind="stable")
    matches = matches[order]
    for column in (0, 1):
        _, first = np.unique(matches[:, column], return_index=True)
        matches = matches[np.sort(first)]
    return matches[np.lexsort((matches[:, 1], matches[:, 0]))]
