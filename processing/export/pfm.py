"""Portable float maps: little- or big-endian, grey or colour, rows stored bottom-up.

Header: ``Pf`` (grey) or ``PF`` (colour), width and height, a scale whose *sign* is the byte order (negative =
little-endian). The magnitude of the scale is not applied, as in the HCI and Middlebury tools.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.errors import BadInput
from lfrig.contracts.files import disk_errors

_HEADER = re.compile(rb"(P[Ff])\s+(\d+)\s+(\d+)\s+([-+]?[0-9.]+(?:[eE][-+]?\d+)?)\s")
_CHANNELS = {b"Pf": 1, b"PF": 3}


def encode_pfm(image: NDArray[np.floating], *, little_endian: bool = True) -> bytes:
    """The bytes of a PFM file of ``image``, float [H, W] or [H, W, 3]; NaN and infinities are kept."""
    if image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3) or 0 in image.shape:
        raise BadInput(f"a PFM holds [H, W] or [H, W, 3], got {list(image.shape)}", remedy="export another array")
    kind = "Pf" if image.ndim == 2 else "PF"
    height, width = image.shape[:2]
    scale = "-1" if little_endian else "1"
    pixels = np.ascontiguousarray(image[::-1], "<f4" if little_endian else ">f4")
    return f"{kind}\n{width} {height}\n{scale}\n".encode("ascii") + pixels.tobytes()


def decode_pfm(data: bytes, path: Path | str = "PFM data") -> NDArray[np.float32]:
    """The image in the bytes of a PFM file: float32 [H, W] or [H, W, 3], native byte order, top row first.

    Raises
    ------
    BadInput
        No PFM header, or fewer or more bytes than the header says; names ``path``.
    """
    header = _HEADER.match(data)
    if header is None:
        raise BadInput("is not a PFM file (no 'Pf' header)", path=path, code="not-pfm", remedy="restore the file")
    channels = _CHANNELS[header[1]]
    width, height, scale = int(header[2]), int(header[3]), float(header[4])
    expected, found = width * height * channels * 4, len(data) - header.end()
    if found != expected or expected == 0 or scale == 0:
        raise BadInput(
            f"holds {found} bytes of pixels, its header ({width} × {height}, scale {scale:g}) asks for {expected}",
            path=path, code="pfm-damaged", remedy="restore the file",
        )  # fmt: skip
    flat = np.frombuffer(data, "<f4" if scale < 0 else ">f4", offset=header.end())
    shape = (height, width) if channels == 1 else (height, width, 3)
    return np.ascontiguousarray(flat.reshape(shape)[::-1], np.float32)


def write_pfm(path: Path, image: NDArray[np.floating], *, little_endian: bool = True) -> None:
    """Write ``image``, float [H, W] or [H, W, 3], to ``path``; raises `DiskError`."""
    with disk_errors(path):
        path.write_bytes(encode_pfm(image, little_endian=little_endian))


def read_pfm(path: Path) -> NDArray[np.float32]:
    """Read a PFM file: float32 [H, W] or [H, W, 3]; raises `BadInput` that names it."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise BadInput("does not exist", path=path, code="missing-file", remedy="check the path") from None
    except OSError as error:
        raise BadInput(f"cannot be read: {error.strerror}", path=path, remedy="check the permissions") from None
    return decode_pfm(data, path)
