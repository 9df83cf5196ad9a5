"""Surface → disparity field of every output view → views in the photo's colours.

The field lives on the grid of the *output* view: copying the centre's disparity instead costs 3 dB. The z-buffered
field carries every surface point to the output view and keeps the nearest; pixels whose surface the photo does not
show (disoccluded) take the background's disparity and are inpainted from their surroundings. The fixed-point field
``g(u) = d(u + g)`` is the simpler alternative; it rewards fat foregrounds and is kept as an oracle and ablation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.progress import Monitor
from lfrig.processing.kernels.warp import warp_views
from lfrig.processing.model import F32, Image

Method = Literal["z_buffer", "fixed_point"]


@dataclass(frozen=True)
class SynthesisSettings:
    """Knobs; px are px per view step."""

    method: Method = "z_buffer"
    match_px: float = 0.08
    """The fixed-point polish keeps the splatted disparity unless it moves less than this."""
    hidden_px: float = 0.06
    """A gathered sample this much nearer than the field shows the foreground: the point is disoccluded."""
    inpaint_radius: int = 2


DEFAULT_SYNTHESIS = SynthesisSettings()


def render_views(
    image: Image,
    disparity: F32,
    rows: int,
    cols: int,
    *,
    method: Method = "z_buffer",
    settings: SynthesisSettings = DEFAULT_SYNTHESIS,
    threads: int = 0,
    monitor: Monitor | None = None,
) -> Image:
    """Render a light field from its centre view and the centre's disparity.

    Parameters
    ----------
    image : uint8 or uint16 [H, W, 3]
        The centre view; it is returned bit for bit as the view at offset (0, 0).
    disparity : float32 [H, W]
        px per view step; must be finite (see `fill_nan`).
    rows, cols : int
        Views; offsets run over ``r − (rows−1)/2``, ``c − (cols−1)/2``.

    Returns
    -------
    uint8 or uint16 [rows, cols, H, W, 3]
    """
    offsets = view_offsets(rows, cols)
    out = np.empty((len(offsets), *image.shape), image.dtype)
    for v, (dr, dc) in enumerate(offsets):
        if dr == 0 and dc == 0:
            out[v] = image
        else:
            field, hidden = view_field(disparity, dr, dc, method, settings)
            view = warp_views(image, field[None], np.array([[dr, dc]], np.float32), threads=threads)[0]
            out[v] = _inpaint(view, hidden, settings.inpaint_radius)
        if monitor:
            monitor.advance()
    return out.reshape(rows, cols, *image.shape)


def view_offsets(rows: int, cols: int) -> list[tuple[float, float]]:
    """(dr, dc) of every view from the centre of the grid, row-major."""
    return [(r - (rows - 1) / 2, c - (cols - 1) / 2) for r in range(rows) for c in range(cols)]


def view_field(
    disparity: F32, dr: float, dc: float, method: Method = "z_buffer", settings: SynthesisSettings = DEFAULT_SYNTHESIS
) -> tuple[F32, NDArray[np.bool_]]:
    """Disparity on the grid of the output view at offset (dr, dc), and which of its pixels the photo does not show.

    Returns
    -------
    field : float32 [H, W], hidden : bool [H, W]
    """
    if method == "fixed_point":
        return _fixed_point(disparity, disparity.copy(), dr, dc, 6, np.inf), np.zeros(disparity.shape, bool)
    field = _fill_holes(_splat(disparity, dr, dc))
    field = _fixed_point(disparity, field, dr, dc, 3, settings.match_px)
    sample = _gather(disparity, field, dr, dc)
    return field, np.asarray(sample - field > settings.hidden_px)


def _splat(disparity: F32, dr: float, dc: float) -> F32:
    """Nearest surface carried to each output pixel, −inf where nothing lands; splatted at twice the density."""
    import cv2

    height, width = disparity.shape
    dense = cv2.resize(disparity, (2 * width, 2 * height), interpolation=cv2.INTER_NEAREST)
    ys, xs = np.mgrid[0 : 2 * height, 0 : 2 * width].astype(np.float32)
    x = np.rint((xs - 0.5) / 2 - np.float32(dc) * dense).astype(np.int32)
    y = np.rint((ys - 0.5) / 2 - np.float32(dr) * dense).astype(np.int32)
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    out = np.full(height * width, -np.inf, np.float32)
    np.maximum.at(out, y[inside] * width + x[inside], dense[inside])
    return out.reshape(height, width)


def _fill_holes(field: F32, rounds: int = 8) -> F32:
    """Holes grow shut from the far side: the lowest disparity next to them."""
    import cv2

    window = np.ones((3, 3), np.uint8)
    for _ in range(rounds):
        hole = np.isneginf(field)
        if not hole.any():
            return field
        lowest = cv2.erode(np.where(hole, np.float32(1e9), field), window)
        field = np.where(hole & (lowest < 1e8), lowest, field).astype(np.float32)
    hole = np.isneginf(field)
    if hole.any():
        known = field[~hole]
        field[hole] = np.median(known) if known.size else 0.0
    return field


def _gather(disparity: F32, field: F32, dr: float, dc: float) -> F32:
    import cv2

    ys, xs = np.mgrid[0 : field.shape[0], 0 : field.shape[1]].astype(np.float32)
    x, y = xs + np.float32(dc) * field, ys + np.float32(dr) * field
    return np.asarray(cv2.remap(disparity, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


def _fixed_point(disparity: F32, field: F32, dr: float, dc: float, rounds: int, limit: float) -> F32:
    """``g ← d(u + g·offset)``, as long as it moves less than ``limit``: sub-pixel polish on smooth surfaces."""
    for _ in range(rounds):
        sample = _gather(disparity, field, dr, dc)
        field = np.where(np.abs(sample - field) < limit, sample, field).astype(np.float32)
    return field


def _inpaint(view: Image, hidden: NDArray[np.bool_], radius: int) -> Image:
    import cv2

    if not hidden.any():
        return view
    if view.dtype == np.uint8:
        return np.asarray(cv2.inpaint(view, hidden.astype(np.uint8), radius, cv2.INPAINT_TELEA))
    # OpenCV inpaints three channels at 8 bit only: 16-bit pixels go channel by channel.
    channels = [cv2.inpaint(np.ascontiguousarray(view[..., i]), hidden.astype(np.uint8), radius, cv2.INPAINT_TELEA)
                for i in range(3)]  # fmt: skip
    return np.stack(channels, -1)


def fill_nan(disparity: F32) -> F32:
    """Unknown disparities replaced by the lowest known one of their neighbourhood, growing: the far side."""
    return _fill_holes(np.where(np.isfinite(disparity), disparity, -np.inf).astype(np.float32), rounds=10_000)
