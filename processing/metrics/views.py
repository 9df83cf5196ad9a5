"""Light fields against the truth: PSNR, SSIM and the error of their epipolar-plane images.

The centre view of a synthesized light field is the photo itself, so the plain means leave it out.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.errors import BadInput
from lfrig.contracts.score import LightFieldScore
from lfrig.processing.metrics.pixels import BORDER_PX, inner_region
from lfrig.processing.model import F32, U8

MSE_FLOOR = 1.0 / 12.0
"""The variance of rounding to 8 bits [grey levels²]: pictures that agree in every byte are only known to
agree to this, so the PSNR is at most 58.9 dB, and a mean over views stays finite when one is exact."""

SSIM_SIGMA_PX = 1.5
SSIM_WINDOW_PX = 11
SSIM_C1 = (0.01 * 255.0) ** 2
SSIM_C2 = (0.03 * 255.0) ** 2


def psnr(image: U8, truth: U8) -> float:
    """Peak signal-to-noise ratio [dB] over all pixels and the three channels, peak 255 (see `MSE_FLOOR`).

    Parameters
    ----------
    image, truth : uint8 [..., 3] RGB, same shape
    """
    _same_shape(image, truth)
    difference = image.astype(np.float32) - truth
    mse = float(np.mean(np.square(difference), dtype=np.float64))
    return float(10.0 * np.log10(255.0**2 / max(mse, MSE_FLOOR)))


def ssim_map(image: U8, truth: U8) -> F32:
    """Structural similarity around every pixel (Wang et al., IEEE TIP 13, 2004): Gaussian window 11×11, σ 1.5
    px, K₁ .01, K₂ .03, on the luma (BT.601).

    Parameters
    ----------
    image, truth : uint8 [H, W, 3] RGB

    Returns
    -------
    float32 [H, W]
        The outermost 5 pixels use a mirrored border; leave them out of means.
    """
    import cv2

    _same_shape(image, truth)

    def local_mean(x: F32) -> F32:
        blurred = cv2.GaussianBlur(x, (SSIM_WINDOW_PX, SSIM_WINDOW_PX), SSIM_SIGMA_PX)
        return np.asarray(blurred, np.float32)

    # Centred on mid-grey: E[x²] − E[x]² loses half the digits of float32 around 255² otherwise.
    a, b = (cv2.cvtColor(x.astype(np.float32), cv2.COLOR_RGB2GRAY) - np.float32(127.5) for x in (image, truth))
    mean_a, mean_b = local_mean(a), local_mean(b)
    var_a = local_mean(a * a) - mean_a * mean_a
    var_b = local_mean(b * b) - mean_b * mean_b
    covariance = local_mean(a * b) - mean_a * mean_b
    mean_a, mean_b = mean_a + np.float32(127.5), mean_b + np.float32(127.5)
    luminance = (2 * mean_a * mean_b + SSIM_C1) / (mean_a**2 + mean_b**2 + SSIM_C1)
    return np.asarray(luminance * (2 * covariance + SSIM_C2) / (var_a + var_b + SSIM_C2), np.float32)


def ssim(image: U8, truth: U8, *, border_px: int = SSIM_WINDOW_PX // 2) -> float:
    """Mean of `ssim_map` without ``border_px`` at the frame's border (never less than half a window)."""
    inner = inner_region((truth.shape[0], truth.shape[1]), max(border_px, SSIM_WINDOW_PX // 2))
    return float(ssim_map(image, truth)[inner].mean(dtype=np.float64))


def epi_mae(views: U8, truth: U8) -> float:
    """Mean absolute error of the gradients of all horizontal and vertical epipolar-plane images [grey
    levels].

    A horizontal EPI is one image row y across the views of one view row, [cols, W]; a vertical one an image
    column across the views of one view column, [rows, H]. Both of its gradients (across views, along the
    line) count alike. This is the EPI term that light-field synthesis networks are trained with (Jin et al.,
    ICCV 2020), so it can be compared with theirs.

    Parameters
    ----------
    views, truth : uint8 [rows, cols, H, W, 3] RGB
    """
    _same_shape(views, truth)
    # The gradient of a difference is the difference of the gradients; one view row at a time bounds the
    # memory.
    totals = [
        _mean_abs_gradients((views[r].astype(np.int16) - truth[r]), spatial_axis=2) for r in range(views.shape[0])
    ]
    totals += [
        _mean_abs_gradients((views[:, c].astype(np.int16) - truth[:, c]), spatial_axis=1) for c in range(views.shape[1])
    ]
    return float(np.mean(totals))


def light_field_score(views: U8, truth: U8, *, border_px: int = BORDER_PX) -> LightFieldScore:
    """PSNR [dB, RGB], SSIM [luma] and EPI error of a light field.

    PSNR and SSIM are computed view by view and then averaged: over all views but the centre, over all, and
    over the four corner views.

    Parameters
    ----------
    views, truth : uint8 [rows, cols, H, W, 3] RGB
        rows and cols are at least 3. Of an even number of views the centre is the one before the middle.
    border_px : int
        Pixels at every view's border that are not scored: the photo does not show what enters the frame
        there.

    Raises
    ------
    BadInput
        The shapes differ or nothing is left inside the border.
    """
    _same_shape(views, truth)
    rows, cols, height, width = truth.shape[:4]
    ys, xs = inner_region((height, width), border_px)
    psnr_db = np.empty((rows, cols))
    similarity = np.empty((rows, cols))
    for r, c in _indices(rows, cols):
        psnr_db[r, c] = psnr(views[r, c, ys, xs], truth[r, c, ys, xs])
        similarity[r, c] = ssim(views[r, c], truth[r, c], border_px=border_px)
    others = np.ones((rows, cols), bool)
    others[(rows - 1) // 2, (cols - 1) // 2] = False
    corners = np.ix_([0, -1], [0, -1])
    return LightFieldScore(
        psnr=float(psnr_db[others].mean()),
        ssim=float(similarity[others].mean()),
        psnr_with_centre=float(psnr_db.mean()),
        ssim_with_centre=float(similarity.mean()),
        psnr_corners=float(psnr_db[corners].mean()),
        ssim_corners=float(similarity[corners].mean()),
        epi_mae=epi_mae(views[:, :, ys, xs], truth[:, :, ys, xs]),
    )


def _mean_abs_gradients(error: NDArray[np.int16], *, spatial_axis: int) -> float:
    across_views = np.abs(np.diff(error, axis=0)).mean(dtype=np.float64)
    along_line = np.abs(np.diff(error, axis=spatial_axis)).mean(dtype=np.float64)
    return float(across_views + along_line) / 2


def _indices(rows: int, cols: int) -> Iterator[tuple[int, int]]:
    return ((r, c) for r in range(rows) for c in range(cols))


def _same_shape(image: U8, truth: U8) -> None:
    if image.shape != truth.shape or image.dtype != np.uint8 or truth.dtype != np.uint8:
        raise BadInput(
            f"pictures to compare must be uint8 of one shape, got {image.dtype} {list(image.shape)} and "
            f"{truth.dtype} {list(truth.shape)}",
            field="views", remedy="compare pictures of one size and depth",
        )  # fmt: skip
