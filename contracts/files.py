"""Atomic files and folders: what exists is whole, and what existed before a failure still does."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from lfrig.contracts.errors import BadInput, DiskError

_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_DENIED = {errno.EACCES, errno.EPERM, errno.EROFS}


@contextlib.contextmanager
def disk_errors(path: Path) -> Iterator[None]:
    """Turn an `OSError` of writing under ``path`` into a `DiskError` with a remedy."""
    try:
        yield
    except OSError as error:
        raise _disk_error(error, path) from error


def _disk_error(error: OSError, path: Path) -> DiskError:
    if error.errno in _FULL:
        return DiskError("no space left on the disk", path=path, code="disk-full", remedy="free some space")
    if error.errno in _DENIED:
        return DiskError(
            "cannot be written (read-only or no permission)", path=path, code="read-only",
            remedy="choose another folder or change its permissions",
        )  # fmt: skip
    return DiskError(f"cannot be written: {error.strerror or error}", path=path, remedy="choose another folder")


def sync_folder(folder: Path) -> None:
    """Make renames inside ``folder`` durable."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def atomic_write_bytes(path: Path, data: bytes) -> None:
    """Write a file so that a crash leaves either the old one or the new one: temp, fsync, rename, folder fsync."""
    with disk_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
        try:
            with temporary.open("wb") as stream:
                stream.write(data)
                stream.flush()
                os.fsync(stream.fileno())
            temporary.replace(path)
            sync_folder(path.parent)
        finally:
            temporary.unlink(missing_ok=True)


def atomic_write_text(path: Path, text: str) -> None:
    """`atomic_write_bytes` of UTF-8 text."""
    atomic_write_bytes(path, text.encode("utf-8"))


@contextlib.contextmanager
def atomic_folder(path: Path, *, overwrite: bool = False) -> Iterator[Path]:
    """Build a folder aside and move it into place only when the block succeeds.

    Yields the temporary folder to fill. When the block raises, it is removed and whatever was at ``path`` stays.

    Raises
    ------
    BadInput
        ``path`` exists and ``overwrite`` is false (checked before any work).
    DiskError
        Writing failed.
    """
    refuse_existing(path, overwrite=overwrite)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    previous = path.with_name(f".{path.name}.{os.getpid()}.old")
    with disk_errors(path):
        shutil.rmtree(temporary, ignore_errors=True)
        temporary.mkdir(parents=True)
    try:
        with disk_errors(path):
            yield temporary
            for file in temporary.rglob("*"):
                if file.is_file():
                    with file.open("rb") as stream:
                        os.fsync(stream.fileno())
            if path.exists():
                path.rename(previous)
            temporary.rename(path)
            sync_folder(path.parent)
    except BaseException:
        if previous.exists() and not path.exists():
            previous.rename(path)
        raise
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        if path.exists():
            shutil.rmtree(previous, ignore_errors=True)


def refuse_existing(path: Path, *, overwrite: bool) -> None:
    """Raise `BadInput` when ``path`` exists and may not be replaced."""
    if path.exists() and not overwrite:
        raise BadInput(
            "exists already", path=path, code="exists", remedy="give --overwrite, or another --out"
        )


def sha256_file(path: Path) -> str:
    """Hex SHA-256 of a file's bytes."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def sha256_files(paths: list[Path]) -> str:
    """Hex SHA-256 over the bytes of several files, in the order given, names not included."""
    total = hashlib.sha256()
    for path in paths:
        total.update(bytes.fromhex(sha256_file(path)))
    return total.hexdigest()
