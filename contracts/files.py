"""Atomic files and folders: what exists is whole, and what existed before a failure still does."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import itertools
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from lfrig.contracts.errors import BadInput, DiskError

_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_DENIED = {errno.EACCES, errno.EPERM, errno.EROFS}
_CANNOT_SYNC = {errno.EINVAL, errno.ENOTSUP, errno.EBADF}
"""What network and user-space file systems answer that have no fsync of a folder."""
_SERIAL = itertools.count()
SESSION_FILE = "session.json"
CAPTURES, CALIBRATION = "captures", "calibration"
ORIGINALS = (CAPTURES, CALIBRATION)
"""Folders of a session that nothing else holds a copy of."""


@contextlib.contextmanager
def disk_errors(path: Path) -> Iterator[None]:
    """Turn an `OSError` of writing under ``path`` into a `DiskError` with a remedy."""
    try:
        yield
    except OSError as error:
        raise _disk_error(error, path) from error


def _disk_error(error: OSError, path: Path) -> DiskError:
    path = _named_in(error, path)
    if error.errno in _FULL:
        return DiskError("no space left on the disk", path=path, code="disk-full", remedy="free some space")
    if error.errno in _DENIED:
        return DiskError(
            "cannot be written (read-only or no permission)", path=path, code="read-only",
            remedy="choose another folder or change its permissions",
        )  # fmt: skip
    reason = error.strerror or error
    return DiskError(f"cannot be written: {reason}", path=path, remedy="choose another folder")


def _named_in(error: OSError, path: Path) -> Path:
    """The file that the error names, unless that is a hidden name of ours, which means ``path``."""
    if not isinstance(error.filename, str | bytes) or not error.filename:
        return path
    named = Path(os.fsdecode(error.filename))
    return path if any(part.startswith(f".{path.name}.") for part in named.parts) else named


def sync_folder(folder: Path) -> None:
    """Make renames inside ``folder`` durable (where the file system can)."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in _CANNOT_SYNC:
            raise
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def atomic_writer(path: Path) -> Iterator[BinaryIO]:
    """A stream to write a file with, so that a crash or an exception leaves the old one: temp, fsync, rename, folder
    fsync.

    Raises
    ------
    DiskError
        Disk full, read-only, no permission; whatever was at ``path`` stays.
    """
    with disk_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = _beside(path, "tmp")
        try:
            with temporary.open("wb") as stream:
                yield stream
                stream.flush()
                os.fsync(stream.fileno())
            temporary.replace(path)
            sync_folder(path.parent)
        finally:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)


def atomic_write_bytes(path: Path, data: bytes) -> None:
    """Write a whole file as `atomic_writer` does."""
    with atomic_writer(path) as stream:
        stream.write(data)


def atomic_write_text(path: Path, text: str) -> None:
    """`atomic_write_bytes` of UTF-8 text."""
    atomic_write_bytes(path, text.encode("utf-8"))


@contextlib.contextmanager
def atomic_folder(path: Path, *, overwrite: bool = False, sync: bool = True) -> Iterator[Path]:
    """Build a folder aside and move it into place only when the block succeeds.

    Yields the temporary folder to fill. When the block raises, it is removed with the parents that were made
    for it, and whatever was at ``path`` stays. A process killed between the two renames of an overwrite leaves
    the old folder under a hidden name; the next `atomic_folder` of the same path puts it back first.
    ``sync=False`` does not wait for the disk: for what can be made again and is checked when it is read.

    Raises
    ------
    BadInput
        ``path`` exists and ``overwrite`` is false (checked before any work).
    DiskError
        Writing failed.
    """
    with disk_errors(path):
        _restore_abandoned(path)
    refuse_existing(path, overwrite=overwrite)
    if path.is_file():
        raise BadInput("is a file, where a folder is to be made", path=path, code="exists", remedy="give another --out")
    temporary = _beside(path, "tmp")
    made = [parent for parent in path.parents if not parent.exists()]
    try:
        with disk_errors(path):
            temporary.mkdir(parents=True)
            yield temporary
            if sync:
                _sync_tree(temporary)
            refuse_existing(path, overwrite=overwrite)  # it may have appeared meanwhile
            _swap(temporary, path)
    finally:
        _remove(temporary)
        for parent in made:  # innermost first; one that holds something stays
            with contextlib.suppress(OSError):
                parent.rmdir()


