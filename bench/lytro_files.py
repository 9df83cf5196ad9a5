"""Small valid Lytro files and calibrations, from the format's constants alone: what fuzzing and tests start from."""

from __future__ import annotations

import hashlib
import io
import json
import struct
import tarfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.lytro import (
    COLOURS,
    CONTENT_MAGIC,
    FILE_HEADER,
    FILE_MAGIC,
    FILE_VERSION,
    HOT_PIXELS_NAME,
    ILLUM,
    MANIFEST_NAME,
    REFERENCE_PREFIX,
    SECTION_HEADER,
    SECTION_VERSION,
    TOC_MAGIC,
    UPPER_LEFT_PIXEL,
    CameraFigures,
)

Json = dict[str, Any]
U16 = NDArray[np.uint16]
SERIAL = "B5140000001"


@dataclass(frozen=True)
class SmallShot:
    """A shot of a tiny sensor; ``figures`` are the model's, its size is ``width`` × ``height``."""

    figures: CameraFigures = ILLUM
    width: int = 20
    height: int = 18
    seed: int = 0
    serial: str = SERIAL
    zoom_step: int = 600
    focus_step: int = 900
    geometry: bytes | None = b"geometry of this zoom and focus"
    embedded_white: bool = False
    hot_pixels: Sequence[tuple[int, int]] | None = None
    lens: Mapping[str, float] = field(
        default_factory=lambda: {"focalLength": 0.0242, "fNumber": 2.2, "infinityLambda": 33.9}
    )

    def values(self, level: float = 0.4) -> U16:
        """Sensor values, uint16 [height, width], around ``level`` of the sensor's range."""
        f = self.figures
        spread = np.random.default_rng(self.seed).uniform(-0.2, 0.2, (self.height, self.width))
        return np.rint(f.black + (level + spread) * (f.white - f.black)).clip(0, f.white).astype(np.uint16)


def pack(values: U16, figures: CameraFigures) -> bytes:
    """Pack sensor values as the model does; the last group is filled with zeros."""
    flat = values.reshape(-1).astype(np.uint16)
    if figures.bits == 10:
        groups = np.append(flat, np.zeros(-len(flat) % 4, np.uint16)).reshape(-1, 4)
        low = sum((groups[:, i] & 3) << (2 * i) for i in range(4))
        return np.column_stack([groups >> 2, low]).astype(np.uint8).tobytes()
    groups = np.append(flat, np.zeros(-len(flat) % 2, np.uint16)).reshape(-1, 2)
    first, second = groups.T
    return np.column_stack([first >> 4, (first & 15) << 4 | second >> 8, second & 255]).astype(np.uint8).tobytes()


def metadata(shot: SmallShot) -> Json:
    """The metadata section in the layout of the shot's model."""
    f = shot.figures
    corner = next(key for key, pattern in UPPER_LEFT_PIXEL.items() if pattern == f.bayer)
    details: Json = {
        "pixelPacking": {"endianness": f.packing, "bitsPerPixel": f.bits},
        "pixelFormat": {
            "rightShift": 0,
            "black": dict.fromkeys(COLOURS, f.black),
            "white": dict.fromkeys(COLOURS, f.white),
        },
        "mosaic": {"tile": "r,gr:gb,b", "upperLeftPixel": corner},
    }
    matrix = [1.5, -0.4, -0.1, -0.3, 1.5, -0.2, 0.0, -0.5, 1.5]
    gains = {"r": 1.31, "gr": 1.0, "gb": 1.0, "b": 1.34}
    image: Json = {"width": shot.width, "height": shot.height, "orientation": 1}
    if f.model == "F01":
        image |= {
            "rawDetails": details,
            "color": {"whiteBalanceGain": gains, "ccmRgbToSrgbArray": matrix, "gamma": 0.41666},
        }
    else:
        image |= {**details, "iso": 80, "color": {"whiteBalanceGain": gains, "ccm": matrix}}
    sensor: Json = {"pixelPitch": f.pixel_pitch_m, "bitsPerPixel": f.bits}
    if f.model == "F01":
        sensor["iso"] = 207
    return {
        "camera": {"make": "Lytro, Inc.", "model": f.model, "firmware": "1.1.1 (23)"},
        "image": image,
        "devices": {
            "clock": {"zuluTime": "2015-05-17T13:31:37.412Z"},
            "sensor": sensor,
            "shutter": {"frameExposureDuration": 0.01, "pixelExposureDuration": 0.008},
            "mla": {
                "tiling": "hexUniformRowMajor", "lensPitch": f.lens_pitch_m, "rotation": -0.00054,
                "scaleFactor": {"x": 1.0, "y": 1.0003}, "sensorOffset": {"x": 8.4e-06, "y": -9.5e-07, "z": 3.7e-05},
            },
            "lens": {**shot.lens, "zoomStep": shot.zoom_step, "focusStep": shot.focus_step},
        },
    }  # fmt: skip


