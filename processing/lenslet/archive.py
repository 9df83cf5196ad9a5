"""Files of a calibration archive, read where they are: a tar (plain or gzip), a folder, or one RAW file's siblings.

Nothing is extracted. The tar reader is our own because `tarfile` reads extended headers of any size into memory and
follows formats that no camera writes; this one takes regular files and folders, bounds what it reads, and refuses
links, devices and names that lead outside. Layout: POSIX.1-2001 ustar and pax, and GNU long names.
"""

from __future__ import annotations

import contextlib
import gzip
import mmap
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import Protocol

from lfrig.contracts.errors import BadInput
from lfrig.contracts.paths import check_inside

_BLOCK = 512
_GZIP_MAGIC = b"\x1f\x8b"
_CACHED_MEMBER_BYTES = 1 << 16
_CACHED_MEMBERS = 512
_MAX_NAME = 200
_NOT_OURS = "give the camera's caldata-….tar, its unpacked folder, or a white image's .RAW file"
_KINDS = {b"1": "a hard link", b"2": "a symbolic link", b"3": "a device", b"4": "a device", b"6": "a pipe"}


@dataclass(frozen=True)
class ArchiveLimits:
    """What an archive may hold at most; a camera's has about 200 files of at most 52 MB."""

    archive_bytes: int = 16 << 30
    member_bytes: int = 256 << 20
    members: int = 8192
    extended_header_bytes: int = 1 << 16


class Archive(Protocol):
    """Files by name (as in the archive, ``/`` between folders)."""

    path: Path
    sizes: dict[str, int]
    """Size [bytes] of every file by its name."""

    def read(self, name: str) -> memoryview:
        """A file's bytes; raises `BadInput` when they cannot be read."""
        ...


def open_archive(path: Path | str, limits: ArchiveLimits | None = None) -> Archive:
    """Open whichever kind of archive ``path`` is.

    Raises
    ------
    BadInput
        Codes ``missing-file``, ``not-a-calibration``, ``truncated``, ``garbage``, ``too-large``, ``too-many-files``,
        ``unsafe-member`` (a link, a device, a name that leads outside).
    """
    path, limits = Path(path), limits or ArchiveLimits()
    if not path.exists():
        raise BadInput("does not exist", path=path, code="missing-file", remedy="check the path")
    if path.is_dir():
        return _Folder(path, limits)
    if path.suffix.lower() == ".raw":
        return _Folder(path.parent, limits, stem=path.stem)
    return _Tar(path, limits)


class _Folder:
    """The files below a folder; with a ``stem`` only those in it that share it."""

    def __init__(self, path: Path, limits: ArchiveLimits, stem: str | None = None) -> None:
        self.path = path
        found = list(islice(path.glob("*") if stem else path.rglob("*"), limits.members + 1))
        if len(found) > limits.members:
            raise _too_many(path, limits)
        files = [file for file in sorted(found) if file.is_file() and stem in (None, file.stem)]
        self.sizes = {file.relative_to(path).as_posix(): file.stat().st_size for file in files}
        self._limits = limits

    def read(self, name: str) -> memoryview:
        file = self.path / name
        if self.sizes[name] > self._limits.member_bytes:
            raise _too_large(self.path, name, self.sizes[name])
        with _readable(file):
            return memoryview(_mapped(file) if self.sizes[name] else b"")


class _Tar:
    """A tar file, plain (memory-mapped) or gzip."""

    def __init__(self, path: Path, limits: ArchiveLimits) -> None:
        self.path = path
        self._limits = limits
        self._offsets: dict[str, int] = {}
        self._cached: dict[str, bytes] = {}
        self.sizes: dict[str, int] = {}
        with _readable(path):
            with path.open("rb") as stream:
                self._compressed = stream.read(2) == _GZIP_MAGIC
            self._map = None if self._compressed or not path.stat().st_size else memoryview(_mapped(path))
            with self._reader() as reader:
                for name, offset, size in _members(reader, path, limits):
                    self._offsets[name], self.sizes[name] = offset, size
                    small = size <= _CACHED_MEMBER_BYTES and len(self._cached) < _CACHED_MEMBERS
                    if self._compressed and small:
                        self._cached[name] = bytes(reader.read(offset, size))

    def read(self, name: str) -> memoryview:
        if name in self._cached:
            return memoryview(self._cached[name])
        with _readable(self.path), self._reader() as reader:
            return reader.read(self._offsets[name], self.sizes[name])

    @contextlib.contextmanager
    def _reader(self) -> Iterator[_Reader]:
        if self._compressed:
            with gzip.open(self.path) as stream:
                yield _Gunzip(stream, self._limits.archive_bytes)
        else:
            yield _Mapped(self._map if self._map is not None else memoryview(b""))


class _Reader(Protocol):
    def read(self, offset: int, size: int) -> memoryview:
        """``size`` bytes from ``offset``, fewer at the end."""
        ...


class _Mapped:
    def __init__(self, data: memoryview) -> None:
        self._data = data

    def read(self, offset: int, size: int) -> memoryview:
        return self._data[offset : offset + size]


class _Gunzip:
    """Reads forward in one pass where it can; never past ``limit`` bytes."""

    def __init__(self, stream: gzip.GzipFile, limit: int) -> None:
        self._stream, self._limit = stream, limit

    def read(self, offset: int, size: int) -> memoryview:
        if offset + size > self._limit:
            raise EOFError
        self._stream.seek(offset)
        return memoryview(self._stream.read(size))


