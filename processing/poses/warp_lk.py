"""Where corners of a light field appear in another picture: predicted by its own depth, warped, and aligned.

Descriptors have to recognise a point without knowing how it will look. Here the depth map and rough poses say how:
what is left is a shift of some pixels (pass 0: pyramidal Lucas–Kanade on the warped picture, Bouguet 2001, kept where
the way back leads home) or of a fraction of one (pass 1), and the last digits come from `patches.align`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from lfrig.processing.geometry import projection
from lfrig.processing.model import F32, F64, Camera, Pose, ScaleFit
from lfrig.processing.poses.corners import Corners
from lfrig.processing.poses.patches import align, sample_points
from lfrig.processing.poses.picture import Picture, Small

SLOPE_STEP_PX = 3.0
MARGIN_PX = 12.0
MIN_CORRELATION = 0.75
MAX_SHIFT_PX = 4.0
"""How far alignment may move a point from where it is predicted, or was flowed to."""

AREA_BOUNDS = (0.25, 4.0)
MAX_STRETCH = 2.5
HOLDS_PX, HOLDS_SHARE, HOLDS_POINTS = 0.3, 0.9, 50
"""Predictions (of so many corners) of which this share moves less than this lead the alignment, whose start they
are, to the same places."""

FLOW_WINDOW_PX = 17
FLOW_LEVELS = 2
WAY_BACK_PX = 1.5
MIN_RESPONSE = 0.03
MAX_COMMON_SHIFT = 0.15


@dataclass(frozen=True)
class Relief:
    """What a light field knows of its own depth: corners, and the smoothed ``disparity`` float32 [H, W] around them."""

    corners: Corners
    disparity: F32

    def first(self, count: int) -> Relief:
        """With the strongest corners only."""
        return Relief(self.corners.first(count), self.disparity)

    def ground_at(self, xy: F64, disparity: F64 | None = None) -> Ground:
        """The surface around points [N, 2]. A point's own ``disparity`` [N] counts where it is finite."""
        own = sample_points(self.disparity, xy).astype(np.float64)
        if disparity is not None:
            own = np.where(np.isfinite(disparity), disparity, own)
        e = SLOPE_STEP_PX
        rise = [
            sample_points(self.disparity, xy + d) - sample_points(self.disparity, xy - d) for d in ([e, 0.0], [0.0, e])
        ]
        return Ground(xy, own, np.stack(rise, 1).astype(np.float64) / (2 * e))

    @cached_property
    def ground(self) -> Ground:
        """The surface around the corners."""
        return self.ground_at(self.corners.xy, self.corners.disparity)


@dataclass(frozen=True)
class Ground:
    """The surface around points: ``xy`` float64 [N, 2] px, ``disparity`` [N] px per view step, and its ``slope`` [N, 2]
    by x and y.
    """

    xy: F64
    disparity: F64
    slope: F64

    def take(self, rows: NDArray[np.intp]) -> Ground:
        """Some of the points."""
        return Ground(self.xy[rows], self.disparity[rows], self.slope[rows])


@dataclass(frozen=True)
class Station:
    """A view's camera and pose."""

    camera: Camera
    pose: Pose


