"""What a photo's EXIF knows: which way is up, the focal length in pixels, exposure, time.

Tag numbers and meanings: CIPA DC-008 (Exif 2.32).
"""

from __future__ import annotations

import io
import math
import re
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from lfrig.contracts.capture import CameraSpec, ExposureSpec
from lfrig.processing.model import Image
from lfrig.rig.session.images import Pixels, image_size, open_pillow, quiet_pillow, read_bytes, read_image
from lfrig.rig.session.raw_photo import develop, is_raw_photo, read_header

_ORIENTATION, _EXIF_IFD = 0x0112, 0x8769
_EXPOSURE_TIME, _ISO, _TIME = 0x829A, 0x8827, 0x9003
_FOCAL_LENGTH, _FOCAL_LENGTH_35MM = 0x920A, 0xA405
_PIXELS_X, _PIXELS_Y = 0xA002, 0xA003
_PLANE_RESOLUTION_X, _PLANE_RESOLUTION_UNIT = 0xA20E, 0xA210
_UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}
_FILM_DIAGONAL_MM = math.hypot(36.0, 24.0)

SIGMA_FROM_PLANE_RESOLUTION = 0.02
"""Relative: the lens's own focal length is nominal, and focusing close lengthens it."""
SIGMA_FROM_35MM = 0.05
"""Relative: whole millimetres, and makers disagree whether the diagonal or the width is meant (4 % at 4:3)."""
_PLAUSIBLE_FOCAL = (0.3, 30.0)
"""In image widths: fields of view from 118° to 2°."""


@dataclass(frozen=True)
class Exif:
    """The tags that matter, by number; ``orientation`` 1..8 (1 = as stored)."""

    orientation: int = 1
    tags: Mapping[int, Any] = field(default_factory=dict)

    def number(self, tag: int) -> float | None:
        """A tag as a positive finite number, or None."""
        value = self.tags.get(tag)
        value = value[0] if isinstance(value, tuple) and value else value
        try:
            number = float(value)  # type: ignore[arg-type]
        except (TypeError, ValueError, ZeroDivisionError):
            return None
        return number if math.isfinite(number) and number > 0 else None


def read_exif(path: Path) -> Exif:
    """EXIF of a picture file; empty when it has none or a damaged one. Raises `BadInput` for no picture at all.

    The orientation of a raw photo is always 1: it is applied when it is developed.
    """
    if is_raw_photo(path):
        return _raw_photo_exif(path)
    with open_pillow(read_bytes(path), path) as picture:
        tags = _all_tags(picture.getexif)
    orientation = tags.get(_ORIENTATION, 1)
    return Exif(orientation if orientation in range(1, 9) else 1, tags)


def _all_tags(load: Callable[[], Any]) -> dict[int, Any]:
    """The tags of the first directory and of the Exif one; none where they are damaged."""
    try:
        with quiet_pillow():
            exif = load()
            return {**exif, **exif.get_ifd(_EXIF_IFD)}
    # A damaged block costs the metadata, not the picture; Pillow answers it with any of these.
    except (OSError, ValueError, SyntaxError, TypeError, KeyError, IndexError, struct.error):
        return {}


def _raw_photo_exif(path: Path) -> Exif:
    """EXIF of a raw photo that is a TIFF file (most are); of others, exposure and focal length as LibRaw reads them."""
    header = read_header(path)
    known = {_EXPOSURE_TIME: header.exposure_s, _ISO: header.iso, _FOCAL_LENGTH: header.focal_length_mm}
    data = read_bytes(path)
    byte_order = data[:2]
    if byte_order not in (b"II", b"MM"):
        return Exif(tags=known)

    def load() -> Any:
        from PIL import Image as Pillow

        exif = Pillow.Exif()
        stream = io.BytesIO(data)
        # Olympus and Panasonic write another number where TIFF has 42; what follows is TIFF.
        stream.seek(2)
        stream.write(b"*\0" if byte_order == b"II" else b"\0*")
        stream.seek(0)
        exif.load_from_fp(stream)
        return exif

    return Exif(tags={**known, **_all_tags(load)})


