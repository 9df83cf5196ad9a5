"""Arrays → embedded pictures: photographs, colour-mapped maps, strips."""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass
from functools import cache

import numpy as np
from PIL import Image as Pillow

from lfrig.processing.model import F32, U8
from lfrig.processing.report.html import Html
from lfrig.processing.report.html import image as image_element

PHOTO_QUALITY = 82
MAX_WIDTH = 720
"""Widest embedded picture [px]: what a page column shows; larger photos are reduced."""


@dataclass(frozen=True)
class Picture:
    """An encoded picture: its data URI and its size [px]."""

    uri: str
    width: int
    height: int

    def element(self, alt: str, class_: str | None = None) -> Html:
        """The picture as an element."""
        return image_element(self.uri, alt, self.width, self.height, class_)


@dataclass(frozen=True)
class Scale:
    """A colour scale: values ``low`` … ``high`` on the colour map ``name``."""

    low: float
    high: float
    name: str = "viridis"


@cache
def lookup_table(name: str) -> U8:
    """256 colours uint8 [256, 3] RGB of a perceptually uniform map (viridis, magma, inferno, cividis), or of
    ``balance``, a diverging blue–grey–red one.
    """
    if name == "balance":
        return _diverging()
    import cv2

    ramp = np.arange(256, dtype=np.uint8)[:, None]
    colours = cv2.applyColorMap(ramp, getattr(cv2, f"COLORMAP_{name.upper()}"))
    return np.ascontiguousarray(colours[:, 0, ::-1])


def robust_scale(values: F32, name: str = "viridis", tail_percent: float = 0.5) -> Scale:
    """A scale over the known values without their extreme tails; (0, 1) when nothing is known."""
    known = values[np.isfinite(values)]
    if known.size == 0:
        return Scale(0.0, 1.0, name)
    low, high = np.percentile(known, [tail_percent, 100 - tail_percent]).astype(float)
    pad = max(1e-9, 1e-3 * max(abs(low), abs(high)))
    return Scale(low, high if high - low > pad else low + pad, name)


def photograph(image: U8, max_width: int = MAX_WIDTH) -> Picture:
    """A photograph, uint8 [H, W, 3], reduced to ``max_width`` and compressed with loss."""
    small = shrink(image, max_width)
    stream = io.BytesIO()
    Pillow.fromarray(small).save(stream, "JPEG", quality=PHOTO_QUALITY, optimize=True)
    return Picture(_uri("image/jpeg", stream.getvalue()), small.shape[1], small.shape[0])


def coloured(values: F32, scale: Scale, max_width: int = MAX_WIDTH) -> Picture:
    """A map, float32 [H, W], in the colours of ``scale``, without loss; unknown (NaN) pixels are transparent."""
    stride = -(-values.shape[1] // max_width)
    small = values[::stride, ::stride]
    known = np.isfinite(small)
    unit = (np.where(known, small, scale.low) - scale.low) / (scale.high - scale.low)
    # Index 0 is kept for "unknown", the other 255 are the scale.
    index = np.where(known, 1 + np.rint(np.clip(unit, 0, 1) * 254), 0).astype(np.uint8)
    picture = Pillow.fromarray(index)
    colours = lookup_table(scale.name)
    picture.putpalette(np.concatenate([colours[:1], colours[:255]]).tobytes())
    return _png(picture, transparency=0)


def grey(values: U8) -> Picture:
    """A grey PNG without loss, uint8 [H, W]."""
    return _png(Pillow.fromarray(values))


def cutout(values: U8) -> Picture:
    """A picture with transparency, uint8 [H, W, 4], compressed with loss where that is available."""
    from PIL import features

    picture = Pillow.fromarray(values)
    if not features.check("webp"):
        return _png(picture)
    stream = io.BytesIO()
    picture.save(stream, "WEBP", quality=70, method=4)
    return Picture(_uri("image/webp", stream.getvalue()), *picture.size)


def strip(image: U8, factor: int, axis: int) -> Picture:
    """A narrow picture, uint8 [H, W, 3], repeated ``factor`` times along ``axis`` so that its lines can be seen."""
    return photograph(np.repeat(image, factor, axis=axis), max_width=max(image.shape[1] * factor, MAX_WIDTH))


def shrink(image: U8, max_width: int) -> U8:
    """``image`` [H, W, 3] no wider than ``max_width`` (area average)."""
    height, width = image.shape[:2]
    if width <= max_width:
        return np.ascontiguousarray(image)
    import cv2

    size = (max_width, max(1, round(height * max_width / width)))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def _diverging() -> U8:
    anchors = np.array([[24, 60, 145], [88, 140, 205], [236, 236, 234], [222, 120, 84], [142, 24, 38]], float)
    at = np.linspace(0, 4, 256)
    columns = [np.interp(at, np.arange(5), anchors[:, channel]) for channel in range(3)]
    return np.asarray(np.rint(np.stack(columns, -1)), np.uint8)


def _png(picture: Pillow.Image, transparency: int | None = None) -> Picture:
    stream = io.BytesIO()
    options = {} if transparency is None else {"transparency": transparency}
    picture.save(stream, "PNG", compress_level=9, **options)
    return Picture(_uri("image/png", stream.getvalue()), *picture.size)


def _uri(kind: str, data: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(data).decode('ascii')}"
