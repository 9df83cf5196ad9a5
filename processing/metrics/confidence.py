"""Is a confidence worth its name? Sparsification says whether it ranks errors, reliability whether it is
calibrated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.errors import BadInput
from lfrig.processing.model import F32, F64

STEPS = 100


@dataclass(frozen=True)
class Sparsification:
    """Mean absolute error of what is left when the least confident fraction has been removed.

    ``removed`` float64 [100] fractions 0, .01 … .99; ``by_confidence`` and ``by_error`` (the best any
    confidence could do) float64 [100], both relative to the error before any removal; ``ause`` the area
    between them (Ilg et al., ECCV 2018): 0 is perfect, and a confidence that knows nothing has the area under
    1 − ``by_error``.
    """

    removed: F64
    by_confidence: F64
    by_error: F64
    ause: float

    @property
    def ause_of_random(self) -> float:
        """The area as a share of that of a confidence that knows nothing: 0 is perfect, 1 no better than chance."""
        random = float(np.mean(1 - self.by_error))
        return self.ause / random if random > 0 else 0.0


@dataclass(frozen=True)
class Reliability:
    """Predicted against observed frequency of |error| < threshold, in equal bins of the prediction.

    ``predicted`` and ``observed`` float64 [bins] (NaN for an empty bin); ``pixels`` int64 [bins]; ``ece`` the
    mean of |predicted − observed| weighted with the pixels (expected calibration error).
    """

    predicted: F64
    observed: F64
    pixels: NDArray[np.int64]
    ece: float


def sparsification(error: F32, confidence: F32) -> Sparsification:
    """Sparsification curves and their area (AUSE).

    Parameters
    ----------
    error, confidence : float32, same shape
        Signed or absolute errors [px]; pixels where either is not finite are left out. Pixels of equal
        confidence share their mean error, so their order does not matter.
    """
    known = _both_known(error, confidence)
    absolute = np.abs(error[known]).astype(np.float64)
    _, group, count = np.unique(confidence[known], return_inverse=True, return_counts=True)
    shared = (np.bincount(group, absolute) / count)[group]
    total = absolute.mean()
    removed = np.arange(STEPS) / STEPS
    if total == 0:
        flat = np.zeros(STEPS)
        return Sparsification(removed, flat, flat, 0.0)
    by_confidence = _remaining_mean(shared[np.argsort(-confidence[known], kind="stable")], removed) / total
    by_error = _remaining_mean(np.sort(absolute), removed) / total
    return Sparsification(removed, by_confidence, by_error, float(np.mean(by_confidence - by_error)))


def reliability(error: F32, confidence: F32, *, threshold_px: float = 0.1, bins: int = 10) -> Reliability:
    """Compare ``confidence`` = P(|error| < ``threshold_px``), in 0..1, with what happened.

    Parameters
    ----------
    error, confidence : float32, same shape
        An unknown error (NaN) counts as a miss; an unknown confidence as 0.
    """
    if error.shape != confidence.shape or error.size == 0:
        raise BadInput("error and confidence differ in shape or are empty", field="confidence", remedy="check them")
    predicted = np.clip(np.nan_to_num(confidence.ravel().astype(np.float64), nan=0.0), 0.0, 1.0)
    hit = np.abs(error.ravel()) < threshold_px
    index = np.minimum((predicted * bins).astype(int), bins - 1)
    pixels = np.bincount(index, minlength=bins)
    with np.errstate(invalid="ignore"):
        mean_predicted = np.bincount(index, predicted, bins) / pixels
        observed = np.bincount(index, hit, bins) / pixels
    ece = float(np.nansum(np.abs(mean_predicted - observed) * pixels) / pixels.sum())
    return Reliability(mean_predicted, observed, pixels.astype(np.int64), ece)


def _remaining_mean(errors: F64, removed: F64) -> F64:
    """Mean of the first (1 − removed) part of errors that are sorted from best to worst; at least one is
    kept.
    """
    means = np.cumsum(errors) / np.arange(1, len(errors) + 1)
    kept = np.maximum(np.rint((1.0 - removed) * len(errors)).astype(int), 1)
    return np.asarray(means[kept - 1], np.float64)


def _both_known(error: F32, confidence: F32) -> NDArray[np.bool_]:
    if error.shape != confidence.shape:
        raise BadInput("error and confidence differ in shape", field="confidence", remedy="check them")
    known = np.isfinite(error) & np.isfinite(confidence)
    if not known.any():
        raise BadInput("no pixel has both an error and a confidence", field="confidence", remedy="check them")
    return np.asarray(known)
