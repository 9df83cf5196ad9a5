"""Ingest foreign files into a session, all or none; or open a light field without a session."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from lfrig.contracts.capture import CaptureDocument
from lfrig.contracts.errors import BadInput
from lfrig.contracts.files import CAPTURES, SESSION_FILE
from lfrig.contracts.progress import Monitor
from lfrig.processing.model import LightField
from lfrig.rig.ingest.calibration import SessionCalibration, kept_calibration, open_calibration, refuse_unused
from lfrig.rig.ingest.candidate import Candidate, Kind, Request
from lfrig.rig.ingest.formats import recognise
from lfrig.rig.session.capture_folder import content_hash
from lfrig.rig.session.store import SessionStore

Content = tuple[Kind, str]
"""What makes two captures the same: their kind and the hash of their pixels' files."""


@dataclass(frozen=True)
class IngestedCapture:
    """One source's fate: ``id`` is the new capture's, or, where ``skipped``, that of the one with its content."""

    id: str
    source: Path
    kind: Kind
    format: str
    skipped: bool = False


def ingest(
    session_path: Path | str,
    sources: Sequence[Path | str],
    *,
    kind: Kind | None = None,
    pattern: str | None = None,
    calibration: Path | None = None,
    monitor: Monitor | None = None,
) -> list[IngestedCapture]:
    """Copy light fields and photos into a session, which is made when it does not exist.

    Parameters
    ----------
    session_path, sources : Path
        The session's folder; what to ingest, in order.
    kind : {"light_field", "photo"}, optional
        What the sources are; by default found out from each.
    pattern : str, optional
        How views are named, such as ``"view_{row:02d}_{col:02d}.png"``.
    calibration : Path, optional
        Calibration of the camera, for the raw light fields among the sources: archive, folder or a white image's .RAW.
    monitor : Monitor, optional
        Progress and cancel; warned with code ``duplicate-capture`` of content that the session has already.

    Returns
    -------
    list of IngestedCapture
        One per source, in order.

    Raises
    ------
    BadInput
        A source cannot be used; the session has not changed.
    DiskError
        Writing failed; the session has not changed.
    Interrupted
        Cancelled; the session has not changed.
    NotInThisVersion
        A camera's sensor values without their container.
    UsageError
        A calibration, and no raw light field.
    """
    monitor = monitor or Monitor()
    known_calibration = open_calibration(Path(calibration)) if calibration is not None else None
    request = Request(kind, pattern, known_calibration)
    candidates = [recognise(Path(source), request) for source in sources]
    refuse_unused(known_calibration, used=any(_uses(found, known_calibration) for found in candidates))
    with _session(Path(session_path)) as store:
        known = _known_content(store)
        fresh: dict[Content, Candidate] = {}
        for found in candidates:
            if _key(found) not in known:
                fresh.setdefault(_key(found), found)
        needed = known_calibration if any(_uses(found, known_calibration) for found in fresh.values()) else None
        with monitor.task("ingest", len(fresh)), kept_calibration(store.path, needed, monitor):
            ids = store.add_captures([partial(_build, found, monitor=monitor) for found in fresh.values()])
    ids_by_content = known | dict(zip(fresh, ids, strict=True))
    return [_fate(found, ids_by_content[_key(found)], fresh.get(_key(found)), monitor) for found in candidates]


def open_light_field(path: Path | str, *, threads: int = 0, monitor: Monitor | None = None) -> LightField:
    """Read a light field in any known format, without a session; its id is the name of the file or folder.

    Raises
    ------
    BadInput
        It is nothing that can be read, or broken.
    NotInThisVersion
        A camera's sensor values without their container.
    """
    return recognise(Path(path), Request()).light_field(monitor or Monitor(), threads)


def _uses(candidate: Candidate, calibration: SessionCalibration | None) -> bool:
    raw = candidate.document.raw
    return calibration is not None and raw is not None and raw.calibration == calibration.name


def _key(candidate: Candidate) -> Content:
    return candidate.document.kind, candidate.content_hash


def _known_content(store: SessionStore) -> dict[Content, str]:
    """Ids of the session's captures by content; one that is broken is no twin of anything."""
    known = {}
    for capture_id in store.document.captures:
        with contextlib.suppress(BadInput):
            document = store.capture(capture_id)
            known[document.kind, content_hash(store.capture_folder(capture_id), document)] = capture_id
    return known


def _build(candidate: Candidate, folder: Path, *, monitor: Monitor) -> CaptureDocument:
    candidate.write(folder, monitor)
    monitor.advance()
    return candidate.stored_document()


def _fate(candidate: Candidate, capture_id: str, stored: Candidate | None, monitor: Monitor) -> IngestedCapture:
    skipped = stored is not candidate
    if skipped:
        lost = (
            "; its --calibration is not taken over"
            if candidate.document.raw and candidate.document.raw.calibration
            else ""
        )
        monitor.warn(
            "duplicate-capture", f"{candidate.source}: is in the session already, as {capture_id}; skipped{lost}"
        )
    else:
        for notice in candidate.notes():
            monitor.warn(notice.code, f"{candidate.source}: {notice.message}")
    return IngestedCapture(capture_id, candidate.source, candidate.document.kind, candidate.format, skipped)


@contextlib.contextmanager
def _session(path: Path) -> Iterator[SessionStore]:
    """Open or make a session; one that was made here goes again when the block fails."""
    folder_existed, session_existed = path.exists(), (path / SESSION_FILE).exists()
    store = SessionStore.create(path)
    try:
        yield store
    except BaseException:
        if not session_existed:
            with contextlib.suppress(OSError):
                (path / SESSION_FILE).unlink()
                if (path / CAPTURES).is_dir():
                    (path / CAPTURES).rmdir()
                if not folder_existed:
                    path.rmdir()
        raise
