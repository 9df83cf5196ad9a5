"""RGB images to PNG files and back, 8 or 16 bits per channel, without loss."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lfrig.contracts.errors import BadInput
from lfrig.contracts.files import disk_errors
from lfrig.processing.model import U8, Image

COMPRESSION = 3
"""zlib level: 6 is 10 % smaller and three times slower on photographs."""


def encode_png(image: Image) -> bytes:
    """PNG bytes of an RGB image, uint8 or uint16 [H, W, 3]."""
    import cv2

    ok, data = cv2.imencode(".png", image[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, COMPRESSION])
    if not ok:  # cv2 reports what it cannot encode by its return value
        raise BadInput(f"cannot be encoded as PNG: {image.dtype} {list(image.shape)}", remedy="pass uint8 or uint16")
    return bytes(data)


def write_png(path: Path, image: Image) -> None:
    """Write an RGB image, uint8 or uint16 [H, W, 3]; raises `DiskError`."""
    with disk_errors(path):
        path.write_bytes(encode_png(image))


def read_png(path: Path) -> Image:
    """Read an RGB image, uint8 or uint16 [H, W, 3]; raises `BadInput` that names the file."""
    import cv2

    if not path.is_file():
        raise BadInput("does not exist", path=path, code="missing-file", remedy="restore the file")
    try:
        data = np.fromfile(path, np.uint8)
    except OSError as error:
        raise BadInput(f"cannot be read: {error.strerror}", path=path, remedy="check the permissions") from None
    image = cv2.imdecode(data, cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH) if data.size else None
    if image is None or image.dtype not in (np.uint8, np.uint16):
        raise BadInput("is not an image", path=path, code="not-an-image", remedy="restore the file")
    return np.ascontiguousarray(image[..., ::-1])


def to_8_bit(image: Image) -> U8:
    """The high byte of a uint16 image; a uint8 image as it is."""
    return image.astype(np.uint8, copy=False) if image.itemsize == 1 else (image >> 8).astype(np.uint8)
