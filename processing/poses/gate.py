"""Refusals and warnings of the pose stage: each names the capture, what is wrong with it, and what to do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lfrig.contracts.errors import GeometryRefused
from lfrig.contracts.progress import Monitor
from lfrig.processing.geometry import rotation_angle_deg
from lfrig.processing.model import F64, Pose
from lfrig.processing.poses.epipolar import fundamental_matrix, sampson_distance
from lfrig.processing.poses.features import Features
from lfrig.processing.poses.matching import Matches
from lfrig.processing.poses.structure import Structure, common_points
from lfrig.processing.poses.tracks import Pair

SAME_ROTATION_DEG = 0.01
SAME_CENTRE = 1e-5
DIFFERENT_VIEW_DEG = 2.0
STILL_PX = 0.3
STILL_FRACTION = 0.8
ENOUGH_MATCHES = 20
GOOD_ANCHORS = 60
WIDE_STEP_DEG = 25.0
ANGLE_SIGMAS = 4.0
FOCAL_SIGMAS = 4.0
MIN_FOCAL_SIGMA = 0.01
UNKNOWN_FOCAL = 0.2
MAX_FOCAL_FACTOR = 1.4
FOUND_SHARE = 0.4
MIN_FOUND = 0.12
"""A view in whose best pair fewer corners are found than this fraction of the usual, or of all, is doubted."""

MIN_LINK = 40
MIN_PHOTO_MATCHES = 12
MIN_VIEW_MATCHES = 15
MIN_AGREEMENT = 0.2
"""Wrong geometry: at most 0.22 of the unguided matches of a view's best pair agree; right one: above 0.6, on texture
that repeats exactly 0.24 to 0.6."""

DOUBTFUL_AGREEMENT = 0.35
MIN_AGREEMENT_ALONE = 0.5
"""Without a prior the poses come from these matches, so more must agree (right: above 0.68, wrong: below 0.5)."""

AGREE = 0.006
"""Sampson distance that counts as agreement, as a fraction of the image width (3 px at 541)."""


def refuse_identical_poses(poses: Sequence[Pose], names: Sequence[str], distance: float) -> None:
    """Refuse two captures from one place; ``distance`` is that of the scene."""
    for j in range(len(poses)):
        for i in range(j):
            turn = rotation_angle_deg(poses[i].rotation, poses[j].rotation)
            step = float(np.linalg.norm(poses[i].centre - poses[j].centre))
            if turn < SAME_ROTATION_DEG and step < SAME_CENTRE * distance:
                raise GeometryRefused(
                    f"captures {names[i]} and {names[j]} have the same pose",
                    code="identical-poses",
                    remedy="correct the pose or turntable_deg of one of them, or leave it out with --sources",
                )


def refuse_duplicates(
    poses: Sequence[Pose], features: Sequence[Features], matches: Mapping[Pair, Matches], names: Sequence[str]
) -> None:
    """Refuse two captures whose pictures are the same although their poses say that they should differ."""
    for (i, j), pairs in matches.items():
        if len(pairs) < ENOUGH_MATCHES:
            continue
        if rotation_angle_deg(poses[i].rotation, poses[j].rotation) < DIFFERENT_VIEW_DEG:
            continue
        moved = np.linalg.norm(features[i].xy[pairs[:, 0]] - features[j].xy[pairs[:, 1]], axis=1)
        if (moved < STILL_PX).mean() > STILL_FRACTION:
            raise GeometryRefused(
                f"captures {names[i]} and {names[j]} show the same view although their poses differ",
                code="duplicate-capture",
                remedy="the plate did not turn or a picture was stored twice: shoot one again, "
                "or leave it out with --sources",
            )


@dataclass(frozen=True)
class Agreement:
    """How far matches that no geometry guided agree with a solved one: per view, how many do in all of its pairs, of
    how many, and the largest fraction in any pair.

    The matches that a solution was made from cannot tell: within a gate, false ones are found for any geometry.
    """

    agreeing: list[int]
    tried: list[int]
    best: list[float]


def measure_agreement(
    structure: Structure, features: Sequence[Features], unguided: Mapping[Pair, Matches]
) -> Agreement:
    """Compare epipolar distances with a gate of `AGREE` of the image width."""
    views = len(structure.poses)
    agreeing, tried, best = [0] * views, [0] * views, [0.0] * views
    cameras, poses = structure.cameras, structure.poses
    for (i, j), pairs in unguided.items():
        if not len(pairs):
            continue
        fundamental = fundamental_matrix(cameras[i], poses[i], cameras[j], poses[j])
        distance = sampson_distance(fundamental, features[i].xy[pairs[:, 0]], features[j].xy[pairs[:, 1]])
        good = int((distance < AGREE * cameras[j].width).sum())
        for v in (i, j):
            agreeing[v] += good
            tried[v] += len(pairs)
            if len(pairs) >= MIN_VIEW_MATCHES:
                best[v] = max(best[v], good / len(pairs))
    return Agreement(agreeing, tried, best)


def refuse_lonely_views(agreement: Agreement, names: Sequence[str]) -> None:
    """Refuse views whose pose the images do not carry, or contradict."""
    for v, name in enumerate(names):
        if agreement.agreeing[v] >= MIN_VIEW_MATCHES and agreement.best[v] >= MIN_AGREEMENT:
            continue
        fit = f"only {agreement.agreeing[v]} of its {agreement.tried[v]} matches with other captures fit any pose"
        raise GeometryRefused(
            f"capture {name}: {fit if agreement.tried[v] else 'nothing in it matches any other capture'} "
            f"({MIN_VIEW_MATCHES} matches and {MIN_AGREEMENT:.0%} of a pair are needed)",
            code="too-few-matches",
            remedy="check its turntable_deg and that nothing moved; give the scene more texture or turn in smaller "
            "steps (10-15°), or leave the capture out with --sources",
        )


def refuse_unstable_views(agreement: Agreement, names: Sequence[str]) -> None:
    """Refuse poses found without a prior that a good part of their own matches contradicts."""
    for v, name in enumerate(names):
        if agreement.best[v] < MIN_AGREEMENT_ALONE:
            raise GeometryRefused(
                f"capture {name}: only {agreement.best[v]:.0%} of its matches with any other capture fit one geometry, "
                f"{MIN_AGREEMENT_ALONE:.0%} are needed when nothing is known of the rig",
                code="unstable-poses",
                remedy="record the turntable's angles and mount, or poses; texture that repeats misleads without them",
            )


def refuse_bent_lenses(structure: Structure, names: Sequence[str]) -> None:
    """Refuse poses found without a prior that need a focal length far from the recorded one: with nothing else known,
    it is the poses that are wrong.
    """
    log_focals = structure.parameters[structure.arrangement.log_focals]
    for v, name in enumerate(names):
        sigma = structure.arrangement.views[v].camera.sigma_focal
        if sigma < UNKNOWN_FOCAL and abs(log_focals[v]) > FOCAL_SIGMAS * max(sigma, MIN_FOCAL_SIGMA):
            raise GeometryRefused(
                f"capture {name}: the poses found need a focal length {np.exp(log_focals[v]):.2f} times the recorded "
                "one, and nothing else is known of the rig",
                code="unstable-poses",
                remedy="check camera.fx; record the turntable's angles and mount, or poses",
            )


def refuse_optics(name: str, what: str) -> None:
    """Refuse poses found without a prior by which a capture's recorded optics contradict the others'."""
    raise GeometryRefused(
        f"capture {name}: its recorded {what} contradicts the depths that the poses give, and the other captures'",
        code="unstable-poses",
        remedy="check its optics; record the turntable's angles and mount, or poses",
    )


def refuse_scattered_views(groups: Sequence[Sequence[int]], names: Sequence[str]) -> None:
    """Refuse poses found without a prior by which the views fall into groups that nothing near ties together."""
    if len(groups) > 1:
        listed = " and ".join(", ".join(names[v] for v in group) for group in groups)
        raise GeometryRefused(
            f"{listed}: every way to place them relative to each other fits only what is far away, or nothing",
            code="unstable-poses",
            remedy="record the turntable's angles and mount, or poses (a backdrop that repeats misleads without them), "
            "or add captures between these",
        )


def warn_of_doubtful_poses(
    agreement: Agreement, names: Sequence[str], monitor: Monitor, limit: float = DOUBTFUL_AGREEMENT
) -> None:
    """Warn of poses that most matches contradict."""
    for v, name in enumerate(names):
        if agreement.tried[v] >= GOOD_ANCHORS and agreement.best[v] < limit:
            monitor.warn(
                "pose-doubtful",
                f"capture {name}: only {agreement.best[v]:.0%} of its matches with any other capture fit its pose; "
                "check it (texture that repeats may also be the reason)",
            )


def doubts(
    structure: Structure, fractions: Mapping[Pair, float], sigma_deg: float | None, part: float = 1.0
) -> list[int]:
    """Views of a light-field-aware solution that are not to be trusted: few points, angles or focal lengths far from
    what was recorded, or corners that are not found where they should be.

    Wrong geometry finds 6 % of the corners where neighbours find 40 %; residuals do not tell the two apart. With
    ``sigma_deg`` None, angles and focal lengths are not judged. ``part`` is that of the corners that was followed.
    """
    arrangement, x = structure.arrangement, structure.parameters
    count = np.bincount(structure.seen.view, minlength=len(arrangement.views))
    best = np.zeros(len(arrangement.views))
    for pair, fraction in fractions.items():
        for v in pair:
            best[v] = max(best[v], fraction)
    found = []
    for v, view in enumerate(arrangement.views):
        wrong = bool(count[v] < part * GOOD_ANCHORS or best[v] < FOUND_SHARE * np.median(best) or best[v] < MIN_FOUND)
        if sigma_deg is not None:
            turn, focal = x[arrangement.turns][v], x[arrangement.log_focals][v]
            wrong |= bool(abs(turn) > ANGLE_SIGMAS * np.deg2rad(view.sigma_angle_deg) and view.sigma_angle_deg > 0)
            wrong |= bool(abs(focal) > FOCAL_SIGMAS * view.camera.sigma_focal and view.camera.sigma_focal > 0)
        if wrong:
            found.append(v)
    return found or unlinked(structure, part)


def corrected(structure: Structure) -> list[int]:
    """Views whose solved turntable angle contradicts the recorded one."""
    arrangement = structure.arrangement
    turns = np.abs(np.rad2deg(structure.parameters[arrangement.turns]))
    sigmas = [view.sigma_angle_deg for view in arrangement.views]
    return [v for v, sigma in enumerate(sigmas) if sigma > 0 and turns[v] > ANGLE_SIGMAS * sigma]


def refuse_direction() -> None:
    """Refuse angles that count the wrong way."""
    raise GeometryRefused(
        "the turntable angles fit the images only with the opposite sign",
        code="turntable-direction",
        remedy="turntable_deg counts counter-clockwise seen from above: invert the recorded angles",
    )


def warn_of_unconfirmed(
    doubted: Sequence[int], fractions: Mapping[Pair, float], names: Sequence[str], photo: str, monitor: Monitor
) -> None:
    """Warn of views that structure from motion placed where the light fields' depths do not expect them."""
    for v in doubted:
        best = max((f for pair, f in fractions.items() if v in pair), default=0.0)
        who = f"capture {names[v]}" if v < len(names) else f"photo {photo}"
        monitor.warn(
            "pose-unconfirmed",
            f"{who}: at most {best:.0%} of the corners are found where depth and poses expect them; check the result "
            "(repeating or shiny texture, a blurred capture, or something that moved)",
        )


