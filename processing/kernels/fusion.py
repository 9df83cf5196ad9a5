"""Adding a source's disparity evidence to the volume in the target's frustum, and the first-surface rule.

Target planes are uniform in inverse depth: ``w_k = w0 + dw·k``. A target voxel (x, y, k) lies in the source at
``p = A (x, y, 1) + b w_k``, pixel ``(p0/p2, p1/p2)``, inverse depth ``w_k / p2``, disparity ``δ = (w_k/p2 − c) / a``:
one projective map. C++ form: ``fusion.cpp``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lfrig.contracts.native import load_native
from lfrig.contracts.progress import Monitor
from lfrig.processing.model import F32, F64, Evidence, ScaleFit

_NATIVE = "lfrig.processing.kernels._native"
RIM_PX = np.float32(1e-3)
"""A ray that meets the frame's rim to within rounding is inside, whichever way the rounding went."""


@dataclass(frozen=True)
class Pool:
    """How evidence is pooled: ``log_pool`` Σ w log((1−ε) p·stretch + ε/N), else the weighted mean of p.

    ``floor_share`` is ε; ``visibility`` makes a source neutral behind its own surface; ``literal`` takes the target's
    plane for the source's (the paper's printed form).
    """

    log_pool: bool = True
    visibility: bool = True
    literal: bool = False
    floor_share: float = 0.05


def add_evidence(
    volume: F32,
    mass: F32 | None,
    evidence: Evidence,
    scale: ScaleFit,
    matrix: F64,
    offset: F64,
    planes: tuple[float, float],
    pool: Pool,
    *,
    weight: float = 1.0,
    margin_px: float = 0.06,
    threads: int = 0,
    monitor: Monitor | None = None,
) -> int:
    """Add one source to ``volume`` in place.

    Parameters
    ----------
    volume : float32 [H, W, N]
        Log evidence (log pool) or summed probability (mean pool).
    mass : float32 [H, W, N] or None
        Summed weights; needed by the mean pool only.
    matrix, offset : float64 [3, 3], [3]
        `geometry.projection` from target to source.
    planes : (w0, dw)
        Target planes [1/m].
    margin_px : float
        Slack of the visibility test [px per view step of the source].

    Returns
    -------
    int
        Voxels that fell inside the source's frame.
    """
    w0, dw = planes
    native = load_native(_NATIVE)
    if native is None:
        return _add_numpy(volume, mass, evidence, scale, matrix, offset, planes, pool, weight, margin_px, monitor)
    numbers = np.concatenate(
        [matrix.ravel(), offset, [scale.a, scale.c, *evidence.planes_px, weight, margin_px]]
    ).astype(np.float32)
    empty = np.empty((0, 0, 0), np.float32)
    return int(
        native.fuse_add(
            evidence.probability,
            evidence.disparity,
            numbers,
            w0,
            dw,
            pool.floor_share,
            pool.log_pool,
            pool.visibility,
            pool.literal,
            volume,
            empty if mass is None else mass,
            threads,
        )
    )


