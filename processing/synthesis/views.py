"""The views of a light field, made from its centre view and the centre's disparity."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.progress import Monitor
from lfrig.processing.kernels.spline import sample_spline, spline
from lfrig.processing.kernels.warp import warp_views
from lfrig.processing.model import F32, Image
from lfrig.processing.synthesis.field import splat, view_field, view_offsets
from lfrig.processing.synthesis.matte import Layers, split_layers
from lfrig.processing.synthesis.peel import near_rim
from lfrig.processing.synthesis.settings import DEFAULT_SYNTHESIS, Method, SynthesisSettings

LEAST_REACH_PX, MOST_REACH_PX = 3, 24
POLISH_ROUNDS, FAR_ROUNDS = 2, 6

MakeView = Callable[[float, float], Image]


def render_views(
    image: Image,
    disparity: F32,
    rows: int,
    cols: int,
    *,
    method: Method = "layered",
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
    method : Method
        How; it counts, not that of ``settings``.

    Returns
    -------
    uint8 or uint16 [rows, cols, H, W, 3]
    """
    offsets = view_offsets(rows, cols)
    make = (
        _layered(image, disparity, max(rows, cols), settings, threads)
        if method == "layered"
        else _single(image, disparity, method, settings, threads)
    )
    out = np.empty((len(offsets), *image.shape), image.dtype)
    for v, (dr, dc) in enumerate(offsets):
        out[v] = image if dr == 0 and dc == 0 else make(dr, dc)
        if monitor:
            monitor.advance()
    return out.reshape(rows, cols, *image.shape)


def _single(image: Image, disparity: F32, method: Method, settings: SynthesisSettings, threads: int) -> MakeView:
    """One layer, bicubic; what the photo does not show is inpainted in every view."""

    def make(dr: float, dc: float) -> Image:
        field, hidden = view_field(disparity, dr, dc, method, settings)
        view = warp_views(image, field[None], np.array([[dr, dc]], np.float32), threads=threads)[0]
        return _inpaint(view, hidden, settings.inpaint_radius)

    return make


def _layered(image: Image, disparity: F32, views: int, settings: SynthesisSettings, threads: int) -> MakeView:
    """Far layer where the photo shows no surface, near over far layer at depth steps, the photo itself elsewhere."""
    scale = np.float32(1 if image.dtype == np.uint8 else 257)
    photo_grey = image.astype(np.float32) / scale
    layers = split_layers(photo_grey, disparity, _reach_px(disparity, views, settings), settings)
    photo, far, near = spline(photo_grey), spline(layers.far_grey), spline(layers.near_grey)
    ys, xs = np.mgrid[0 : disparity.shape[0], 0 : disparity.shape[1]].astype(np.float32)

    def make(dr: float, dc: float) -> Image:
        row, col = np.float32(dr), np.float32(dc)
        field, hidden = view_field(disparity, dr, dc, "z_buffer", settings)
        grey = sample_spline(photo, xs + col * field, ys + row * field, threads=threads)

        def far_at(where: NDArray[np.bool_], start: F32, rounds: int) -> tuple[F32, F32]:
            """The far layer's disparity [N] and colours [N, 3] at some pixels of the view."""
            x, y, found = xs[where], ys[where], start
            for _ in range(rounds):
                found = _bilinear(layers.behind.disparity, x + col * found, y + row * found)
            return found, sample_spline(far, x + col * found, y + row * found, threads=threads)

        drawn = hidden | _nearest(layers.far_drawn, xs + col * field, ys + row * field)
        behind_px, colours = far_at(drawn, field[drawn], FAR_ROUNDS - POLISH_ROUNDS)
        same = hidden[drawn] | (np.abs(behind_px - field[drawn]) < settings.hidden_px)
        drawn[drawn] = same
        grey[drawn] = colours[same]
        edge, edge_px = _near_edge(layers, field, dr, dc, settings)
        near_grey = sample_spline(near, xs[edge] + col * edge_px, ys[edge] + row * edge_px, threads=threads)
        share = np.clip(near_grey[:, 3:], 0, 1)
        grey[edge] = share * near_grey[:, :3] + (1 - share) * far_at(edge, edge_px, FAR_ROUNDS)[1]
        limit = 255 * scale
        rounded = (np.clip(grey * scale, 0, limit) + np.float32(0.5)).astype(image.dtype)
        return cast(Image, rounded)

    return make


def _near_edge(
    layers: Layers, field: F32, dr: float, dc: float, settings: SynthesisSettings
) -> tuple[NDArray[np.bool_], F32]:
    """Pixels of a view, bool [H, W], at which a near surface has its edge, and its disparity there, float32 [N]."""
    carried = splat(layers.near_px, dr, dc, layers.near_drawn)
    edge = carried > field - settings.hidden_px  # else something nearer stands before the edge
    found = carried[edge]
    y, x = (a.astype(np.float32) for a in np.nonzero(edge))
    for _ in range(POLISH_ROUNDS):
        sample = _bilinear(layers.near_px, x + np.float32(dc) * found, y + np.float32(dr) * found)
        found = np.where(np.abs(sample - found) < settings.match_px, sample, found)
    return edge, found


def _reach_px(disparity: F32, views: int, settings: SynthesisSettings) -> int:
    """How far [px] the outermost view looks behind the nearest side of the highest depth step, and two more."""
    import cv2

    rim = near_rim(disparity, settings.step_px)
    if not rim.any():
        return LEAST_REACH_PX
    highest = float((disparity - cv2.erode(disparity, np.ones((3, 3), np.uint8)))[rim].max())
    return int(np.clip(np.ceil((views - 1) / 2 * highest) + 2, LEAST_REACH_PX, MOST_REACH_PX))


def _bilinear(values: F32, x: F32, y: F32) -> F32:
    """``values`` float32 [H, W] at N positions, beyond the frame its border."""
    height, width = values.shape
    x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
    ix, iy = x.astype(np.int64), y.astype(np.int64)
    right, down = np.minimum(ix + 1, width - 1), np.minimum(iy + 1, height - 1)
    wx, wy = x - ix, y - iy
    upper = values[iy, ix] * (1 - wx) + values[iy, right] * wx
    lower = values[down, ix] * (1 - wx) + values[down, right] * wx
    return np.asarray(upper * (1 - wy) + lower * wy, np.float32)


def _nearest(mask: NDArray[np.bool_], x: F32, y: F32) -> NDArray[np.bool_]:
    """``mask`` bool [H, W] at the pixels nearest to positions [H, W]; false beyond the frame."""
    import cv2

    return np.asarray(cv2.remap(mask.astype(np.uint8), x, y, cv2.INTER_NEAREST) > 0)


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
