"""``--format dng``: the sensor values of a raw light field as a colour-filter-array DNG, for raw converters.

The values are the camera's own, neither divided by a white image nor demosaiced: a picture of lenses. Levels, filter
pattern and white balance are the file's. Tags: Adobe, "Digital Negative (DNG) Specification", version 1.4.

``ColorMatrix1`` takes XYZ at D65 to camera RGB, while a Lytro file has the matrix C from *white-balanced* camera RGB to
linear sRGB. With C's rows scaled to sum to one (greys stay grey), g the white-balance gains and M the matrix from
linear sRGB to XYZ (IEC 61966-2-1), it is ``diag(1/g) · C⁻¹ · M⁻¹``. The white of the shot, ``AsShotNeutral`` = 1/g, is
then D65 by construction, and a converter that balances white and inverts the matrix arrives at C.
"""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.files import disk_errors
from lfrig.contracts.progress import Monitor
from lfrig.processing.export.content import Content
from lfrig.processing.lenslet.colour import colour_matrix
from lfrig.processing.lenslet.container import read_container
from lfrig.processing.lenslet.contents import part, raw_frame
from lfrig.processing.lenslet.develop import bayer_sites
from lfrig.processing.lenslet.metadata import RawMetadata, read_metadata
from lfrig.processing.lenslet.raw import IMAGE_FIELD
from lfrig.processing.lenslet.unpack import U16, unpack
from lfrig.processing.model import F64

XYZ_OF_SRGB = ((0.4124, 0.3576, 0.1805), (0.2126, 0.7152, 0.0722), (0.0193, 0.1192, 0.9505))
"""Linear sRGB → XYZ, white D65 (IEC 61966-2-1)."""
MAX_CONDITION = 1e3
"""A colour matrix worse than this cannot be inverted to any use; the identity is written then."""
_MAX_TERM, _MAX_DENOMINATOR = 2**31 - 1, 1_000_000
_D65 = 21
_CFA = 32803
_CFA_COLOURS = "RGB"

Tag = tuple[int, str, int, Any, bool]
"""(number, TIFF type, count, value, whether it is written once), as tifffile takes it."""


def export_dng(content: Content, out: Path, monitor: Monitor) -> None:
    """Write the sensor values of ``content``'s raw file to ``out``, uint16, not compressed; same file, same bytes.

    Raises
    ------
    BadInput
        There is no raw file, or it cannot be read.
    DiskError
        Writing failed.
    """
    path = content.require_raw()
    with monitor.task("dng", 2):
        sensor, metadata = read_sensor(path)
        monitor.advance()
        write_dng(out, sensor, metadata)
        monitor.advance()


def read_sensor(path: Path) -> tuple[U16, RawMetadata]:
    """Sensor values uint16 [Hs, Ws] as recorded, and the metadata; raises `BadInput`."""
    container = read_container(path)
    frame = raw_frame(container)
    metadata = read_metadata(container, frame)
    return unpack(part(container, frame.image_ref, IMAGE_FIELD), metadata, path, IMAGE_FIELD), metadata


def write_dng(out: Path, sensor: U16, metadata: RawMetadata) -> None:
    """Write sensor values uint16 [Hs, Ws] with what the metadata say of them; raises `DiskError`."""
    import tifffile

    with disk_errors(out):
        tifffile.imwrite(
            out, sensor, photometric=_CFA, subfiletype=0, software="lfrig", metadata=None, extratags=dng_tags(metadata)
        )


def dng_tags(metadata: RawMetadata) -> list[Tag]:
    """The tags beyond those of any TIFF file; what the metadata do not say is left out."""
    make, model = _ascii(metadata.make) or "Lytro", _ascii(metadata.model) or "Light Field Camera"
    black = [metadata.black[site] for site in bayer_sites(metadata.bayer)]
    # One white for all colours: the lowest, so that what is saturated in any of them is white.
    white = int(min(*metadata.white, 2**metadata.bits - 1))
    tags: list[Tag] = [
        (271, "s", 0, make, True),
        (272, "s", 0, model, True),
        (33421, "H", 2, (2, 2), True),  # CFARepeatPatternDim
        (33422, "B", 4, bytes(_CFA_COLOURS.index(letter) for letter in metadata.bayer), True),  # CFAPattern
        (50706, "B", 4, bytes([1, 4, 0, 0]), True),  # DNGVersion
        (50707, "B", 4, bytes([1, 1, 0, 0]), True),  # DNGBackwardVersion
        (50708, "s", 0, f"{make} {model}", True),  # UniqueCameraModel
        (50713, "H", 2, (2, 2), True),  # BlackLevelRepeatDim
        _rationals(50714, black),  # BlackLevel
        (50717, "I", 1, white, True),  # WhiteLevel
        _rationals(50721, color_matrix(metadata).ravel(), signed=True),  # ColorMatrix1
        _rationals(50728, neutral(metadata)),  # AsShotNeutral
        (50778, "H", 1, _D65, True),  # CalibrationIlluminant1
    ]
    serial = _ascii(metadata.serial)
    if serial:
        tags.append((50735, "s", 0, serial, True))  # CameraSerialNumber
    for number, value in ((33434, metadata.exposure_s), (33437, metadata.f_number)):  # ExposureTime, FNumber
        if value is not None:
            tags.append(_rationals(number, [value]))
    if metadata.iso is not None:
        tags.append((34855, "H", 1, round(min(metadata.iso, 65535)), True))  # ISOSpeedRatings
    if metadata.focal_length_m is not None:
        tags.append(_rationals(37386, [metadata.focal_length_m * 1e3]))  # FocalLength [mm]
    return tags


def neutral(metadata: RawMetadata) -> F64:
    """Camera RGB of white, green 1, float64 [3]; ones where no white balance was recorded."""
    if metadata.white_balance is None:
        return np.ones(3)
    r, gr, gb, b = metadata.white_balance
    green = (gr + gb) / 2
    return np.clip([green / r, 1.0, green / b], 1e-3, 1e3)


def color_matrix(metadata: RawMetadata) -> F64:
    """XYZ (D65) → camera RGB before white balance, float64 [3, 3]; see the head of this file."""
    srgb_of_camera: NDArray[np.float64] = colour_matrix(metadata).astype(np.float64)
    if np.linalg.cond(srgb_of_camera) > MAX_CONDITION:
        srgb_of_camera = np.eye(3)
    xyz_of_camera = np.array(XYZ_OF_SRGB) @ srgb_of_camera
    return np.asarray(neutral(metadata)[:, None] * np.linalg.inv(xyz_of_camera))


def _rationals(number: int, values: Any, *, signed: bool = False) -> Tag:
    parts: list[int] = []
    for value in np.clip(np.asarray(values, np.float64), -_MAX_TERM, _MAX_TERM).tolist():
        # Numerator and denominator have 32 bits.
        largest = min(_MAX_DENOMINATOR, _MAX_TERM // (int(abs(value)) + 1))
        fraction = Fraction(value).limit_denominator(max(1, largest))
        parts += [fraction.numerator, fraction.denominator]
    return number, "2i" if signed else "2I", len(parts) // 2, parts, True


def _ascii(text: str | None) -> str:
    """What a TIFF string may hold of a text."""
    return "".join(letter for letter in text or "" if " " <= letter <= "~").strip()
