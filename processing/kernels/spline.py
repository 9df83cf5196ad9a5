"""Cubic B-spline interpolation of pictures at scattered positions.

The picture is written once as B-spline coefficients (the recursive filter of Unser, Aldroubi & Eden, IEEE Trans. Signal
Processing 41, 1993; pole √3 − 2), after which every sample costs as much as with any other 4×4 kernel. The spline keeps
more of the high frequencies than Catmull–Rom: warped views lose .1–1 dB less. C++ form of the sampling: ``spline.cpp``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lfrig.contracts.native import load_native
from lfrig.processing.model import F32

POLE = np.float32(np.sqrt(3.0) - 2.0)
PAD = 10
"""Border [px] by which a picture is continued before it is filtered: |pole|¹⁰ is 2e-6."""


@dataclass(frozen=True)
class Spline:
    """A picture as B-spline coefficients, float32 [H + 2·PAD, W + 2·PAD, C]; see `spline`."""

    coefficients: F32


def spline(picture: F32) -> Spline:
    """The cubic spline through a picture, float32 [H, W, C]; beyond the frame its border is continued."""
    padded = np.pad(picture.astype(np.float32), ((PAD, PAD), (PAD, PAD), (0, 0)), mode="edge")
    columns = _filtered(padded)
    rows = _filtered(np.ascontiguousarray(columns.transpose(1, 0, 2)))
    return Spline(np.ascontiguousarray(rows.transpose(1, 0, 2)))


def _filtered(samples: F32) -> F32:
    """Coefficients along the first axis: one causal and one anticausal recursion."""
    out = np.empty_like(samples)
    # The border is continued by a constant, whose causal sum is the geometric series.
    out[0] = samples[0] / (1 - POLE)
    for i in range(1, len(samples)):
        out[i] = samples[i] + POLE * out[i - 1]
    out[-1] = (POLE / (POLE * POLE - 1)) * (out[-1] + POLE * out[-2])
    for i in range(len(samples) - 2, -1, -1):
        out[i] = POLE * (out[i + 1] - out[i])
    out *= np.float32(6)
    return out


def sample_spline(picture: Spline, x: F32, y: F32, *, threads: int = 0) -> F32:
    """Values of a spline.

    Parameters
    ----------
    x, y : float32, same shape
        Positions [px]; beyond the frame the border's value counts.

    Returns
    -------
    float32 [..., C]
    """
    if x.shape != y.shape:
        raise ValueError(f"x is {x.shape}, y {y.shape}")
    coefficients = picture.coefficients
    native = load_native("lfrig.processing.kernels._native")
    flat_x, flat_y = (np.ascontiguousarray(a, np.float32).ravel() for a in (x, y))
    out = np.empty((flat_x.size, coefficients.shape[2]), np.float32)
    if native is None:
        out[:] = sample_spline_numpy(coefficients, flat_x, flat_y)
    else:
        native.sample_spline(coefficients, flat_x, flat_y, out, PAD, threads)
    return out.reshape(*x.shape, coefficients.shape[2])


def sample_spline_numpy(coefficients: F32, x: F32, y: F32) -> F32:
    """NumPy twin: float32 [H + 2·PAD, W + 2·PAD, C], [N], [N] → [N, C]."""
    height, width = coefficients.shape[:2]
    # fmax and fmin drop NaN, as those of C do: it counts as the top left corner.
    fx = np.fmin(np.fmax(x + np.float32(PAD), np.float32(1)), np.float32(width - 2))
    fy = np.fmin(np.fmax(y + np.float32(PAD), np.float32(1)), np.float32(height - 2))
    ix, iy = np.minimum(fx.astype(np.int64), width - 3), np.minimum(fy.astype(np.int64), height - 3)
    wx, wy = _weights(fx - ix.astype(np.float32)), _weights(fy - iy.astype(np.float32))
    total = np.zeros((x.size, coefficients.shape[2]), np.float32)
    for j in range(4):
        part = np.zeros_like(total)
        for i in range(4):
            part += wx[i][:, None] * coefficients[iy - 1 + j, ix - 1 + i]
        total += wy[j][:, None] * part
    return total


def _weights(t: F32) -> tuple[F32, F32, F32, F32]:
    """The four taps of the cubic B-spline around a fraction t in 0..1."""
    s, sixth = 1 - t, np.float32(1 / 6)
    return (
        sixth * s * s * s,
        sixth * (4 - 3 * t * t * (2 - t)),
        sixth * (4 - 3 * s * s * (2 - s)),
        sixth * t * t * t,
    )
