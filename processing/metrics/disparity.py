"""Disparity against the truth: the measures of the HCI benchmark (Honauer et al., ACCV 2016) and of the
paper.

Errors are in px per view step of the light field that the truth belongs to, so they depend on its b·F; the
ratio of the RMSE to the true range, which does not, stands beside them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.errors import BadInput
from lfrig.contracts.score import DisparityScore
from lfrig.processing.metrics.pixels import BORDER_PX, Mask, depth_edges, inner_region, textureless
from lfrig.processing.model import F32, F64, U8


def linear_alignment(estimate: F32, truth: F32) -> tuple[float, float]:
    """Scale and offset that bring an estimate closest to the truth, in the least-squares sense.

    Parameters
    ----------
    estimate, truth : float32, same shape
        Pixels where either is not finite are left out.

    Returns
    -------
    (scale, offset)
        ``scale · estimate + offset ≈ truth``; the scale is 0 for a constant estimate, and (1, 0) without any
        pixel.
    """
    known = np.isfinite(estimate) & np.isfinite(truth)
    if not known.any():
        return 1.0, 0.0
    x, y = estimate[known].astype(np.float64), truth[known].astype(np.float64)
    # Centred, because the normal equations of [δ, 1] are ill-conditioned where the disparity crosses zero.
    x0, y0 = x.mean(), y.mean()
    variance = np.mean((x - x0) ** 2)
    if variance <= (1e-7 * max(np.abs(x).max(), 1e-30)) ** 2:
        return 0.0, float(y0)
    scale = float(np.mean((x - x0) * (y - y0)) / variance)
    return scale, float(y0 - scale * x0)


def disparity_score(estimate: F32, truth: F32, mask: Mask, *, true_range: float, fill: float) -> DisparityScore:
    """Score the pixels of ``mask``.

    Parameters
    ----------
    estimate, truth : float32 [H, W] px per view step
        NaN in the estimate means unknown: such a pixel is bad at every threshold, and its error is that of
        ``fill``. Pixels whose truth is not finite are not scored.
    mask : bool [H, W]
        The pixels to score; at least one must have a truth.
    true_range : float
        Largest minus smallest true disparity of the whole picture [px]; 0 gives ``rmse_over_range`` 0.
    fill : float
        The disparity [px] that stands for unknown: the median of the known ones (`disparity_scores`).
    """
    scored = mask & np.isfinite(truth)
    pixels = int(scored.sum())
    if pixels == 0:
        raise BadInput("there is no pixel to score", field="mask", remedy="check the truth and the border")
    values = estimate[scored].astype(np.float64)
    known = np.isfinite(values)
    error = np.abs(np.where(known, values, fill) - truth[scored])
    mse = float(np.mean(error**2))
    return DisparityScore(
        pixels=pixels,
        unknown=pixels - int(known.sum()),
        mse=mse,
        rmse=mse**0.5,
        rmse_over_range=mse**0.5 / true_range if true_range > 0 else 0.0,
        ppe_005=_percent((error < 0.05) & known),
        ppe_010=_percent((error < 0.10) & known),
        badpix_007=_percent((error > 0.07) | ~known),
        badpix_003=_percent((error > 0.03) | ~known),
        badpix_001=_percent((error > 0.01) | ~known),
        q25=float(np.quantile(error, 0.25)),
    )


def disparity_scores(
    estimate: F32,
    truth: F32,
    *,
    inverse_depth: F32 | None = None,
    photo: U8 | None = None,
    border_px: int = BORDER_PX,
) -> dict[str, DisparityScore]:
    """Score a disparity map on all classes of pixels.

    Parameters
    ----------
    estimate, truth : float32 [H, W] px per view step
        NaN = unknown (see `disparity_score`).
    inverse_depth : float32 [H, W], optional
        True inverse depth, for the class ``edge``; without it there is none.
    photo : uint8 [H, W, 3] RGB, optional
        For the class ``textureless``; without it there is none.
    border_px : int
        Pixels at the frame's border that are not scored.

    Returns
    -------
    dict
        ``all``, ``edge``, ``textureless``, and ``aligned``: all pixels after the `linear_alignment` of this
        very estimate. A class without pixels is left out.

    Raises
    ------
    BadInput
        The shapes differ, or no pixel has a truth.
    """
    if estimate.shape != truth.shape or estimate.ndim != 2:
        raise BadInput(
            f"the estimate is {list(estimate.shape)}, the truth {list(truth.shape)}",
            field="disparity", remedy="score a result against the truth of its own session",
        )  # fmt: skip
    inner = inner_region(truth.shape, border_px)
    estimate, truth = estimate[inner], truth[inner]
    masks = {"all": np.ones(truth.shape, bool)}
    if inverse_depth is not None:
        masks["edge"] = depth_edges(inverse_depth)[inner]
    if photo is not None:
        masks["textureless"] = textureless(photo)[inner]
    true_range = _range(truth)
    fill = _median(estimate)
    scores = {
        name: disparity_score(estimate, truth, mask, true_range=true_range, fill=fill)
        for name, mask in masks.items()
        if name == "all" or (mask & np.isfinite(truth)).any()
    }
    scale, offset = linear_alignment(estimate, truth)
    aligned = (scale * estimate.astype(np.float64) + offset).astype(np.float32)
    scores["aligned"] = disparity_score(aligned, truth, masks["all"], true_range=true_range, fill=scale * fill + offset)
    return scores


def _percent(mask: NDArray[np.bool_]) -> float:
    return float(100.0 * np.count_nonzero(mask) / mask.size)


def _range(values: F32) -> float:
    finite = values[np.isfinite(values)]
    return float(finite.max() - finite.min()) if finite.size else 0.0


def _median(values: F32 | F64) -> float:
    finite = values[np.isfinite(values)]
    # Nothing known at all: the focal plane is as good a guess as any.
    return float(np.median(finite)) if finite.size else 0.0
