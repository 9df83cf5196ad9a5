"""Raw photos for tests: DNG files of a smooth scene whose colours are known, written by tifffile."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

BLACK, WHITE = 200, 15000
NEUTRAL = (0.5, 1.0, 0.8)
PATTERN = "GRBG"
SRGB_OF_XYZ = ((3.2406, -1.5372, -0.4986), (-0.9689, 1.8758, 0.0415), (0.0557, -0.2040, 1.0570))
IMAGE_WIDTH, IMAGE_LENGTH, COMPRESSION, STRIP_OFFSETS, STRIP_BYTES = 256, 257, 259, 273, 279
ORIENTATION, EXIF_DIRECTORY, ACTIVE_AREA, DEFAULT_SCALE, PRIVATE = 274, 34665, 50829, 50718, 65000

U16 = NDArray[np.uint16]


def smooth_scene(height: int, width: int) -> NDArray[np.float64]:
    """Linear sRGB light [H, W, 3] in 0.1..0.75, different at each corner."""
    y, x = np.mgrid[:height, :width] / max(height, width)
    return np.stack([0.15 + 0.5 * x, 0.2 + 0.3 * y + 0.2 * x, 0.7 - 0.3 * x - 0.25 * y], -1)


def srgb16(linear: NDArray[np.float64]) -> NDArray[np.float64]:
    """16-bit sRGB values of linear light."""
    return 65535 * np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def mosaic(linear: NDArray[np.float64], pattern: str = PATTERN) -> U16:
    """What a sensor with a colour filter array records of linear sRGB light under a light of colour `NEUTRAL`."""
    camera = BLACK + (WHITE - BLACK) * linear * NEUTRAL
    y, x = np.mgrid[: linear.shape[0], : linear.shape[1]]
    channels = np.array(["RGB".index(letter) for letter in pattern]).reshape(2, 2)[y % 2, x % 2]
    return np.asarray(np.rint(np.take_along_axis(camera, channels[..., None], 2)[..., 0]), np.uint16)


def rational(values: Any) -> list[int]:
    return [part for value in values for part in (round(value * 10000), 10000)]


def write_dng(
    path: Path, values: U16, *, neutral: tuple[float, ...] | None = NEUTRAL, extra: tuple[Any, ...] = (), **options: Any
) -> Path:
    """A DNG of sensor values under `PATTERN`; ``extra`` are further tags as tifffile takes them."""
    matrix = np.array(SRGB_OF_XYZ) * np.array(NEUTRAL)[:, None]
    pattern = bytes("RGB".index(letter) for letter in PATTERN)
    tags: list[Any] = [
        (271, "s", 0, "Test", True), (272, "s", 0, "Camera", True), (50708, "s", 0, "Test Camera", True),
        (33421, "H", 2, (2, 2), True), (33422, "B", 4, pattern, True),
        (50706, "B", 4, bytes([1, 4, 0, 0]), True), (50707, "B", 4, bytes([1, 1, 0, 0]), True),
        (50714, "H", 1, BLACK, True), (50717, "H", 1, WHITE, True),
        (50721, "2i", 9, rational(matrix.ravel()), True), (50778, "H", 1, 21, True),
    ]  # fmt: skip
    if neutral is not None:
        tags.append((50728, "2I", 3, rational(neutral), True))
    options.setdefault("photometric", 32803)
    tifffile.imwrite(path, values, extratags=[*tags, *extra], metadata=None, **options)
    return path


def scene_dng(path: Path, height: int = 48, width: int = 64, **options: Any) -> Path:
    """A DNG of `smooth_scene`."""
    return write_dng(path, mosaic(smooth_scene(height, width)), **options)


def exif_dng(path: Path, tags: dict[int, tuple[int, bytes]], **options: Any) -> Path:
    """A DNG with an Exif directory at its end; ``tags`` are (TIFF type, value) of one value each, in order."""
    sizes = {3: 2, 4: 4, 5: 8, 2: 1}
    data = scene_dng(path, extra=((PRIVATE, "I", 1, 0, True),), **options).read_bytes()
    at = len(data) + len(data) % 2
    entries, blobs, free = b"", b"", at + 2 + 12 * len(tags) + 4
    for number, (kind, value) in sorted(tags.items()):
        field = value.ljust(4, b"\0")
        if len(value) > 4:
            field = struct.pack("<I", free + len(blobs))
            blobs += value
        entries += struct.pack("<HHI", number, kind, len(value) // sizes[kind]) + field
    directory = struct.pack("<H", len(tags)) + entries + bytes(4) + blobs
    path.write_bytes(patched(data, {PRIVATE: at}, renamed={PRIVATE: EXIF_DIRECTORY}).ljust(at, b"\0") + directory)
    return path


def lossless_jpeg(values: U16, bits: int = 16) -> bytes:
    """Lossless JPEG of one component (ITU-T T.81, process 14): predictor 1, five bits for every category."""
    height, width = values.shape
    signed = values.astype(np.int64)
    predicted = np.empty_like(signed)
    predicted[:, 1:] = signed[:, :-1]
    predicted[1:, 0] = signed[:-1, 0]
    predicted[0, 0] = 1 << (bits - 1)
    code = ""
    for difference in (signed - predicted).ravel().tolist():
        category = abs(difference).bit_length()
        code += f"{category:05b}"
        if category:
            code += f"{difference if difference > 0 else difference + (1 << category) - 1:0{category}b}"
    code += "1" * (-len(code) % 8)
    data = int(code, 2).to_bytes(len(code) // 8, "big").replace(b"\xff", b"\xff\0")
    categories = bytes(range(17))
    table = b"\0" + bytes([0, 0, 0, 0, len(categories)] + [0] * 11) + categories
    frame = struct.pack(">BHHB", bits, height, width, 1) + b"\1\x11\0"
    scan = b"\1\1\0\1\0\0"

    def segment(marker: int, body: bytes) -> bytes:
        return struct.pack(">BBH", 0xFF, marker, len(body) + 2) + body

    return b"\xff\xd8" + segment(0xC3, frame) + segment(0xC4, table) + segment(0xDA, scan) + data + b"\xff\xd9"


def patched(data: bytes, tags: dict[int, int], renamed: dict[int, int] | None = None) -> bytes:
    """A little-endian TIFF file with tags of its first directory replaced by one number each, some renamed."""
    changed = bytearray(data)
    (first,) = struct.unpack_from("<I", data, 4)
    (count,) = struct.unpack_from("<H", data, first)
    places = {struct.unpack_from("<H", data, first + 2 + 12 * k)[0]: first + 2 + 12 * k for k in range(count)}
    for number, value in tags.items():
        struct.pack_into("<HHII", changed, places[number], (renamed or {}).get(number, number), 4, 1, value)
    return bytes(changed)


def compressed_dng(path: Path, values: U16, data: bytes) -> Path:
    """A DNG whose pixels are ``data``, lossless JPEG of ``values``, at the end of the file."""
    plain = write_dng(path, values).read_bytes()
    path.write_bytes(patched(plain, {COMPRESSION: 7, STRIP_OFFSETS: len(plain), STRIP_BYTES: len(data)}) + data)
    return path
