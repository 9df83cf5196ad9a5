"""Which features of two images show the same point: mutual nearest neighbours whose runner-up is clearly worse."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfrig.processing.model import F32
from lfrig.processing.poses.epipolar import Indices
from lfrig.processing.poses.features import DESCRIPTOR_LENGTH, Features

Matches = NDArray[np.int64]
"""[M, 2]: rows of the first and of the second image's features."""

RATIO = 0.85
LIKELY_DISTANCE = 0.5
"""Squared distance of unit descriptors beyond which nothing is a match or a rival worth knowing."""

GUIDED_DISTANCE = 0.35
"""The same for a match inside a small gate, where there is hardly a rival for the ratio test to tell a false match by
(true ones: 90 % below 0.4; false ones: 75 % above)."""

GUIDED_LOG_SCALE = 0.6
"""Largest difference of the logarithms of keypoint scales in a guided match."""


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


class Gallery(Sequence[Features]):
    """The features of all views, and the likely pairs of any two, found once."""

    def __init__(self, features: Sequence[Features]) -> None:
        self._features = tuple(features)
        self._likely: dict[tuple[int, int], Candidates] = {}

    def __getitem__(self, index):  # type: ignore[no-untyped-def]
        """One view's features, or several views' in a tuple."""
        return self._features[index]

    def __len__(self) -> int:
        return len(self._features)

    def __iter__(self) -> Iterator[Features]:
        return iter(self._features)

    def likely(self, i: int, j: int) -> Candidates:
        """Likely pairs of views i and j."""
        if (i, j) not in self._likely:
            self._likely[i, j] = likely_pairs(self._features[i], self._features[j])
        return self._likely[i, j]

    def match(self, i: int, j: int) -> Matches:
        """Matches of views i and j that no geometry guides."""
        return match_candidates(self._features[i], self._features[j], self.likely(i, j))


def likely_pairs(first: Features, second: Features) -> Candidates:
    """All pairs whose descriptors are alike."""
    if not len(first) or not len(second):
        return Candidates(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0, np.float32))
    a, b = first.descriptor, second.descriptor
    # Every entry is an integer below 2**24: float32 holds the sums exactly, in whatever order they are formed.
    squared = a @ b.T
    squared *= -2
    squared += (a * a).sum(1)[:, None]
    squared += (b * b).sum(1)[None, :]
    rows, columns = np.nonzero(squared < LIKELY_DISTANCE * DESCRIPTOR_LENGTH**2)
    return Candidates(rows, columns, np.asarray(squared[rows, columns], np.float32))


def similar_scale(first: Features, second: Features, candidates: Candidates) -> NDArray[np.bool_]:
    """Which candidates are of about the same scale [K]."""
    ratio = np.log(first.scale)[candidates.rows] - np.log(second.scale)[candidates.columns]
    return np.asarray(np.abs(ratio) < GUIDED_LOG_SCALE, np.bool_)


def match_candidates(
    first: Features, second: Features, candidates: Candidates, limit: float = LIKELY_DISTANCE
) -> Matches:
    """Mutual nearest neighbours among candidates, closer than ``limit`` and clearly closer than the runner-up.

    Each position is used at most once per image. The runner-up must lie elsewhere: another orientation of the same
    keypoint is no rival.
    """
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
    beyond = np.float32(LIKELY_DISTANCE * DESCRIPTOR_LENGTH**2)
    rival = np.where(second.place[columns] == second.place[best[rows]], beyond, squared)
    runner_up = np.minimum.reduceat(rival, starts)
    column_best: F32 = np.full(len(second), np.inf, np.float32)
    np.minimum.at(column_best, columns, squared)
    distance = squared[chosen]
    bound = np.minimum(RATIO**2 * runner_up, limit * DESCRIPTOR_LENGTH**2)
    keep = (distance < bound) & (distance <= column_best[columns[chosen]])
    chosen = chosen[keep]
    return _one_to_one(np.c_[first.place[rows[chosen]], second.place[columns[chosen]]], distance[keep])


def _one_to_one(matches: Matches, distance: F32) -> Matches:
    """Keep the closest match of every position; order by the first image."""
    order = np.argsort(distance, kind="stable")
    matches = matches[order]
    for column in (0, 1):
        _, first = np.unique(matches[:, column], return_index=True)
        matches = matches[np.sort(first)]
    return matches[np.lexsort((matches[:, 1], matches[:, 0]))]