def _swap(temporary: Path, path: Path) -> None:
    """Move ``temporary`` to ``path``; what was there is removed only once the new one is in place."""
    previous = _beside(path, "old")
    try:
        if os.path.lexists(path):
            path.rename(previous)
        temporary.rename(path)
        sync_folder(path.parent)
    except BaseException:
        if not os.path.lexists(temporary) and os.path.lexists(path):
            path.rename(temporary)
        if os.path.lexists(previous):
            previous.rename(path)
        raise
    _remove(previous)


def _restore_abandoned(path: Path) -> None:
    """Put back what a killed process had moved aside for an overwrite that never finished."""
    if os.path.lexists(path) or not path.parent.is_dir():
        return
    prefix = f".{path.name}."
    for entry in sorted(path.parent.iterdir()):
        name = entry.name
        if name.startswith(prefix) and name.endswith(".old") and not _is_running(name[len(prefix) :]):
            entry.rename(path)
            return


def _is_running(suffix: str) -> bool:
    """Whether the process that `_beside` names in ``<pid>-<n>.old`` still runs; True when in doubt."""
    pid = suffix.partition("-")[0]
    if not pid.isdigit():
        return True
    try:
        os.kill(int(pid), 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:
        return True
    return True


def _beside(path: Path, ending: str) -> Path:
    """A hidden name in the same folder that no other process and no other thread uses."""
    return path.with_name(f".{path.name}.{os.getpid()}-{next(_SERIAL)}.{ending}")


def _sync_tree(folder: Path) -> None:
    for entry in [folder, *folder.rglob("*")]:
        if entry.is_symlink():
            continue
        if entry.is_dir():
            sync_folder(entry)
        elif entry.is_file():
            with entry.open("rb") as stream:
                os.fsync(stream.fileno())


def _remove(path: Path) -> None:
    """Remove a file, a link or a folder as far as possible; never raises `OSError`."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)


def refuse_existing(path: Path, *, overwrite: bool) -> None:
    """Raise `BadInput` when ``path`` exists and may not be replaced.

    Originals may never be, even with ``overwrite``: a session, its captures and its calibrations.
    """
    if not path.name:
        raise BadInput("has no name of its own", path=path, code="no-name", remedy="name a new folder in --out")
    if not os.path.lexists(path):
        return
    if not overwrite:
        raise BadInput("exists already", path=path, code="exists", remedy="give --overwrite, or another --out")
    if _holds_originals(path):
        raise BadInput(
            "holds captures, which --overwrite never replaces", path=path, code="holds-captures",
            remedy="give another --out, or remove it by hand",
        )  # fmt: skip


def refuse_replacing(path: Path, *sources: Path) -> None:
    """Raise `BadInput` when writing ``path`` would replace a file or folder that is read."""
    target = path.resolve()
    for source in sources:
        if source.resolve().is_relative_to(target):
            raise BadInput(
                f"would replace {source}, which is read", path=path, code="own-input", remedy="give another --out"
            )


def _holds_originals(path: Path) -> bool:
    """Whether a folder is a session, holds one, or is what a session keeps its originals in."""
    if not path.is_dir():
        return False
    if (path / SESSION_FILE).exists():
        return True
    kept = [
        parent / name for parent in path.absolute().parents if (parent / SESSION_FILE).exists() for name in ORIGINALS
    ]
    return any(path.absolute().is_relative_to(folder) for folder in kept)


def sha256_file(path: Path) -> str:
    """Hex SHA-256 of a file's bytes; raises `BadInput` when it cannot be read."""
    try:
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise BadInput(f"cannot be read: {error.strerror}", path=path, remedy="check the path") from None


def sha256_files(paths: list[Path]) -> str:
    """Hex SHA-256 over the bytes of several files, in the order given, names not included."""
    total = hashlib.sha256()
    for path in paths:
        total.update(bytes.fromhex(sha256_file(path)))
    return total.hexdigest()
