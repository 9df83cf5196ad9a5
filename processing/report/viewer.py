"""The draggable light field: its data (one atlas of all views, one disparity map) and its place on the page.

``viewer.js`` finds the JSON block ``light-field`` and the element with the class ``viewer``, and draws through
``renderers.js``; without a script the centre view is shown as a still picture.
"""

from __future__ import annotations

import base64
import io
import math

import numpy as np
from PIL import Image as Pillow

from lfrig.processing.export.png import to_8_bit
from lfrig.processing.export.sweep import fill_unknown
from lfrig.processing.model import F32, U8, Image
from lfrig.processing.report import pictures
from lfrig.processing.report.html import Html, el, join, json_script

ATLAS_PIXELS = 12_000_000
"""At most; a 7×7 light field of 541×376 has 10 million. Larger views are reduced."""
ATLAS_SIDE = 16_383
"""The largest side that WebP has."""
ATLAS_QUALITY = 80
MAX_GAIN = 6.0
LEAST_MOTION = 0.02
"""Of the picture's width: light fields whose nearest and farthest points move less against each other over the
aperture start exaggerated, else nobody would see that they move at all."""
HELP = (
    "Drag to move the viewpoint, click to focus there, wheel or pinch to open the aperture. "
    "Keys: arrows move, + and − open and close, [ and ] focus, Space sways, Home resets."
)


def viewer(
    views: Image,
    disparity: F32,
    *,
    bf_px_m: float | None = None,
    focus_distance_m: float | None = None,
    metric: bool = True,
) -> Html:
    """The viewer of a light field.

    Parameters
    ----------
    views : uint8 or uint16 [rows, cols, H, W, 3]
    disparity : float32 [H, W]
        px per view step on the centre view; NaN = unknown.
    bf_px_m, focus_distance_m : float, optional
        Baseline times focal length [px·m] and focus distance [m]: with both, focus is shown as a distance too.
    metric : bool
        False: lengths are in gauge units.
    """
    rows, cols, height, width = views.shape[:4]
    tile = _tile_size(rows, cols, height, width)
    atlas, kind = _atlas(to_8_bit(views), tile)
    filled = fill_unknown(disparity)
    scale = pictures.robust_scale(filled)
    ratio = tile[0] / width
    low, high = scale.low * ratio, scale.high * ratio
    data = {
        "rows": rows, "cols": cols, "width": tile[0], "height": tile[1],
        "atlas": f"data:{kind};base64,{base64.b64encode(atlas).decode('ascii')}",
        "disparity": _disparity_picture(filled, scale, tile).uri, "low": low, "high": high,
        "perPixel": 1 / ratio, "gain": _gain(low, high, max(rows, cols), tile[0]), "maxGain": MAX_GAIN,
        "bf": bf_px_m, "focusDistance": focus_distance_m, "unit": "m" if metric else "units",
    }  # fmt: skip
    still = pictures.photograph(to_8_bit(views)[(rows - 1) // 2, (cols - 1) // 2])
    return join(json_script("light-field", data), _markup(still, tile))


def _markup(still: pictures.Picture, tile: tuple[int, int]) -> Html:
    canvas = el("canvas", width=tile[0], height=tile[1], tabindex=0, role="application", hidden="",
                aria_label="light-field viewer", aria_describedby="viewer-help")  # fmt: skip
    return el(
        "div",
        el("div", still.element("centre view of the light field", class_="still"), canvas,
           el("div", class_="pad", aria_hidden="true"), class_="stage",
           style=f"--shape: {tile[0] / tile[1]:.4f}"),
        el("div", _slider("focus", "Focus"), _slider("aperture", "Aperture"), _slider("gain", "Parallax"),
           el("div", el("button", "Sway", type="button", data_do="sway"),
              el("button", "Reset", type="button", data_do="reset"), class_="buttons"), class_="controls"),
        el("p", HELP, id="viewer-help", class_="help"),
        class_="viewer",
    )  # fmt: skip


def _slider(name: str, label: str) -> Html:
    slider = el("input", type="range", name_=name, min=0, max=1, step="any", aria_label=label)
    return el("label", el("span", label), el("output"), slider, data_for=name)


def _tile_size(rows: int, cols: int, height: int, width: int) -> tuple[int, int]:
    """(width, height) of a view in the atlas [px]."""
    scale = min(
        1.0,
        math.sqrt(ATLAS_PIXELS / (rows * cols * height * width)),
        ATLAS_SIDE / (cols * width),
        ATLAS_SIDE / (rows * height),
    )
    return max(1, int(width * scale)), max(1, int(height * scale))


def _atlas(views: U8, tile: tuple[int, int]) -> tuple[bytes, str]:
    """All views in one compressed picture, row by row, and its media type."""
    import cv2
    from PIL import features

    rows, cols, height, width = views.shape[:4]
    if tile != (width, height):
        flat = views.reshape(rows * cols, height, width, 3)
        small = np.stack([cv2.resize(view, tile, interpolation=cv2.INTER_AREA) for view in flat])
        views = small.reshape(rows, cols, tile[1], tile[0], 3).astype(np.uint8)
    sheet = Pillow.fromarray(views.transpose(0, 2, 1, 3, 4).reshape(rows * tile[1], cols * tile[0], 3))
    stream = io.BytesIO()
    if features.check("webp"):
        sheet.save(stream, "WEBP", quality=ATLAS_QUALITY, method=2)
        return stream.getvalue(), "image/webp"
    sheet.save(stream, "JPEG", quality=ATLAS_QUALITY, subsampling=0)
    return stream.getvalue(), "image/jpeg"


def _disparity_picture(disparity: F32, scale: pictures.Scale, tile: tuple[int, int]) -> pictures.Picture:
    """The disparity as 8 grey levels per … of its range: 256 levels over a few px are finer than the eye sees."""
    import cv2

    unit = np.clip((disparity - scale.low) / (scale.high - scale.low), 0, 1).astype(np.float32)
    if tile != (disparity.shape[1], disparity.shape[0]):
        unit = cv2.resize(unit, tile, interpolation=cv2.INTER_NEAREST).astype(np.float32)
    return pictures.grey(np.rint(255 * unit).astype(np.uint8))


def _gain(low: float, high: float, views: int, width: int) -> float:
    """How much the parallax is exaggerated at first (1 = as it is), a multiple of one half."""
    motion = (high - low) * (views - 1) / width
    if motion <= 0:
        return 1.0
    return min(MAX_GAIN, max(1.0, round(2 * LEAST_MOTION / motion) / 2))
