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
from lfrig.processing.poses.join_photo import Joined, join_photo
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
from lfrig.processing.poses.structure import Structure, complete, match_again, refine
from lfrig.processing.poses.tracks import Pair, build_tracks

COARSE_SCHEDULE_PX = (16.0, 4.0, 1.0)
JOINT_SCHEDULE_PX = (4.0, 1.0)
FIRST_BAND = 0.008
"""Where the coarse poses may still be off, as a fraction of a view's width (4 px at 541)."""

FLIP_GAIN = 3
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
    if kind != "given":
        _refuse_unsupported(coarse, joined, features, unguided, guide, monitor)
    pairs = neighbours(joined.structure.poses)
    first = joined.structure
    if is_free(first.arrangement):
        band = FIRST_BAND * max(s.width for s in sources)
        seen = build_tracks(features, match_again(first, features, pairs, guide, band))
        first = refine(first.arrangement, first.parameters, seen, _widened(guide), JOINT_SCHEDULE_PX, monitor)
    final = complete(first, features, pairs, guide, monitor)
    if kind != "given":
        turns = np.rad2deg(final.parameters[final.arrangement.turns])[: len(sources)]
        recorded = np.array([s.turntable_deg for s in sources])
        gate.check_angles(turns, recorded, prior.turntable_sigma_deg, names, monitor)
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
    return refine(arrangement, np.zeros(arrangement.size), seen, _widened(guide), schedule, monitor)


def _hides(guided: Mapping[Pair, Matches], unguided: Mapping[Pair, Matches], views: int) -> bool:
    """Whether some view loses most of its matches to the prior's gate."""
    for v in range(views):
        inside = sum(len(m) for pair, m in guided.items() if v in pair)
        outside = sum(len(m) for pair, m in unguided.items() if v in pair)
        if inside < HIDDEN * outside:
            return True
    return False


def _refuse_unsupported(
    coarse: Structure,
    joined: Joined,
    features: Sequence[Features],
    matches: Mapping[Pair, Matches],
    guide: Guide,
    monitor: Monitor,
) -> None:
    """Refuse when unguided matches do not carry the turntable's poses; say so when the other direction would."""
    count = len(guide.sources)
    inner = coarse.seen.per_view(count)
    supports = [int(inner[v]) + joined.agreeing.get(v, 0) for v in range(count)]
    if min(supports) >= gate.MIN_VIEW_MATCHES:
        return
    flipped = replace(
        coarse.arrangement,
        views=tuple(replace(v, angle_deg=-v.angle_deg) for v in coarse.arrangement.views),
    )
    other = _from_matches(flipped, features[:-1], matches, guide, monitor)
    if len(other.seen) > FLIP_GAIN * max(len(coarse.seen), gate.MIN_VIEW_MATCHES):
        raise GeometryRefused(
            "the turntable angles fit the images only with the opposite sign",
            code="turntable-direction",
            remedy="turntable_deg counts counter-clockwise seen from above: invert the recorded angles",
        )
    gate.refuse_lonely_views(supports, matches, [s.id for s in guide.sources])


def _widened(guide: Guide) -> tuple[float, float]:
    """Depths that points may have while poses are still rough."""
    return guide.depth_range[0] / 1.5, guide.depth_range[1] * 1.5


def _moved(arrangement: Arrangement, origin: F64) -> Arrangement:
    """The arrangement in a world whose origin is moved to ``origin`` [3]."""
    return replace(arrangement, mounts=tuple(recentred(m, origin) for m in arrangement.mounts))
