"""Wide-baseline matching in a narrow band: the photo against the sources, slanted, bilateral, zero-mean.

For every pixel and every label k the patch around it, tilted like the surface there, is carried into a source at
inverse depth ``w(x, y) + (k − K/2)·step`` and compared by weighted zero-mean normalised cross-correlation. Weights fall
with colour difference (Yoon & Kweon, PAMI 2006) and distance. ``noise`` is added to both variances, so that what
is no texture but noise correlates with nothing.

Patches overlap, so a source is read once per pixel and label: as a row of slots along the pixel's epipolar line, one
label apart, centred on its own inverse depth. A patch reads the rows of its pixels, each shifted by where the patch's
plane passes that pixel, between slots linearly. Where that is more than `REACH` labels away the pixel does not count:
it belongs to another surface. C++ form: ``band_cost.cpp``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.native import load_native
from lfrig.processing.model import F32, F64, U8

U16 = NDArray[np.uint16]

UNIT = 2048
"""A cost of 1 in the fixed point of the result."""
REACH = 8
"""Labels beyond the band on both sides that a pixel's row holds."""
LEAST_VISIBLE = 0.01
"""Share of visibility below which a source is not asked."""


@dataclass(frozen=True)
class Patch:
    """The window: radius and stride [px], colour scale (sum of absolute RGB differences) and the cost at which a label
    says nothing.
    """

    radius: int = 4
    stride: int = 2
    sigma_grey: float = 40.0
    cap: float = 1.0

    @property
    def taps(self) -> list[tuple[int, int]]:
        """Offsets (dx, dy) [px] that are compared: every other place of the grid, like one colour of a chessboard."""
        places = range(-self.radius, self.radius + 1, self.stride)
        return [(dx, dy) for i, dy in enumerate(places) for j, dx in enumerate(places) if (i + j) % 2 == 0]


@dataclass(frozen=True)
class View:
    """What a source shows: ``grey`` float32 [Hs, Ws], grey levels 0..255 of its centre view, which count as whole ones;
    ``visible`` float32 [H, W], how far it sees the surface, 0..1; ``projection`` (A, b), float64 [3, 3] and [3], of
    photo pixels into it (`geometry.projection`); ``noise``, the variance that counts as no texture [grey levels²].
    """

    grey: F32
    visible: F32
    projection: tuple[F64, F64]
    noise: float = 1.0

    @property
    def flat(self) -> F32:
        """A row by row, then b, float32 [12]."""
        return np.ascontiguousarray(np.r_[self.projection[0].ravel(), self.projection[1]], np.float32)


def band_cost(
    photo: F32,
    guide: U8,
    views: Sequence[View],
    surface: tuple[F32, F32, F32],
    step: float,
    labels: int,
    patch: Patch,
    *,
    least_visible: float = LEAST_VISIBLE,
    unit: int = UNIT,
    threads: int = 0,
) -> U16:
    """Matching cost of every label, the mean over the sources, weighted by how far each sees the surface.

    Parameters
    ----------
    photo : float32 [H, W]
        Grey levels 0..255.
    guide : uint8 [H, W, 3]
        The photo's colours.
    surface : (w, gx, gy), float32 [H, W] each
        Inverse depth [1/m] of the middle label and its slopes per pixel.
    step : float
        Between labels [1/m].
    labels : int
        K, at most 128.
    least_visible : float
        Sources that see a pixel no better are not compared there; −1 compares all everywhere.
    unit : int
        A cost of 1 in fixed point.

    Returns
    -------
    uint16 [H, W, K], ``min(1 − ZNCC, cap)`` in 1 / ``unit``; the cap where no source shows the point.
    """
    shape = photo.shape
    if guide.shape != (*shape, 3) or any(part.shape != shape for part in (*surface, *(v.visible for v in views))):
        raise ValueError(f"shapes do not match: photo {shape}, guide {guide.shape}")
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        return band_cost_numpy(photo, guide, views, surface, step, labels, patch, least_visible, unit)
    out = np.empty((*shape, labels), np.uint16)
    native.band_cost(
        np.ascontiguousarray(photo), np.ascontiguousarray(guide), [np.ascontiguousarray(v.grey) for v in views],
        [np.ascontiguousarray(v.visible) for v in views], [v.flat for v in views], [v.noise for v in views],
        *(np.ascontiguousarray(part) for part in surface), step, patch.radius, patch.stride, REACH, patch.sigma_grey,
        patch.cap, least_visible, unit, out, threads,
    )  # fmt: skip
    return out


def band_cost_numpy(
    photo: F32,
    guide: U8,
    views: Sequence[View],
    surface: tuple[F32, F32, F32],
    step: float,
    labels: int,
    patch: Patch,
    least_visible: float,
    unit: int,
) -> U16:
    """NumPy twin."""
    taps = list(_taps(photo, guide, surface, np.float32(step), patch))
    with np.errstate(divide="ignore", invalid="ignore"):
        mass = sum(tap.weight for tap in taps)
        mean = sum(tap.weight * tap.grey for tap in taps) / mass
        own = sum(tap.weight * (tap.grey - mean) ** 2 for tap in taps) / mass
    total = np.zeros((*photo.shape, labels), np.float32)
    seen = np.zeros_like(photo)
    for view in views:
        weight = np.where(view.visible > least_visible, view.visible, np.float32(0))
        cost = _cost_in(view, taps, (np.asarray(mass), np.asarray(mean), np.asarray(own)), surface[0], step, labels)
        total += weight[..., None] * np.where(cost < patch.cap, cost, np.float32(patch.cap))
        seen += weight
    with np.errstate(divide="ignore", invalid="ignore"):
        total /= seen[..., None]
    total[~(seen > 0)] = patch.cap
    return np.asarray(total * np.float32(unit) + np.float32(0.5), np.uint16)