def unlinked(structure: Structure, part: float = 1.0) -> list[int]:
    """Views that `MIN_LINK` common points, or that ``part`` of them, do not tie to the first one, through whatever
    chain.
    """
    views = len(structure.arrangement.views)
    linked = common_points(structure) >= part * MIN_LINK
    reached = np.eye(1, views, dtype=bool)[0]
    for _ in range(views):
        reached = reached | linked[reached].any(0)
    return np.flatnonzero(~reached).tolist()


def refuse_photo(count: int, name: str) -> None:
    """Refuse a photo that too few matches tie to the sources."""
    if count < MIN_PHOTO_MATCHES:
        raise GeometryRefused(
            f"photo {name}: only {count} points of the sources are found in it, {MIN_PHOTO_MATCHES} are needed",
            code="photo-no-overlap",
            remedy="take the photo of the same scene from between the sources, or give its pose",
        )


def check_angles(structure: Structure, names: Sequence[str], sigma_deg: float, monitor: Monitor) -> None:
    """Warn of single angles of the first views (``names``) that the images contradict; refuse when most are wrong."""
    arrangement = structure.arrangement
    turns_deg = np.rad2deg(structure.parameters[arrangement.turns])[: len(names)]
    recorded_deg = np.array([view.angle_deg for view in arrangement.views[: len(names)]])
    wrong = np.abs(turns_deg) > ANGLE_SIGMAS * sigma_deg
    if len(names) > 2 and wrong.sum() > len(names) / 2:
        spread = recorded_deg - recorded_deg.mean()
        listed = ", ".join(f"capture {names[v]} by {turns_deg[v]:+.1f}°" for v in np.flatnonzero(wrong).tolist())
        factor = 1 + float((spread * turns_deg).sum() / max((spread**2).sum(), 1e-9))
        raise GeometryRefused(
            f"the images contradict {int(wrong.sum())} of {len(names)} turntable angles ({listed}; "
            f"they turned {factor:.2f} times as far as recorded)",
            code="turntable-angles",
            remedy="check the turntable's steps per degree, its direction and the order of the captures",
        )
    for v in np.flatnonzero(wrong).tolist():
        monitor.warn(
            "angle-corrected",
            f"capture {names[v]}: the turntable said {recorded_deg[v]:.2f}°, the images say "
            f"{recorded_deg[v] + turns_deg[v]:.2f}°; the images are believed",
        )


