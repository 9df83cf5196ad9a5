"""Poses from a prior (given, or mount and turntable): matched, adjusted together with the photo, and checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from lfrig.contracts.progress import Monitor, Muted
from lfrig.processing.model import F64, Evidence, LightField, Photo, Pose, RigPrior
from lfrig.processing.poses import gate
from lfrig.processing.poses.arrangement import Arrangement
from lfrig.processing.poses.guide import Guide
from lfrig.processing.poses.join_photo import join_located, locate, refuse_or_doubt
from lfrig.processing.poses.matching import Gallery, Matches
from lfrig.processing.poses.priors import (
    PhotoPrior,
    centred_arrangement,
    depth_limits,
    neighbours,
    photo_prior,
    prior_band_px,
    recentred_arrangement,
    turntable_arrangement,
    with_photo,
)
from lfrig.processing.poses.structure import COARSE_SCHEDULE_PX, Structure, complete, match_again, refine, widened
from lfrig.processing.poses.tracks import Pair, build_tracks

JOINT_SCHEDULE_PX = (4.0, 1.0)
FLIP_GAIN = 2
SECOND_BAND = 0.03
"""Where a rough solution may still be off, as a fraction of a view's width (16 px at 541)."""

CONVINCING = 1.5
"""How many times more unguided matches must fit for the prior to be given up."""

HIDDEN = 0.7
"""A right prior keeps nearly all true matches and finds more; keeping less than this fraction is suspicious."""


def solve_with_prior(
    kind: str,
    sources: Sequence[LightField],
    evidence: Sequence[Evidence],
    features: Gallery,
    target: Photo,
    prior: RigPrior,
    monitor: Monitor,
) -> Structure:
    """Structure of the sources (first views) and the photo (last view), in the frame of the prior.

    ``kind`` is ``given`` or ``colmap-turntable``; ``features`` hold the photo's last.
    """
    names = [s.id for s in sources]
    # The turntable has its axis at the origin already.
    origin = None
    if kind == "given":
        arrangement, origin = centred_arrangement(sources)
    else:
        arrangement = turntable_arrangement(sources, prior)
    guide = Guide(sources, evidence, depth_limits(sources, prior), True)
    expected = arrangement.poses(np.zeros(arrangement.size))
    gate.refuse_identical_poses(expected, names, guide.depth_range[0])
    known = photo_prior(target, prior, origin)
    unguided = _unguided(expected, features)
    among_sources = {p: m for p, m in unguided.items() if max(p) < len(sources)}
    gate.refuse_duplicates(expected, features, among_sources, names)

    rough = _rough(arrangement, features, unguided, target, known, guide, monitor)
    pairs = neighbours(rough.poses)
    if is_free(rough.arrangement):
        band = SECOND_BAND * max(s.width for s in sources)
        seen = build_tracks(features, match_again(rough, features, pairs, guide, band, vote=True))
        rough = refine(rough.arrangement, rough.parameters, seen, widened(guide), JOINT_SCHEDULE_PX, monitor)
    final = complete(rough, features, pairs, guide, monitor)

    agreement = gate.measure_agreement(final, features, unguided)
    if kind == "given":
        gate.warn_of_doubtful_poses(agreement, names, monitor, gate.MIN_AGREEMENT)
    else:
        _check_turntable(final, agreement, features, unguided, guide, prior.turntable_sigma_deg, monitor)
    refuse_or_doubt(agreement.agreeing[-1], final, features[-1], known, target, monitor)
    _report_photo_angle(final, target, monitor)
    return final if origin is None else moved_back(final, origin)


def moved_back(solved: Structure, origin: F64) -> Structure:
    """What was solved around ``origin`` [3] in the frame of the given poses."""
    return replace(
        solved, arrangement=recentred_arrangement(solved.arrangement, -origin), points=solved.points + origin
    )


def is_free(arrangement: Arrangement) -> bool:
    """Whether anything in it may move."""
    return bool((arrangement.sigmas() > 0).any())


def _unguided(expected: Sequence[Pose], features: Gallery) -> dict[Pair, Matches]:
    """Matches that no geometry guides: of neighbouring sources, and of every source with the photo."""
    last = len(expected)
    pairs = [*neighbours(expected), *((v, last) for v in range(last))]
    return {(i, j): features.match(i, j) for i, j in pairs}


