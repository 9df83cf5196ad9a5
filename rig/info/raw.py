"""Descriptions of raw light fields and of calibrations."""

from __future__ import annotations

from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from lfrig.contracts.errors import BadInput
from lfrig.contracts.lytro import FILE_MAGIC
from lfrig.processing.lenslet.calibration import Calibration, WhiteEntry
from lfrig.processing.lenslet.container import Container, read_container
from lfrig.processing.lenslet.contents import Frame, raw_frame
from lfrig.processing.lenslet.metadata import RawMetadata, read_metadata
from lfrig.processing.lenslet.raw import check_payload
from lfrig.rig.info.sessions import document_facts
from lfrig.rig.info.text import Description, count
from lfrig.rig.ingest.raw import FORMAT, SUFFIXES, document_of

CALIBRATION_SUFFIXES = frozenset({".tar", ".tgz", ".gz"})


def is_raw(path: Path) -> bool:
    """Whether a file is named, or begins, like a Lytro camera's."""
    if path.suffix.lower() in SUFFIXES:
        return True
    try:
        with path.open("rb") as stream:
            return stream.read(len(FILE_MAGIC)) == FILE_MAGIC
    except OSError:
        return False


def describe_raw(path: Path) -> Description:
    """A .lfr or .lfp file, as far as it goes; raises `BadInput` where not even its metadata can be read."""
    container = read_container(path, partial=True)
    frame = raw_frame(container)
    metadata = read_metadata(container, frame)
    container.check()
    problems = list(container.problems)
    try:
        check_payload(container, frame, metadata)
    except BadInput as error:
        problems.append(error.message)
    told = document_facts(document_of(metadata))
    return {
        "type": "raw",
        "format": FORMAT,
        **told,
        "summary": f"raw {told['summary']}, {_camera(metadata)}, {metadata.width}×{metadata.height} px sensor of "
        f"{metadata.bits} bits",
        "metadata": _json_able({key: value for key, value in asdict(metadata).items() if value is not None}),
        "sections": _sections(container, frame),
        "problems": problems,
    }


def describe_calibration(path: Path) -> Description:
    """A calibration archive; raises `BadInput` when it is none."""
    calibration = Calibration.open(path)
    cameras = ", ".join(calibration.serials) or "an unknown camera"
    return {
        "type": "calibration",
        "summary": f"calibration of {cameras}, {count(len(calibration.entries), 'white image')}",
        "white_images": [_white_row(entry) for entry in calibration.entries],
        "hot_pixels": _hot_pixels(calibration),
        "problems": list(calibration.problems),
    }


def _camera(metadata: RawMetadata) -> str:
    return f"{metadata.model or 'unknown camera'} {metadata.serial or ''}".strip()


def _sections(container: Container, frame: Frame) -> list[Description]:
    """A row per section; ``what`` is the frame's name for it."""
    named = {
        value: field.name.removesuffix("_ref")
        for field in fields(frame)
        if field.name.endswith("_ref") and isinstance(value := getattr(frame, field.name), str)
    }
    return [
        {
            "what": "table of contents" if section.kind == "toc" else named.get(section.reference, "other"),
            "bytes": section.length,
            "reference": section.reference,
        }
        for section in container.sections
    ]


def _white_row(entry: WhiteEntry) -> Description:
    metadata = entry.metadata
    return {
        "name": entry.name,
        "zoom_step": metadata.zoom_step,
        "focus_step": metadata.focus_step,
        "exposure_s": metadata.exposure_s,
        "size": f"{metadata.width}×{metadata.height} px",
        "serial": metadata.serial,
        "geometry": entry.geometry_ref,
    }


def _hot_pixels(calibration: Calibration) -> int:
    try:
        return len(calibration.hot_pixels(calibration.entries[0].metadata))
    except BadInput as error:
        calibration.problems.append(error.message)
        return 0


def _json_able(value: Any) -> Any:
    """``value`` with lists for tuples, as JSON would give it back."""
    if isinstance(value, dict):
        return {key: _json_able(item) for key, item in value.items()}
    return [_json_able(item) for item in value] if isinstance(value, tuple) else value
