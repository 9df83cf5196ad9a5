"""One capture's folder, wherever it is: ``capture.json`` and the pictures that it names."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from lfrig.contracts.capture import CameraSpec, CaptureDocument, ViewsSpec
from lfrig.contracts.errors import BadInput
from lfrig.contracts.files import CAPTURES, SESSION_FILE, sha256_files
from lfrig.contracts.progress import Monitor
from lfrig.processing.model import Image, LightField, Photo
from lfrig.rig.session.convert import rectification_for, to_camera, to_light_field, to_pose
from lfrig.rig.session.decoded import decoded_views
from lfrig.rig.session.exif import camera_spec, read_photo
from lfrig.rig.session.images import image_size, read_image8
from lfrig.rig.session.views import read_views, refuse_missing, taken_range

CAPTURE_FILE = "capture.json"


def session_of(folder: Path) -> Path | None:
    """The session among whose captures a capture's folder lies; None when it is in none."""
    home = folder.resolve().parent
    return home.parent if home.name == CAPTURES and (home.parent / SESSION_FILE).is_file() else None


def load_light_field(
    folder: Path,
    capture_id: str,
    document: CaptureDocument,
    *,
    depth_range_m: tuple[float, float] | None = None,
    session: Path | None = None,
    threads: int = 0,
    monitor: Monitor | None = None,
) -> LightField:
    """Read a light field; square pixels, no distortion, an odd number of rows and columns.

    One that has no views but a raw file is decoded; what its document says of camera and optics wins over the file's
    own metadata.

    Parameters
    ----------
    depth_range_m : (near, far), optional
        The one to take where the document has none [m].
    session : Path, optional
        The session it belongs to, where calibrations are found and decoded views are kept (`decoded_views`).

    Raises
    ------
    BadInput
        It is a photo; views are missing, damaged, or of mixed sizes; its camera has another size; its raw file or
        calibration cannot be used.
    """
    if document.kind == "light_field" and document.views is None:
        return _decoded_light_field(folder, capture_id, document, depth_range_m, session, threads, monitor)
    files = taken_files(folder, document)
    refuse_missing([path for row in files for path in row])
    rectified = rectification_for(document, *image_size(files[0][0]), folder / CAPTURE_FILE)
    views = read_views(files, threads=threads, monitor=monitor, transform=rectified.apply if rectified else None)
    return to_light_field(capture_id, views, document, depth_range_m)


def _decoded_light_field(
    folder: Path,
    capture_id: str,
    document: CaptureDocument,
    depth_range_m: tuple[float, float] | None,
    session: Path | None,
    threads: int,
    monitor: Monitor | None,
) -> LightField:
    found = decoded_views(folder, document, session=session, threads=threads, monitor=monitor)
    views = found.views
    rectified = rectification_for(document, views.shape[3], views.shape[2], folder / CAPTURE_FILE)
    if rectified is not None:
        rows, cols = views.shape[:2]
        views = np.stack([np.stack([rectified.apply(views[r, c]) for c in range(cols)]) for r in range(rows)])
    known = to_light_field(capture_id, views, document, depth_range_m)
    optics = found.optics
    if document.optics is not None:
        told = known.optics
        optics = replace(
            told,
            baseline_m=told.baseline_m if told.baseline_m is not None else optics.baseline_m,
            focus_distance_m=told.focus_distance_m if told.focus_distance_m is not None else optics.focus_distance_m,
        )
    return replace(known, camera=known.camera or found.camera, optics=optics)


def load_photo(folder: Path, capture_id: str, document: CaptureDocument, *, session: Path | None = None) -> Photo:
    """Read a photo, upright and rectified; of a light field its centre view. Raises as `load_light_field`."""
    image: Image
    if document.kind == "light_field" and document.views is None:
        decoded = load_light_field(folder, capture_id, document, session=session)
        return Photo(capture_id, decoded.centre_view, decoded.camera, decoded.pose, decoded.turntable_deg)
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
        raise BadInput("is raw and has no views", path=folder, code="no-views", remedy="decode it first")
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