def _rough(
    arrangement: Arrangement,
    features: Gallery,
    unguided: dict[Pair, Matches],
    target: Photo,
    known: PhotoPrior | None,
    guide: Guide,
    monitor: Monitor,
) -> Structure:
    """All views, the photo last: from the prior, and when that hides most of the unguided matches (an angle or a mount
    is wrong) from those, if many more of them fit.
    """
    last = len(features) - 1
    inner = {p: m for p, m in unguided.items() if last not in p}
    whole = arrangement if known is None else with_photo(arrangement, target, known)
    guided = _expected_matches(whole, features, guide)
    best = _from_matches(whole, features, guided, guide, monitor)
    hidden = _hides(guided, unguided if known is not None else inner, len(whole.views))
    if known is not None and not (hidden and is_free(whole)):
        return best
    sources = best
    if known is not None or hidden:
        sources = _from_matches(arrangement, features, inner, guide, monitor)
        if known is None and _fitting(sources, features, inner) < CONVINCING * _fitting(best, features, inner):
            sources = best
    located = locate(sources, features, unguided, target)
    if known is None:
        gate.refuse_photo(0 if located is None else located.support, target.id)
    if located is None:
        return best
    held = Muted(monitor)
    other = join_located(sources, located, target, known, held)
    if known is not None and _fitting(other, features, unguided) < CONVINCING * _fitting(best, features, unguided):
        return best
    held.release()
    return other


def _expected_matches(arrangement: Arrangement, features: Gallery, guide: Guide) -> dict[Pair, Matches]:
    """Matches of all views near where the prior expects them."""
    zero = np.zeros(arrangement.size)
    cameras, poses = arrangement.cameras(zero), arrangement.poses(zero)
    bands = {(i, j): prior_band_px(arrangement, i, j) for i, j in neighbours(poses)}
    return guide.matches(cameras, poses, features, guide.intervals(features), bands, vote=True)


def _from_matches(
    arrangement: Arrangement,
    features: Gallery,
    matches: Mapping[Pair, Matches],
    guide: Guide,
    monitor: Monitor,
) -> Structure:
    schedule = COARSE_SCHEDULE_PX if is_free(arrangement) else COARSE_SCHEDULE_PX[-1:]
    seen = build_tracks(features, matches)
    return refine(arrangement, np.zeros(arrangement.size), seen, widened(guide), schedule, monitor)


def _fitting(structure: Structure, features: Gallery, unguided: Mapping[Pair, Matches]) -> int:
    """How many unguided matches agree with a structure."""
    return sum(gate.measure_agreement(structure, features, unguided).agreeing)


def _hides(guided: Mapping[Pair, Matches], unguided: Mapping[Pair, Matches], views: int) -> bool:
    """Whether some view loses most of its matches to the prior's gate."""
    for v in range(views):
        inside = sum(len(m) for pair, m in guided.items() if v in pair)
        outside = sum(len(m) for pair, m in unguided.items() if v in pair and pair in guided)
        if inside < HIDDEN * outside:
            return True
    return False


def _check_turntable(
    final: Structure,
    agreement: gate.Agreement,
    features: Gallery,
    unguided: Mapping[Pair, Matches],
    guide: Guide,
    sigma_deg: float,
    monitor: Monitor,
) -> None:
    """Refuse angles that the images contradict, and say so when the other direction would fit; warn of single ones."""
    names = [s.id for s in guide.sources]
    count = len(names)
    views = final.arrangement.views[:count]
    if min(agreement.best[:count]) < gate.MIN_AGREEMENT and unguided:
        flipped = Arrangement(final.arrangement.mounts[:1], tuple(replace(v, angle_deg=-v.angle_deg) for v in views))
        inner = {p: m for p, m in unguided.items() if max(p) < count}
        other = _from_matches(flipped, features, inner, guide, monitor)
        best = gate.measure_agreement(other, features, inner).best
        if min(best) > FLIP_GAIN * max(min(agreement.best[:count]), gate.MIN_AGREEMENT):
            gate.refuse_direction()
    gate.refuse_lonely_views(agreement, names)
    gate.warn_of_doubtful_poses(agreement, names, monitor)
    gate.check_angles(final, names, sigma_deg, monitor)


def _report_photo_angle(final: Structure, target: Photo, monitor: Monitor) -> None:
    """Warn when the images contradict the plate angle that was recorded with the photo."""
    view = final.arrangement.views[-1]
    turn = float(np.rad2deg(final.parameters[final.arrangement.turns][-1]))
    if view.sigma_angle_deg > 0 and abs(turn) > gate.ANGLE_SIGMAS * view.sigma_angle_deg:
        monitor.warn(
            "photo-pose-corrected",
            f"photo {target.id}: the turntable said {view.angle_deg:.2f}°, the images say "
            f"{view.angle_deg + turn:.2f}°; the images are believed",
        )
