"""``lfrig decode``: a raw file to a folder of views that everything else reads as a capture."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lfrig.contracts.capture import CaptureDocument, OriginSpec, ViewsSpec
from lfrig.contracts.errors import BadInput
from lfrig.contracts.files import atomic_folder, disk_errors, refuse_existing, refuse_replacing, sha256_file
from lfrig.contracts.progress import Monitor
from lfrig.rig.session.capture_folder import CAPTURE_FILE, session_of
from lfrig.rig.session.convert import raw_document
from lfrig.rig.session.decoded import find_calibration
from lfrig.rig.session.views import write_views

if TYPE_CHECKING:
    from lfrig.processing.lenslet.decode import Decoded, Views
    from lfrig.processing.lenslet.raw import RawCapture

WEIGHT_FILE = "weight.npy"
FORMAT = "lytro-raw"


@dataclass(frozen=True)
class DecodeOutcome:
    """What was made: the folder, and what the decoder found out, JSON-able."""

    folder: Path
    facts: dict[str, Any]


def decode_file(
    path: Path | str,
    out: Path | str,
    *,
    calibration: Path | str | None = None,
    views: Views = 7,
    partial: bool = False,
    overwrite: bool = False,
    threads: int = 0,
    monitor: Monitor | None = None,
) -> DecodeOutcome:
    """Decode a raw light field into a capture folder, which appears whole or not at all.

    The folder holds ``capture.json``, ``views/RR_CC.png`` and ``weight.npy``, uint8 [n, n, H, W]: 255 = full
    modulation and nothing saturated.

    Parameters
    ----------
    calibration : Path, optional
        The camera's calibration: a tar, a folder, or one white image's .RAW; of a session's capture by default the one
        that its capture.json names.
    views : {7, 14, 15}
        How many views per side; see `lfrig.processing.lenslet.decode.decode`.
    partial : bool
        Take what is whole of a torn file.

    Raises
    ------
    BadInput
        The file or the calibration cannot be used; ``out`` exists.
    UsageError
        More views than the lenses have pixels.
    DiskError
        Writing failed.
    """
    from lfrig.processing.lenslet.decode import decode
    from lfrig.processing.lenslet.raw import read_raw

    monitor, path, out = monitor or Monitor(), Path(path), Path(out)
    if not path.is_file():
        raise BadInput("is not a file", path=path, code="missing-file", remedy="give a .lfr or .lfp file")
    calibration = calibration or _recorded_calibration(path)
    refuse_existing(out, overwrite=overwrite)
    refuse_replacing(out, path, *([Path(calibration)] if calibration else []))
    raw = read_raw(path, calibration=calibration, partial=partial, monitor=monitor)
    found = decode(raw, views=views, threads=threads, monitor=monitor)
    document = capture_document(raw, found, path)
    assert document.views is not None
    with atomic_folder(out, overwrite=overwrite) as staging:
        write_views(staging, found.views, document.views.file, threads=threads)
        with disk_errors(staging / WEIGHT_FILE):
            np.save(staging / WEIGHT_FILE, found.weight)
        document.save(staging / CAPTURE_FILE)
    return DecodeOutcome(out, facts(raw, found))


def _recorded_calibration(path: Path) -> Path | None:
    """What the capture.json beside a raw file names, in its session or beside it."""
    if not (path.parent / CAPTURE_FILE).is_file():
        return None
    raw = CaptureDocument.load(path.parent / CAPTURE_FILE).raw
    if raw is None or raw.path != path.name:
        return None
    return find_calibration(path.parent, raw.calibration, session_of(path.parent))


def capture_document(raw: RawCapture, found: Decoded, path: Path) -> CaptureDocument:
    """The capture.json of decoded views; what the file does not say stays unknown."""
    rows, cols, height, width = found.views.shape[:4]
    return raw_document(
        raw.metadata, found.camera, found.optics, (width, height), views=ViewsSpec(rows=rows, cols=cols),
        origin=OriginSpec(name=path.name, format=FORMAT, sha256=sha256_file(path)),
    )  # fmt: skip


def facts(raw: RawCapture, found: Decoded) -> dict[str, Any]:
    """What the decoder found out, JSON-able."""
    rows, cols, height, width = found.views.shape[:4]
    return {
        "views": {"rows": rows, "cols": cols, "height": height, "width": width, "centre": [found.centre] * 2},
        "white_image": {
            "rule": raw.rule, "name": raw.white.name if raw.white else None,
            "zoom_steps": raw.zoom_steps, "focus_steps": raw.focus_steps,
        },
        "lattice": found.lattice.as_dict(),
        "hot_pixels": len(raw.hot_pixels),
        "mean_weight": float(found.weight.mean() / 255),
        "problems": list(raw.problems),
    }  # fmt: skip
