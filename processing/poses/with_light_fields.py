"""The light-field way as a whole: two passes of warp-LK, a gate, and structure from motion where the gate says no."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from lfrig.contracts.errors import GeometryRefused
from lfrig.contracts.progress import Monitor, Muted
from lfrig.processing.model import F64, ScaleFit
from lfrig.processing.poses import gate
from lfrig.processing.poses.arrangement import Arrangement, Line
from lfrig.processing.poses.confirm import confirmation, refuse_untied, refuse_untied_corrections
from lfrig.processing.poses.guide import Guide
from lfrig.processing.poses.light_fields import (
    disparity_residual,
    first_pass,
    recorded_line,
    second_pass,
    widest_link_deg,
    with_lines,
)
from lfrig.processing.poses.place_photo import with_located_photo, with_photo_at_priors
from lfrig.processing.poses.priors import PUPIL_SHIFT_M, photo_prior, turntable_arrangement, with_photo
from lfrig.processing.poses.structure import Structure
from lfrig.processing.poses.task import SURE_NOISE_PX, Solved, Task, bare, finished, placed
from lfrig.processing.poses.with_prior import solve_with_prior

MAX_SHIFTED = 3
ALONE_STEP_DEG = 25.0
UNRECORDED_SIGMA = 0.3
"""Sigma of a line that is not recorded but fitted to points: nothing is known beforehand."""


def solve_with_light_fields(task: Task, monitor: Monitor) -> tuple[str, Structure]:
    """Structure of the sources and, as its last view, the photo; and the method that found it, ``lf`` where the light
    fields had the last word.
    """
    lines = [recorded_line(s, len(task.sources)) for s in task.sources]
    arrangement = with_lines(turntable_arrangement(task.sources, task.prior, PUPIL_SHIFT_M), lines)
    expected = arrangement.poses(np.zeros(arrangement.size))
    gate.refuse_identical_poses(expected, task.names, task.depth_range_m[0])
    solved = _by_light_fields(task, arrangement, monitor)
    if solved is not None and solved.structure.noise_px < SURE_NOISE_PX:
        return "lf", _kept(task, solved)
    if solved is None:
        held = Muted(monitor)
        try:
            kind, other = _from_motion(task, lines, held)
        except GeometryRefused:
            _refuse_wrong_direction(task, arrangement)
            raise
        # Asked last: what repeats around the plate may fit at the angles' negatives too.
        if kind != "lf":
            _refuse_wrong_direction(task, arrangement)
        # What the light fields do not confirm is no correction.
        held.release(lambda notice: kind == "lf" or not notice.code.endswith("-corrected"))
        return kind, other.structure
    return "lf", _kept(task, _better(task, lines, solved, monitor))


def _kept(task: Task, solved: Solved) -> Structure:
    """The solution, remembered for the next solve."""
    task.work.keep_solution(task.sources, solved.structure, solved.followed.by_pair)
    return solved.structure


def _better(task: Task, lines: Sequence[Line | None], solved: Solved, monitor: Monitor) -> Solved:
    """The solution, or the one that starts from structure from motion if more corners are found in it.

    Texture that repeats can hold a wrong geometry within every gate; what it lacks is matches.
    """
    held = Muted(monitor)
    try:
        kind, other = _from_motion(task, lines, held)
    except GeometryRefused:
        return solved
    if kind != "lf" or other.followed.total <= solved.followed.total:
        return solved
    held.release()
    return other


def _from_motion(task: Task, lines: Sequence[Line | None], monitor: Monitor) -> tuple[str, Solved]:
    """Structure from motion and the second pass on it, which has the last word on angles where it succeeds."""
    held = Muted(monitor)
    first = solve_with_prior(
        "colmap-turntable",
        task.sources,
        task.evidence,
        task.features(range(len(task.sources))),
        task.target,
        task.prior,
        held,
    )
    kind, solved = _polished(task, lines, first, held)
    if kind == "lf":
        gate.check_angles(solved.structure, task.names, task.prior.turntable_sigma_deg, monitor)
    held.release(lambda notice: kind != "lf" or notice.code != "angle-corrected")
    return kind, solved


def _by_light_fields(task: Task, arrangement: Arrangement, monitor: Monitor) -> Solved | None:
    """Both passes, with the photo where its mount puts it, else where its SIFT features do; None when the gate is not
    passed.
    """
    known = photo_prior(task.target, task.prior)
    if any(v.line is None for v in arrangement.views):
        return None
    sigma_deg = task.prior.turntable_sigma_deg
    if known is not None:
        whole = with_photo(arrangement, task.target, known)
        before = _from_before(task, whole, finished)
        if before is not None:
            return before
        for start in _starts(whole):
            rough = first_pass(task.looks, whole, start, task.rough_range_m, task.effort)
            solved = finished(task, rough, sigma_deg)
            if solved is not None:
                return solved
    zero = np.zeros(arrangement.size)
    alone = _from_before(task, arrangement, placed)
    if alone is not None:
        return with_located_photo(task, alone, known, sigma_deg, monitor)
    if widest_link_deg(arrangement.poses(zero)) > ALONE_STEP_DEG or len(task.sources) == 1:
        # Too far apart without the photo between them: it is located from the priors as they are.
        return None if known is None else with_photo_at_priors(task, bare(arrangement), known, sigma_deg, monitor)
    rough = first_pass(task.looks, arrangement, zero, task.rough_range_m, task.effort)
    alone = placed(task, rough, sigma_deg)
    return None if alone is None else with_located_photo(task, alone, known, sigma_deg, monitor)


def _from_before(
    task: Task, arrangement: Arrangement, solve: Callable[[Task, Structure | None, float | None], Solved | None]
) -> Solved | None:
    """Solved from where an earlier solution left the sources; None where there is none, or it does not pass the gate.
    Only what is new, the photo or a source, is followed by flow.
    """
    x, placed_views = task.work.start(arrangement, task.sources)
    if not placed_views:
        return None
    start: Structure | None = bare(arrangement, x)
    if len(placed_views) < len(arrangement.views):
        known = task.work.followed(task.sources)
        start = first_pass(task.looks, arrangement, x, task.rough_range_m, task.effort, placed_views, known)
    return solve(task, start, task.prior.turntable_sigma_deg)


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


def _refuse_wrong_direction(task: Task, arrangement: Arrangement) -> None:
    """Refuse angles that fit with the other sign."""
    flipped = replace(arrangement, views=tuple(replace(v, angle_deg=-v.angle_deg) for v in arrangement.views))
    start = np.zeros(flipped.size)
    if len(flipped.views) > 1 and np.ptp([v.angle_deg for v in flipped.views]) > 0:
        rough = first_pass(task.looks, flipped, start, task.rough_range_m, task.effort)
        if finished(task, rough, task.prior.turntable_sigma_deg) is not None:
            gate.refuse_direction()


def _polished(task: Task, lines: Sequence[Line | None], first: Structure, monitor: Monitor) -> tuple[str, Solved]:
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
    aligned = second_pass(task.looks, rough, task.depth_range_m, task.effort)
    solved, followed = aligned.structure, aligned.followed
    # Angles and focal lengths are judged for themselves.
    doubted = gate.doubts(solved, followed.fractions(), None)
    if doubted:
        refuse_untied(confirmation(first, task.sources, task.evidence, task.target, guide), task.names, task.target.id)
        gate.warn_of_unconfirmed(doubted, followed.fractions(), task.names, task.target.id, monitor)
        return "colmap-turntable", Solved(first, followed)
    corrected = [v for v in gate.corrected(solved) if v < len(task.sources)]
    if corrected:
        # That the turntable was wrong is a claim which matches of a pattern that repeats support as well.
        confirmed = confirmation(solved, task.sources, task.evidence, task.target, guide)
        refuse_untied_corrections(confirmed, corrected, task.names)
    return "lf", Solved(solved, followed)


def solved_scales(structure: Structure, sources: int) -> tuple[ScaleFit | None, ...]:
    """Scale of each source as the adjustment left it, None where none took part; scatter and inliers are those of its
    own corners.
    """
    lines = structure.arrangement.lines(structure.parameters)
    seen = structure.seen
    if seen.disparity is None:
        return (None,) * sources
    residual = disparity_residual(structure.arrangement.linearise(structure.parameters)[0], seen, structure.points)
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