def _members(reader: _Reader, path: Path, limits: ArchiveLimits) -> Iterator[tuple[str, int, int]]:
    """(name, offset, size) of every regular file."""
    at, long_name, count = 0, None, 0
    while at + _BLOCK <= limits.archive_bytes:
        header = bytes(reader.read(at, _BLOCK))
        if len(header) == _BLOCK and not header.strip(b"\0"):
            return  # a block of zeros ends the archive
        if not header and count:
            return  # some writers leave it out
        _check_header(header, path, first=count == 0)
        count += 1
        if count > limits.members:
            raise _too_many(path, limits)
        size, kind = _number(header[124:136], path), header[156:157]
        offset = at + _BLOCK
        at = offset + -(-size // _BLOCK) * _BLOCK
        if kind in (b"x", b"g", b"L"):
            if size > limits.extended_header_bytes:
                raise _too_large(path, "extended header", size)
            extension = bytes(reader.read(offset, size))
            if kind != b"g":
                long_name = _pax_path(extension) if kind == b"x" else _text(extension)
            continue
        name = _safe_name(long_name or _name(header), path)
        long_name = None
        if kind == b"5":
            continue
        if kind not in (b"0", b"\0", b"7"):
            what = _KINDS.get(kind, f"an entry of type {kind.decode('latin-1')!r}")
            raise _unsafe(f"is {what}, which no camera writes", path, name)
        if size > limits.member_bytes:
            raise _too_large(path, name, size)
        if size and len(reader.read(offset + size - 1, 1)) != 1:
            raise BadInput(
                f"the archive ends before its {size} bytes",
                path=path,
                field=name,
                code="truncated",
                remedy="copy it again",
            )
        if not PurePosixPath(name).name.startswith("._"):  # a Macintosh's attributes
            yield name, offset, size
    raise BadInput("is too large for a calibration", path=path, code="too-large", remedy=_NOT_OURS)


def _check_header(header: bytes, path: Path, *, first: bool) -> None:
    """Refuse what is no tar header: its checksum is over itself with blanks for the checksum."""
    if len(header) == _BLOCK:
        total = sum(header) - sum(header[148:156]) + 8 * ord(" ")
        recorded = header[148:156].strip(b"\0 ")
        if recorded and not recorded.strip(b"01234567") and int(recorded, 8) == total:
            return
    if first:
        raise BadInput("is no calibration archive", path=path, code="not-a-calibration", remedy=_NOT_OURS)
    code, message = ("truncated", "ends early") if len(header) < _BLOCK else ("garbage", "is damaged")
    raise BadInput(message, path=path, code=code, remedy="copy it again")


def _number(field: bytes, path: Path) -> int:
    """A size, octal or (GNU) base 256."""
    if field[0] & 0x80:
        return int.from_bytes(field[1:], "big")
    digits = field.strip(b"\0 ")
    if digits.strip(b"01234567"):
        raise BadInput("is damaged (a size is no number)", path=path, code="garbage", remedy="copy it again")
    return int(digits or b"0", 8)


def _name(header: bytes) -> str:
    name = _text(header[:100])
    prefix = _text(header[345:500]) if header[257:263] == b"ustar\0" else ""
    return f"{prefix}/{name}" if prefix else name


def _text(field: bytes) -> str:
    return field.partition(b"\0")[0].decode("utf-8", "replace")


def _pax_path(records: bytes) -> str | None:
    """The ``path`` of an extended header: lines ``<length> <key>=<value>``."""
    found, at = None, 0
    while at < len(records):
        digits, blank, _ = records[at : at + 8].partition(b" ")
        if not blank or not digits.isdigit() or int(digits) <= len(digits) + 1:
            break
        key, _, value = records[at + len(digits) + 1 : at + int(digits)].rstrip(b"\n").partition(b"=")
        if key == b"path":
            found = value.decode("utf-8", "replace")
        at += int(digits)
    return found


def _safe_name(name: str, path: Path) -> str:
    shown = "".join(letter if letter.isprintable() else "?" for letter in name[:_MAX_NAME])
    try:
        return check_inside(shown.removeprefix("./") or ".")
    except ValueError:
        raise _unsafe("leads outside of the archive", path, shown) from None


def _unsafe(message: str, path: Path, name: str) -> BadInput:
    return BadInput(message, path=path, field=name, code="unsafe-member", remedy=_NOT_OURS)


def _too_large(path: Path, name: str, size: int) -> BadInput:
    message = f"is {size} bytes, more than any camera's"
    return BadInput(message, path=path, field=name, code="too-large", remedy=_NOT_OURS)


def _too_many(path: Path, limits: ArchiveLimits) -> BadInput:
    message = f"holds more than {limits.members} files"
    return BadInput(message, path=path, code="too-many-files", remedy=_NOT_OURS)


def _mapped(file: Path) -> mmap.mmap:
    with file.open("rb") as stream:
        return mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)


@contextlib.contextmanager
def _readable(path: Path) -> Iterator[None]:
    try:
        yield
    except (EOFError, zlib.error, gzip.BadGzipFile):
        raise BadInput("is damaged or too large", path=path, code="truncated", remedy="copy it again") from None
    except OSError as error:
        raise BadInput(f"cannot be read: {error.strerror}", path=path, remedy="check the path") from None
