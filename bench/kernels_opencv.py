"""The kernels as OpenCV would do them, at its best: what a native form has to beat.

Each takes the arguments of the kernel's public function and gives what that gives, to the precision of OpenCV's own
interpolation; OpenCV uses as many threads as it was told.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lfrig.processing.kernels.fusion import ColourTerm, CostScale, FusedCost, Pool, SourceVolume, SurfaceRule
from lfrig.processing.kernels.grey import SCALE
from lfrig.processing.model import F32, F64, Evidence, Image, ScaleFit

Sampler = Callable[[int, float, float], NDArray[Any]]
"""(view, dx, dy) → the view moved by that much [px]."""


def sweep_by_warps(
    grey: NDArray[np.int16], centre: NDArray[np.int16], offsets: F64, first: float, step: float, planes: int,
    truncation: float, **_: object,
) -> F32:  # fmt: skip
    """Plane sweep: one `cv2.warpAffine` of 8-bit views per view and plane, truncated differences summed."""
    height, width = centre.shape
    views = _eight_bits(grey)

    def moved(view: int, dx: float, dy: float) -> NDArray[Any]:
        map_ = np.array([[1, 0, dx], [0, 1, dy]])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        return np.asarray(
            cv2.warpAffine(views[view], map_, (width, height), flags=flags, borderMode=cv2.BORDER_REPLICATE)
        )

    return _sweep(moved, _eight_bits(centre), offsets, first, step, planes, truncation)


def sweep_by_rectangles(
    grey: NDArray[np.int16], centre: NDArray[np.int16], offsets: F64, first: float, step: float, planes: int,
    truncation: float, **_: object,
) -> F32:  # fmt: skip
    """The same with `cv2.getRectSubPix`, which knows that a shift is the same for all pixels."""
    height, width = centre.shape
    views = _eight_bits(grey)

    def moved(view: int, dx: float, dy: float) -> NDArray[Any]:
        middle = (width - 1) / 2 + dx, (height - 1) / 2 + dy
        return np.asarray(cv2.getRectSubPix(views[view], (width, height), middle))

    return _sweep(moved, _eight_bits(centre), offsets, first, step, planes, truncation)


def _eight_bits(grey: NDArray[np.int16]) -> NDArray[np.uint8]:
    return ((grey + SCALE // 2) // SCALE).astype(np.uint8)


def _sweep(
    moved: Sampler, centre: NDArray[np.uint8], offsets: F64, first: float, step: float, planes: int, truncation: float
) -> F32:
    out = np.empty((planes, *centre.shape), np.float32)
    for k in range(planes):
        delta = first + step * k
        total = np.zeros(centre.shape, np.uint16)
        for view, (dr, dc) in enumerate(offsets):
            difference = cv2.absdiff(moved(view, -dc * delta, -dr * delta), centre)
            _, difference = cv2.threshold(difference, truncation, 255, cv2.THRESH_TRUNC)
            cv2.add(total, difference, total, dtype=cv2.CV_16U)
        out[k] = cv2.blur(total.astype(np.float32), (3, 3), borderType=cv2.BORDER_REPLICATE)
    out *= np.float32(1 / len(offsets))
    return np.ascontiguousarray(np.moveaxis(out, 0, 2))


def warp_by_remap(image: Image, fields: F32, offsets: F32, **_: object) -> Image:
    """49-view warp: one bicubic `cv2.remap` per view."""
    height, width = image.shape[:2]
    ys, xs = np.mgrid[0:height, 0:width].astype(np.float32)
    out = np.empty((len(fields), *image.shape), image.dtype)
    for view, field, (dr, dc) in zip(out, fields, offsets, strict=True):
        map_x, map_y = cv2.scaleAdd(field, float(dc), xs), cv2.scaleAdd(field, float(dr), ys)
        cv2.remap(image, map_x, map_y, cv2.INTER_CUBIC, dst=view, borderMode=cv2.BORDER_REPLICATE)
    return out


MOSAIC_COLUMNS = 16
RIM_PX = 1e-3
"""As the kernels have it: a ray that meets the frame's rim to within rounding is inside."""
SATURATED = 0.02
"""Share of saturated pixels from which on a colour is a lower bound only."""


