"""Picture files to RGB arrays and back: bounded, with an error that names the file for whatever is wrong with it.

PNG goes through OpenCV (16 bits, releases the GIL) after a check of its chunks and checksums, because OpenCV would
report a torn file on stderr only; TIFF of 16 bits through tifffile, the rest through Pillow.
"""

from __future__ import annotations

import contextlib
import io
import struct
import threading
import warnings
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from lfrig.contracts.errors import BadInput
from lfrig.contracts.files import disk_errors
from lfrig.processing.model import U8, Image

Pixels = TypeVar("Pixels", U8, Image)
MAX_PIXELS = 89_478_485
"""Largest picture that is decoded [px] (Pillow's own limit: a quarter of a GiB of RGB)."""
MAX_FILE_BYTES = 1 << 30
IMAGE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".ppm", ".pgm", ".webp"})
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_TIFF_SIGNATURES = (b"II*\0", b"MM\0*")
_WARNINGS = threading.RLock()
_READABLE = "give a PNG, JPEG or TIFF file"


def read_image(path: Path) -> Image:
    """Decode a picture as stored (EXIF orientation not applied): RGB uint8 or uint16 [H, W, 3].

    Grey becomes RGB, transparency is dropped.

    Raises
    ------
    BadInput
        Missing, unreadable, not a picture, torn, or larger than `MAX_PIXELS` (checked in its header).
    """
    data = read_bytes(path)
    if data.startswith(_PNG_SIGNATURE):
        check_png(data, path)
        return _decode_png(data, path)
    if data.startswith(_TIFF_SIGNATURES):
        deep = _decode_deep_tiff(data, path)
        if deep is not None:
            return deep
    return _decode_pillow(data, path)


def read_image8(path: Path) -> U8:
    """`read_image` as uint8; of 16 bits the upper 8."""
    image = read_image(path)
    return image.astype(np.uint8, copy=False) if image.itemsize == 1 else (image >> 8).astype(np.uint8)


def image_size(path: Path) -> tuple[int, int]:
    """(width, height) [px] as stored, from the header; raises as `read_image`."""
    data = read_bytes(path)
    if data.startswith(_PNG_SIGNATURE):
        return png_size(data, path)
    with open_pillow(data, path) as picture:
        return int(picture.size[0]), int(picture.size[1])


def read_bytes(path: Path) -> bytes:
    """A file's bytes; raises `BadInput` when it is missing, unreadable or unreasonably large."""
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise BadInput("is larger than 1 GiB", path=path, code="too-large", remedy=_READABLE)
        return path.read_bytes()
    except FileNotFoundError:
        raise BadInput("does not exist", path=path, code="missing-file", remedy="check the path") from None
    except OSError as error:
        raise BadInput(f"cannot be read: {error.strerror}", path=path, remedy="check the path") from None


def encode_png(image: Image, *, compression: int = 3) -> bytes:
    """PNG bytes of RGB uint8 or uint16 [H, W, 3]; the same bytes for the same pixels."""
    import cv2

    ok, data = cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_PNG_COMPRESSION, compression])
    if not ok:
        raise RuntimeError(f"OpenCV could not encode {image.dtype} {image.shape}")
    return bytes(data)


def write_png(path: Path, image: Image) -> None:
    """`encode_png` into a file (not atomic: meant for folders that are built aside); raises `DiskError`."""
    with disk_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(encode_png(image))


def png_size(data: bytes, path: Path) -> tuple[int, int]:
    """(width, height) [px] from a PNG's first chunk."""
    if len(data) < 33 or data[12:16] != b"IHDR":
        raise _torn(path)
    width, height = struct.unpack(">II", data[16:24])
    check_size(width, height, path)
    return width, height


def check_png(data: bytes, path: Path) -> None:
    """Raise `BadInput` unless the PNG is whole: size within bounds, each checksum right, an end chunk."""
    png_size(data, path)
    view, at = memoryview(data), len(_PNG_SIGNATURE)
    while at + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, at)
        end = at + 12 + length
        if end > len(data):
            break
        if zlib.crc32(view[at + 4 : end - 4]) != struct.unpack_from(">I", data, end - 4)[0]:
            raise BadInput("is damaged (wrong checksum)", path=path, code="damaged-image", remedy="copy the file again")
        if data[at + 4 : at + 8] == b"IEND":
            return
        at = end
    raise _torn(path)


