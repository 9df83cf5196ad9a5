"""Evidence of colour in the target's frustum: does a source show the photo's colour where a voxel lies?

A voxel that a source sees in another colour than the photo's is refuted, one in the same colour supported; where the
source's own surface hides it, or outside its frame, nothing is said. The light fields' disparities leave a ray that
passes behind an object, or where no source sees anything, to chance; this term knows that a ray cannot end in
empty space. C++ form: ``colour_evidence.cpp``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lfrig.contracts.native import load_native
from lfrig.processing.model import F32, F64, ScaleFit

SATURATED = np.float32(0.02)
"""Share of saturated pixels in the blur from which on a value is a lower bound only."""


@dataclass(frozen=True)
class ColourTerm:
    """A voxel gets ``weight · seen · (unknown − min(difference / sigma_grey, cap))``."""

    weight: float
    sigma_grey: float
    cap: float
    unknown: float
    margin_px: float


def add_colour_evidence(
    volume: F32,
    photo: F32,
    image: F32,
    disparity: F32,
    scale: ScaleFit,
    projection: tuple[F64, F64],
    planes: tuple[float, float],
    term: ColourTerm,
    *,
    threads: int = 0,
) -> None:
    """Add one source's term to ``volume`` float32 [H, W, N] in place.

    Parameters
    ----------
    photo, image : float32 [H, W, 4] and [Hs, Ws, 4]
        Colours in grey levels, equally blurred and matched (`tone.match`), and the share of saturated pixels.
    disparity : float32 [Hs, Ws]
        The source's own surface [px per view step].
    projection : (A, b)
        `geometry.projection` from target to source.
    planes : (w0, dw)
        Target planes [1/m].
    """
    matrix, offset = projection
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        _add_numpy(volume, photo, image, disparity, scale, projection, planes, term)
        return
    numbers = np.r_[
        matrix.ravel(), offset, scale.a, scale.c, term.margin_px, term.weight, term.sigma_grey, term.cap, term.unknown
    ].astype(np.float32)
    native.colour_evidence(
        np.ascontiguousarray(photo), np.ascontiguousarray(image), np.ascontiguousarray(disparity), numbers, *planes,
        volume, threads,
    )  # fmt: skip


def _add_numpy(
    volume: F32,
    photo: F32,
    image: F32,
    disparity: F32,
    scale: ScaleFit,
    projection: tuple[F64, F64],
    planes: tuple[float, float],
    term: ColourTerm,
) -> None:
    """NumPy twin, plane by plane."""
    height, width, count = volume.shape
    a, b = (part.astype(np.float32) for part in projection)
    ys, xs = np.mgrid[0:height, 0:width].astype(np.float32)
    px, py, pz = (a[i, 0] * xs + a[i, 1] * ys + a[i, 2] for i in range(3))
    right, bottom = np.float32(image.shape[1] - 1), np.float32(image.shape[0] - 1)
    for k in range(count):
        w = np.float32(planes[0] + planes[1] * k)
        z = pz + b[2] * w
        inverse = np.where(z > 1e-6, 1 / np.maximum(z, np.float32(1e-6)), np.float32(0))
        u, v = (px + b[0] * w) * inverse, (py + b[1] * w) * inverse
        inside = (z > 1e-6) & (u >= 0) & (v >= 0) & (u < right) & (v < bottom)
        u, v = u[inside], v[inside]
        delta = (w * inverse[inside] - np.float32(scale.c)) / np.float32(scale.a)
        seen = disparity[(v + 0.5).astype(np.int64), (u + 0.5).astype(np.int64)]
        margin = np.float32(term.margin_px)
        hidden = np.clip((seen - delta - margin) / (np.float32(0.5) * margin), 0, 1)
        cost = np.minimum(_mismatch(photo[inside], _sample(image, u, v)) / np.float32(term.sigma_grey), term.cap)
        volume[:, :, k][inside] += np.float32(term.weight) * (1 - hidden) * (np.float32(term.unknown) - cost)


def _mismatch(photo: F32, colour: F32) -> F32:
    """Mean difference of colours [M, 4]; saturated values are lower bounds: being brighter says nothing."""
    under, over = colour[:, 3:] <= SATURATED, photo[:, 3:] <= SATURATED
    rise = photo[:, :3] - colour[:, :3]
    return np.asarray(np.where(rise > 0, under * rise, over * -rise).mean(1), np.float32)


def _sample(image: F32, u: F32, v: F32) -> F32:
    iu, iv = u.astype(np.int64), v.astype(np.int64)
    fu, fv = (u - iu)[:, None], (v - iv)[:, None]
    top = image[iv, iu] + fu * (image[iv, iu + 1] - image[iv, iu])
    low = image[iv + 1, iu] + fu * (image[iv + 1, iu + 1] - image[iv + 1, iu])
    return np.asarray(top + fv * (low - top), np.float32)