@functools.lru_cache(maxsize=1)
def _mosaic_of(evidence: _ById) -> NDArray[np.uint16]:
    """A probability volume [H, W, D] as one picture, plane beside plane: `cv2.remap` reads pictures only."""
    volume = evidence.value.probability
    height, width, planes = volume.shape
    rows = -(-planes // MOSAIC_COLUMNS)
    mosaic = np.zeros((rows * height, MOSAIC_COLUMNS * width), np.uint16)
    for k in range(planes):
        row, column = divmod(k, MOSAIC_COLUMNS)
        mosaic[row * height : (row + 1) * height, column * width : (column + 1) * width] = volume[:, :, k]
    return mosaic


class _ById:
    """A key for arrays: the same evidence is the same mosaic."""

    def __init__(self, value: Evidence) -> None:
        self.value = value

    def __hash__(self) -> int:
        return id(self.value)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _ById) and other.value is self.value


def fuse_by_remap(
    volume: F32, evidence: Evidence, scale: ScaleFit, matrix: F64, offset: F64, planes: tuple[float, float], *,
    floor_share: float, margin_px: float,
) -> int:  # fmt: skip
    """Log-pool fusion of one source: two bilinear `cv2.remap` per target plane, joined along the source's planes.

    The mosaic is made once per source, which is not charged.
    """
    height, width, count = volume.shape
    source_height, source_width = evidence.disparity.shape
    mosaic = _mosaic_of(_ById(evidence))
    ys, xs = np.mgrid[0:height, 0:width].astype(np.float32)
    a, b = matrix.astype(np.float32), offset.astype(np.float32)
    px, py, pz = (a[i, 0] * xs + a[i, 1] * ys + a[i, 2] for i in range(3))
    first, step = evidence.planes_px
    neutral, flat = -float(np.log(count)), floor_share / count
    right, bottom = source_width - 1 - RIM_PX, source_height - 1 - RIM_PX
    inside_total = 0
    for k in range(count):
        w = planes[0] + planes[1] * k
        inverse = 1 / cv2.max(pz + np.float32(b[2] * w), 1e-6)
        u, v = (px + np.float32(b[0] * w)) * inverse, (py + np.float32(b[1] * w)) * inverse
        inside = cv2.inRange(cv2.merge([u, v]), (-1e-3, -1e-3, 0, 0), (right + 2e-3, bottom + 2e-3, 0, 0))
        inside_total += cv2.countNonZero(inside)
        u, v = cv2.min(cv2.max(u, 0.0), right), cv2.min(cv2.max(v, 0.0), bottom)
        delta = inverse * np.float32(w / scale.a) - np.float32(scale.c / scale.a)
        p = _between_planes(mosaic, u, v, (delta - np.float32(first)) * np.float32(1 / step), evidence)
        stretch = cv2.min(pz * inverse * inverse * np.float32(abs(planes[1] / (scale.a * step))), 4.0)
        score = cv2.log(p * stretch * np.float32(1 - floor_share) + np.float32(flat))
        seen = cv2.remap(evidence.disparity, u, v, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
        hidden = cv2.min(cv2.max((seen - delta - np.float32(margin_px)) * np.float32(2 / margin_px), 0.0), 1.0)
        score += hidden * cv2.max(np.float32(neutral) - score, 0.0)
        score[inside == 0] = neutral
        volume[:, :, k] += score
    return inside_total


def colours_by_remap(
    volume: F32, photo: F32, image: F32, disparity: F32, scale: ScaleFit, projection: tuple[F64, F64],
    planes: tuple[float, float], *, weight: float, sigma_grey: float, cap: float, unknown: float, margin_px: float,
) -> None:  # fmt: skip
    """Colour evidence of one source: one bilinear `cv2.remap` of its four channels per target plane.

    Which planes of a ray are within reach of its best is known only when all sources' evidence is there, and OpenCV
    maps whole pictures: all of them are compared.
    """
    height, width, count = volume.shape
    right, bottom = image.shape[1] - 1.0, image.shape[0] - 1.0
    ys, xs = np.mgrid[0:height, 0:width].astype(np.float32)
    a, b = (part.astype(np.float32) for part in projection)
    px, py, pz = (a[i, 0] * xs + a[i, 1] * ys + a[i, 2] for i in range(3))
    own, over = np.ascontiguousarray(photo[..., :3]), (photo[..., 3:] <= SATURATED).astype(np.float32)
    for k in range(count):
        w = planes[0] + planes[1] * k
        inverse = 1 / cv2.max(pz + np.float32(b[2] * w), 1e-6)
        u, v = (px + np.float32(b[0] * w)) * inverse, (py + np.float32(b[1] * w)) * inverse
        inside = (u >= 0) & (v >= 0) & (u < right) & (v < bottom)
        colour = cv2.remap(image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        rise = own - colour[..., :3]
        under = (colour[..., 3:] <= SATURATED).astype(np.float32)
        mismatch = cv2.max(rise, 0.0) * under - cv2.min(rise, 0.0) * over
        cost = cv2.min(cv2.transform(mismatch, np.full((1, 3), 1 / 3 / sigma_grey)), cap)
        delta = inverse * np.float32(w / scale.a) - np.float32(scale.c / scale.a)
        seen = cv2.remap(disparity, u, v, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
        hidden = (seen - delta - np.float32(margin_px)) * np.float32(2 / margin_px)
        shown = 1 - cv2.min(cv2.max(hidden, 0.0), 1.0)
        volume[:, :, k] += np.float32(weight) * shown * (np.float32(unknown) - cost) * inside


def fuse_volume_by_remap(
    sources: Sequence[SourceVolume], shape: tuple[int, int, int], planes: tuple[float, float], pool: Pool, *,
    photo: NDArray[np.uint8] | None = None, colour: ColourTerm | None = None, surface: SurfaceRule | None = None,
    scale: CostScale = CostScale(), **_: object,  # noqa: B008 (frozen)
) -> FusedCost:  # fmt: skip
    """All of the fusion of several sources: evidence, colours, the first-surface rule, costs in fixed point."""
    # Of the kernel's modes the shipped one: log pool, visibility, exact map.
    assert pool.log_pool and not pool.literal and pool.margin_px is not None
    volume, inside = np.zeros(shape, np.float32), 0
    for source in sources:
        inside += fuse_by_remap(
            volume, source.evidence, source.scale, *source.projection, planes, floor_share=pool.floor_share,
            margin_px=pool.margin_px,
        )  # fmt: skip
    if photo is not None and colour is not None:
        gain, compared = np.zeros(shape, np.float32), _with_share(photo)
        for source in sources:
            assert source.colour is not None
            colours_by_remap(
                gain, compared, _with_share(source.colour), source.evidence.disparity, source.scale,
                source.projection, planes, weight=colour.weight, sigma_grey=colour.sigma_grey, cap=colour.cap,
                unknown=colour.unknown, margin_px=pool.margin_px,
            )  # fmt: skip
        gain[volume < volume.max(2, keepdims=True) - np.float32(colour.reach)] = 0
        volume += gain
    if surface is not None:
        neutral = -len(sources) * float(np.log(shape[2]))
        over = np.clip(np.float32(surface.beta) * (volume - np.float32(neutral + surface.tau)), 0, surface.cap)
        nearest = np.maximum.accumulate(over[:, :, ::-1], axis=2)[:, :, ::-1]
        volume[:, :, : shape[2] - surface.gap] -= nearest[:, :, surface.gap :]
    best = volume.max(2)
    cost = np.minimum(np.rint((best[..., None] - volume) / scale.unit), round(scale.cap / scale.unit))
    return FusedCost(cost.astype(np.uint16), best, inside, 0, 0, 0)


def _with_share(marked: NDArray[np.uint8]) -> F32:
    """Colours in grey levels and the share of saturated pixels 0..1, float32 [H, W, 4]."""
    return np.asarray(marked * np.array([1, 1, 1, 1 / 255], np.float32), np.float32)


def _between_planes(mosaic: NDArray[np.uint16], u: F32, v: F32, q: F32, evidence: Evidence) -> F32:
    """Probability at (v, u, q), trilinear; 0 outside the planes."""
    height, width, planes = evidence.probability.shape
    valid = (q >= 0) & (q < planes - 1)
    low = np.where(valid, q, 0).astype(np.int32)
    share = np.where(valid, q - low, 0).astype(np.float32)
    parts = []
    for plane in (low, low + 1):
        x, y = (plane % MOSAIC_COLUMNS) * width + u, (plane // MOSAIC_COLUMNS) * height + v
        part = cv2.remap(mosaic, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR)
        parts.append(part.astype(np.float32))
    return np.asarray(
        np.where(valid, (parts[0] + share * (parts[1] - parts[0])) * np.float32(1 / 65535), 0), np.float32
    )