@dataclass(frozen=True)
class Warp:
    """From pixels of a light field's centre view into another picture, through the light field's surface."""

    relief: Relief
    scale: ScaleFit
    here: Station
    there: Station
    limits: tuple[float, float]
    """Lowest and highest inverse depth [1/m]."""

    def field(self, here: Small, there: Small) -> tuple[F32, F32]:
        """Where every pixel of the half-size picture goes in the other half-size picture, x and y, float32 [h, w]."""
        import cv2

        height, width = here.even.shape
        disparity = cv2.resize(self.relief.disparity, (width, height), interpolation=cv2.INTER_AREA)
        inverse = np.clip(self.scale.inverse_depth(disparity), *self.limits).astype(np.float32)
        # Pixels of the half-size pictures as pixels of the full ones, and back.
        up, down = here.to_full, np.linalg.inv(there.to_full)
        matrix, offset = self._projection
        m, t = (part.astype(np.float32) for part in (down @ matrix @ up, down @ offset))
        x, y = np.arange(width, dtype=np.float32)[None], np.arange(height, dtype=np.float32)[:, None]
        z = np.maximum(m[2, 0] * x + m[2, 1] * y + m[2, 2] + t[2] * inverse, np.float32(1e-3))
        u = (m[0, 0] * x + m[0, 1] * y + m[0, 2] + t[0] * inverse) / z
        v = (m[1, 0] * x + m[1, 1] * y + m[1, 2] + t[1] * inverse) / z
        return u, v

    def points(self, ground: Ground) -> tuple[F64, F64, F64]:
        """Where points [N, 2] go, the derivative of that by xy [N, 2, 2] on the smooth surface, and the direction in
        which they go with inverse depth, unit vectors [N, 2].
        """
        inverse = self.scale.a * ground.disparity + self.scale.c
        clipped = np.clip(inverse, *self.limits)
        slope = np.where((inverse == clipped)[:, None], self.scale.a * ground.slope, 0.0)
        matrix, offset = self._projection
        p = ground.xy @ matrix[:, :2].T + matrix[:, 2] + clipped[:, None] * offset
        z = np.where(np.abs(p[:, 2]) < 1e-6, 1e-6, p[:, 2])
        there = p[:, :2] / z[:, None]
        # dp/dx = column of the matrix + offset · dw/dx, then the quotient rule.
        dp = matrix[None, :, :2] + offset[None, :, None] * slope[:, None, :]
        affine = (dp[:, :2] - there[:, :, None] * dp[:, 2:]) / z[:, None, None]
        along = (offset[:2] - there * offset[2]) / z[:, None]
        along /= np.maximum(np.hypot(along[:, :1], along[:, 1:]), 1e-12)
        there[p[:, 2] <= 0] = np.nan
        return there, affine, along

    def at(self, xy: F64, inverse_depth: F64) -> F64:
        """Where points [N, 2] go at inverse depths [..., N], float64 [..., N, 2]; NaN behind the other view."""
        matrix, offset = self._projection
        p = xy @ matrix[:, :2].T + matrix[:, 2] + inverse_depth[..., None] * offset
        z = np.where(p[..., 2:] > 1e-6, p[..., 2:], np.nan)
        return np.asarray(p[..., :2] / z, np.float64)

    @cached_property
    def _projection(self) -> tuple[F64, F64]:
        return projection(self.here.camera, self.here.pose, self.there.camera, self.there.pose)


