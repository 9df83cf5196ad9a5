"""Other methods on the same inputs, each with the best settings found on the tuning scenes.

- `sgbm_disparity`      OpenCV's StereoSGBM on pairs of a light field's views (Hirschmüller 2008, as OpenCV
  has it)
- `sgbm_in_target`      that of every source, carried into the target with the source's pose and scale
- `copied_disparity`    the nearest source's own disparity map, taken for the target's
- `plane_sweep`         a plane sweep over the sources' *central* views: what MVSNet and its kin see
- `copied_field`        views warped with the centre's disparity copied to every view, instead of a disparity
  field

All return float32 [H, W] on the target's grid, or views.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lfrig.processing.geometry import project, projection
from lfrig.processing.kernels.sgm import aggregate, finest_unit
from lfrig.processing.kernels.warp import warp_views
from lfrig.processing.model import F32, U8, Camera, LightField, LightFieldRequest, Photo, Pose, Source
from lfrig.processing.synthesis import fill_nan, view_offsets

SGBM_FRACTION = 16
"""StereoSGBM counts disparities in sixteenths of a pixel."""


@dataclass(frozen=True)
class SgbmSettings:
    """Settings of `sgbm_disparity`; ``pairs`` "row" matches the outermost views of the middle row, "cross"
    the centre with the outermost view of each of the four directions and takes the median.
    """

    upsampling: int = 2
    block_px: int = 3
    p1: int = 60
    p2: int = 400
    uniqueness: int = 5
    left_right_px: int = 1
    median_px: int = 5
    pairs: str = "cross"


BEST_SGBM = SgbmSettings()


@dataclass(frozen=True)
class SweepSettings:
    """Settings of `plane_sweep`: ZNCC over ``window_px``², the mean over the best ``keep`` of the sources,
    SGM.
    """

    planes: int = 128
    window_px: int = 5
    keep: float = 0.5
    p1: float = 0.4
    p2: float = 4.0
    edge_grey: float = 30.0


BEST_SWEEP = SweepSettings()


def sgbm_disparity(
    light_field: LightField, disparity_range: tuple[float, float], settings: SgbmSettings = BEST_SGBM
) -> F32:
    """Disparity of the centre view [px per view step], float32 [H, W], by StereoSGBM; NaN where it found
    none.

    Parameters
    ----------
    disparity_range : (lo, hi)
        Disparities to search [px per view step].
    """
    rows, cols = light_field.angular
    r0, c0 = light_field.centre_index
    if settings.pairs == "row":
        # From the leftmost to the rightmost view; the map is the left one's and is carried to the centre.
        views = light_field.views
        steps = cols - 1
        left = _match(views[r0, 0], views[r0, -1], steps, disparity_range, settings) / np.float32(steps)
        return _carry_across(left, float(c0))
    centre = light_field.centre_view
    found = []
    for turns, view, steps in (
        (0, light_field.views[r0, -1], cols - 1 - c0),
        (2, light_field.views[r0, 0], c0),
        (1, light_field.views[-1, c0], rows - 1 - r0),
        (3, light_field.views[0, c0], r0),
    ):
        # Turned so that the other view lies to the right of the centre.
        a, b = (np.ascontiguousarray(np.rot90(image, turns)) for image in (centre, view))
        disparity = _match(a, b, steps, disparity_range, settings) / np.float32(steps)
        found.append(np.rot90(disparity, -turns))
    with np.errstate(all="ignore"):
        import warnings

        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # a pixel that no pair matched stays NaN
            return np.asarray(np.nanmedian(np.stack(found), axis=0), np.float32)


def sgbm_in_target(
    sources: Sequence[Source],
    camera: Camera,
    pose: Pose,
    request: LightFieldRequest,
    settings: SgbmSettings = BEST_SGBM,
) -> F32:
    """SGBM disparity of every source, carried into the target, merged and filled from the far side.

    Where two sources agree within a tenth of a pixel they are averaged; elsewhere the nearer surface hides
    the other.
    """
    maps = []
    for source in sources:
        own = sgbm_disparity(source.light_field, _range(source), settings)
        maps.append(carry_to_target(source, own, camera, pose))
    return _filled(request.disparity(merge(maps, 0.1 / (request.baseline_m * camera.focal_px)), camera.focal_px))


def copied_disparity(sources: Sequence[Source], camera: Camera, pose: Pose, request: LightFieldRequest) -> F32:
    """The disparity map of the source nearest by direction, rescaled to the request, taken for the
    target's.
    """
    import cv2

    nearest = max(sources, key=lambda s: float(s.pose.direction @ pose.direction))
    inverse_depth = nearest.scale.inverse_depth(nearest.evidence.disparity)
    size = (camera.width, camera.height)
    return request.disparity(np.asarray(cv2.resize(inverse_depth, size), np.float32), camera.focal_px)


def plane_sweep(
    sources: Sequence[Source],
    target: Photo,
    camera: Camera,
    pose: Pose,
    inverse_depth_range: tuple[float, float],
    request: LightFieldRequest,
    settings: SweepSettings = BEST_SWEEP,
    *,
    threads: int = 0,
) -> F32:
    """Multi-view stereo of the photo against the sources' central views: ZNCC on planes uniform in inverse
    depth, semi-global aggregation, parabola through the best plane.
    """
    import cv2

    w0, w1 = inverse_depth_range
    dw = (w1 - w0) / (settings.planes - 1)
    ys, xs = np.mgrid[0 : camera.height, 0 : camera.width].astype(np.float32)
    photo = _grey(target.image8)
    views = [(_grey(s.light_field.centre_view), *projection(camera, pose, s.camera, s.pose)) for s in sources]
    cost = np.empty((camera.height, camera.width, settings.planes), np.float32)
    keep = max(1, round(settings.keep * len(views)))
    for k in range(settings.planes):
        plane = np.full_like(xs, w0 + k * dw)
        each = []
        for grey, matrix, offset in views:
            u, v, _ = (np.nan_to_num(a, nan=-9e3) for a in project(matrix, offset, xs, ys, plane))
            warped = cv2.remap(grey, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=-1e3)
            similarity = zncc(photo, np.asarray(warped, np.float32), settings.window_px)
            each.append(np.where(warped < 0, np.float32(0), similarity))
        cost[..., k] = 1 - np.sort(np.stack(each), axis=0)[-keep:].mean(0)
    unit = finest_unit(2.0, settings.p1, settings.p2)
    total = aggregate(
        np.rint(cost * unit).astype(np.uint16), target.image8, unit * settings.p1, unit * settings.p2,
        settings.edge_grey, threads=threads,
    ).astype(np.float32)  # fmt: skip
    return request.disparity(np.asarray(w0 + dw * _parabola(total), np.float32), camera.focal_px)


def copied_field(image: U8, disparity: F32, rows: int, cols: int, *, threads: int = 0) -> U8:
    """Views [rows, cols, H, W, 3] gathered with the *centre's* disparity at every view (the paper's
    ablation).
    """
    offsets = np.array(view_offsets(rows, cols), np.float32)
    fields = np.broadcast_to(disparity, (len(offsets), *disparity.shape))
    views = warp_views(image, np.ascontiguousarray(fields), offsets, threads=threads)
    return np.asarray(views, np.uint8).reshape(rows, cols, *image.shape)


def carry_to_target(source: Source, disparity: F32, camera: Camera, pose: Pose) -> F32:
    """Inverse depth [1/m] on the target's grid from a source's disparity map: every pixel splatted at twice
    the density, the nearest kept; NaN where nothing lands.
    """
    import cv2

    size = (2 * source.camera.width, 2 * source.camera.height)
    dense = cv2.resize(disparity, size, interpolation=cv2.INTER_NEAREST)
    ys, xs = np.mgrid[0 : size[1], 0 : size[0]].astype(np.float32)
    inverse_depth = source.scale.inverse_depth(dense)
    matrix, offset = projection(source.camera, source.pose, camera, pose)
    u, v, w = project(matrix, offset, (xs - 0.5) / 2, (ys - 0.5) / 2, inverse_depth)
    return _splat(u, v, w, (camera.height, camera.width))


def merge(maps: Sequence[F32], agree: float) -> F32:
    """One map [1/m] from several: the mean of those that agree with the nearest surface within ``agree``."""
    stack = np.stack(maps)
    nearest = np.where(np.isfinite(stack), stack, -np.inf).max(0)
    with np.errstate(invalid="ignore"):
        agreeing = np.abs(stack - nearest) < agree
    count = agreeing.sum(0)
    total = np.where(agreeing, stack, 0).sum(0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(count > 0, total / count, np.nan), np.float32)


def zncc(a: F32, b: F32, window_px: int) -> F32:
    """Zero-mean normalised cross-correlation of two pictures over a box, float32 [H, W] in −1..1; 0 where
    flat.
    """
    import cv2

    def mean(x: F32) -> F32:
        return np.asarray(cv2.boxFilter(x, -1, (window_px, window_px)), np.float32)

    a, b = a - np.float32(128), b - np.float32(128)
    mean_a, mean_b = mean(a), mean(b)
    covariance = mean(a * b) - mean_a * mean_b
    product = np.maximum(mean(a * a) - mean_a**2, 0) * np.maximum(mean(b * b) - mean_b**2, 0)
    return np.asarray(np.clip(covariance / np.sqrt(product + 1.0), -1, 1), np.float32)


def _match(left: U8, right: U8, steps: int, limits: tuple[float, float], settings: SgbmSettings) -> F32:
    """Disparity [px] of ``left`` against ``right``, a view ``steps`` to its right; NaN where there is
    none.
    """
    import cv2

    up = settings.upsampling
    lo, hi = int(np.floor(limits[0] * steps * up)), int(np.ceil(limits[1] * steps * up))
    count = 16 * max(1, -(-(hi - lo + 1) // 16))
    # StereoSGBM leaves out the columns whose candidates lie beyond the frame: a replicated margin keeps them
    # in.
    margin = max(abs(lo), abs(lo + count)) + settings.block_px
    size = (left.shape[1] * up, left.shape[0] * up)
    a, b = (
        cv2.copyMakeBorder(
            cv2.resize(image, size, interpolation=cv2.INTER_CUBIC), 0, 0, margin, margin, cv2.BORDER_REPLICATE
        )
        for image in (left, right)
    )
    matcher = cv2.StereoSGBM.create(
        minDisparity=lo, numDisparities=count, blockSize=settings.block_px, P1=settings.p1, P2=settings.p2,
        uniquenessRatio=settings.uniqueness, disp12MaxDiff=settings.left_right_px * up,
        mode=cv2.STEREO_SGBM_MODE_HH,
    )  # fmt: skip
    raw = matcher.compute(a, b)[:, margin:-margin].astype(np.float32) / SGBM_FRACTION
    raw[raw < lo] = np.nan
    filled = fill_nan(raw) if np.isfinite(raw).any() else raw
    # Back to the pixels of the view: the middle of each up × up block.
    small = cv2.resize(filled, (left.shape[1], left.shape[0]), interpolation=cv2.INTER_AREA) / np.float32(up)
    if settings.median_px > 1:
        small = cv2.medianBlur(small, settings.median_px)
    return np.asarray(small, np.float32)


def _carry_across(disparity: F32, steps: float) -> F32:
    """A view's own disparity map moved to the view ``steps`` to its right; NaN where nothing lands."""
    ys, xs = np.mgrid[0 : disparity.shape[0], 0 : disparity.shape[1]].astype(np.float32)
    return _splat(xs - np.float32(steps) * disparity, ys, disparity, (disparity.shape[0], disparity.shape[1]))


