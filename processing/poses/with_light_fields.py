"""The light-field way as a whole: two passes of warp-LK, a gate, and structure from motion where the gate says no."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lfrig.contracts.errors import GeometryRefused
from lfrig.contracts.progress import Monitor, Muted
from lfrig.processing.geometry import world_points
from lfrig.processing.model import F64, Evidence, LightField, Photo, RigPrior, ScaleFit
from lfrig.processing.poses import gate
from lfrig.processing.poses.arrangement import Arrangement, Line
from lfrig.processing.poses.confirm import confirmation, refuse_untied
from lfrig.processing.poses.guide import Guide, disparity_around
from lfrig.processing.poses.join_photo import join_located
from lfrig.processing.poses.light_fields import (
    disparity_residual,
    first_pass,
    recorded_line,
    second_pass,
    widest_link_deg,
    with_lines,
)
from lfrig.processing.poses.matching import Gallery
from lfrig.processing.poses.priors import (
    PUPIL_SHIFT_M,
    PhotoPrior,
    depth_limits,
    known_camera,
    photo_prior,
    turntable_arrangement,
    with_photo,
)
from lfrig.processing.poses.sightings import Followed, Looks, look_at
from lfrig.processing.poses.structure import Structure
from lfrig.processing.poses.target import Located, locate_photo
from lfrig.processing.poses.tracks import Observations
from lfrig.processing.poses.with_prior import solve_with_prior

MAX_TRIED = 2
MAX_SHIFTED = 3
SURE_NOISE_PX = 0.1
"""Aligned patches of a right geometry agree to 0.04–0.08 px; above this another start is tried as well."""

ALONE_STEP_DEG = 25.0
UNRECORDED_SIGMA = 0.3
"""Sigma of a line that is not recorded but fitted to points: nothing is known beforehand."""


@dataclass(frozen=True)
class Solved:
    """A solution, and the matches that it rests on."""

    structure: Structure
    followed: Followed


@dataclass(frozen=True)
class Task:
    """What is to be solved; ``features`` finds the SIFT features of all views (the photo's last) when needed."""

    sources: Sequence[LightField]
    evidence: Sequence[Evidence]
    target: Photo
    prior: RigPrior
    features: Callable[[], Gallery]

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


def solve_with_light_fields(task: Task, monitor: Monitor) -> tuple[str, Structure]:
    """Structure of the sources and, as its last view, the photo; and the method that found it, ``lf`` where the light
    fields had the last word.
    """
    looks = look_at(task.sources, task.evidence, task.target, monitor)
    lines = [recorded_line(s, len(task.sources)) for s in task.sources]
    arrangement = with_lines(turntable_arrangement(task.sources, task.prior, PUPIL_SHIFT_M), lines)
    expected = arrangement.poses(np.zeros(arrangement.size))
    gate.refuse_identical_poses(expected, task.names, task.depth_range_m[0])
    solved = _by_light_fields(task, looks, arrangement, monitor)
    if solved is not None and solved.structure.noise_px < SURE_NOISE_PX:
        return "lf", solved.structure
    if solved is None:
        held = Muted(monitor)
        try:
            kind, other = _from_motion(task, looks, lines, held)
        except GeometryRefused:
            _refuse_wrong_direction(task, looks, arrangement, monitor)
            raise
        # Asked last: what repeats around the plate may fit at the angles' negatives too.
        if kind != "lf":
            _refuse_wrong_direction(task, looks, arrangement, monitor)
        # What the light fields do not confirm is no correction.
        held.release(lambda notice: kind == "lf" or not notice.code.endswith("-corrected"))
        return kind, other.structure
    return "lf", _better(task, looks, lines, solved, monitor).structure


def _better(task: Task, looks: Looks, lines: Sequence[Line | None], solved: Solved, monitor: Monitor) -> Solved:
    """The solution, or the one that starts from structure from motion if more corners are found in it.

    Texture that repeats can hold a wrong geometry within every gate; what it lacks is matches.
    """
    held = Muted(monitor)
    try:
        kind, other = _from_motion(task, looks, lines, held)
    except GeometryRefused:
        return solved
    if kind != "lf" or other.followed.total <= solved.followed.total:
        return solved
    held.release()
    return other


def _from_motion(task: Task, looks: Looks, lines: Sequence[Line | None], monitor: Monitor) -> tuple[str, Solved]:
    """Structure from motion and the second pass on it."""
    first = solve_with_prior(
        "colmap-turntable", task.sources, task.evidence, task.features(), task.target, task.prior, monitor
    )
    return _polished(task, looks, lines, first, monitor)


def _by_light_fields(task: Task, looks: Looks, arrangement: Arrangement, monitor: Monitor) -> Solved | None:
    """Both passes, with the photo where its mount puts it, else where its SIFT features do; None when the gate is not
    passed.
    """
    known = photo_prior(task.target, task.prior)
    if any(v.line is None for v in arrangement.views):
        return None
    if known is not None:
        whole = with_photo(arrangement, task.target, known)
        for start in _starts(whole):
            rough = first_pass(looks, whole, start, task.rough_range_m, monitor)
            solved = _finished(task, looks, rough, monitor)
            if solved is not None:
                return solved
    zero = np.zeros(arrangement.size)
    if widest_link_deg(arrangement.poses(zero)) > ALONE_STEP_DEG or len(task.sources) == 1:
        # Too far apart without the photo between them: it is located from the priors as they are.
        return None if known is None else _with_located_photo(task, looks, bare(arrangement), known, monitor)
    alone = _finished(task, looks, first_pass(looks, arrangement, zero, task.rough_range_m, monitor), monitor)
    return None if alone is None else _with_located_photo(task, looks, alone.structure, known, monitor)


def _starts(whole: Arrangement) -> Iterator[F64]:
    """The priors as they are; then with one view, the photo first, turned by its sigma to one side or the other.

    On texture that repeats the flow may follow into the next period; from a little further it need not, and a wrong
    period does not pass the gate.
    """
    yield np.zeros(whole.size)
    for v in reversed(range(len(whole.views))[-MAX_SHIFTED:]):
        for side in (-1, 1):
            x = np.zeros(whole.size)
            x[whole.turns.start + v] = side * np.deg2rad(whole.views[v].sigma_angle_deg)
            if x.any():
                yield x


def _finished(task: Task, looks: Looks, rough: Structure | None, monitor: Monitor) -> Solved | None:
    """The second pass, when the gate is passed."""
    if rough is None:
        return None
    solved, followed = second_pass(looks, rough, task.depth_range_m, monitor)
    doubted = gate.doubts(solved, followed.fractions(), task.prior.turntable_sigma_deg)
    return None if doubted else Solved(solved, followed)


def _refuse_wrong_direction(task: Task, looks: Looks, arrangement: Arrangement, monitor: Monitor) -> None:
    """Refuse angles that fit with the other sign."""
    flipped = replace(arrangement, views=tuple(replace(v, angle_deg=-v.angle_deg) for v in arrangement.views))
    start = np.zeros(flipped.size)
    if len(flipped.views) > 1 and np.ptp([v.angle_deg for v in flipped.views]) > 0:
        rough = first_pass(looks, flipped, start, task.rough_range_m, monitor)
        if _finished(task, looks, rough, monitor) is not None:
            gate.refuse_direction()


def bare(arrangement: Arrangement) -> Structure:
    """The priors as they are, without a point."""
    none = np.zeros(0, np.int64)
    seen = Observations(none, none, none, np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    size = arrangement.size
    return Structure(arrangement, np.zeros(size), seen, np.zeros((0, 3)), 1.0, np.zeros((size, size)))


def _with_located_photo(
    task: Task, looks: Looks, alone: Structure, known: PhotoPrior | None, monitor: Monitor
) -> Solved | None:
    """The photo joined where its SIFT features put it: of several hypotheses that in which most corners are found."""
    best, held = None, Muted(monitor)
    for located in hypotheses(task, alone)[:MAX_TRIED]:
        own = Muted(monitor)
        joined: Structure | None = join_located(alone, located, task.target, known, own)
        if joined is not None and not alone.seen.count:
            joined = first_pass(looks, joined.arrangement, joined.parameters, task.rough_range_m, monitor)
        solved = _finished(task, looks, joined, monitor)
        if solved is not None and (best is None or solved.followed.total > best.followed.total):
            best, held = solved, own
    held.release()
    return best


def hypotheses(task: Task, solved: Structure) -> list[Located]:
    """Possible poses of the photo: its SIFT matches with every source, whose depths the light fields tell."""
    features, count = task.features(), len(task.sources)
    cameras, poses, lines = solved.cameras, solved.poses, solved.arrangement.lines(solved.parameters)
    worlds, views, rows = [], [], []
    for v in range(count):
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
    world, view, row = np.concatenate(worlds), np.concatenate(views), np.concatenate(rows)
    n = len(world)
    seen = Observations(np.arange(n), view, row, np.zeros((n, 2)), np.ones(n))
    known = replace(solved, seen=seen, points=world)
    matches = {v: features.match(v, count) for v in range(count)}
    theirs = dict(enumerate(features[:count]))
    return locate_photo(known, theirs, features[count], matches, known_camera(task.target))


def _polished(
    task: Task, looks: Looks, lines: Sequence[Line | None], first: Structure, monitor: Monitor
) -> tuple[str, Solved]:
    """The second pass on what structure from motion found; dropped where it would lose a view."""
    guide = Guide(task.sources, task.evidence, task.depth_range_m, True)
    found = [guide.fitted_line(first, v) for v in range(len(task.sources))]
    cameras = first.cameras
    priors = list(lines)
    x = first.parameters.copy()
    for v, scale in enumerate(found):
        if scale is None:
            continue
        line = priors[v]
        if line is None:
            priors[v] = Line.of_scale(scale, cameras[v], UNRECORDED_SIGMA)
            continue
        start = first.arrangement.log_lines.start + 2 * v
        now = Line.of_scale(scale, cameras[v], 0.0)
        x[start : start + 2] = np.log([now.baseline_m / line.baseline_m, now.inverse_focus / line.inverse_focus])
    rough = replace(first, arrangement=with_lines(first.arrangement, priors), parameters=x)
    solved, followed = second_pass(looks, rough, task.depth_range_m, monitor)
    # Angles and focal lengths have been judged, and warned of, already.
    doubted = gate.doubts(solved, followed.fractions(), None)
    if doubted:
        refuse_untied(confirmation(first, task.sources, task.evidence, task.target, guide), task.names, task.target.id)
        gate.warn_of_unconfirmed(doubted, followed.fractions(), task.names, task.target.id, monitor)
        return "colmap-turntable", Solved(first, followed)
    return "lf", Solved(solved, followed)


def solved_scales(structure: Structure, sources: int) -> tuple[ScaleFit | None, ...]:
    """Scale of each source as the adjustment left it, None where none took part; scatter and inliers are those of its
    own corners.
    """
    lines = structure.arrangement.lines(structure.parameters)
    seen = structure.seen
    if seen.disparity is None:
        return (None,) * sources
    residual = disparity_residual(structure.arrangement, structure.parameters, seen, structure.points)
    scales: list[ScaleFit | None] = []
    for v in range(sources):
        line, own = lines[v], np.isfinite(residual) & (seen.view == v)
        if line is None or not own.any():
            scales.append(None)
            continue
        scale = line.scale(structure.cameras[v])
        spread = 1.4826 * float(np.median(np.abs(residual[own])))
        inside = float((np.abs(residual[own]) < 4 * spread).mean())
        scales.append(ScaleFit(scale.a, scale.c, scale.a * spread, inside, int(own.sum()), "joint"))
    return tuple(scales)
