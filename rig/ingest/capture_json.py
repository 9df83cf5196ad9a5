"""A folder with a ``capture.json``, such as ``captures/<id>`` of another session: taken as it is."""

from __future__ import annotations

from pathlib import Path

from lfrig.contracts.capture import CaptureDocument
from lfrig.contracts.errors import BadInput, NotInThisVersion
from lfrig.rig.ingest.candidate import Candidate, Request, in_words
from lfrig.rig.ingest.photo import PhotoFile
from lfrig.rig.ingest.view_files import ViewFiles
from lfrig.rig.session.capture_folder import CAPTURE_FILE, content_files, view_files
from lfrig.rig.session.views import refuse_missing

FORMAT = "capture.json"


def recognise(path: Path, request: Request) -> Candidate | None:
    """A capture folder, or its capture.json; None for anything else."""
    folder = path.parent if path.name == CAPTURE_FILE and path.is_file() else path
    if not (folder / CAPTURE_FILE).is_file():
        return None
    document = CaptureDocument.load(folder / CAPTURE_FILE)
    if request.kind is not None and request.kind != document.kind:
        raise BadInput(
            f"is a {in_words(document.kind)}, not a {in_words(request.kind)}", path=folder / CAPTURE_FILE, field="kind",
            remedy="leave --as out",
        )  # fmt: skip
    content = tuple(content_files(folder, document))
    if document.kind == "photo":
        return PhotoFile(folder, FORMAT, document, content)
    if document.views is None:
        raise NotInThisVersion(f"{folder}: decoding a raw light field", remedy="decode it elsewhere first")
    refuse_missing(content)
    grid = tuple(map(tuple, view_files(folder, document.views)))
    raw = () if document.raw is None else ((folder / document.raw.path, document.raw.path),)
    return ViewFiles(folder, FORMAT, document, content, grid, tuple(pair for pair in raw if pair[0].is_file()))