def _splat(x: F32, y: F32, values: F32, shape: tuple[int, int]) -> F32:
    """The largest value that lands on each pixel, float32 [H, W]; NaN where none does."""
    known = np.isfinite(x) & np.isfinite(y) & np.isfinite(values)
    xi, yi = np.rint(x[known]).astype(np.int64), np.rint(y[known]).astype(np.int64)
    inside = (xi >= 0) & (yi >= 0) & (xi < shape[1]) & (yi < shape[0])
    out = np.full(shape[0] * shape[1], -np.inf, np.float32)
    np.maximum.at(out, yi[inside] * shape[1] + xi[inside], values[known][inside])
    out[np.isneginf(out)] = np.nan
    return out.reshape(shape)


def _range(source: Source) -> tuple[float, float]:
    first, step = source.evidence.planes_px
    return first, first + step * (source.evidence.planes - 1)


def _filled(disparity: F32) -> F32:
    import cv2

    return np.asarray(cv2.medianBlur(fill_nan(disparity), 5), np.float32)


def _grey(image: U8) -> F32:
    import cv2

    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.float32)


def _parabola(cost: F32) -> F32:
    """Index of the smallest cost along the last axis, refined by the parabola through its neighbours."""
    best = np.clip(cost.argmin(2), 1, cost.shape[2] - 2)
    before, at, after = (np.take_along_axis(cost, (best + step)[..., None], 2)[..., 0] for step in (-1, 0, 1))
    curvature = before - 2 * at + after
    with np.errstate(divide="ignore", invalid="ignore"):
        shift = np.where(curvature > 1e-9, 0.5 * (before - after) / curvature, 0)
    return np.asarray(best + np.clip(shift, -0.5, 0.5), np.float32)