@dataclass(frozen=True)
class Sighted:
    """Corners in another picture: ``xy`` float64 [N, 2] px, NaN where not found; ``likeness`` float32 [N], the
    normalised correlation of the patches; ``start`` float64 [N, 2], where they were looked for; and which of them were
    ``expected`` inside the picture, bool [N].
    """

    xy: F64
    likeness: F32
    start: F64
    expected: NDArray[np.bool_]

    def first(self, count: int) -> Sighted:
        """The strongest corners only."""
        return Sighted(self.xy[:count], self.likeness[:count], self.start[:count], self.expected[:count])

    @property
    def count(self) -> int:
        """How many were found."""
        return int(self.found.sum())

    @property
    def found(self) -> NDArray[np.bool_]:
        """Which were [N]."""
        return np.isfinite(self.xy[:, 0])

    @property
    def fraction(self) -> float:
        """Share of the expected ones that were found."""
        return self.count / max(int(self.expected.sum()), 1)

    def still_holds(self, warp: Warp) -> bool:
        """Whether the corners are expected where they were: looking again would find the same."""
        rows = np.flatnonzero(self.found)
        rows = rows[:: max(1, len(rows) // HOLDS_POINTS)]
        if not len(rows):
            return False
        moved = np.hypot(*(warp.points(warp.relief.ground.take(rows))[0] - self.start[rows]).T)
        return bool(np.quantile(moved, HOLDS_SHARE) < HOLDS_PX)


def follow(warp: Warp, here: Picture, there: Picture, *, flow: bool, before: Sighted | None = None) -> Sighted:
    """Where the light field's corners appear in another picture.

    With ``flow`` the prediction may be off by tens of pixels; without, by a few. What was found ``before``, of the
    first of these corners or of more, is handed back where the prediction has hardly changed since.
    """
    corners = warp.relief.corners
    count, done = len(corners), 0
    found, alike = np.full((count, 2), np.nan), np.zeros(count, np.float32)
    if before is not None and not flow:
        kept = before if count >= len(before.xy) else before.first(count)
        if kept.still_holds(warp):
            done = len(kept.xy)
            if done == count:
                return kept
            found[:done], alike[:done] = kept.xy, kept.likeness
    if not count:
        return Sighted(found, alike, found, np.zeros(0, bool))
    start, affine, along = warp.points(warp.relief.ground)
    expected = np.isfinite(start).all(1) & _usable(start, affine, there.shape)
    good = expected
    if flow:
        moved, kept_rows = _flowed(warp, here, there, corners.xy)
        height, width = here.shape
        moved = np.clip(moved, 3, [width - 4, height - 4])
        # Where the flow says that the corner went in the warped picture, and from there on into the true one.
        start, affine, along = warp.points(warp.relief.ground_at(moved))
        good = kept_rows & np.isfinite(start).all(1) & _usable(start, affine, there.shape)
    rows = done + np.flatnonzero(good[done:])
    if len(rows):
        xy, likeness = align(here.detail, there.detail, corners.xy[rows], start[rows], affine[rows], along[rows])
        near = np.hypot(*(xy - start[rows]).T) < MAX_SHIFT_PX
        keep = near & (likeness > MIN_CORRELATION)
        found[rows[keep]], alike[rows[keep]] = xy[keep], likeness[keep]
    return Sighted(found, alike, start, expected)


def _usable(xy: F64, affine: F64, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Points inside the picture whose surroundings are neither squeezed nor stretched too much to be compared."""
    height, width = shape
    area = affine[:, 0, 0] * affine[:, 1, 1] - affine[:, 0, 1] * affine[:, 1, 0]
    good = (area > AREA_BOUNDS[0]) & (area < AREA_BOUNDS[1]) & (np.abs(affine).max((1, 2)) < MAX_STRETCH)
    inside = (xy > MARGIN_PX).all(1) & (xy < [width - MARGIN_PX, height - MARGIN_PX]).all(1)
    return np.asarray(good & inside, np.bool_)


def _flowed(warp: Warp, here: Picture, there: Picture, xy: F64) -> tuple[F64, NDArray[np.bool_]]:
    """Optical flow [N, 2] px from a picture to the other one seen from its place, and which points came back home.

    At half size: it has to come within the reach of the alignment, no further.
    """
    import cv2

    near, far = here.small, there.small
    u, v = warp.field(near, far)
    # The border is flat, so nothing there attracts the flow.
    seen = np.asarray(
        cv2.remap(far.even, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=128), np.uint8
    )
    points = near.from_full(xy)[:, None].astype(np.float32)
    shift = common_shift(near.even, seen)
    flow = partial(
        cv2.calcOpticalFlowPyrLK, winSize=(FLOW_WINDOW_PX, FLOW_WINDOW_PX), maxLevel=FLOW_LEVELS,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )  # fmt: skip
    moved, forth, _ = flow(near.even, seen, points, points + shift)
    home, back, _ = flow(seen, near.even, moved, moved - shift)
    close = np.hypot(*(home - points)[:, 0].T) < WAY_BACK_PX / 2
    return near.full(moved[:, 0].astype(np.float64)), np.asarray((forth[:, 0] > 0) & (back[:, 0] > 0) & close, np.bool_)


def common_shift(first: NDArray[np.uint8], second: NDArray[np.uint8]) -> F32:
    """How far the second picture is shifted as a whole, float32 [2] px (phase correlation); zero where nothing stands
    out.
    """
    import cv2

    size = first.shape[1], first.shape[0]
    a, b = (p.astype(np.float32) - 128 for p in (first, second))
    (dx, dy), response = cv2.phaseCorrelate(a, b, cv2.createHanningWindow(size, cv2.CV_32F))
    if response < MIN_RESPONSE or max(abs(dx), abs(dy)) > MAX_COMMON_SHIFT * size[0]:
        return np.zeros(2, np.float32)
    return np.array([dx, dy], np.float32)
