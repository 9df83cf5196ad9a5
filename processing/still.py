"""Whether something in the pictures stands still while the plate turns: a backdrop, a table's edge, a lamp.

What does not turn with the plate has no place in its world: it draws poses towards no motion at all and is fused at
depths that belong to nothing. It shows as corners that keep their place from capture to capture, but for the zoom.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations

import numpy as np

from lfrig.contracts.progress import Monitor
from lfrig.processing.geometry import turn_deg
from lfrig.processing.model import F32, F64, U8, Camera, LightField
from lfrig.processing.patch import correlation, patch_window
from lfrig.processing.poses.work import PoseWork

Point = tuple[float, float]
"""(x, y) px."""

MAX_CORNERS = 500
MIN_STILL = 8
MIN_TURN_DEG = 5.0
REACH = 0.04
"""How far a still corner may seem to move, as a fraction of the width: errors of focal lengths and of the mount."""

ZOOM_TOLERANCE, ROLL_TOLERANCE_DEG = 0.1, 1.5
RESIDUAL_PX = 1.0
ALIKE = 0.8
RADIUS = 5
WINDOW_PX, LEVELS = 15, 2

STILL_SHARE = 0.04
"""Share of the corners, in the middle one of all pairs of captures. A pattern that repeats around the plate (posts,
bricks) seems to stand still in pairs whose turn is a multiple of its period; what does stand still, in nearly all.
On the tuning scenes nothing that turns comes above 0.02; a still wall over a fifth of the picture makes 0.05 to 0.3."""

PARTS = 4
FEW = (0.0, 0.1, 0.4, 1.0)
"""Corners are tracked part by part. Where so many or fewer, as a fraction of `STILL_SHARE` of all, seem to stand still
after each part, the share is not above that: of 20 among 500, three in a thousand draws have none in the first quarter,
two in ten thousand only two in the first half."""


@dataclass(frozen=True)
class _Prepared:
    """A grey picture uint8 [H, W], its corners float32 [N, 2] px, and the pixel that the optical axis meets."""

    grey: U8
    corners: F32
    middle: Point


def _prepared(picture: U8, middle: Point | None = None) -> _Prepared:
    import cv2

    grey = np.asarray(cv2.cvtColor(np.ascontiguousarray(picture), cv2.COLOR_RGB2GRAY), np.uint8)
    corners = cv2.goodFeaturesToTrack(grey, MAX_CORNERS, 0.01, 7, blockSize=5)
    own = (grey.shape[1] - 1) / 2, (grey.shape[0] - 1) / 2
    return _Prepared(grey, np.zeros((0, 2), np.float32) if corners is None else corners[:, 0], middle or own)


def still_share(first: U8, second: U8, zoom: float, middles: tuple[Point, Point] | None = None) -> float:
    """Share of the corners of a picture that a second one, ``zoom`` times as large, shows in the same place.

    ``middles`` are the pixels (x, y) that the optical axes meet, by default the pictures' own middles; the pictures may
    be of different sizes.

    Corners are tracked from where they would be if nothing had turned (pyramidal Lucas–Kanade, there and back); those
    that agree on one similarity near that zoom stand still.
    """
    here, there = middles or (None, None)
    return _share(_prepared(first, here), _prepared(second, there), zoom)


def _share(a: _Prepared, b: _Prepared, zoom: float) -> float:
    count = len(a.corners)
    if not count:
        return 0.0
    middle_a, middle_b = (np.array(p.middle, np.float32) for p in (a, b))
    here, other = _of_one_size(a.grey, b.grey)
    expected = np.asarray((a.corners - middle_a) * np.float32(zoom) + middle_b, np.float32)
    found, seeming = np.zeros_like(expected), np.zeros(0, np.intp)
    # Strong and weak corners alike in every part: where hardly one of a part seems to stand still, few of all do.
    for done, part in enumerate(np.arange(first, count, PARTS) for first in range(PARTS)):
        found[part], there = _tracked(here, other, a.corners[part], expected[part])
        near = np.hypot(*(found[part] - expected[part]).T) < REACH * a.grey.shape[1]
        part = part[there & near]
        part = part[_correlation(here, other, a.corners[part], found[part], zoom) > ALIKE]
        seeming = np.union1d(seeming, part)
        if len(seeming) <= FEW[done] * STILL_SHARE * count:
            return 0.0
    if len(seeming) < MIN_STILL:
        return 0.0
    # Only what seems to stand still is asked for its way back.
    start = a.corners[seeming]
    returned, back = _tracked(other, here, found[seeming], start)
    rows = seeming[back & (np.hypot(*(returned - start).T) < 0.5)]
    return _agreeing(a.corners[rows], found[rows], zoom) / count


def warn_of_still_background(sources: Sequence[LightField], monitor: Monitor, work: PoseWork | None = None) -> None:
    """Warn when a good part of what is seen does not turn with the plate; ``work`` remembers what was compared."""
    work = PoseWork() if work is None else work
    pairs = [(a, b) for a, b in combinations(sources, 2) if turn_deg(a.turntable_deg, b.turntable_deg) >= MIN_TURN_DEG]
    shares = []
    for a, b in pairs:
        zoom = _focal(b.camera, b.width) / _focal(a.camera, a.width)
        here, there = (
            work.once("still", (s.views, s.camera), partial(_prepared, s.centre_view, _middle(s))) for s in (a, b)
        )
        share = work.once(f"still at {zoom:.6f}", (here, there), partial(_share, here, there, zoom))
        shares.append((share, a.id, b.id))
        if sum(s <= STILL_SHARE for s, _, _ in shares) > len(pairs) // 2:
            return  # whatever the others say, the middle one of all does not stand still
    if not shares:
        return
    share, one, other = sorted(shares)[len(shares) // 2]
    if share > STILL_SHARE:
        monitor.warn(
            "still-background",
            f"captures {one} and {other}: {share:.0%} of the corners stand still while the plate turns; what does "
            "not turn with it misleads poses and depth: hang a plain backdrop, or move the camera closer",
        )


def _middle(light_field: LightField) -> Point:
    camera = light_field.camera
    if camera is None:
        return (light_field.width - 1) / 2, (light_field.height - 1) / 2
    return camera.cx, camera.cy


def _of_one_size(a: U8, b: U8) -> tuple[U8, U8]:
    """Both pictures [H, W], the smaller one continued by its border: the tracker wants equal sizes."""
    import cv2

    if a.shape == b.shape:
        return a, b
    height, width = (max(a.shape[axis], b.shape[axis]) for axis in (0, 1))
    padded = (
        cv2.copyMakeBorder(p, 0, height - p.shape[0], 0, width - p.shape[1], cv2.BORDER_REPLICATE) for p in (a, b)
    )
    one, other = (np.asarray(p, np.uint8) for p in padded)
    return one, other


def _focal(camera: Camera | None, width: int) -> float:
    return float(width) if camera is None else camera.focal_px


def _tracked(a: U8, b: U8, points: F32, guess: F32) -> tuple[F32, np.ndarray]:
    import cv2

    if not len(points):
        return points, np.zeros(0, bool)
    moved, found, _ = cv2.calcOpticalFlowPyrLK(
        a, b, points[:, None], guess[:, None].copy(), winSize=(WINDOW_PX, WINDOW_PX), maxLevel=LEVELS,
        criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 0.03), flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )  # fmt: skip
    return np.asarray(moved[:, 0], np.float32), np.asarray(found[:, 0] > 0)


def _correlation(a: U8, b: U8, here: F32, there: F32, zoom: float) -> F64:
    """Normalised cross-correlation of the patches around points [N, 2] of two pictures."""
    import cv2

    if not len(here):
        return np.zeros(0)
    window = patch_window(RADIUS)
    patches = []
    for picture, points, size in ((a, here, 1.0), (b, there, zoom)):
        places = points[:, None] + window * np.float32(size)
        seen = cv2.remap(picture.astype(np.float32), places[..., 0], places[..., 1], cv2.INTER_LINEAR)
        patches.append(np.asarray(seen, np.float32))
    return correlation(*patches)


def _agreeing(here: F32, there: F32, zoom: float) -> int:
    """How many points agree on one similarity that is all but the zoom."""
    import cv2

    if len(here) < MIN_STILL:
        return 0
    cv2.setRNGSeed(0)
    matrix, inliers = cv2.estimateAffinePartial2D(here, there, ransacReprojThreshold=RESIDUAL_PX, maxIters=500)
    if matrix is None:
        return 0
    scale, roll_deg = np.hypot(matrix[0, 0], matrix[1, 0]), np.rad2deg(np.arctan2(matrix[1, 0], matrix[0, 0]))
    still = abs(scale / zoom - 1) < ZOOM_TOLERANCE and abs(roll_deg) < ROLL_TOLERANCE_DEG
    count = int(inliers.sum())
    return count if still and count >= MIN_STILL else 0
