"""Whether something in the pictures stands still while the plate turns: a backdrop, a table's edge, a lamp.

What does not turn with the plate has no place in its world: it draws poses towards no motion at all and is fused at
depths that belong to nothing. It shows as corners that keep their place from capture to capture, but for the zoom.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from lfrig.contracts.progress import Monitor
from lfrig.processing.model import F32, F64, U8, Camera, LightField
from lfrig.processing.patch import correlation, patch_window

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
WINDOW_PX = 15

STILL_SHARE = 0.04
"""Share of the corners, in the middle one of all pairs of captures. A pattern that repeats around the plate (posts,
bricks) seems to stand still in pairs whose turn is a multiple of its period; what does stand still, in nearly all.
On the tuning scenes nothing that turns comes above 0.02; a still wall over a fifth of the picture makes 0.05 to 0.3."""


def still_share(first: U8, second: U8, zoom: float, middles: tuple[Point, Point] | None = None) -> float:
    """Share of the corners of a picture that a second one, ``zoom`` times as large, shows in the same place.

    ``middles`` are the pixels (x, y) that the optical axes meet, by default the pictures' own middles; the pictures may
    be of different sizes.

    Corners are tracked from where they would be if nothing had turned (pyramidal Lucas–Kanade, there and back); those
    that agree on one similarity near that zoom stand still.
    """
    import cv2

    a, b = (cv2.cvtColor(np.ascontiguousarray(p), cv2.COLOR_RGB2GRAY) for p in (first, second))
    corners = cv2.goodFeaturesToTrack(a, MAX_CORNERS, 0.01, 7, blockSize=5)
    if corners is None:
        return 0.0
    start = corners[:, 0].astype(np.float32)
    own = tuple(((p.shape[1] - 1) / 2, (p.shape[0] - 1) / 2) for p in (a, b))
    middle_a, middle_b = (np.array(middle, np.float32) for middle in middles or own)
    width = a.shape[1]
    a, b = _of_one_size(a, b)
    expected = np.asarray((start - middle_a) * np.float32(zoom) + middle_b, np.float32)
    found, there = _tracked(a, b, start, expected)
    returned, back = _tracked(b, a, found, start)
    good = there & back & (np.linalg.norm(returned - start, axis=1) < 0.5)
    good &= np.linalg.norm(found - expected, axis=1) < REACH * width
    good[good] = _correlation(a, b, start[good], found[good], zoom) > ALIKE
    return _agreeing(start[good], found[good], zoom) / len(start)


def warn_of_still_background(sources: Sequence[LightField], monitor: Monitor) -> None:
    """Warn when a good part of what is seen does not turn with the plate."""
    shares = []
    for i, j in combinations(range(len(sources)), 2):
        a, b = sources[i], sources[j]
        if a.turntable_deg is not None and b.turntable_deg is not None:
            turn = abs((a.turntable_deg - b.turntable_deg + 180) % 360 - 180)
            if turn < MIN_TURN_DEG:
                continue
        zoom = _focal(b.camera, b.width) / _focal(a.camera, a.width)
        shares.append((still_share(a.centre_view, b.centre_view, zoom, (_middle(a), _middle(b))), a.id, b.id))
    if not shares:
        return
    share, first, second = sorted(shares)[len(shares) // 2]
    if share > STILL_SHARE:
        monitor.warn(
            "still-background",
            f"captures {first} and {second}: {share:.0%} of the corners stand still while the plate turns; what does "
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

    height, width = (max(a.shape[axis], b.shape[axis]) for axis in (0, 1))
    padded = (
        cv2.copyMakeBorder(p, 0, height - p.shape[0], 0, width - p.shape[1], cv2.BORDER_REPLICATE) for p in (a, b)
    )
    first, second = (np.asarray(p, np.uint8) for p in padded)
    return first, second


def _focal(camera: Camera | None, width: int) -> float:
    return float(width) if camera is None else camera.focal_px


def _tracked(a: U8, b: U8, points: F32, guess: F32) -> tuple[F32, np.ndarray]:
    import cv2

    if not len(points):
        return points, np.zeros(0, bool)
    moved, found, _ = cv2.calcOpticalFlowPyrLK(
        a, b, points[:, None], guess[:, None].copy(), winSize=(WINDOW_PX, WINDOW_PX), maxLevel=2,
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