@dataclass(frozen=True)
class _Tap:
    """A pixel of every patch, [H, W] each: its weight and grey level, where it is, and where its row is read: slot and
    fraction for label 0.
    """

    weight: F32
    grey: F32
    y: NDArray[np.int64]
    x: NDArray[np.int64]
    slot: NDArray[np.int64]
    fraction: F32


def _taps(photo: F32, guide: U8, surface: tuple[F32, F32, F32], step: np.float32, patch: Patch) -> list[_Tap]:
    """Those outside the frame, or whose row does not reach the plane, weigh nothing."""
    height, width = photo.shape
    colour = guide.astype(np.float32)
    ys, xs = np.mgrid[0:height, 0:width]
    w, gx, gy = surface
    found = []
    for dx, dy in patch.taps:
        y, x = np.clip(ys + dy, 0, height - 1), np.clip(xs + dx, 0, width - 1)
        with np.errstate(over="ignore", invalid="ignore"):
            at = (w + gx * np.float32(dx) + gy * np.float32(dy) - w[y, x]) / step + np.float32(REACH)
            counts = (ys + dy == y) & (xs + dx == x) & (at >= 0) & (at < 2 * REACH)
        at = np.where(counts, at, np.float32(0))
        off = np.abs(colour[y, x] - colour).sum(2) / np.float32(patch.sigma_grey)
        off += np.float32((dx * dx + dy * dy) / (1.5 * patch.radius**2))
        weight = np.asarray(np.exp(-off) * counts, np.float32)
        slot = at.astype(np.int64)
        found.append(_Tap(weight, photo[y, x], y, x, slot, np.asarray(at - slot, np.float32)))
    return found


def _cost_in(view: View, taps: Sequence[_Tap], own: tuple[F32, F32, F32], w: F32, step: float, labels: int) -> F32:
    """1 − ZNCC in one source, float32 [H, W, K]; NaN where it does not show the point. ``own``: mass, mean and variance
    of the photo's patches.
    """
    a, b = view.flat[:9].reshape(3, 3), view.flat[9:]
    ys, xs = np.mgrid[0 : w.shape[0], 0 : w.shape[1]].astype(np.float32)
    grey = np.floor(np.clip(np.nan_to_num(view.grey, nan=0.0) + np.float32(0.5), 0, 255))
    rows = np.empty((*w.shape, labels + 2 * REACH), np.float32)
    shown = np.zeros(rows.shape, bool)
    for k in range(rows.shape[2]):
        u, v, z = _carry(a, b, xs, ys, w + np.float32((k - REACH - labels // 2) * step))
        rows[..., k] = _bilinear(grey, u, v)
        size = view.grey.shape
        shown[..., k] = (z > 1e-6) & (u >= 0) & (v >= 0) & (u <= size[1] - 1) & (v <= size[0] - 1)
    mass, mean, variance = own
    cost = np.full((*w.shape, labels), np.nan, np.float32)
    for k in range(labels):
        first, second, cross = (np.zeros_like(w) for _ in range(3))
        for tap in taps:
            before, after = (rows[tap.y, tap.x, tap.slot + k + i] for i in (0, 1))
            value = before + tap.fraction * (after - before)
            first += tap.weight * value
            second += tap.weight * value * value
            cross += tap.weight * (tap.grey - mean) * value
        with np.errstate(divide="ignore", invalid="ignore"):
            other = np.maximum(second / mass - (first / mass) ** 2, 0) + np.float32(view.noise)
            correlation = cross / mass / np.sqrt(other * (variance + np.float32(view.noise)))
        cost[..., k] = np.where(shown[..., REACH + k], 1 - correlation, np.float32(np.nan))
    return cost


def _carry(a: F32, b: F32, xs: F32, ys: F32, w: F32) -> tuple[F32, F32, F32]:
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        z = a[2, 0] * xs + a[2, 1] * ys + a[2, 2] + b[2] * w
        u = (a[0, 0] * xs + a[0, 1] * ys + a[0, 2] + b[0] * w) / z
        v = (a[1, 0] * xs + a[1, 1] * ys + a[1, 2] + b[1] * w) / z
    return u, v, z


def _bilinear(image: F32, u: F32, v: F32) -> F32:
    height, width = image.shape
    u = np.clip(np.nan_to_num(u, nan=0.0), 0, np.float32(width - 1.001)).astype(np.float32)
    v = np.clip(np.nan_to_num(v, nan=0.0), 0, np.float32(height - 1.001)).astype(np.float32)
    iu, iv = u.astype(np.int64), v.astype(np.int64)
    fu, fv = u - iu, v - iv
    top = image[iv, iu] + fu * (image[iv, iu + 1] - image[iv, iu])
    low = image[iv + 1, iu] + fu * (image[iv + 1, iu + 1] - image[iv + 1, iu])
    return np.asarray(top + fv * (low - top), np.float32)
