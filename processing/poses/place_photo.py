"""The photo joins light fields that are placed already: where its SIFT features put it, and most corners are found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from lfrig.contracts.progress import Monitor, Muted
from lfrig.processing.geometry import rotation_angle_deg, world_points
from lfrig.processing.model import Pose
from lfrig.processing.poses.confirm import is_photo_tied
from lfrig.processing.poses.guide import Guide, disparity_around
from lfrig.processing.poses.join_photo import join_located
from lfrig.processing.poses.light_fields import first_pass
from lfrig.processing.poses.matching import Gallery
from lfrig.processing.poses.priors import PAIR_LIMIT_DEG, PhotoPrior, known_camera
from lfrig.processing.poses.sightings import directed_pairs, follow_all
from lfrig.processing.poses.structure import Structure
from lfrig.processing.poses.target import Located, locate_photo
from lfrig.processing.poses.task import Solved, Task, bare, finished
from lfrig.processing.poses.tracks import Observations

MAX_TRIED = 2
MAX_RANKED = 4
NEAR_DEG = 22.0
"""SIFT recognises most of what it sees at this angle."""

RANKED_CORNERS = 250
"""Of every source, the strongest: enough to tell which of several places is the photo's."""


def with_located_photo(
    task: Task, alone: Solved, known: PhotoPrior | None, sigma_deg: float | None, monitor: Monitor
) -> Solved | None:
    """The photo joined to solved sources. Features of half-size pictures come first; they place it to a pixel, and the
    corners see to the rest.

    A place that nothing near confirms is left for a better one; where there is none, that in which most corners are
    found is handed on, to be refused by name.
    """
    poses = alone.structure.poses
    guide = Guide(task.sources, task.evidence, task.depth_range_m, True)
    best: tuple[Solved, Muted] | None = None
    for features, views in ((task.quick_features, _spread(poses)), (task.features, range(len(poses)))):
        candidates = _ranked(task, alone.structure, features(tuple(views)), known, monitor)
        for joined, held in candidates[:MAX_TRIED]:
            solved = finished(task, joined, sigma_deg, {**alone.followed.by_pair, **task.work.followed(task.sources)})
            if solved is None:
                continue
            asked = partial(is_photo_tied, solved.structure, task.sources, task.evidence, task.target, guide)
            if task.work.once("tied", (solved.structure,), asked):
                held.release()
                return solved
            if best is None or solved.followed.total > best[0].followed.total:
                best = solved, held
    if best is None:
        return None
    best[1].release()
    return best[0]


def _spread(poses: Sequence[Pose]) -> list[int]:
    """Views such that every other one is within `NEAR_DEG` of one of them."""
    chosen: list[int] = []
    for v, pose in enumerate(poses):
        if all(rotation_angle_deg(pose.rotation, poses[c].rotation) > NEAR_DEG for c in chosen):
            chosen.append(v)
    return chosen


def with_photo_at_priors(
    task: Task, sources: Structure, known: PhotoPrior, sigma_deg: float | None, monitor: Monitor
) -> Solved | None:
    """The photo joined to sources that stand where the priors put them, and all solved together: of several hypotheses
    that in which most corners are found.
    """
    best, best_held = None, Muted(monitor)
    for located in hypotheses(task, sources, task.features(range(len(task.sources))))[:MAX_TRIED]:
        held = Muted(monitor)
        joined = join_located(sources, located, task.target, known, held)
        rough = first_pass(task.looks, joined.arrangement, joined.parameters, task.rough_range_m, task.effort)
        solved = finished(task, rough, sigma_deg)
        if solved is not None and (best is None or solved.followed.total > best.followed.total):
            best, best_held = solved, held
    best_held.release()
    return best


def _ranked(
    task: Task, alone: Structure, features: Gallery, known: PhotoPrior | None, monitor: Monitor
) -> list[tuple[Structure, Muted]]:
    """The likeliest hypotheses, joined to the sources: those first in which most of the sources' corners are found.

    Texture that repeats holds a wrong place with every inlier of its own; what it lacks is corners.
    """
    found = []
    for located in hypotheses(task, alone, features)[:MAX_RANKED]:
        held = Muted(monitor)
        joined = join_located(alone, located, task.target, known, held)
        last = len(joined.arrangement.views) - 1
        pairs = [p for p in directed_pairs(joined.poses, last, PAIR_LIMIT_DEG) if p[1] == last]
        followed = follow_all(
            task.looks, joined.arrangement, joined.parameters, pairs, task.depth_range_m, limit=RANKED_CORNERS
        )
        found.append((followed.total, bare(joined.arrangement, joined.parameters), held))
    found.sort(key=lambda candidate: -candidate[0])
    return [(joined, held) for _, joined, held in found]


def hypotheses(task: Task, solved: Structure, features: Gallery) -> list[Located]:
    """Possible poses of the photo: its SIFT matches with the sources that have features, whose depths the light fields
    tell.
    """
    count = len(task.sources)
    asked = [v for v in range(count) if len(features[v])]
    cameras, poses, lines = solved.cameras, solved.poses, solved.arrangement.lines(solved.parameters)
    worlds, views, rows = [], [], []
    for v in asked:
        line = lines[v]
        if line is None:
            continue
        judged = disparity_around(features[v].xy, task.evidence[v])
        scale = line.scale(cameras[v])
        inverse = scale.a * judged.own + scale.c
        good = np.flatnonzero(judged.sure & (inverse > 1 / task.depth_range_m[1]))
        worlds.append(world_points(cameras[v], poses[v], features[v].xy[good], 1 / inverse[good]))
        views.append(np.full(len(good), v))
        rows.append(good)
    if not worlds:
        return []
    world, view, row = np.concatenate(worlds), np.concatenate(views), np.concatenate(rows)
    n = len(world)
    seen = Observations(np.arange(n), view, row, np.zeros((n, 2)), np.ones(n))
    known = replace(solved, seen=seen, points=world)
    matches = {v: features.match(v, count) for v in asked}
    theirs = dict(enumerate(features[:count]))
    return locate_photo(known, theirs, features[count], matches, known_camera(task.target))
