"""Confidence of the surface: P(|disparity error| < 0.1 px), and the standard deviation that goes with it.

A logistic model over what the stages saw of a pixel: the mass at its peak, how many sources agree, whether it lies
near a depth step, whether any source has it in frame. Its coefficients were fitted on the tuning scenes by
``python -m lfrig.bench.calibrate_confidence`` and are checked on the reporting scenes (docs/benchmarks.md).
"""

from __future__ import annotations

import numpy as np

from lfrig.processing.model import F32

COEFFICIENTS = {
    "bias": 2.89,
    "peak": 0.04,
    "one_source": 0.00,
    "more_sources": 1.12,
    "near_step": -1.73,
    "out_of_view": -2.0,
}
"""``out_of_view`` is a cautious guess: no pixel of the tuning scenes lies outside every source's frame."""
STEP_PX = 0.10
STEP_RADIUS = 4
TOLERANCE_PX = 0.1


def features(disparity: F32, peak: F32, agreeing: F32, in_view: np.ndarray) -> dict[str, F32]:
    """The model's inputs per pixel, float32 [H, W] each, keyed as `COEFFICIENTS`.

    Parameters
    ----------
    disparity : float32 [H, W]
        Surface in px per view step of the requested light field (any offset).
    peak : float32 [H, W]
        Share of the evidence at the best plane, 0..1.
    agreeing : float32 [H, W]
        Sources that agree with the surface.
    in_view : bool [H, W]
        Inside at least one source's frame.
    """
    import cv2

    size = 2 * STEP_RADIUS + 1
    window = np.ones((size, size), np.uint8)
    step = (cv2.dilate(disparity, window) - cv2.erode(disparity, window)) > STEP_PX
    p = np.clip(peak, 1e-4, 1 - 1e-4)
    one, more = (agreeing == 1), (agreeing >= 2)
    parts = {
        "bias": np.ones_like(p),
        "peak": np.log(p / (1 - p)),
        "one_source": one,
        "more_sources": more,
        "near_step": step,
        "out_of_view": ~in_view,
    }
    return {name: np.asarray(value, np.float32) for name, value in parts.items()}


def calibrate(disparity: F32, peak: F32, agreeing: F32, in_view: np.ndarray) -> tuple[F32, F32]:
    """(confidence, sigma): P(|error| < 0.1 px) and the Gaussian standard deviation [px] that has this probability."""
    parts = features(disparity, peak, agreeing, in_view)
    total = np.zeros_like(disparity)
    for name, value in parts.items():
        total += np.float32(COEFFICIENTS[name]) * value
    probability = np.asarray(1 / (1 + np.exp(-total)), np.float32)
    return probability, sigma_of(probability)


def sigma_of(probability: F32, tolerance_px: float = TOLERANCE_PX) -> F32:
    """σ [px] with P(|e| < tolerance) = probability for a zero-mean Gaussian; between 0.01 and 2 px."""
    # tabulated: NumPy has no inverse error function
    grid = np.geomspace(0.01, 2.0, 256)
    table = np.array([_within(tolerance_px / s) for s in grid])  # falls with sigma
    return np.interp(probability, table[::-1], grid[::-1]).astype(np.float32)


def _within(ratio: float) -> float:
    from math import erf, sqrt

    return erf(ratio / sqrt(2.0))
