"""What a file or a folder is, what is in it, and what is missing or not known of it.

Every description is JSON-able and has ``path``, ``type``, ``summary``, what is particular to the type, ``unknown``
(fields that must be found out) and ``problems`` (what is missing or broken, in words).
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from lfrig.contracts.errors import BadInput
from lfrig.contracts.files import SESSION_FILE
from lfrig.contracts.result import ReportDocument
from lfrig.contracts.schema import read_json
from lfrig.rig.info.arrays import describe_npy, describe_pfm
from lfrig.rig.info.documents import (
    describe_bench,
    describe_report,
    describe_result,
    describe_score,
    describe_truth,
)
from lfrig.rig.info.raw import CALIBRATION_SUFFIXES, describe_calibration, describe_raw, is_raw
from lfrig.rig.info.sessions import describe_capture, describe_foreign, describe_session
from lfrig.rig.info.text import Description, text_lines
from lfrig.rig.session.capture_folder import CAPTURE_FILE

__all__ = ["Description", "describe", "text_lines"]


def describe(path: Path | str) -> Description:
    """Describe a session, capture, result, light field, calibration, picture, float map or JSON document of lfrig's.

    Raises
    ------
    BadInput
        It does not exist, is of no known kind, or is too broken to be described.
    """
    path = Path(path)
    if not path.exists():
        raise BadInput("does not exist", path=path, code="missing-file", remedy="check the path")
    found = _describe_folder(path) if path.is_dir() else _describe_file(path)
    return {"path": str(path), **found, "unknown": found.get("unknown", []), "problems": found.get("problems", [])}


def _describe_folder(path: Path) -> Description:
    readers: dict[str, Callable[[], Description]] = {
        SESSION_FILE: lambda: describe_session(path),
        "report.json": lambda: describe_result(path),
        "truth.json": lambda: describe_truth(path / "truth.json"),
        CAPTURE_FILE: lambda: describe_capture(path),
    }
    for name, reader in readers.items():
        if (path / name).is_file():
            return reader()
    return describe_foreign(path)


def _describe_file(path: Path) -> Description:
    readers = {".json": _describe_json, ".pfm": describe_pfm, ".npy": describe_npy}
    readers |= dict.fromkeys(CALIBRATION_SUFFIXES, describe_calibration)
    reader = readers.get(path.suffix.lower()) or (describe_raw if is_raw(path) else describe_foreign)
    return reader(path)


def _describe_json(path: Path) -> Description:
    data = read_json(path)
    schema = str(data.get("schema", "")) if isinstance(data, dict) else ""
    readers: dict[str, Callable[[], Description]] = {
        "lfrig.session": lambda: describe_session(path.parent),
        "lfrig.capture": lambda: describe_capture(path.parent),
        "lfrig.result": lambda: describe_report(ReportDocument.load(path)),
        "lfrig.score": lambda: describe_score(path),
        "lfrig.truth": lambda: describe_truth(path),
        "lfrig.bench": lambda: describe_bench(path),
    }
    reader = readers.get(schema.partition("/")[0])
    if reader is None:
        raise BadInput(
            f"is {schema!r}" if schema else "is missing", path=path, field="schema", code="unknown-schema",
            remedy=f"known: {', '.join(readers)}",
        )  # fmt: skip
    return reader()
