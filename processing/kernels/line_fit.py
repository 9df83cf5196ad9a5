"""Robust lines through points. C++ form: ``line_fit.cpp``.

Least median of squares: Rousseeuw 1984. Tukey's biweight with a scale by the median absolute residual: Holland &
Welsch 1977.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lfrig.contracts.native import load_native
from lfrig.processing.model import F64

NORMAL = 1.4826
"""Standard deviations of a normal distribution per median of its magnitudes."""

TUKEY = 4.685
"""Standard deviations from which a point does not count."""


class LinePrior(NamedTuple):
    """What is known of a line beforehand, and its precision 1/σ² (0 = nothing)."""

    slope: float = 0.0
    offset: float = 0.0
    slope_precision: float = 0.0
    offset_precision: float = 0.0


def least_median_line(x: F64, y: F64, slopes: F64, offsets: F64) -> int:
    """Index of the candidate line, of C ``slopes`` and ``offsets`` [C], with the least median residual of the points
    [N]; the first of equals.
    """
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        return least_median_line_numpy(x, y, slopes, offsets)
    return int(native.line_least_median(*(np.ascontiguousarray(part, np.float64) for part in (x, y, slopes, offsets))))


def biweight_line(
    x: F64,
    y: F64,
    start: tuple[float, float],
    *,
    share: float,
    floor: float,
    settled: float,
    iterations: int,
    prior: LinePrior | None = None,
) -> F64:
    """The line ``y = slope x + offset`` through most of the points by Tukey's biweight, x centred at each step.

    Parameters
    ----------
    x, y : float64 [N]
        Points; N > 0.
    start : (slope, offset)
        Close enough that most points are near it.
    share : float
        Part of an independent point that each counts as, against the prior.
    floor : float
        Least standard deviation, greater than 0.
    settled : float
        A step that moves the line by less than this share of its scatter, anywhere, is the last.

    Returns
    -------
    float64 [3]
        Slope, offset, and the standard deviation of y around the line. Where no point counts, or nothing determines the
        line, the last one that was. C++ and NumPy differ by rounding.
    """
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        return biweight_line_numpy(
            x, y, start, share=share, floor=floor, settled=settled, iterations=iterations, prior=prior
        )
    found = np.empty(3)
    native.line_biweight(
        np.ascontiguousarray(x, np.float64), np.ascontiguousarray(y, np.float64), np.array(prior or LinePrior()),
        *start, share, floor, settled, iterations, found,
    )  # fmt: skip
    return found


@np.errstate(over="ignore", invalid="ignore")
def least_median_line_numpy(x: F64, y: F64, slopes: F64, offsets: F64) -> int:
    """NumPy twin of `least_median_line`."""
    _check(x, y)
    return int(np.median(_magnitudes(x, y, slopes[:, None], offsets[:, None]), axis=1).argmin())


@np.errstate(over="ignore", invalid="ignore")
def biweight_line_numpy(
    x: F64,
    y: F64,
    start: tuple[float, float],
    *,
    share: float,
    floor: float,
    settled: float,
    iterations: int,
    prior: LinePrior | None = None,
) -> F64:
    """NumPy twin of `biweight_line`."""
    _check(x, y)
    known = prior or LinePrior()
    (slope, offset), scale = start, floor
    for _ in range(iterations):
        scale = NORMAL * float(np.median(_magnitudes(x, y, slope, offset))) + floor
        near = 1 - ((y - (slope * x + offset)) / (TUKEY * scale)) ** 2
        weights = np.where(near > 0, near, 0.0) ** 2
        total = float(weights.sum())
        if not total > 0:
            break
        mean = float((weights * x).sum()) / total
        # Unknowns: slope and the level at the mean, so that the system is well conditioned.
        centred = x - mean
        precision, q = share / (scale * scale), known.offset_precision
        # offset = level − mean · slope: the offset's prior is a row (−mean, 1).
        a = precision * float((weights * centred**2).sum()) + known.slope_precision + mean * mean * q
        b, c = -mean * q, precision * total + q
        determinant = a * c - b * b
        if not (a > 0 and determinant > 0):
            break
        by_slope = precision * float((weights * centred * y).sum())
        by_slope += known.slope * known.slope_precision - mean * known.offset * q
        by_level = precision * float((weights * y).sum()) + known.offset * q
        new_slope = (c * by_slope - b * by_level) / determinant
        new_offset = (a * by_level - b * by_slope) / determinant - new_slope * mean
        moved = abs(new_slope - slope) * float(np.abs(centred).max()) + abs(new_offset - offset)
        slope, offset = new_slope, new_offset
        if moved < settled * scale:
            break
    return np.array([slope, offset, scale])


def _check(x: F64, y: F64) -> None:
    if not len(x) or len(x) != len(y):
        raise ValueError("line_fit: shapes do not match")


def _magnitudes(x: F64, y: F64, slope: F64 | float, offset: F64 | float) -> F64:
    """Of the residuals; what is no number counts as infinite."""
    distance = np.abs(y - (slope * x + offset))
    return np.where(np.isnan(distance), np.inf, distance)
