"""What the light-field way is asked to solve, and what it calls solved."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from lfrig.processing.model import Evidence, LightField, Photo, RigPrior
from lfrig.processing.poses import gate
from lfrig.processing.poses.arrangement import Arrangement
from lfrig.processing.poses.light_fields import Aligned, Effort, Known, second_pass, settle
from lfrig.processing.poses.matching import Gallery
from lfrig.processing.poses.priors import depth_limits
from lfrig.processing.poses.sightings import Followed, Looks
from lfrig.processing.poses.structure import Structure
from lfrig.processing.poses.tracks import Observations
from lfrig.processing.poses.work import PoseWork

SURE_NOISE_PX = 0.1
"""Aligned patches of a right geometry agree to 0.04–0.08 px; above this another start is tried as well."""


FindFeatures = Callable[[Sequence[int]], Gallery]
"""SIFT features of all views, the photo's last, for the sources asked for; the others have none."""


@dataclass(frozen=True)
class Solved:
    """A solution, and the matches that it rests on."""

    structure: Structure
    followed: Followed


@dataclass(frozen=True)
class Task:
    """What is to be solved. ``features`` finds the SIFT features of sources and photo when needed, ``quick_features``
    those of the pictures at half size; ``work`` knows what earlier solves found.
    """

    sources: Sequence[LightField]
    evidence: Sequence[Evidence]
    target: Photo
    prior: RigPrior
    looks: Looks
    features: FindFeatures
    quick_features: FindFeatures
    effort: Effort
    work: PoseWork = field(default_factory=PoseWork)

    @property
    def depth_range_m(self) -> tuple[float, float]:
        """Depths that points may have."""
        return depth_limits(self.sources, self.prior)

    @property
    def rough_range_m(self) -> tuple[float, float]:
        """The same with room for rough poses."""
        near, far = self.depth_range_m
        return near / 1.5, far * 1.5

    @property
    def names(self) -> list[str]:
        """Of the sources."""
        return [s.id for s in self.sources]


def bare(arrangement: Arrangement, x: np.ndarray | None = None) -> Structure:
    """The priors as they are (or other parameters), without a point."""
    none, size = np.zeros(0, np.int64), arrangement.size
    seen = Observations(none, none, none, np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    return Structure(
        arrangement, np.zeros(size) if x is None else x, seen, np.zeros((0, 3)), 1.0, np.zeros((size, size))
    )


def finished(task: Task, rough: Structure | None, sigma_deg: float | None, known: Known | None = None) -> Solved | None:
    """The second pass, when the gate is passed; ``sigma_deg`` as `gate.doubts` takes it."""
    return _passed(task, rough, sigma_deg, known, second_pass)


def placed(task: Task, rough: Structure | None, sigma_deg: float | None) -> Solved | None:
    """Views placed well enough for the photo to join them, when the gate is passed."""
    return _passed(task, rough, sigma_deg, None, settle)


def _passed(
    task: Task,
    rough: Structure | None,
    sigma_deg: float | None,
    known: Known | None,
    solve: Callable[[Looks, Structure, tuple[float, float], Effort, Known], Aligned],
) -> Solved | None:
    if rough is None:
        return None
    followed = task.work.followed(task.sources) if known is None else known
    found = solve(task.looks, rough, task.depth_range_m, task.effort, followed)
    doubted = gate.doubts(found.structure, found.followed.fractions(), sigma_deg, found.part)
    return None if doubted else Solved(found.structure, found.followed)
