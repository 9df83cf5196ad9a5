"""Views of raw captures, decoded once: ``SESSION/cache/decode/<hash>/``, which is safe to delete at any time."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lfrig.contracts.capture import CaptureDocument
from lfrig.contracts.errors import BadInput, DiskError
from lfrig.contracts.files import CALIBRATION, atomic_folder, atomic_write_text, sha256_file
from lfrig.contracts.progress import Monitor
from lfrig.processing.model import U8, Camera, Optics

if TYPE_CHECKING:
    from lfrig.processing.lenslet.decode import Decoded

DECODER = 1
"""Raised whenever decoding the same file gives other bytes: what is cached then no longer serves."""
CACHE = "cache"
VIEWS, FIGURES = "views.npy", "decoded.json"


@dataclass(frozen=True, eq=False)
class DecodedViews:
    """Views of a raw capture: uint8 [7, 7, H, W, 3], and what the file's metadata say of camera and optics."""

    views: U8
    camera: Camera | None
    optics: Optics


def decoded_views(
    folder: Path, document: CaptureDocument, *, session: Path | None, threads: int = 0, monitor: Monitor | None = None
) -> DecodedViews:
    """The views of a raw capture, from the session's cache or decoded now.

    Parameters
    ----------
    session : Path, optional
        The session that the capture belongs to: its ``calibration/`` is looked into and its ``cache/`` used. Without
        one the calibration is looked for beside the raw file, and nothing is cached.
    monitor : Monitor, optional
        Warned by reader and decoder, also of what was decoded earlier; ``cache-not-written`` when there is no room.

    Raises
    ------
    BadInput
        The raw file or its calibration cannot be used; the file is not the one that was captured.
    """
    monitor = monitor or Monitor()
    assert document.raw is not None
    path = folder / document.raw.path
    calibration = find_calibration(folder, document.raw.calibration, session)
    if document.raw.calibration is not None and calibration is None:
        monitor.warn("calibration-missing", f"{path}: its calibration {document.raw.calibration!r} is not there")
    sha256 = sha256_file(path)
    if document.raw.sha256 not in (None, sha256):
        raise BadInput(
            "is not the file that was captured (its SHA-256 differs)", path=path, field="raw.sha256",
            code="changed-file", remedy="copy the capture again",
        )  # fmt: skip
    place = None if session is None else session / CACHE / "decode" / cache_key(sha256, calibration)
    kept = None if place is None else _load(place, monitor)
    if kept is not None:
        return kept
    found, notices = _decode(path, calibration, session, threads, monitor)
    if place is not None:
        _keep(place, found, notices, monitor)
    return found


def find_calibration(folder: Path, name: str | None, session: Path | None) -> Path | None:
    """The calibration that a capture names: a tar or a folder in SESSION/calibration, or beside the raw file.

    None when it names none, or it is not there: the reader then warns and takes the next best white image.
    """
    if name is None:
        return None
    if Path(name).name != name or name in ("", ".", ".."):
        raise BadInput(
            f"{name!r} is not a plain name", path=folder / "capture.json", field="raw.calibration",
            remedy="name a file in SESSION/calibration",
        )  # fmt: skip
    places = ([session / CALIBRATION] if session else []) + [folder]
    candidates = [place / f"{name}{ending}" for place in places for ending in ("", ".tar")]
    return next((path for path in candidates if path.exists()), None)


def cache_key(sha256: str, calibration: Path | None) -> str:
    """Names what decoded views depend on.

    Of a calibration, which can be gigabytes, size and time of change stand for its content.
    """
    parts: list[Any] = [DECODER, sha256]
    if calibration is not None:
        files = [calibration] if calibration.is_file() else sorted(p for p in calibration.rglob("*") if p.is_file())
        parts += [[path.name, path.stat().st_size, path.stat().st_mtime_ns] for path in files]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def _decode(
    path: Path, calibration: Path | None, session: Path | None, threads: int, monitor: Monitor
) -> tuple[DecodedViews, list[list[str]]]:
    from lfrig.processing.lenslet.decode import decode
    from lfrig.processing.lenslet.raw import read_raw

    known = len(monitor.notices)
    raw = read_raw(path, calibration=calibration, monitor=monitor)
    cache = session / CACHE / "lattice" if session else None
    found: Decoded = decode(raw, lattice_cache=cache, threads=threads, monitor=monitor)
    notices = [[notice.code, notice.message] for notice in monitor.notices[known:]]
    return DecodedViews(found.views, found.camera, found.optics), notices


def _keep(place: Path, found: DecodedViews, notices: list[list[str]], monitor: Monitor) -> None:
    camera, optics = found.camera, found.optics
    figures = {
        "focal": None if camera is None else [camera.focal_px, camera.sigma_focal],
        "optics": [optics.baseline_m, optics.focus_distance_m, optics.sigma_baseline],
        "notices": notices,
    }
    try:
        with atomic_folder(place, overwrite=True) as staging:
            np.save(staging / VIEWS, found.views)
            atomic_write_text(staging / FIGURES, json.dumps(figures) + "\n")
    except DiskError as error:
        monitor.warn("cache-not-written", f"decoded views are not kept: {error.message}")


def _load(place: Path, monitor: Monitor) -> DecodedViews | None:
    """What `_keep` wrote; None when it is not there, or damaged."""
    try:
        figures = json.loads((place / FIGURES).read_text(encoding="utf-8"))
        views = np.load(place / VIEWS, allow_pickle=False)
        if views.dtype != np.uint8 or views.ndim != 5 or views.shape[4] != 3:
            return None
        focal, notices = figures["focal"], [(str(code), str(message)) for code, message in figures["notices"]]
        camera = None if focal is None else Camera.centred(views.shape[3], views.shape[2], *map(float, focal))
        optics = Optics(*figures["optics"])
    except (OSError, ValueError, KeyError, TypeError, EOFError):
        return None
    for code, message in notices:
        monitor.warn(code, message)
    return DecodedViews(views, camera, optics)