def warn_of_focals(log_focals: F64, sigmas: F64, names: Sequence[str], monitor: Monitor) -> None:
    """Warn of focal lengths far from what was recorded; refuse those that no slip of the pen explains."""
    known = sigmas < UNKNOWN_FOCAL
    for v in np.flatnonzero(known & (np.abs(log_focals) > np.log(MAX_FOCAL_FACTOR))).tolist():
        raise GeometryRefused(
            f"capture {names[v]}: the images fit only with a focal length {np.exp(log_focals[v]):.2f} times the "
            "recorded one",
            code="focal-implausible",
            remedy="check camera.fx, and turntable_deg of this and the other captures; or leave it out with --sources",
        )
    far = (sigmas > 0) & (np.abs(log_focals) > FOCAL_SIGMAS * sigmas)
    for v in np.flatnonzero(far).tolist():
        monitor.warn(
            "focal-corrected",
            f"capture {names[v]}: the images make its focal length {100 * np.expm1(log_focals[v]):+.1f} % off the "
            "recorded one; check camera.fx",
        )


def warn_of_few_anchors(counts: Sequence[int], names: Sequence[str], monitor: Monitor) -> None:
    """Warn of captures whose anchors are few."""
    for name, count in zip(names, counts, strict=True):
        if count < GOOD_ANCHORS:
            monitor.warn(
                "few-anchors",
                f"capture {name}: only {count} anchors, {GOOD_ANCHORS} make a safe scale; more texture or smaller "
                "steps help",
            )


def warn_of_wide_steps(poses: Sequence[Pose], names: Sequence[str], monitor: Monitor) -> None:
    """Warn of a view whose nearest neighbour (``names`` has the photo last) is further away than is usual."""
    for v in range(len(poses)):
        steps = [rotation_angle_deg(poses[v].rotation, p.rotation) for i, p in enumerate(poses) if i != v]
        if steps and min(steps) > WIDE_STEP_DEG:
            monitor.warn(
                "wide-step",
                f"capture {names[v]} is {min(steps):.0f}° from its nearest neighbour; 10-15° are recommended, up to "
                "20° are normal",
            )
