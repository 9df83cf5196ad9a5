"""The table of contents: which section is the picture, which its metadata. The layouts of both cameras.

Illum: ``frames[].frame``; F01: ``picture.frameArray[].frame``; the TXT files of calibrations: the same below
``master``. A frame names its parts by reference or holds its metadata itself.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lfrig.contracts.errors import BadInput
from lfrig.processing.lenslet.container import Container

Json = dict[str, Any]


@dataclass(frozen=True)
class Frame:
    """One shot of a file: references of its parts, and the metadata it holds itself (empty: they are referred to)."""

    image_ref: str | None = None
    metadata_ref: str | None = None
    private_metadata_ref: str | None = None
    modulation_ref: str | None = None
    modulation_metadata_ref: str | None = None
    hot_pixel_ref: str | None = None
    geometry_correction_ref: str | None = None
    metadata: Json = field(default_factory=dict)
    private_metadata: Json = field(default_factory=dict)


def raw_frame(container: Container) -> Frame:
    """The first frame that names a picture of the sensor.

    Raises
    ------
    BadInput
        ``no-table-of-contents``; ``no-raw-frame`` for a file that was developed already; whatever is wrong with the
        table of contents.
    """
    tables = [section for section in container.sections if section.kind == "toc"]
    noted = f" ({container.problems[0]})" if container.problems else ""
    if not tables:
        raise BadInput(
            f"has no table of contents{noted}", path=container.path, code="no-table-of-contents",
            remedy="copy the file from the camera again",
        )  # fmt: skip
    for section in tables:
        for frame in frames(container.json(section)):
            if frame.image_ref is not None:
                return frame
    raise BadInput(
        "holds no raw picture of the sensor (a developed picture or a calibration?)", path=container.path,
        code="no-raw-frame", remedy="give the camera's raw file, such as IMG_0001.LFR or IMG_0001-raw.lfp",
    )  # fmt: skip


def frames(table: Json) -> list[Frame]:
    """The frames of a decoded table of contents, or of a calibration's TXT file; what is no frame is left out."""
    table = _object(table, "master") or table
    picture = _object(table, "picture")
    listed = [*_list(table, "frames"), *_list(picture, "frameArray")]
    found = [_object(entry, "frame") for entry in listed if isinstance(entry, dict)]
    return [_frame(entry) for entry in found if entry]


def part(container: Container, reference: str | None, what: str) -> memoryview:
    """Data of a section that the table of contents names.

    Raises
    ------
    BadInput
        ``missing-section``, or damaged.
    """
    section = container.find(reference)
    if section is None:
        raise missing(container.path, what)
    return container.data(section)


def json_part(container: Container, reference: str | None, what: str) -> Json:
    """As `part`, decoded."""
    section = container.find(reference)
    if section is None:
        raise missing(container.path, what)
    return container.json(section)


def missing(path: Path, what: str) -> BadInput:
    """The error for a part that is named and not there."""
    return BadInput(
        "is not in the file", path=path, field=what, code="missing-section",
        remedy="copy the file from the camera again",
    )  # fmt: skip


def _frame(entry: Json) -> Frame:
    return Frame(
        image_ref=_reference(entry, "imageRef"),
        metadata_ref=_reference(entry, "metadataRef"),
        private_metadata_ref=_reference(entry, "privateMetadataRef"),
        modulation_ref=_reference(entry, "modulationDataRef"),
        modulation_metadata_ref=_reference(entry, "modulationDataMetadataRef"),
        hot_pixel_ref=_reference(entry, "hotPixelRef"),
        geometry_correction_ref=_reference(entry, "geometryCorrectionRef"),
        metadata=_object(entry, "metadata"),
        private_metadata=_object(entry, "privateMetadata"),
    )


def _object(parent: Json, name: str) -> Json:
    value = parent.get(name)
    return value if isinstance(value, dict) else {}


def _list(parent: Json, name: str) -> list[Any]:
    value = parent.get(name)
    return value if isinstance(value, list) else []


def _reference(entry: Json, name: str) -> str | None:
    value = entry.get(name)
    return value.lower() if isinstance(value, str) and len(value) <= 64 else None
