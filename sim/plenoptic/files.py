"""The files that the simulated plenoptic camera leaves: shots (.lfr, .lfp) and the archive of its calibration."""

from __future__ import annotations

import hashlib
import io
import json
import struct
import tarfile
from collections.abc import Iterable
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.lytro import (
    CONTENT_MAGIC,
    FILE_HEADER,
    FILE_MAGIC,
    FILE_VERSION,
    HOT_PIXELS_NAME,
    MANIFEST_NAME,
    REFERENCE_PREFIX,
    SECTION_ALIGNMENT,
    SECTION_HEADER,
    SECTION_VERSION,
    TOC_MAGIC,
    WHITE_IMAGE_PREFIX,
)
from lfrig.sim.plenoptic.body import I32, Body
from lfrig.sim.plenoptic.metadata import Json, private_metadata
from lfrig.sim.plenoptic.packing import pack

Values = NDArray[np.uint16]


@dataclass(frozen=True, eq=False)
class WhiteShot:
    """One white image for the calibration archive: sensor values, its ``metadata``, its geometry correction."""

    values: Values
    metadata: Json
    geometry: bytes


def reference(data: bytes) -> str:
    """How tables of contents name a section."""
    return REFERENCE_PREFIX + hashlib.sha1(data).hexdigest()


def shot_file(body: Body, values: Values, metadata: Json, *, geometry_ref: str, white: Values | None = None) -> bytes:
    """A whole shot as the body's model writes it: Illum ``frames``, its table last; F01 ``picture``, its table first.

    ``white`` goes into the file as its modulation data, for cameras without calibration.
    """
    contents = [_json(metadata), _json(private_metadata(body)), _packed(body, values)]
    frame = dict(zip(("metadataRef", "privateMetadataRef", "imageRef"), map(reference, contents), strict=True))
    frame["geometryCorrectionRef"] = geometry_ref
    if white is not None:
        contents.append(_packed(body, white))
        frame["modulationDataRef"] = reference(contents[-1])
    toc: Json = {"frames": [{"frame": frame}], "thumbnails": []}
    if body.model == "F01":
        toc = {"picture": {"frameArray": [{"frame": frame}], "derivationArray": []}}
    sections = [_section(CONTENT_MAGIC, data) for data in contents]
    sections.insert(0 if body.model == "F01" else len(sections), _section(TOC_MAGIC, _json(toc)))
    return b"".join([FILE_HEADER.pack(FILE_MAGIC, FILE_VERSION, 0), *sections])


def write_calibration(stream: BinaryIO, body: Body, whites: Iterable[WhiteShot]) -> None:
    """``caldata-<serial>.tar``: white images, the manifest that finds them, the list of hot pixels.

    White images are made and written one by one; the archive holds no times, so equal content is equal bytes.
    """
    known = []
    with tarfile.open(fileobj=stream, mode="w", format=tarfile.USTAR_FORMAT) as archive:

        def add(name: str, data: bytes) -> None:
            entry = tarfile.TarInfo(f"{body.serial}/{name}")
            entry.size = len(data)
            archive.addfile(entry, io.BytesIO(data))

        for number, white in enumerate(whites):
            name = f"{WHITE_IMAGE_PREFIX}{number:04d}"
            add(f"{name}.RAW", _packed(body, white.values))
            add(f"{name}.TXT", _json(white.metadata))
            add(f"{name}.GCT", white.geometry)
            known.append({"name": f"{name}.GCT", "hash": reference(white.geometry)})
        add(HOT_PIXELS_NAME, _hot_pixels(body.hot_pixels))
        add(MANIFEST_NAME, _json({"calibrationFiles": known}))


def _section(magic: bytes, data: bytes) -> bytes:
    header = SECTION_HEADER.pack(magic, SECTION_VERSION, len(data), reference(data).encode("ascii"))
    return b"".join([header, data, bytes(-(len(header) + len(data)) % SECTION_ALIGNMENT)])


def _packed(body: Body, values: Values) -> bytes:
    return pack(values, body.figures.bits, body.figures.packing)


def _hot_pixels(places: I32) -> bytes:
    return struct.pack("<I", len(places)) + places.T.astype("<i2").tobytes()


def _json(document: Json) -> bytes:
    return json.dumps(document, indent=1).encode("utf-8")
