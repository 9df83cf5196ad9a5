"""Given poses: the light fields' corners confirm them and become anchors; nothing has to be recognised for that."""

from __future__ import annotations

from lfrig.contracts.progress import Monitor
from lfrig.processing.poses import gate
from lfrig.processing.poses.light_fields import recorded_line, with_lines
from lfrig.processing.poses.place_photo import with_located_photo
from lfrig.processing.poses.priors import centred_arrangement, photo_prior, with_photo
from lfrig.processing.poses.structure import Structure
from lfrig.processing.poses.task import Solved, Task, bare, finished, placed
from lfrig.processing.poses.with_prior import moved_back, solve_with_prior

GIVEN_NOISE_PX = 0.25
"""Corners that agree to this are where given poses put them, also where shiny or repeating texture blurs their places
(0.04 to 0.12 px at true poses); poses that are off by a hundredth of a degree show as much."""


def solve_given(task: Task, monitor: Monitor) -> Structure:
    """Structure of the sources and, as its last view, the photo, at given poses (free within their sigmas).

    Where the corners do not confirm every view, or the optics that tell their depths are not recorded, features have to
    be matched, and say what is wrong.
    """
    solved = _by_corners(task, monitor)
    if solved is not None and solved.structure.noise_px < GIVEN_NOISE_PX:
        task.work.keep_solution(task.sources, solved.structure, solved.followed.by_pair)
        return solved.structure
    return solve_with_prior(
        "given", task.sources, task.evidence, task.features(range(len(task.sources))), task.target, task.prior, monitor
    )


def _by_corners(task: Task, monitor: Monitor) -> Solved | None:
    """Corners aligned where poses and depths put them; None when the gate is not passed."""
    lines = [recorded_line(s, len(task.sources)) for s in task.sources]
    if any(line is None for line in lines):
        return None
    centred, origin = centred_arrangement(task.sources)
    arrangement = with_lines(centred, lines)
    gate.refuse_identical_poses(bare(arrangement).poses, task.names, task.depth_range_m[0])
    known = photo_prior(task.target, task.prior, origin)
    if known is not None:
        whole = with_photo(arrangement, task.target, known)
        solved = finished(task, bare(whole, task.work.start(whole, task.sources)[0]), None)
    else:
        alone = placed(task, bare(arrangement, task.work.start(arrangement, task.sources)[0]), None)
        solved = None if alone is None else with_located_photo(task, alone, None, None, monitor)
    if solved is None:
        return None
    return Solved(moved_back(solved.structure, origin), solved.followed)
