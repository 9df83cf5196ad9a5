"""A camera's raw light field (.lfr, .lfp): checked, copied as it is, never decoded here.

What its metadata say of camera, optics and exposure goes into capture.json as priors; the calibration is stored once
for the session (`rig.ingest.calibration`) and named by the capture.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from lfrig.contracts.capture import CaptureDocument, RawSpec
from lfrig.contracts.errors import BadInput
from lfrig.contracts.files import sha256_file
from lfrig.contracts.lytro import FILE_MAGIC
from lfrig.contracts.progress import Monitor, Notice
from lfrig.processing.lenslet.container import Container, read_container
from lfrig.processing.lenslet.contents import Frame, raw_frame
from lfrig.processing.lenslet.metadata import RawMetadata, read_metadata
from lfrig.processing.lenslet.priors import camera_and_optics, view_size
from lfrig.processing.lenslet.raw import check_payload, notice_of_rule
from lfrig.processing.model import LightField
from lfrig.rig.ingest.candidate import Candidate, Request, copy_files
from lfrig.rig.session.capture_folder import load_light_field
from lfrig.rig.session.convert import raw_document

FORMAT = "lytro"
SUFFIXES = frozenset({".lfr", ".lfp", ".lfx"})
STORED_NAME = "capture.lfr"


@dataclass(frozen=True)
class RawFile(Candidate):
    """One shot's file; ``told`` is what the user should know of its white image."""

    told: tuple[Notice, ...] = ()

    def notes(self) -> list[Notice]:
        """Which white image will serve, when it is not the exact one."""
        return list(self.told)

    def write(self, folder: Path, monitor: Monitor) -> None:
        """Copy the file."""
        copy_files([(self.source, folder / STORED_NAME)], monitor)

    def light_field(self, monitor: Monitor, threads: int = 0) -> LightField:
        """Decode it."""
        raw = RawSpec(path=self.source.name)
        document = self.document.model_copy(update={"raw": raw})
        return load_light_field(self.source.parent, self.source.stem, document, threads=threads, monitor=monitor)


def recognise(path: Path, request: Request) -> Candidate | None:
    """A file named or beginning like a Lytro camera's; None for others, and when a photo was asked for.

    Every section is checked, so that what was torn on the way is refused before it is stored.

    Raises
    ------
    BadInput
        It is torn, damaged, hostile, or holds no raw picture; see `read_container`, `read_metadata`.
    """
    if not path.is_file() or request.kind == "photo":
        return None
    if path.suffix.lower() not in SUFFIXES and not _begins_like_one(path):
        return None
    container = read_container(path)
    container.check()
    frame = raw_frame(container)
    metadata = read_metadata(container, frame)
    check_payload(container, frame, metadata)
    calibration = request.calibration
    spec = RawSpec(path=STORED_NAME, sha256=sha256_file(path), calibration=calibration.name if calibration else None)
    document = document_of(metadata).model_copy(update={"raw": spec})
    return RawFile(path, FORMAT, document, (path,), _notices(container, frame, metadata, request))


def document_of(metadata: RawMetadata) -> CaptureDocument:
    """What the metadata say, as a capture's document without its file."""
    camera, optics = camera_and_optics(metadata)
    return raw_document(metadata, camera, optics, view_size(metadata), raw=RawSpec(path=STORED_NAME))


def _begins_like_one(path: Path) -> bool:
    try:
        with path.open("rb") as stream:
            return stream.read(len(FILE_MAGIC)) == FILE_MAGIC
    except OSError as error:
        raise BadInput(f"cannot be read: {error.strerror}", path=path, remedy="check the permissions") from None


def _notices(container: Container, frame: Frame, metadata: RawMetadata, request: Request) -> tuple[Notice, ...]:
    known = request.calibration.content if request.calibration else None
    matches = known.matches(metadata) if known else []
    embedded = not matches and container.find(frame.modulation_ref) is not None
    told = notice_of_rule(metadata, known, matches[0] if matches else None, embedded=embedded)
    return () if told is None else (Notice(*told),)
