"""The format of Lytro files and the nominal figures of the two cameras: what reader and writer must agree on.

Facts about bytes, no behaviour. `processing/lenslet` reads by them, the simulator writes by them, and they share
nothing else, so that one tests the other. Sources: the files' own metadata, and the readers of LFToolbox, imageio and
PlenoptiCam; the list of hot pixels after the lytro_tools scripts.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Literal

# -- container ---------------------------------------------------------------------------------------------------
FILE_MAGIC = b"\x89LFP\r\n\x1a\n"
"""First 8 bytes of .lfp, .lfr and .lfx files."""
TOC_MAGIC = b"\x89LFM\r\n\x1a\n"
"""Section that holds the JSON table of contents."""
CONTENT_MAGIC = b"\x89LFC\r\n\x1a\n"
"""Section that holds content: JSON, sensor values, a thumbnail, …"""
FILE_HEADER = struct.Struct(">8sII")
"""Magic, version, length (0)."""
FILE_VERSION = 1
SECTION_HEADER = struct.Struct(">8sII45s35x")
"""Magic, version, length of the data, reference; the data follow, then zeros up to the next section."""
SECTION_VERSION = 0
REFERENCE_PREFIX = "sha1-"
"""A reference is this and 40 hex digits, the SHA-1 of the section's data."""
SECTION_ALIGNMENT = 16
"""What cameras pad sections to; readers must not rely on it."""

# -- calibration archive -----------------------------------------------------------------------------------------
MANIFEST_NAME = "cal_file_manifest.json"
"""``{"calibrationFiles": [{"name": "MOD_0001.GCT", "hash": "sha1-…"}]}``; the hash is `geometryCorrectionRef`."""
HOT_PIXELS_NAME = "HOTPIXEL.BIN"
"""u32 count, count × i16 x, count × i16 y, little-endian."""
WHITE_IMAGE_PREFIX = "MOD_"
"""White images are ``MOD_nnnn.RAW`` (packed like a shot) with ``MOD_nnnn.TXT`` (JSON metadata) and ``.GCT``."""

# -- sensor ------------------------------------------------------------------------------------------------------
Packing = Literal["big", "little"]
"""How values of more than 8 bits are packed.

``little`` 10 bits: 5 bytes hold 4 values, bytes 0..3 their upper 8 bits, bits 2i and 2i+1 of byte 4 the lower 2 of
value i. ``big`` 12 bits: 3 bytes hold 2 values, ``b0 << 4 | b1 >> 4`` and ``(b1 & 15) << 8 | b2``. 8 and 16 bits are
plain bytes, 16 in the byte order named.
"""
PACKED_GROUPS: dict[tuple[int, Packing], tuple[int, int]] = {
    (8, "big"): (1, 1),
    (8, "little"): (1, 1),
    (10, "little"): (4, 5),
    (12, "big"): (2, 3),
    (16, "big"): (1, 2),
    (16, "little"): (1, 2),
}
"""(pixels, bytes) of a group by bits per pixel and packing; a sensor's last group may hold fewer pixels."""


def packed_size(pixels: int, bits: int, packing: Packing) -> int:
    """Bytes that ``pixels`` values fill, the last group completed; `KeyError` for a packing that no camera has."""
    group_pixels, group_bytes = PACKED_GROUPS[bits, packing]
    return -(-pixels // group_pixels) * group_bytes


BayerPattern = Literal["RGGB", "GRBG", "GBRG", "BGGR"]
"""Colours of the sensor's first 2×2 pixels, row by row."""
UPPER_LEFT_PIXEL: dict[str, BayerPattern] = {"r": "RGGB", "gr": "GRBG", "gb": "GBRG", "b": "BGGR"}
"""Bayer pattern by ``mosaic.upperLeftPixel``, with ``mosaic.tile`` = ``r,gr:gb,b``."""
COLOURS = ("r", "gr", "gb", "b")
"""Names and order of the four Bayer colours; ``gr`` is the green in the red pixels' rows."""


@dataclass(frozen=True)
class CameraFigures:
    """Nominal figures of a camera model; the file's own metadata win."""

    model: str
    width: int
    height: int
    bits: int
    packing: Packing
    bayer: BayerPattern
    black: int
    white: int
    pixel_pitch_m: float
    lens_pitch_m: float

    @property
    def payload_bytes(self) -> int:
        """Size of the packed sensor values."""
        return packed_size(self.width * self.height, self.bits, self.packing)


F01 = CameraFigures("F01", 3280, 3280, 12, "big", "BGGR", 168, 4095, 1.4e-6, 1.4e-5)
ILLUM = CameraFigures("ILLUM", 7728, 5368, 10, "little", "GRBG", 64, 1023, 1.4e-6, 2e-5)
CAMERAS: dict[str, CameraFigures] = {"F01": F01, "ILLUM": ILLUM, "B01": ILLUM}
"""Figures by ``camera.model``; B01 is what the Illum's calibration files call it."""