def reference(data: bytes) -> str:
    """How a table of contents names a section."""
    return REFERENCE_PREFIX + hashlib.sha1(data).hexdigest()


def encoded(document: Json) -> bytes:
    """JSON bytes."""
    return json.dumps(document).encode("utf-8")


def section(
    magic: bytes, data: bytes, padding: int = 0, *, length: int | None = None, name: str | None = None
) -> bytes:
    """One section; ``length`` and ``name`` lie in the header when given."""
    header = SECTION_HEADER.pack(
        magic, SECTION_VERSION, len(data) if length is None else length, (name or reference(data)).encode("ascii")
    )
    return header + data + bytes(padding)


def container(*sections: bytes) -> bytes:
    """A file of these sections."""
    return FILE_HEADER.pack(FILE_MAGIC, FILE_VERSION, 0) + b"".join(sections)


def shot_parts(shot: SmallShot) -> tuple[Json, dict[str, bytes]]:
    """The table of contents and the content it names, by the name of the field that does."""
    parts = {
        "metadataRef": encoded(metadata(shot)),
        "privateMetadataRef": encoded({"camera": {"serialNumber": shot.serial}}),
        "imageRef": pack(shot.values(), shot.figures),
    }
    if shot.embedded_white:
        parts["modulationDataRef"] = pack(shot.values(0.7), shot.figures)
    if shot.hot_pixels is not None:
        parts["hotPixelRef"] = hot_pixel_list(shot.hot_pixels)
    frame = {name: reference(data) for name, data in parts.items()}
    if shot.geometry is not None:
        frame["geometryCorrectionRef"] = reference(shot.geometry)
    listed = [{"frame": frame}]
    return {"picture": {"frameArray": listed}} if shot.figures.model == "F01" else {"frames": listed}, parts


def shot_file(shot: SmallShot, padding: int = 7) -> bytes:
    """A whole file: Illum with the table of contents last, F01 first."""
    table, parts = shot_parts(shot)
    sections = [section(CONTENT_MAGIC, data, padding) for data in parts.values()]
    sections.insert(0 if shot.figures.model == "F01" else len(sections), section(TOC_MAGIC, encoded(table), padding))
    return container(*sections)


def hot_pixel_list(places: Sequence[tuple[int, int]]) -> bytes:
    """HOTPIXEL.BIN of these (x, y)."""
    return struct.pack("<I", len(places)) + np.array(places, "<i2").reshape(-1, 2).T.tobytes()


def white_files(shot: SmallShot, number: int, level: float = 0.7) -> dict[str, bytes]:
    """RAW, TXT and GCT of a white image taken at the shot's zoom and focus."""
    document = metadata(shot)
    private = {"camera": {"serialNumber": shot.serial}}
    text = {"master": {"picture": {"frameArray": [{"frame": {"metadata": document, "privateMetadata": private}}]}}}
    name = f"MOD_{number:04d}"
    raw = pack(shot.values(level), shot.figures)
    return {f"{name}.RAW": raw, f"{name}.TXT": encoded(text), f"{name}.GCT": shot.geometry or b""}


def calibration_files(shots: Sequence[SmallShot], hot_pixels: Sequence[tuple[int, int]] = ()) -> dict[str, bytes]:
    """A calibration with a white image for each shot, by name."""
    files: dict[str, bytes] = {}
    for number, shot in enumerate(shots):
        files |= white_files(shot, number)
    known = [{"name": name, "hash": reference(data)} for name, data in files.items() if name.endswith(".GCT")]
    files[MANIFEST_NAME] = encoded({"calibrationFiles": known})
    files[HOT_PIXELS_NAME] = hot_pixel_list(hot_pixels)
    return files


def tar_bytes(files: Mapping[str, bytes], folder: str = SERIAL, *, mode: str = "w") -> bytes:
    """A tar of these files; ``mode`` as for `tarfile.open`."""
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode=mode, format=tarfile.USTAR_FORMAT) as archive:  # type: ignore[call-overload]
        for name, data in files.items():
            entry = tarfile.TarInfo(f"{folder}/{name}" if folder else name)
            entry.size = len(data)
            archive.addfile(entry, io.BytesIO(data))
    return stream.getvalue()
