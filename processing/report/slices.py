"""Which rows, columns and planes are worth showing, and the slices themselves."""

from __future__ import annotations

import numpy as np

from lfrig.processing.model import F32, U8, Evidence

BORDER = 0.1
"""Fraction of the picture at each side where no slice is taken: light fields are weak there."""


def lively_row(disparity: F32, confidence: F32) -> int:
    """The row [px] along which confident disparity changes most: there an EPI shows lines of several slopes.

    ``disparity`` float32 [H, W] (NaN = unknown), ``confidence`` float32 [H, W].
    """
    known = disparity[np.isfinite(disparity)]
    low, high = np.percentile(known, [1, 99]) if known.size else (0.0, 0.0)
    step = np.abs(np.diff(disparity, axis=1)) * np.minimum(confidence[:, 1:], confidence[:, :-1])
    # A jump counts as an edge, not by its height: else one wild row wins.
    activity = np.minimum(np.nan_to_num(step), 0.2 * (high - low)).sum(1)
    window = max(1, len(activity) // 24)
    smooth = np.convolve(activity, np.ones(window), "same")
    margin = int(BORDER * len(activity))
    return margin + int(np.argmax(smooth[margin : len(smooth) - margin]))


def lively_column(disparity: F32, confidence: F32) -> int:
    """The column [px] along which confident disparity changes most."""
    return lively_row(disparity.T, confidence.T)


def horizontal_epi(views: U8, row_px: int) -> U8:
    """Row ``row_px`` of the middle row of views, [cols, W, 3]: a point at disparity δ is a line that moves δ px left
    per view.
    """
    return np.asarray(views[(views.shape[0] - 1) // 2, :, row_px], np.uint8)


def vertical_epi(views: U8, column_px: int) -> U8:
    """Column ``column_px`` of the middle column of views, [H, rows, 3]."""
    return np.asarray(views[:, (views.shape[1] - 1) // 2, :, column_px].swapaxes(0, 1), np.uint8)


def telling_planes(evidence: Evidence, count: int) -> list[int]:
    """Indices of up to ``count`` planes spread over the disparities that occur, denser where more pixels are."""
    first, step = evidence.planes_px
    known = evidence.disparity[np.isfinite(evidence.disparity)]
    if known.size == 0:
        return [evidence.planes // 2]
    index = np.rint((np.percentile(known, np.linspace(5, 95, count)) - first) / step).astype(int)
    return sorted({int(i) for i in np.clip(index, 0, evidence.planes - 1)})


def plane(evidence: Evidence, index: int) -> F32:
    """Probability of one plane, float32 [H, W]."""
    return np.asarray(evidence.probability[:, :, index], np.float32)


def along_row(evidence: Evidence, row_px: int) -> F32:
    """Probability along a row, float32 [D, W], nearest (largest disparity) on top."""
    return np.asarray(evidence.probability[row_px].T[::-1], np.float32)


def matched_row(height: int, other_height: int, row: int) -> int:
    """The row of a map of ``height`` that shows the same as ``row`` of one of ``other_height``."""
    return min(height - 1, int(row * height / other_height))
