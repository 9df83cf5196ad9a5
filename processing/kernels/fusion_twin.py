"""NumPy twin of `fusion.fuse_volume`, plane by plane: the readable reference, and the fallback without native core."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfrig.processing.kernels.fusion import ColourTerm, CostScale, FusedCost, Pool, SourceVolume, SurfaceRule
from lfrig.processing.model import F32, U8

I64 = NDArray[np.int64]
RIM_PX = np.float32(1e-3)
"""A ray that meets the frame's rim to within rounding is inside, whichever way the rounding went."""
LEAST_MASS = np.float32(1.2e-38)
SATURATED = 5
"""Share of saturated pixels in the blur (/255) from which on a value is a lower bound only."""


def fuse_numpy(
    sources: Sequence[SourceVolume],
    shape: tuple[int, int, int],
    planes: tuple[float, float],
    pool: Pool,
    photo: U8 | None,
    colour: ColourTerm | None,
    surface: SurfaceRule | None,
    scale: CostScale,
) -> FusedCost:
    """Every voxel of every source; see `fusion.fuse_volume`."""
    evidence = np.zeros(shape, np.float32)
    inside = _pool_logs(evidence, sources, planes, pool) if pool.log_pool else _mean(evidence, sources, planes, pool)
    if photo is not None and colour is not None:
        _add_colours(evidence, sources, planes, pool, photo, colour)
    if surface is not None:
        hide_behind(evidence, -len(sources) * float(np.log(shape[2])), surface)
    counts = np.rint(evidence / np.float32(scale.unit))
    top = counts.max(2)
    cost = np.minimum(top[..., None] - counts, round(scale.cap / scale.unit)).astype(np.uint16)
    bricks = -(-shape[0] // 8) * -(-shape[1] // 8) * shape[2] * len(sources)
    return FusedCost(cost, np.asarray(top * np.float32(scale.unit), np.float32), inside, bricks, 0, 0)


@dataclass(frozen=True)
class _Places:
    """Where the rays lie in a source at one plane, for those inside its frame (bool [H, W]): u, v [px], index of its
    plane, 1 / ratio of depths; float32 [M].
    """

    inside: NDArray[np.bool_]
    u: F32
    v: F32
    q: F32
    inverse: F32


def _places(source: SourceVolume, shape: tuple[int, ...], w: np.float32, literal: bool) -> _Places:
    height, width = source.evidence.disparity.shape
    a, b = (part.astype(np.float32) for part in source.projection)
    ys, xs = np.mgrid[0 : shape[0], 0 : shape[1]].astype(np.float32)
    z = a[2, 0] * xs + a[2, 1] * ys + a[2, 2] + b[2] * w
    inverse = 1 / np.maximum(z, np.float32(1e-6))
    u = (a[0, 0] * xs + a[0, 1] * ys + a[0, 2] + b[0] * w) * inverse
    v = (a[1, 0] * xs + a[1, 1] * ys + a[1, 2] + b[1] * w) * inverse
    right, bottom = np.float32(width - 1), np.float32(height - 1)
    inside = (z > 1e-6) & (u > -RIM_PX) & (v > -RIM_PX) & (u < right + RIM_PX) & (v < bottom + RIM_PX)
    inside &= min(width, height) > 1
    inverse = inverse[inside]
    source_w = np.full_like(inverse, w) if literal else w * inverse
    first, step = (np.float32(x) for x in source.evidence.planes_px)
    delta = (source_w - np.float32(source.scale.c)) / np.float32(source.scale.a)
    return _Places(inside, np.clip(u[inside], 0, right), np.clip(v[inside], 0, bottom), (delta - first) / step, inverse)


def _pool_logs(evidence: F32, sources: Sequence[SourceVolume], planes: tuple[float, float], pool: Pool) -> int:
    """Sum of floored logs, each source made neutral where it sees nothing; returns the voxels inside."""
    count, total = evidence.shape[2], 0
    neutral, flat = np.float32(-np.log(count)), np.float32(pool.floor_share / count)
    ys, xs = np.mgrid[0 : evidence.shape[0], 0 : evidence.shape[1]].astype(np.float32)
    for source in sources:
        a = source.projection[0][2].astype(np.float32)
        z = np.abs(a[0] * xs + a[1] * ys + a[2])
        steps = np.float32(abs(planes[1] / (source.scale.a * source.evidence.planes_px[1])))
        for k in range(count):
            at = _places(source, evidence.shape, np.float32(planes[0] + planes[1] * k), pool.literal)
            stretch = np.minimum(np.float32(4), steps * z[at.inside] * at.inverse**2)
            mass = np.float32(1 - pool.floor_share) * _trilinear(source.evidence.probability, at) * stretch + flat
            score = np.log(np.maximum(mass, LEAST_MASS))
            if pool.margin_px is not None:
                score = np.maximum(score, score + _hidden(source, at, pool.margin_px) * (neutral - score))
            evidence[:, :, k][~at.inside] += neutral
            evidence[:, :, k][at.inside] += score
            total += int(at.inside.sum())
    return total


def _mean(evidence: F32, sources: Sequence[SourceVolume], planes: tuple[float, float], pool: Pool) -> int:
    """Log of the mean probability over the sources that see a voxel; returns the voxels inside."""
    weight = np.zeros(evidence.shape, np.float32)
    for source in sources:
        for k in range(evidence.shape[2]):
            at = _places(source, evidence.shape, np.float32(planes[0] + planes[1] * k), pool.literal)
            evidence[:, :, k][at.inside] += _trilinear(source.evidence.probability, at)
            weight[:, :, k] += at.inside
    np.log(np.maximum(evidence / np.maximum(weight, 1e-6), 1e-6), out=evidence)
    return int(weight.sum())


def _add_colours(
    evidence: F32,
    sources: Sequence[SourceVolume],
    planes: tuple[float, float],
    pool: Pool,
    photo: U8,
    term: ColourTerm,
) -> None:
    limit = evidence.max(2) - np.float32(term.reach)
    for k in range(evidence.shape[2]):
        gain = np.zeros(evidence.shape[:2], np.float32)
        for source in sources:
            assert source.colour is not None
            at = _places(source, evidence.shape, np.float32(planes[0] + planes[1] * k), pool.literal)
            cost = np.minimum(_mismatch(photo[at.inside], source.colour, at) / np.float32(term.sigma_grey), term.cap)
            seen = 1 - _hidden(source, at, pool.margin_px) if pool.margin_px is not None else 1
            gain[at.inside] += np.float32(term.weight) * seen * (np.float32(term.unknown) - cost)
        evidence[:, :, k] += np.where(evidence[:, :, k] >= limit, gain, 0)


def _hidden(source: SourceVolume, at: _Places, margin_px: float) -> F32:
    """How far the source's own surface hides the places, 0..1."""
    seen = source.evidence.disparity[(at.v + 0.5).astype(np.int64), (at.u + 0.5).astype(np.int64)]
    first, step = (np.float32(x) for x in source.evidence.planes_px)
    depth = (seen - (at.q * step + first) - np.float32(margin_px)) / np.float32(0.5 * margin_px)
    return np.asarray(np.clip(np.nan_to_num(depth, nan=0.0), 0, 1), np.float32)


def _corners(at: _Places, shape: tuple[int, ...]) -> tuple[I64, I64, F32, F32]:
    """Pixel before each place such that there is one after it (row, column), and the shares beyond it."""
    iu = np.minimum(at.u.astype(np.int64), shape[1] - 2)
    iv = np.minimum(at.v.astype(np.int64), shape[0] - 2)
    return iv, iu, np.asarray(at.v - iv, np.float32), np.asarray(at.u - iu, np.float32)


def _trilinear(volume: NDArray[np.uint16], at: _Places) -> F32:
    """Probability, float32 [M]; 0 beyond the planes."""
    last = volume.shape[2] - 1
    if last < 1:
        return np.zeros_like(at.u)
    known = (at.q >= 0) & (at.q < last)
    q = np.where(known, at.q, 0)
    iq = q.astype(np.int64)
    fq = q - iq
    iv, iu, fv, fu = _corners(at, volume.shape)
    flat = volume.reshape(-1)
    base = (iv * volume.shape[1] + iu) * volume.shape[2] + iq
    row = volume.shape[1] * volume.shape[2]

    def along(start: I64) -> F32:
        near = flat[start].astype(np.float32)
        return np.asarray(near + fq * (flat[start + 1] - near), np.float32)

    top, low = along(base), along(base + row)
    top += fu * (along(base + volume.shape[2]) - top)
    low += fu * (along(base + row + volume.shape[2]) - low)
    value = (top + fv * (low - top)) * np.float32(1 / 65535)
    return np.where(known, value, 0).astype(np.float32)


def _mismatch(photo: U8, image: U8, at: _Places) -> F32:
    """Mean difference of colours [M, 4] in grey levels; saturated values are lower bounds: being brighter says nothing.

    Bilinear with weights in 256ths, as the native form.
    """
    iv, iu, fv, fu = _corners(at, image.shape)
    across, down = ((f * np.float32(256) + np.float32(0.5)).astype(np.int64)[:, None] for f in (fu, fv))
    both = (across * down) >> 8
    a, b, c, d = (image[iv + y, iu + x].astype(np.int64) for y in (0, 1) for x in (0, 1))
    found = a * (256 - across - down + both) + b * (across - both) + c * (down - both) + d * both
    rise = 256 * photo[:, :3].astype(np.int64) - found[:, :3]
    under, over = found[:, 3:] <= 256 * SATURATED, photo[:, 3:] <= SATURATED
    total = (np.maximum(rise, 0) * under + np.maximum(-rise, 0) * over).sum(1)
    return np.asarray(total.astype(np.float32) / np.float32(768), np.float32)


def hide_behind(evidence: F32, neutral: float, rule: SurfaceRule) -> None:
    """The first-surface rule, in place."""
    over = np.clip(np.float32(rule.beta) * (evidence - np.float32(neutral) - np.float32(rule.tau)), 0, rule.cap)
    nearest = np.maximum.accumulate(over[:, :, ::-1], axis=2)[:, :, ::-1]
    evidence[:, :, : max(0, evidence.shape[2] - rule.gap)] -= nearest[:, :, rule.gap :]