def check_size(width: int, height: int, path: Path) -> None:
    """Raise `BadInput` for an empty picture or one larger than `MAX_PIXELS`."""
    if width < 1 or height < 1:
        raise BadInput("has no pixels", path=path, code="not-an-image", remedy=_READABLE)
    if width * height > MAX_PIXELS:
        raise BadInput(
            f"claims {width}×{height} px, more than the {MAX_PIXELS / 1e6:.0f} million that are read",
            path=path,
            code="image-too-large",
            remedy="make it smaller first",
        )


@contextlib.contextmanager
def quiet_pillow() -> Iterator[None]:
    """Pillow warns of damaged metadata and of large pictures on stderr; here neither is its business.

    Python's warning filters belong to the process: hence the lock, and only short work inside.
    """
    with _WARNINGS, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def open_pillow(data: bytes, path: Path) -> Any:
    """An undecoded Pillow image, its size within bounds; raises `BadInput`."""
    from PIL import Image as Pillow
    from PIL import UnidentifiedImageError

    try:
        with quiet_pillow():
            picture = Pillow.open(io.BytesIO(data))
    except Pillow.DecompressionBombError:
        raise BadInput(
            f"claims more than the {MAX_PIXELS / 1e6:.0f} million px that are read",
            path=path, code="image-too-large", remedy="make it smaller first",
        ) from None  # fmt: skip
    except (UnidentifiedImageError, OSError, ValueError, SyntaxError, struct.error):
        raise BadInput("is not an image", path=path, code="not-an-image", remedy=_READABLE) from None
    check_size(*picture.size, path)
    return picture


def _decode_png(data: bytes, path: Path) -> Image:
    import cv2

    # imdecode takes RGB order and 16 bits as they are; it knows no EXIF in PNG unless asked.
    flags = cv2.IMREAD_COLOR_RGB | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    if image is None:
        raise BadInput("is damaged", path=path, code="damaged-image", remedy="copy the file again")
    return np.asarray(image)


def _decode_pillow(data: bytes, path: Path) -> U8:
    with open_pillow(data, path) as picture:
        if picture.mode.startswith(("I", "F")):
            raise BadInput(
                f"has pixels of an unusual kind ({picture.mode})", path=path, code="not-8-or-16-bit",
                remedy="save it as PNG with 8 or 16 bits",
            )  # fmt: skip
        try:
            if picture.format == "TIFF":
                picture.getexif().pop(0x0112, None)  # or Pillow would turn it here, and `upright` again
            return np.array(picture.convert("RGB"))
        except (OSError, ValueError, SyntaxError, struct.error, zlib.error) as error:
            raise BadInput(
                f"is damaged ({error})", path=path, code="damaged-image", remedy="copy the file again"
            ) from None


def _decode_deep_tiff(data: bytes, path: Path) -> Image | None:
    """The first page of a TIFF with 16 bits per channel; None when it has 8 (Pillow knows more compressions)."""
    import tifffile

    try:
        with tifffile.TiffFile(io.BytesIO(data)) as file:
            page = file.pages.first
            if page.dtype != np.uint16:
                return None
            check_size(page.imagewidth, page.imagelength, path)
            pixels = page.asarray()
            axes = page.axes
    except (tifffile.TiffFileError, ValueError, KeyError, struct.error, zlib.error) as error:
        raise BadInput(
            f"cannot be decoded ({error})", path=path, code="damaged-image", remedy="save it as PNG"
        ) from None
    if axes == "SYX":
        pixels = np.moveaxis(pixels, 0, -1)
    if pixels.ndim == 2:
        pixels = pixels[..., None]
    return np.ascontiguousarray(np.broadcast_to(pixels[..., :3] if pixels.shape[2] >= 3 else pixels[..., :1],
                                                (*pixels.shape[:2], 3)))  # fmt: skip


def _torn(path: Path) -> BadInput:
    return BadInput("is cut off before its end", path=path, code="truncated-image", remedy="copy the file again")