def _add_numpy(
    volume: F32,
    mass: F32 | None,
    evidence: Evidence,
    scale: ScaleFit,
    matrix: F64,
    offset: F64,
    planes: tuple[float, float],
    pool: Pool,
    weight: float,
    margin_px: float,
    monitor: Monitor | None,
) -> int:
    """NumPy twin of `add_evidence`, plane by plane."""
    height, width, count = volume.shape
    ys, xs = np.mgrid[0:height, 0:width].astype(np.float32)
    a, b = matrix.astype(np.float32), offset.astype(np.float32)
    px, py, pz = (a[i, 0] * xs + a[i, 1] * ys + a[i, 2] for i in range(3))
    source_height, source_width = evidence.disparity.shape
    first, step = (np.float32(v) for v in evidence.planes_px)
    neutral, flat = np.float32(-np.log(count)), np.float32(pool.floor_share / count)
    inside_total = 0
    for k in range(count):
        w = np.float32(planes[0] + planes[1] * k)
        z = pz + b[2] * w
        inverse = np.where(z > 1e-6, 1 / np.maximum(z, np.float32(1e-6)), np.float32(0))
        u, v = (px + b[0] * w) * inverse, (py + b[1] * w) * inverse
        right, bottom = np.float32(source_width - 1), np.float32(source_height - 1)
        inside = (z > 1e-6) & (u > -RIM_PX) & (v > -RIM_PX) & (u < right + RIM_PX) & (v < bottom + RIM_PX)
        inside_total += int(inside.sum())
        slot = volume[:, :, k]
        if pool.log_pool:
            slot[~inside] += np.float32(weight) * neutral
        u, v = np.clip(u[inside], 0, right - RIM_PX), np.clip(v[inside], 0, bottom - RIM_PX)
        inverse_in = inverse[inside]
        source_w = np.full_like(u, w) if pool.literal else w * inverse_in
        delta = (source_w - np.float32(scale.c)) / np.float32(scale.a)
        p = _trilinear(evidence.probability, u, v, (delta - first) / step)
        if not pool.log_pool:
            assert mass is not None
            slot[inside] += np.float32(weight) * p
            mass[:, :, k][inside] += np.float32(weight)
            continue
        stretch = np.abs(np.float32(planes[1]) * pz[inside] * inverse_in**2 / (np.float32(scale.a) * step))
        score = np.log((1 - np.float32(pool.floor_share)) * p * np.minimum(np.float32(4), stretch) + flat)
        if pool.visibility:
            seen = evidence.disparity[(v + 0.5).astype(np.int64), (u + 0.5).astype(np.int64)]
            hidden = np.clip((seen - delta - np.float32(margin_px)) / np.float32(0.5 * margin_px), 0, 1)
            score = np.maximum(score, score + hidden * (neutral - score))
        slot[inside] += np.float32(weight) * score
        if monitor:
            monitor.advance(0)
    return inside_total


def _trilinear(volume: np.ndarray[tuple[int, int, int], np.dtype[np.uint16]], u: F32, v: F32, q: F32) -> F32:
    """Probability at (v, u, q), float32 [M]; 0 outside the plane range."""
    planes = volume.shape[2]
    valid = (q >= 0) & (q < planes - 1)
    q = np.where(valid, q, 0)
    iu, iv, iq = u.astype(np.int64), v.astype(np.int64), q.astype(np.int64)
    fu, fv, fq = u - iu, v - iv, q - iq
    flat = volume.reshape(-1)
    base = (iv * volume.shape[1] + iu) * planes + iq
    row = volume.shape[1] * planes

    def along(start: np.ndarray[tuple[int], np.dtype[np.int64]]) -> F32:
        near = flat[start].astype(np.float32)
        return np.asarray(near + fq * (flat[start + 1] - near), np.float32)

    top, low = along(base), along(base + row)
    top += fu * (along(base + planes) - top)
    low += fu * (along(base + row + planes) - low)
    value = (top + fv * (low - top)) * np.float32(1 / 65535)
    return np.where(valid, value, 0).astype(np.float32)


def first_surface(
    volume: F32, neutral: float, gap: int, tau: float, beta: float, cap: float, *, threads: int = 0
) -> None:
    """Lower, in place, the evidence of planes that lie behind strong nearer evidence.

    Plane k pays ``min(cap, β·max(0, max_{j ≥ k+gap} (V[j] − neutral) − τ))``: a wall behind an object can be supported
    by two sources while the object is out of frame in one of them, yet a ray ends at its first surface.
    ``volume`` float32 [H, W, N], nearer planes last.
    """
    native = load_native(_NATIVE)
    if native is not None:
        native.first_surface(volume, neutral, gap, tau, beta, cap, threads)
        return
    over = np.clip(np.float32(beta) * (volume - np.float32(neutral) - np.float32(tau)), 0, cap)
    nearest = np.maximum.accumulate(over[:, :, ::-1], axis=2)[:, :, ::-1]
    volume[:, :, : volume.shape[2] - gap] -= nearest[:, :, gap:]
