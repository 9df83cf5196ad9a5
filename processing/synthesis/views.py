"""The views of a light field, made from its centre view and the centre's disparity."""

from __future__ import annotations

from typing import cast

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.progress import Monitor
from lfrig.processing.kernels.layered_views import layered_views
from lfrig.processing.kernels.rims import lowest
from lfrig.processing.kernels.warp import warp_views
from lfrig.processing.model import F32, Image
from lfrig.processing.skipping import SKIP_ALL, Skips, Tally
from lfrig.processing.synthesis.field import view_field, view_offsets
from lfrig.processing.synthesis.matte import split_layers
from lfrig.processing.synthesis.settings import DEFAULT_SYNTHESIS, Method, SynthesisSettings

LEAST_REACH_PX, MOST_REACH_PX = 3, 24


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
    skips: Skips = SKIP_ALL,
    tally: Tally | None = None,
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
    skips, tally
        Of ``layered``: pixels of views that see one smooth surface are gathered and nothing else (``certain``).

    Returns
    -------
    uint8 or uint16 [rows, cols, H, W, 3]
    """
    offsets = view_offsets(rows, cols)
    if method == "layered":
        out = _layered(image, disparity, np.array(offsets, np.float32), settings, threads, skips, tally)
    else:
        out = _single(image, disparity, offsets, method, settings, threads, monitor)
    if monitor and method == "layered":
        for _ in offsets:
            monitor.advance()
    return out.reshape(rows, cols, *image.shape)


def _single(
    image: Image,
    disparity: F32,
    offsets: list[tuple[float, float]],
    method: Method,
    settings: SynthesisSettings,
    threads: int,
    monitor: Monitor | None,
) -> Image:
    """One layer, bicubic; what the photo does not show is inpainted in every view."""
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
    return cast(Image, out)


def _layered(
    image: Image,
    disparity: F32,
    offsets: F32,
    settings: SynthesisSettings,
    threads: int,
    skips: Skips,
    tally: Tally | None,
) -> Image:
    """Far layer where the photo shows no surface, near over far layer at depth steps, the photo itself elsewhere."""
    scale = np.float32(1 if image.dtype == np.uint8 else 257)
    reach_px = _reach_px(disparity, float(np.abs(offsets).max(initial=0)), settings)
    layers = split_layers(image.astype(np.float32) / scale, disparity, reach_px, settings)
    views, worked, cpu_s = layered_views(
        image, disparity, layers, offsets, match_px=settings.match_px, hidden_px=settings.hidden_px,
        certain=skips.certain, threads=threads,
    )  # fmt: skip
    if tally:
        tally.add("certain", worked, views[..., 0].size - worked, "pixels of views", cpu_s)
    return views


def _reach_px(disparity: F32, farthest: float, settings: SynthesisSettings) -> int:
    """How far [px] the outermost view looks behind the nearest side of the highest depth step, and two more."""
    highest = float((disparity - lowest(disparity, 3)).max())
    if highest <= settings.step_px:
        return LEAST_REACH_PX
    return int(np.clip(np.ceil(farthest * highest) + 2, LEAST_REACH_PX, MOST_REACH_PX))


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