def photo_size(path: Path, exif: Exif) -> tuple[int, int]:
    """(width, height) [px] of a photo turned upright, from its header; raises `BadInput`."""
    if is_raw_photo(path):
        header = read_header(path)
        return header.width, header.height
    width, height = image_size(path)
    return (height, width) if exif.orientation >= 5 else (width, height)


def upright(image: Pixels, orientation: int) -> Pixels:
    """Turn and mirror a picture [H, W, 3] as its EXIF orientation 1..8 says."""
    turned: Any = image.transpose(1, 0, 2) if orientation in {5, 6, 7, 8} else image
    turned = turned[::-1] if orientation in {3, 4, 7, 8} else turned
    turned = turned[:, ::-1] if orientation in {2, 3, 6, 7} else turned
    upright_image: Pixels = np.ascontiguousarray(turned)
    return upright_image


def camera_spec(exif: Exif, width: int, height: int) -> CameraSpec:
    """Intrinsics of an upright picture; without a plausible focal length only its size."""
    focal, sigma = _focal_px(exif, width, height)
    if focal is None:
        return CameraSpec(width=width, height=height)
    return CameraSpec(width=width, height=height, fx=focal, fy=focal, sigma_f=sigma)


def _focal_px(exif: Exif, width: int, height: int) -> tuple[float | None, float]:
    from_plane = _from_plane_resolution(exif, width, height)
    if from_plane is not None and _plausible(from_plane, width, height):
        return from_plane, SIGMA_FROM_PLANE_RESOLUTION
    film_mm = exif.number(_FOCAL_LENGTH_35MM)
    if film_mm is not None:
        focal = film_mm * math.hypot(width, height) / _FILM_DIAGONAL_MM
        if _plausible(focal, width, height):
            return focal, SIGMA_FROM_35MM
    return None, 0.0


def _from_plane_resolution(exif: Exif, width: int, height: int) -> float | None:
    focal_mm = exif.number(_FOCAL_LENGTH)
    per_unit = exif.number(_PLANE_RESOLUTION_X)
    unit_mm = _UNIT_MM.get(int(exif.number(_PLANE_RESOLUTION_UNIT) or 2))
    if focal_mm is None or per_unit is None or unit_mm is None:
        return None
    # The resolution is that of the picture as taken; it may have been made smaller since.
    taken = max(exif.number(_PIXELS_X) or 0.0, exif.number(_PIXELS_Y) or 0.0) or max(width, height)
    return focal_mm * per_unit / unit_mm * max(width, height) / taken


def _plausible(focal: float, width: int, height: int) -> bool:
    low, high = _PLAUSIBLE_FOCAL
    return low <= focal / max(width, height) <= high


def exposure_spec(exif: Exif) -> ExposureSpec | None:
    """Exposure time and ISO, or None when neither is known."""
    time_s, iso = exif.number(_EXPOSURE_TIME), exif.number(_ISO)
    return None if time_s is None and iso is None else ExposureSpec(time_s=time_s, iso=iso)


def time_taken(exif: Exif) -> str | None:
    """Local time of the shot as ISO 8601 without a zone (EXIF knows none), or None."""
    match = re.fullmatch(r"(\d{4}):(\d\d):(\d\d) (\d\d:\d\d:\d\d)\0*", str(exif.tags.get(_TIME, "")).strip())
    return f"{match[1]}-{match[2]}-{match[3]}T{match[4]}" if match else None


def read_photo(path: Path) -> tuple[Image, Exif]:
    """A picture turned upright, and its EXIF; a raw photo is developed to 16 bits. Raises `BadInput`."""
    exif = read_exif(path)
    if is_raw_photo(path):
        return develop(path), exif
    image = read_image(path)
    return upright(image, exif.orientation), exif
