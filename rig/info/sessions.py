"""Descriptions of sessions, captures, and of what ingest would take."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from lfrig.contracts.capture import CaptureDocument
from lfrig.contracts.errors import BadInput, LfrigError, NotInThisVersion
from lfrig.contracts.files import CAPTURES, SESSION_FILE
from lfrig.contracts.session import RigSpec
from lfrig.rig.info.text import Description, count, inline
from lfrig.rig.session.capture_folder import CAPTURE_FILE, content_files
from lfrig.rig.session.decoded import find_calibration
from lfrig.rig.session.store import SessionStore


def describe_session(path: Path) -> Description:
    """A session; broken captures and stray folders are problems."""
    store = SessionStore.open(path)
    problems: list[str] = []
    captures = []
    for capture_id in store.document.captures:
        try:
            document = store.capture(capture_id)
            missing = _missing_files(store.capture_folder(capture_id), document, session=path)
            problems += [f"capture {capture_id}: {problem}" for problem in missing]
            captures.append({"id": capture_id, **_capture_row(document)})
        except LfrigError as error:
            problems.append(f"capture {capture_id}: {error.message}")
    kinds = [row["kind"] for row in captures]
    counts = f"{count(kinds.count('light_field'), 'light field')}, {count(kinds.count('photo'), 'photo')}"
    known = store.document.rig.model_dump(mode="json", exclude_none=True)
    return {
        "type": "session",
        "summary": f"session, {counts}",
        "captures": captures,
        "rig": {key: value for key, value in known.items() if value},
        "results": _names(entry for entry in (path / "results").glob("*") if (entry / "report.json").is_file()),
        "truth": str(store.truth_path) if store.truth_path.is_dir() else None,
        "unknown": _unknown_of_rig(store.document.rig),
        "problems": [*problems, *_strays(path, store.document.captures)],
    }


def _strays(path: Path, listed: list[str]) -> list[str]:
    """Capture folders that session.json does not list: what an interrupted capture or ingest left, harmless."""
    present = [name for name in _names((path / CAPTURES).glob("*")) if name not in listed]
    return [
        f"{CAPTURES}/{name} is left of interrupted work (ignored; can be deleted)"
        if name.startswith(".")
        else f"{CAPTURES}/{name} is not listed in {SESSION_FILE} (ignored)"
        for name in present
    ]


def _unknown_of_rig(rig: RigSpec) -> list[str]:
    values: dict[str, object] = {
        "rig.cameras.light_field.camera_from_plate": rig.light_field_mount(),
        "rig.cameras.target.camera_from_plate": rig.target_mount(),
        "rig.turntable_sigma_deg": rig.turntable_sigma_deg,
        "rig.depth_range_m": rig.depth_range_m,
    }
    return [name for name, value in values.items() if value is None]


def describe_capture(folder: Path) -> Description:
    """A folder with a capture.json, whole or not."""
    document = CaptureDocument.load(folder / CAPTURE_FILE)
    return {"type": "capture", **document_facts(document), "problems": _missing_files(folder, document)}


def describe_foreign(path: Path) -> Description:
    """A foreign light field or a photo, through the detectors of ingest; raises `BadInput` for anything else."""
    from lfrig.rig.ingest.candidate import Request
    from lfrig.rig.ingest.formats import recognise

    try:
        found = recognise(path, Request())
    except NotInThisVersion as error:
        problem = f"{error.message}; {error.remedy}"
        return {"type": "raw", "summary": f"raw file ({path.suffix.lower()})", "problems": [problem]}
    notes = [notice.message for notice in found.notes()]
    return {"type": found.document.kind, "format": found.format, **document_facts(found.document), "notes": notes}


def document_facts(document: CaptureDocument) -> Description:
    """Summary, content and unknown fields of a capture's document."""
    row = _capture_row(document)
    facts = inline({"of": row["views"], "at": row["size"]})
    return {
        "summary": f"{document.kind.replace('_', ' ')} {facts}".strip(),
        "document": document.model_dump(mode="json", exclude_none=True, exclude={"kind"}),
        "unknown": _unknown_of_capture(document),
    }


def _capture_row(document: CaptureDocument) -> Description:
    camera, views = document.camera, document.views
    return {
        "kind": document.kind,
        "views": f"{views.rows}×{views.cols}" if views else None,
        "size": f"{camera.width}×{camera.height} px" if camera else None,
        "fx": camera.fx if camera else None,
        "turntable_deg": document.turntable_deg,
        "pose": "given" if document.pose else None,
    }


def _unknown_of_capture(document: CaptureDocument) -> list[str]:
    camera, optics = document.camera, document.optics
    values: dict[str, object] = {
        "camera.fx": camera and camera.fx,
        "turntable_deg": document.turntable_deg,
        "pose": document.pose,
    }
    if document.kind == "light_field":
        values |= {
            "optics.baseline_m": optics and optics.baseline_m,
            "optics.focus_distance_m": optics and optics.focus_distance_m,
            "depth_range_m": document.depth_range_m,
        }
    return [name for name, value in values.items() if value is None]


def _missing_files(folder: Path, document: CaptureDocument, session: Path | None = None) -> list[str]:
    files = content_files(folder, document)
    missing = [file for file in files if not file.is_file()]
    first = missing[0].relative_to(folder).as_posix() if missing else ""
    problems = [f"{len(missing)} of {len(files)} files are missing, the first is {first}"] if missing else []
    raw = document.raw
    if raw is not None and raw.calibration is not None and document.views is None:
        try:
            known = find_calibration(folder, raw.calibration, session)
        except BadInput as error:
            return [*problems, error.message]
        if known is None and session is not None:
            problems.append(f"calibration {raw.calibration} is missing")
    return problems


def _names(entries: Iterable[Path]) -> list[str]:
    return sorted(entry.name for entry in entries)
