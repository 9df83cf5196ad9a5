"""Raw photos (DNG, CR2, CR3, NEF, ARW, …) to RGB, through LibRaw.

Developed as the camera saw it and always alike: AHD demosaic, the camera's white balance (a grey world where the file
records none), linear sRGB from the file's own colour matrix or LibRaw's for the camera, the sRGB curve, 16 bits.
Nothing depends on what is in the picture: no automatic brightness, and white is the sensor's white level.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.errors import BadInput, ProcessingError
from lfrig.contracts.lytro import FILE_MAGIC
from lfrig.contracts.stderr import quiet_stderr
from lfrig.rig.session.images import MAX_FILE_BYTES, check_size
from lfrig.rig.session.tiff_blocks import fault_of_blocks

if TYPE_CHECKING:
    from rawpy import RawPy

RAW_PHOTO_SUFFIXES = frozenset(
    {
        ".3fr", ".arw", ".cr2", ".cr3", ".crw", ".dcr", ".dng", ".erf", ".fff", ".iiq", ".kdc", ".mef", ".mos", ".mrw",
        ".nef", ".nrw", ".orf", ".pef", ".raf", ".rw2", ".rwl", ".sr2", ".srf", ".srw", ".x3f",
    }
)  # fmt: skip
SRGB_CURVE = (2.4, 12.92)
"""Exponent and slope near black of the sRGB curve (IEC 61966-2-1), as LibRaw wants them."""
_TRANSPOSED = 4
"""Bit of LibRaw's ``flip`` that exchanges rows and columns."""
_COPY_AGAIN = "copy the file from the camera again"


@dataclass(frozen=True)
class RawPhotoHeader:
    """What a raw photo says before it is decoded: upright size [px], exposure; 0 = not recorded."""

    width: int
    height: int
    exposure_s: float
    iso: float
    focal_length_mm: float


def is_raw_photo(path: Path) -> bool:
    """Whether a file is named like a raw photo."""
    return path.suffix.lower() in RAW_PHOTO_SUFFIXES


def read_header(path: Path) -> RawPhotoHeader:
    """Size and exposure of a raw photo, without decoding it; raises as `develop`."""
    with _opened(path) as raw:
        width, height = _upright_size(raw)
        other = raw.other
        return RawPhotoHeader(
            width, height, float(other.shutter_speed), float(other.iso_speed), float(other.focal_length)
        )


def develop(path: Path) -> NDArray[np.uint16]:
    """Decode a raw photo: sRGB uint16 [H, W, 3], upright. The same file gives the same bytes.

    Raises
    ------
    BadInput
        ``missing-file``, ``empty-file``, ``light-field`` (a plenoptic camera's file), ``not-a-raw-photo`` (of no
        format or camera that LibRaw knows, or torn before its pixels), ``truncated-image``, ``damaged-image``,
        ``image-too-large`` (checked in its header).
    ProcessingError
        The package rawpy is missing.
    """
    with _opened(path) as raw:
        developed: NDArray[Any] = raw.postprocess(
            use_camera_wb=True,
            gamma=SRGB_CURVE,
            output_bps=16,
            no_auto_bright=True,
            # LibRaw would else take the brightest pixel as white where it is above three quarters of it.
            adjust_maximum_thr=0.0,
        )
    if developed.ndim == 2:
        developed = developed[..., None]
    if developed.shape[2] == 1:  # a monochrome sensor
        developed = np.broadcast_to(developed, (*developed.shape[:2], 3))
    return np.ascontiguousarray(developed[..., :3], np.uint16)


def refuse_light_field(path: Path) -> None:
    """Raise `BadInput` when a file that should be a photo is a plenoptic camera's, whatever its name."""
    if _beginning(path) == FILE_MAGIC:
        raise BadInput(
            "is a raw light field, not a photo", path=path, code="light-field",
            remedy="ingest it as a light field: leave --as photo out",
        )  # fmt: skip


def _beginning(path: Path) -> bytes:
    try:
        with path.open("rb") as stream:
            return stream.read(len(FILE_MAGIC))
    except FileNotFoundError:
        raise BadInput("does not exist", path=path, code="missing-file", remedy="check the path") from None
    except OSError as error:
        raise BadInput(f"cannot be read: {error.strerror}", path=path, remedy="check the path") from None


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[RawPy]:
    """A raw photo with its size within bounds; whatever LibRaw has against it, then or in the block, is `BadInput`."""
    _check_file(path)
    try:
        import rawpy
    except ImportError as error:
        raise ProcessingError(
            f"{path}: raw photos need the package rawpy ({error})", code="missing-package",
            remedy="pip install rawpy, or develop the photo to a 16-bit PNG or TIFF first",
        ) from None  # fmt: skip
    try:
        # LibRaw prints where data are bad before it says that they are.
        with quiet_stderr(), rawpy.imread(str(path)) as raw:
            check_size(*_upright_size(raw), path)
            check_size(raw.sizes.raw_width, raw.sizes.raw_height, path)
            yield raw
    except rawpy.LibRawIOError:
        raise _torn(path) from None
    except rawpy.LibRawDataError:
        raise _damaged(path) from None
    except (rawpy.LibRawTooBigError, rawpy.LibRawUnsufficientMemoryError, rawpy.LibRawMemPoolOverflowError):
        raise BadInput(
            "needs more memory than raw photos may take", path=path, code="image-too-large",
            remedy="develop it to a 16-bit PNG or TIFF first",
        ) from None  # fmt: skip
    except (rawpy.LibRawError, rawpy.NotSupportedError):
        raise BadInput(
            "is no raw photo that can be read: none at all, torn, or of a camera that is not known", path=path,
            code="not-a-raw-photo", remedy="give the camera's own file, or develop it to a 16-bit PNG or TIFF first",
        ) from None  # fmt: skip


def _check_file(path: Path) -> None:
    refuse_light_field(path)
    size = path.stat().st_size
    if size == 0:
        raise BadInput("is empty", path=path, code="empty-file", remedy=_COPY_AGAIN)
    if size > MAX_FILE_BYTES:
        raise BadInput(
            "is larger than 1 GiB", path=path, code="too-large", remedy="develop it to a 16-bit PNG or TIFF first"
        )
    fault = fault_of_blocks(path)
    if fault is not None:
        raise _torn(path) if fault == "torn" else _damaged(path)


def _torn(path: Path) -> BadInput:
    return BadInput("is cut off before its end", path=path, code="truncated-image", remedy=_COPY_AGAIN)


def _damaged(path: Path) -> BadInput:
    return BadInput("is damaged", path=path, code="damaged-image", remedy=_COPY_AGAIN)


def _upright_size(raw: RawPy) -> tuple[int, int]:
    """(width, height) of what `develop` gives: pixels made square by stretching the shorter side, then turned."""
    sizes = raw.sizes
    width, height, aspect = int(sizes.width), int(sizes.height), float(sizes.pixel_aspect)
    if 0 < aspect < 1:
        height = int(height / aspect + 0.5)
    elif aspect > 1:
        width = int(width * aspect + 0.5)
    return (height, width) if sizes.flip & _TRANSPOSED else (width, height)
