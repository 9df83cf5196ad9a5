"""A photo: PNG, JPEG, TIFF, … of 8 or 16 bits, or a camera's raw one; upright as its EXIF says, focal length from EXIF.

A raw photo, and a picture that is upright already, is copied byte for byte; a turned one is stored as PNG, which loses
nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from lfrig.contracts.capture import CaptureDocument
from lfrig.contracts.errors import BadInput
from lfrig.contracts.progress import Monitor, Notice
from lfrig.processing.model import LightField
from lfrig.rig.ingest.candidate import Candidate, Request, copy_files
from lfrig.rig.session.convert import rectification_for
from lfrig.rig.session.exif import camera_spec, exposure_spec, photo_size, read_exif, read_photo, time_taken
from lfrig.rig.session.images import IMAGE_SUFFIXES, write_png
from lfrig.rig.session.raw_photo import RAW_PHOTO_SUFFIXES, refuse_light_field

FORMAT = "photo"


@dataclass(frozen=True)
class PhotoFile(Candidate):
    """One picture; ``content`` is its file."""

    turned: bool = False

    def notes(self) -> list[Notice]:
        """Whether the focal length is unknown."""
        if self.document.camera is not None and self.document.camera.fx is not None:
            return []
        return [Notice("no-focal-length", "has no focal length in its EXIF; it must be found from the pictures")]

    def write(self, folder: Path, monitor: Monitor) -> None:
        """Read the picture, then copy it, or write it upright."""
        image, _ = read_photo(self.content[0])
        rectification_for(self.document, image.shape[1], image.shape[0], self.source)
        target = folder / (self.document.image or "")
        if self.turned:
            write_png(target, image)
        else:
            copy_files([(self.content[0], target)], monitor)

    def light_field(self, monitor: Monitor, threads: int = 0) -> LightField:
        """Raise: a photo is none."""
        raise BadInput(
            "is a photo, not a light field", path=self.source, code="not-a-light-field",
            remedy="give a folder of views, an ESLF picture or a capture folder",
        )  # fmt: skip


def recognise(path: Path, request: Request) -> Candidate | None:
    """Any picture file; None for a folder, for another kind of file, and when a light field was asked for.

    Raises
    ------
    BadInput
        It is a raw light field that was called a photo, or whatever else is wrong with it.
    """
    if not path.is_file() or request.kind == "light_field":
        return None
    if path.suffix.lower() not in IMAGE_SUFFIXES | RAW_PHOTO_SUFFIXES and request.kind != "photo":
        return None
    refuse_light_field(path)
    exif = read_exif(path)
    width, height = photo_size(path, exif)
    turned = exif.orientation != 1
    document = CaptureDocument(
        kind="photo",
        image="photo.png" if turned else f"photo{path.suffix.lower()}",
        camera=camera_spec(exif, width, height),
        exposure=exposure_spec(exif),
        time=time_taken(exif),
    )
    return PhotoFile(path, FORMAT, document, (path,), turned)
