"""A folder with a ``capture.json``, such as ``captures/<id>`` of another session: taken as it is."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from lfrig.contracts.capture import CaptureDocument
from lfrig.contracts.errors import BadInput
from lfrig.contracts.progress import Monitor, Notice
from lfrig.processing.model import LightField
from lfrig.rig.ingest.candidate import Candidate, Request, copy_files, in_words
from lfrig.rig.ingest.photo import PhotoFile
from lfrig.rig.ingest.view_files import ViewFiles
from lfrig.rig.session.capture_folder import CAPTURE_FILE, content_files, load_light_field, session_of, view_files
from lfrig.rig.session.views import refuse_missing

FORMAT = "capture.json"


@dataclass(frozen=True)
class RawCaptureFolder(Candidate):
    """A capture whose pixels are in a raw file."""

    def notes(self) -> list[Notice]:
        """Whether its calibration comes along."""
        raw = self.document.raw
        if raw is None or raw.calibration is None or session_of(self.source) is None:
            return []
        return [Notice("calibration-not-copied", f"names the calibration {raw.calibration!r}: see that it is there")]

    def write(self, folder: Path, monitor: Monitor) -> None:
        """Copy the raw file."""
        assert self.document.raw is not None
        name = self.document.raw.path
        refuse_missing([self.source / name])
        copy_files([(self.source / name, folder / name)], monitor)

    def light_field(self, monitor: Monitor, threads: int = 0) -> LightField:
        """Decode it, with the calibration of the session that it lies in."""
        return load_light_field(
            self.source, self.source.name, self.document, session=session_of(self.source), threads=threads,
            monitor=monitor,
        )  # fmt: skip


def _calibrated(document: CaptureDocument, request: Request) -> CaptureDocument:
    """The document that names the calibration that was given, if one was."""
    if request.calibration is None or document.raw is None:
        return document
    raw = document.raw.model_copy(update={"calibration": request.calibration.name})
    return document.model_copy(update={"raw": raw})


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
        return RawCaptureFolder(folder, FORMAT, _calibrated(document, request), content)
    refuse_missing(content)
    grid = tuple(map(tuple, view_files(folder, document.views)))
    raw = () if document.raw is None else ((folder / document.raw.path, document.raw.path),)
    return ViewFiles(folder, FORMAT, document, content, grid, tuple(pair for pair in raw if pair[0].is_file()))
