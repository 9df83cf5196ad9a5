"""Poses from a prior (given, or mount and turntable): matched, adjusted together with the photo, and checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from lfrig.contracts.errors import GeometryRefused
from lfrig.contracts.progress import Monitor
from lfrig.processing.model import F64, Evidence, LightField, Photo, RigPrior
from lfrig.processing.poses import gate
from lfrig.processing.poses.arrangement import Arrangement
from lfrig.processing.poses.features import Features
from lfrig.processing.poses.guide import Guide
from lfrig.processing.poses.join_photo import FIRST_BAND, join_photo
from lfrig.processing.poses.matching import Matches, match_features
from lfrig.processing.poses.priors import (
    depth_limits,
    given_arrangement,
    neighbours,
    photo_prior,
    prior_band_px,
    recentred,
    turntable_arrangement,
)
from lfrig.processing.poses.structure import COARSE_SCHEDULE_PX, Structure, complete, match_again, refine, widened
from lfrig.processing.poses.tracks import Pair, build_tracks

JOINT_SCHEDULE_PX = (4.0, 1.0)
FLIP_GAIN = 2
HIDDEN = 0.7
"""A right prior keeps nearly all true matches and finds more; keeping less than this fraction is suspicious."""


def solve_with_prior(
    kind: str,
    sources: Sequence[LightField],
    evidence: Sequence[Evidence],
    features: Sequence[Features],
    target: Photo,
    prior: RigPrior,
    monitor: Monitor,
) -> Structure:
    """Structure of the sources (first views) and the photo (last view), in the frame of the prior.

    ``kind`` is ``given`` or ``colmap-turntable``; ``features`` hold the photo's last.
    """
    names = [s.id for s in sources]
    arrangement = given_arrangement(sources) if kind == "given" else turntable_arrangement(sources, prior)
    # Given poses are moved around the cameras, so that a world whose origin is far away costs no digits; the turntable
    # has its axis at the origin already.
    origin = None
    if kind == "given":
        origin = np.mean([p.centre for p in arrangement.mounts], axis=0)
        arrangement = _moved(arrangement, origin)
    guide = Guide(sources, evidence, depth_limits(sources, prior), True)
    expected = arrangement.poses(np.zeros(arrangement.size))
    gate.refuse_identical_poses(expected, names, guide.depth_range[0])
    pairs = neighbours(expected)
    unguided = {(i, j): match_features(features[i], features[j]) for i, j in pairs}
    gate.refuse_duplicates(expected, features, unguided, names)

    coarse = _coarse(arrangement, features, unguided, guide, monitor)
    joined = join_photo(coarse, features, target, photo_prior(target, prior, origin), guide, monitor)
    pairs = neighbours(joined.structure.poses)
    first = joined.structure
    if is_free(first.arrangement) and not joined.settled:
        band = FIRST_BAND * max(s.width for s in sources)
        seen = build_tracks(features, match_again(first, features, pairs, guide, band))
        first = refine(first.arrangement, first.parameters, seen, widened(guide), JOINT_SCHEDULE_PX, monitor)
    final = complete(first, features, pairs, guide, monitor)
    agreement = gate.measure_agreement(final, features, {**unguided, **joined.unguided})
    gate.warn_of_doubtful_poses(agreement, names, monitor)
    if kind != "given":
        _check_turntable(final, agreement, features, unguided, guide, prior.turntable_sigma_deg, monitor)
    if origin is None:
        return final
    return replace(final, arrangement=_moved(final.arrangement, -origin), points=final.points + origin)


def is_free(arrangement: Arrangement) -> bool:
    """Whether anything in it may move."""
    return bool((arrangement.sigmas() > 0).any())


def _coarse(
    arrangement: Arrangement,
    features: Sequence[Features],
    unguided: Mapping[Pair, Matches],
    guide: Guide,
    monitor: Monitor,
) -> Structure:
    """The sources alone: from matches near where the prior expects them, or, when it hides most of the unguided ones
    (an angle is wrong), from those, if more of them fit.
    """
    zero = np.zeros(arrangement.size)
    bands = {(i, j): prior_band_px(arrangement, i, j) for i, j in unguided}
    own = features[:-1]
    guided = guide.matches(arrangement.cameras(zero), arrangement.poses(zero), own, guide.intervals(own), bands)
    structure = _from_matches(arrangement, own, guided, guide, monitor)
    if is_free(arrangement) and _hides(guided, unguided, len(own)):
        other = _from_matches(arrangement, own, unguided, guide, monitor)
        structure = max(structure, other, key=lambda s: len(s.seen))
    return structure


def _from_matches(
    arrangement: Arrangement,
    features: Sequence[Features],
    matches: Mapping[Pair, Matches],
    guide: Guide,
    monitor: Monitor,
) -> Structure:
    schedule = COARSE_SCHEDULE_PX if is_free(arrangement) else COARSE_SCHEDULE_PX[-1:]
    seen = build_tracks(features, matches)
    return refine(arrangement, np.zeros(arrangement.size), seen, widened(guide), schedule, monitor)


def _hides(guided: Mapping[Pair, Matches], unguided: Mapping[Pair, Matches], views: int) -> bool:
    """Whether some view loses most of its matches to the prior's gate."""
    for v in range(views):
        inside = sum(len(m) for pair, m in guided.items() if v in pair)
        outside = sum(len(m) for pair, m in unguided.items() if v in pair)
        if inside < HIDDEN * outside:
            return True
    return False


def _check_turntable(
    final: Structure,
    agreement: gate.Agreement,
    features: Sequence[Features],
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
        other = _from_matches(flipped, features[:-1], unguided, guide, monitor)
        best = gate.measure_agreement(other, features[:-1], unguided).best
        if min(best) > FLIP_GAIN * max(min(agreement.best[:count]), gate.MIN_AGREEMENT):
            raise GeometryRefused(
                "the turntable angles fit the images only with the opposite sign",
                code="turntable-direction",
                remedy="turntable_deg counts counter-clockwise seen from above: invert the recorded angles",
            )
    gate.refuse_lonely_views(agreement, names)
    turns = np.rad2deg(final.parameters[final.arrangement.turns])[:count]
    gate.check_angles(turns, np.array([v.angle_deg for v in views]), sigma_deg, names, monitor)


def _moved(arrangement: Arrangement, origin: F64) -> Arrangement:
    """The arrangement in a world whose origin is moved to ``origin`` [3]."""
    return replace(arrangement, mounts=tuple(recentred(m, origin) for m in arrangement.mounts))
