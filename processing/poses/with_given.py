"""Given poses: the light fields' corners confirm them and become anchors; nothing has to be recognised for that."""

from __future__ import annotations

import numpy as np

from lfrig.contracts.progress import Monitor
from lfrig.processing.poses import gate
from lfrig.processing.poses.light_fields import optics_sigma, recorded_line, with_lines
from lfrig.processing.poses.line_search import search_lines
from lfrig.processing.poses.place_photo import with_located_photo
from lfrig.processing.poses.priors import centred_arrangement, photo_prior, with_photo
from lfrig.processing.poses.structure import Structure
from lfrig.processing.poses.task import Solved, Task, bare, finished, placed
from lfrig.processing.poses.with_prior import moved_back, solve_with_prior

GIVEN_NOISE_PX = 0.25
"""Corners that agree to this are where given poses put them, also where shiny or repeating texture blurs their places
(0.04 to 0.12 px at true poses); poses that are off by a hundredth of a degree show as much."""

MIN_KEPT = 0.7
"""Of the corners found in a view, those that fit: 0.88 to 0.99 at right poses, below 0.4 where one is off by 2° or more
(what a light field's depth predicts is found there, but not where the others see it)."""


def solve_given(task: Task, monitor: Monitor) -> Structure:
    """Structure of the sources and, as its last view, the photo, at given poses (free within their sigmas).

    Where the corners do not confirm every view, or the optics that tell their depths are not recorded, features have to
    be matched, and say what is wrong.
    """
    solved = _by_corners(task, monitor)
    if solved is not None and solved.structure.noise_px < GIVEN_NOISE_PX and least_kept(solved) >= MIN_KEPT:
        task.work.keep_solution(task.sources, solved.structure, solved.followed.by_pair)
        return solved.structure
    return solve_with_prior(
        "given", task.sources, task.evidence, task.features(range(len(task.sources))), task.target, task.prior, monitor
    )


def least_kept(solved: Solved) -> float:
    """Of what was found in a view, the share that the solution rests on; of the worst view."""
    views = len(solved.structure.arrangement.views)
    kept, found = (np.bincount(seen.view, minlength=views) for seen in (solved.structure.seen, solved.followed.seen))
    return float((kept / np.maximum(found, 1)).min())


def _by_corners(task: Task, monitor: Monitor) -> Solved | None:
    """Corners aligned where poses and depths put them; None when the gate is not passed."""
    lines = [recorded_line(s, len(task.sources)) for s in task.sources]
    if any(line is None for line in lines):
        return None
    centred, origin = centred_arrangement(task.sources)
    arrangement = with_lines(centred, lines)
    gate.refuse_identical_poses(bare(arrangement).poses, task.names, task.depth_range_m[0])
    known = photo_prior(task.target, task.prior, origin)
    whole = arrangement if known is None else with_photo(arrangement, task.target, known)
    x, placed_views = task.work.start(whole, task.sources)
    sigmas = [optics_sigma(s) for s in task.sources]
    start = bare(whole, search_lines(task.looks, whole, x, sigmas, task.rough_range_m, placed_views))
    if known is not None:
        solved = finished(task, start, None)
    else:
        alone = placed(task, start, None)
        solved = None if alone is None else with_located_photo(task, alone, None, None, monitor)
    if solved is None:
        return None
    return Solved(moved_back(solved.structure, origin), solved.followed)
