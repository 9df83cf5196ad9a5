"""Image patches around points: cut, compared, and aligned to a fraction of a pixel.

Gauss–Newton on the translation of a patch under a known affine map, with brightness gain and offset removed (Lucas &
Kanade 1981; Shi & Tomasi 1994; Evangelidis & Psarakis 2008 for the normalised correlation).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfrig.processing.model import F32, F64
from lfrig.processing.patch import slopes

WINDOW_SIGMA = 0.6
"""Width of a patch's Gaussian weight, as a fraction of its half width."""

ALIGN_HALF_PX = 6
SHIFT_PASSES = 2
SLANT_PASSES = 3
SLANT_RIDGE = 0.01
MAX_STEP_PX = 1.5
NORMALISE_SIGMA_PX = 6.0


@dataclass(frozen=True)
class Patches:
    """Square patches of one image: ``grey``, and its slopes, float32 [N, K]; the pixels' offsets ``dx``, ``dy`` and
    Gaussian ``weight`` (sum 1), float32 [K].
    """

    grey: F32
    slope_x: F32
    slope_y: F32
    dx: F32
    dy: F32
    weight: F32

    def sample(self, picture: F32, xy: F64) -> F32:
        """The same window in another image around points [N, 2], float32 [N, K]."""
        return sample(picture, xy[:, :1] + self.dx, xy[:, 1:] + self.dy)


def sample(picture: F32, x: NDArray[np.floating], y: NDArray[np.floating]) -> F32:
    """Bilinear values of an image float32 [H, W] at pixels, any shape [A, B]; the border is replicated."""
    import cv2

    if not x.size:
        return np.zeros(x.shape, np.float32)
    u, v = np.ascontiguousarray(x, np.float32), np.ascontiguousarray(y, np.float32)
    return np.asarray(cv2.remap(picture, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32)


def sample_points(picture: F32, xy: F64) -> F32:
    """Bilinear values at points [N, 2], float32 [N]."""
    return sample(picture, xy[:, :1], xy[:, 1:])[:, 0]


def window(half: int) -> tuple[F32, F32, F32]:
    """Offsets dx, dy and weights of a patch of (2 half + 1)² pixels, float32 [K]."""
    g = np.arange(-half, half + 1, dtype=np.float32)
    dx, dy = (m.ravel() for m in np.meshgrid(g, g))
    weight = np.exp(-(dx**2 + dy**2) / (2 * (WINDOW_SIGMA * half) ** 2))
    return dx, dy, np.asarray(weight / weight.sum(), np.float32)


def cut(picture: F32, xy: F64, half: int) -> Patches:
    """Patches of half width ``half`` around points [N, 2]."""
    dx, dy, weight = window(half)
    x, y = xy[:, :1] + dx, xy[:, 1:] + dy
    slope_x, slope_y = slopes(picture)
    return Patches(sample(picture, x, y), sample(slope_x, x, y), sample(slope_y, x, y), dx, dy, weight)


def normalised(grey: F32) -> NDArray[np.uint8]:
    """The image without local brightness and contrast, uint8 [H, W] around 128: what exposure cannot change."""
    import cv2

    blur = (0, 0), NORMALISE_SIGMA_PX
    mean = cv2.GaussianBlur(grey, *blur)
    variance = np.maximum(cv2.GaussianBlur(grey * grey, *blur) - mean * mean, 0)
    even = np.clip((grey - mean) / np.sqrt(variance + 9) * 48 + 128, 0, 255)
    return np.asarray(even, np.uint8)


def align(first: F32, second: F32, first_xy: F64, second_xy: F64, affine: F64, along: F64) -> tuple[F64, F32]:
    """Move points of the second image so that the patches around them look like those of the first.

    Two unknowns at first, the shift; then also the slant of the surface, which stretches a patch along its epipolar
    line: a slant taken from a light field's depth, whose baseline is a hundred times shorter, is too rough for the
    second decimal.

    Parameters
    ----------
    first, second : float32 [H, W]
        Grey images.
    first_xy, second_xy : float64 [N, 2]
        Points, and where to start.
    affine : float64 [N, 2, 2]
        Derivative of second by first pixel coordinates.
    along : float64 [N, 2]
        Direction in which a point moves with its depth, unit vectors.

    Returns
    -------
    float64 [N, 2], float32 [N]
        The points in the second image, and the normalised correlation there.
    """
    dx, dy, weight = window(ALIGN_HALF_PX)
    reference = _standard(sample(first, first_xy[:, :1] + dx, first_xy[:, 1:] + dy), weight)[0]
    slope = slopes(second)
    xy, stretch = second_xy.copy(), np.zeros((len(first_xy), 2))
    for done in range(SHIFT_PASSES + SLANT_PASSES + 1):
        full = affine + along[:, :, None] * stretch[:, None, :]
        u = (xy[:, :1] + full[:, 0, :1] * dx + full[:, 0, 1:] * dy).astype(np.float32)
        v = (xy[:, 1:] + full[:, 1, :1] * dx + full[:, 1, 1:] * dy).astype(np.float32)
        there, contrast = _standard(sample(second, u, v), weight)
        if done == SHIFT_PASSES + SLANT_PASSES:
            break
        gx, gy = (sample(s, u, v) / contrast for s in slope)
        columns = [gx, gy]
        if done >= SHIFT_PASSES:
            moving = gx * along[:, :1].astype(np.float32) + gy * along[:, 1:].astype(np.float32)
            columns += [moving * dx, moving * dy]
        jacobian = np.stack([_centred(c, weight) for c in columns], 1)
        weighted = jacobian * weight
        normal = (weighted @ jacobian.transpose(0, 2, 1)).astype(np.float64)
        normal += np.diag([1e-6, 1e-6, SLANT_RIDGE, SLANT_RIDGE][: len(columns)])
        right = np.einsum("nak,nk->na", weighted, there - reference).astype(np.float64)
        if done >= SHIFT_PASSES:
            right[:, 2:] += SLANT_RIDGE * stretch
        step = -np.linalg.solve(normal, right[..., None])[..., 0]
        length = np.linalg.norm(step[:, :2], axis=1, keepdims=True)
        step *= np.minimum(1, MAX_STEP_PX / np.maximum(length, 1e-6))
        xy += step[:, :2]
        if done >= SHIFT_PASSES:
            stretch += step[:, 2:]
    return xy, np.asarray(np.einsum("nk,nk,k->n", there, reference, weight), np.float32)


def _centred(values: F32, weight: F32) -> F32:
    return np.asarray(values - (values * weight).sum(1, keepdims=True), np.float32)


def _standard(values: F32, weight: F32) -> tuple[F32, F32]:
    """Patches without mean and of unit contrast; and the contrast [N, 1]."""
    values = _centred(values, weight)
    contrast = np.sqrt((values * values * weight).sum(1, keepdims=True)) + np.float32(1e-3)
    return np.asarray(values / contrast, np.float32), np.asarray(contrast, np.float32)
