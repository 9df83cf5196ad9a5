"""One capture's folder, wherever it is: ``capture.json`` and the pictures that it names."""

from __future__ import annotations

from pathlib import Path

from lfrig.contracts.capture import CameraSpec, CaptureDocument, ViewsSpec
from lfrig.contracts.errors import BadInput, NotInThisVersion
from lfrig.contracts.files import sha256_files
from lfrig.contracts.progress import Monitor
from lfrig.processing.model import Image, LightField, Photo
from lfrig.rig.session.convert import rectification_for, to_camera, to_light_field, to_pose
from lfrig.rig.session.exif import camera_spec, read_photo
from lfrig.rig.session.images import image_size, read_image8
from lfrig.rig.session.views import read_views, refuse_missing, taken_range

CAPTURE_FILE = "capture.json"


def load_light_field(
    folder: Path,
    capture_id: str,
    document: CaptureDocument,
    *,
    depth_range_m: tuple[float, float] | None = None,
    threads: int = 0,
    monitor: Monitor | None = None,
) -> LightField:
    """Read a light field; square pixels, no distortion, an odd number of rows and columns.

    ``depth_range_m`` (near, far) [m] is the one to take where the document has none.

    Raises
    ------
    BadInput
        It is a photo; views are missing, damaged, or of mixed sizes; its camera has another size.
    NotInThisVersion
        It is raw and has no decoded views.
    """
    files = taken_files(folder, document)
    refuse_missing([path for row in files for path in row])
    rectified = rectification_for(document, *image_size(files[0][0]), folder / CAPTURE_FILE)
    views = read_views(files, threads=threads, monitor=monitor, transform=rectified.apply if rectified else None)
    return to_light_field(capture_id, views, document, depth_range_m)


def load_photo(folder: Path, capture_id: str, document: CaptureDocument) -> Photo:
    """Read a photo, upright and rectified; of a light field its centre view. Raises as `load_light_field`."""
    image: Image
    if document.kind == "light_field":
        files = taken_files(folder, document)
        centre = files[len(files) // 2][len(files[0]) // 2]
        refuse_missing([centre])
        image = read_image8(centre)
    else:
        image, exif = read_photo(folder / (document.image or ""))
        if document.camera is None or document.camera.fx is None:
            document = _with_exif_focal(document, camera_spec(exif, image.shape[1], image.shape[0]))
    rectified = rectification_for(document, image.shape[1], image.shape[0], folder / CAPTURE_FILE)
    if rectified is not None:
        image = rectified.apply(image)
    camera = to_camera(document.camera)
    return Photo(capture_id, image, camera, to_pose(document.pose), document.turntable_deg)


def _with_exif_focal(document: CaptureDocument, found: CameraSpec) -> CaptureDocument:
    """A photo's document with the focal length of its EXIF; what the document does say stays."""
    said = document.camera
    if said is not None:
        found = said.model_copy(update={"fx": found.fx, "fy": found.fy, "sigma_f": found.sigma_f})
    return document.model_copy(update={"camera": found})


def view_files(folder: Path, spec: ViewsSpec) -> list[list[Path]]:
    """Names of all views, row by row."""
    return [[folder / spec.file(row, col) for col in range(spec.cols)] for row in range(spec.rows)]


def taken_files(folder: Path, document: CaptureDocument) -> list[list[Path]]:
    """Names of the views that are used, row by row; see `views.taken_range`."""
    if document.kind != "light_field":
        raise BadInput(
            "is a photo, not a light field", path=folder, code="not-a-light-field",
            remedy="name a light-field capture",
        )  # fmt: skip
    if document.views is None:
        raise NotInThisVersion(
            f"{folder}: decoding a raw light field", remedy="decode it elsewhere and ingest its views"
        )
    rows, cols = taken_range(document.views.rows, document.views.cols)
    files = view_files(folder, document.views)
    return [[files[row][col] for col in cols] for row in rows]


def content_files(folder: Path, document: CaptureDocument) -> list[Path]:
    """The files that make the capture what it is: its views in order, else its photo or its raw file."""
    if document.views is not None:
        return [path for row in view_files(folder, document.views) for path in row]
    name = document.image or (document.raw.path if document.raw else "")
    return [folder / name]


def content_hash(folder: Path, document: CaptureDocument) -> str:
    """What tells two captures apart: the hash kept at ingest, else that of the files' bytes."""
    if document.origin is not None and document.origin.sha256 is not None:
        return document.origin.sha256
    return sha256_files(content_files(folder, document))
