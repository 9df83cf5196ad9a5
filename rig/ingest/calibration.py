"""The calibration that ``--calibration`` names: checked, then kept once per session as ``calibration/<name>.tar``.

The name is made from the content, so that the same calibration is kept once however often it is given. A tar is copied
byte for byte; a folder, or the files of one white image, become a tar without times or owners.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import tarfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from lfrig.contracts.errors import UsageError
from lfrig.contracts.files import CALIBRATION, atomic_writer, sha256_file
from lfrig.contracts.progress import Monitor
from lfrig.processing.lenslet.archive import Archive, open_archive
from lfrig.processing.lenslet.calibration import Calibration

_KEPT_SUFFIXES = (".RAW", ".TXT", ".GCT", ".JSON", ".BIN")
_NAME_DIGITS = 16
_CHUNK_BYTES = 1 << 22


@dataclass(frozen=True, eq=False)
class SessionCalibration:
    """A calibration on its way into a session: ``name`` is what captures call it."""

    name: str
    content: Calibration
    archive: Archive
    tar: Path | None

    def file(self, session: Path) -> Path:
        """Where a session keeps it."""
        return session / CALIBRATION / f"{self.name}.tar"


def open_calibration(path: Path) -> SessionCalibration:
    """Check a calibration and name it; raises `BadInput` when it is none (`open_archive`, `Calibration`)."""
    archive = open_archive(path)
    content = Calibration(archive)
    is_tar = path.is_file() and path.suffix.lower() != ".raw"
    digest = sha256_file(path) if is_tar else _content_hash(archive)
    return SessionCalibration(digest[:_NAME_DIGITS], content, archive, path if is_tar else None)


@contextlib.contextmanager
def kept_calibration(session: Path, calibration: SessionCalibration | None, monitor: Monitor) -> Iterator[None]:
    """Keep a calibration in the session for the block; one that was not there goes again when the block fails.

    Raises
    ------
    DiskError
        Writing failed.
    """
    if calibration is None or calibration.file(session).exists():
        yield
        return
    target = calibration.file(session)
    folder_existed = target.parent.exists()
    try:
        with atomic_writer(target) as stream:
            _write(calibration, stream, monitor)
        yield
    except BaseException:
        with contextlib.suppress(OSError):
            target.unlink(missing_ok=True)
            if not folder_existed:
                target.parent.rmdir()
        raise


def refuse_unused(calibration: SessionCalibration | None, *, used: bool) -> None:
    """Raise `UsageError` when a calibration was given and no source can use it."""
    if calibration is not None and not used:
        raise UsageError("--calibration is for raw light fields, and no source is one", remedy="leave it out")


def _write(calibration: SessionCalibration, stream: BinaryIO, monitor: Monitor) -> None:
    if calibration.tar is not None:
        with calibration.tar.open("rb") as source:
            while chunk := source.read(_CHUNK_BYTES):
                stream.write(chunk)
                monitor.advance(0)
        return
    with tarfile.open(fileobj=stream, mode="w", format=tarfile.PAX_FORMAT) as tar:
        for name in _kept_names(calibration.archive):
            entry = tarfile.TarInfo(name)
            entry.size = calibration.archive.sizes[name]
            tar.addfile(entry, io.BytesIO(calibration.archive.read(name)))
            monitor.advance(0)


def _content_hash(archive: Archive) -> str:
    total = hashlib.sha256()
    for name in _kept_names(archive):
        total.update(f"{name}\0{archive.sizes[name]}\0".encode())
        total.update(archive.read(name))
    return total.hexdigest()


def _kept_names(archive: Archive) -> list[str]:
    return [name for name in sorted(archive.sizes) if name.upper().endswith(_KEPT_SUFFIXES)]
