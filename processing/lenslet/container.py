"""Lytro's container: a file header, then sections in any order and number, each named by the SHA-1 of its data.

The file is memory-mapped and never copied: a section's data are a view into it. Nothing is believed: lengths,
counts, JSON sizes and nesting are bounded by `ContainerLimits`, and a section's SHA-1 is checked when its data are
first asked for. Layout: `contracts/lytro.py`.
"""

from __future__ import annotations

import hashlib
import mmap
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from lfrig.contracts.errors import BadInput
from lfrig.contracts.lytro import (
    CONTENT_MAGIC,
    FILE_HEADER,
    FILE_MAGIC,
    REFERENCE_PREFIX,
    SECTION_HEADER,
    TOC_MAGIC,
)
from lfrig.processing.lenslet.bounded_json import parse_json_object

COPY_AGAIN = "copy the file from the camera again"
_REFERENCE = re.compile(rb"sha1-[0-9a-fA-F]{40}")
_MAGIC_START = TOC_MAGIC[:3]
_SMALL_FILE_BYTES = 1 << 16
"""Up to here a file is read, because mapping it costs more."""
_MAX_PROBLEMS = 64
"""A partial read gives up the search after so many."""
_FOREIGN = {
    b"\xff\xd8\xff": "a JPEG picture", b"\x89PNG": "a PNG picture", b"II*\0": "a TIFF or DNG picture",
    b"MM\0*": "a TIFF or DNG picture", b"PK\x03\x04": "a ZIP archive", b"\x1f\x8b": "a gzip file", b"%PDF": "a PDF",
}  # fmt: skip


@dataclass(frozen=True)
class ContainerLimits:
    """What a container may hold at most; the defaults are far above anything a camera writes."""

    file_bytes: int = 2 << 30
    section_bytes: int = 256 << 20
    sections: int = 4096
    json_bytes: int = 2 << 20
    json_depth: int = 64


@dataclass(frozen=True)
class Section:
    """One section: where its data are in the file [bytes]; ``whole`` is false for the part before a torn end."""

    kind: Literal["toc", "content"]
    reference: str
    offset: int
    length: int
    whole: bool = True


class Container:
    """A container's sections and their data.

    Attributes
    ----------
    sections : tuple of Section
        In the order of the file.
    problems : list of str
        What is wrong with it, in words; filled only by a partial read, which a whole one would have refused.
    """

    def __init__(
        self, path: Path, data: memoryview, sections: tuple[Section, ...], problems: list[str], *, partial: bool,
        limits: ContainerLimits,
    ) -> None:  # fmt: skip
        self.path = path
        self.sections = sections
        self.problems = problems
        self.partial = partial
        self.limits = limits
        self._data = data
        self._by_reference: dict[str, Section] = {}
        for section in sections:
            self._by_reference.setdefault(section.reference, section)
        self._checked: set[Section] = set()

    def find(self, reference: str | None) -> Section | None:
        """The section of that reference; None when there is none."""
        return self._by_reference.get(reference.lower()) if reference else None

    def data(self, section: Section) -> memoryview:
        """A view of a section's data, its SHA-1 checked.

        Raises
        ------
        BadInput
            Code ``wrong-sha1``; in a partial read that becomes a problem instead.
        """
        data = self._data[section.offset : section.offset + section.length]
        if section not in self._checked:
            if section.whole and hashlib.sha1(data).hexdigest() != section.reference.removeprefix(REFERENCE_PREFIX):
                self._refuse("wrong-sha1", f"its {section.length} bytes are damaged (SHA-1 differs)", section)
            self._checked.add(section)
        return data

    def json(self, section: Section) -> dict[str, Any]:
        """A section's JSON object; raises `BadInput` (too large, too deep, not JSON, damaged)."""
        limits = self.limits
        if section.length > limits.json_bytes:
            raise BadInput(
                f"is {section.length} bytes of JSON, more than {limits.json_bytes}", path=self.path,
                field=section.reference, code="too-large", remedy=COPY_AGAIN,
            )  # fmt: skip
        if not section.whole:
            raise BadInput(
                f"only {section.length} bytes of it are there", path=self.path, field=section.reference,
                code="truncated", remedy=COPY_AGAIN,
            )  # fmt: skip
        return parse_json_object(self.data(section), self.path, section.reference, limits.json_depth)

    def check(self) -> None:
        """Check every section's SHA-1; raises as `data`."""
        for section in self.sections:
            self.data(section)

    def _refuse(self, code: str, message: str, section: Section) -> None:
        if not self.partial:
            raise BadInput(message, path=self.path, field=section.reference, code=code, remedy=COPY_AGAIN)
        self.problems.append(f"{section.reference}: {message}")


def read_container(path: Path | str, *, partial: bool = False, limits: ContainerLimits | None = None) -> Container:
    """Open a .lfr, .lfp or .lfx file.

    Parameters
    ----------
    path : Path
    partial : bool
        Take what is there instead of refusing a file that is torn or holds garbage; what is wrong goes to `problems`.
    limits : ContainerLimits, optional

    Raises
    ------
    BadInput
        Codes ``missing-file``, ``not-a-lytro-file``, ``truncated``, ``garbage``, ``bad-reference``, ``too-large``,
        ``too-many-sections``, ``no-sections``.
    """
    path, limits = Path(path), limits or ContainerLimits()
    try:
        with path.open("rb") as stream:
            size = path.stat().st_size
            if size > limits.file_bytes:
                raise BadInput(
                    f"is {size} bytes, more than {limits.file_bytes}", path=path, code="too-large",
                    remedy="give one shot's file",
                )  # fmt: skip
            small = size <= _SMALL_FILE_BYTES
            data = stream.read(size) if small else mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
    except FileNotFoundError:
        raise BadInput("does not exist", path=path, code="missing-file", remedy="check the path") from None
    except OSError as error:
        raise BadInput(f"cannot be read: {error.strerror}", path=path, remedy="check the path") from None
    return parse_container(memoryview(data), path, partial=partial, limits=limits)


def parse_container(
    data: memoryview, path: Path | str, *, partial: bool = False, limits: ContainerLimits | None = None
) -> Container:
    """`read_container` of bytes that are in memory; ``path`` is what errors name."""
    path, limits = Path(path), limits or ContainerLimits()
    _check_magic(data, path)
    problems: list[str] = []
    sections: list[Section] = []
    scan = _Scan(data, path, limits, problems if partial else None)
    for section in scan.sections():
        if len(sections) == limits.sections:
            scan.refuse("too-many-sections", f"has more than {limits.sections} sections", None)
            break
        sections.append(section)
    if not sections:
        raise BadInput("has no sections" + _first(problems), path=path, code="no-sections", remedy=COPY_AGAIN)
    return Container(path, data, tuple(sections), problems, partial=partial, limits=limits)


def _first(problems: list[str]) -> str:
    return f" ({problems[0]})" if problems else ""


def _check_magic(data: memoryview, path: Path) -> None:
    start = bytes(data[:8])
    if start == FILE_MAGIC and len(data) >= FILE_HEADER.size:
        return
    found = next((what for magic, what in _FOREIGN.items() if start.startswith(magic)), None)
    if found is None and start and FILE_MAGIC.startswith(start):
        raise BadInput("ends within its header", path=path, code="truncated", remedy=COPY_AGAIN)
    what = found or ("empty" if not start else "no Lytro file")
    raise BadInput(
        f"is {what}, not a raw light field" if found else f"is {what}", path=path, code="not-a-lytro-file",
        remedy="give the camera's .lfr or .lfp file",
    )  # fmt: skip


class _Scan:
    """One pass over the sections' headers; ``problems`` is None when the first problem is to be raised."""

    def __init__(self, data: memoryview, path: Path, limits: ContainerLimits, problems: list[str] | None) -> None:
        self._data, self._path, self._limits, self._problems = data, path, limits, problems

    def sections(self) -> Iterator[Section]:
        at: int | None = FILE_HEADER.size
        while at is not None and len(self._problems or ()) < _MAX_PROBLEMS:
            at = self._skip_padding(at)
            if at == len(self._data):
                return
            section = self._header(at)
            if section is None:
                at = self._next_magic(at + 1)
                continue
            at = section.offset + section.length
            yield section

    def refuse(self, code: str, message: str, at: int | None) -> None:
        """Raise, or in a partial read take note."""
        where = "" if at is None else f" at byte {at}"
        if self._problems is None:
            raise BadInput(message + where, path=self._path, code=code, remedy=COPY_AGAIN)
        self._problems.append(message + where)

    def _skip_padding(self, at: int) -> int:
        """Position of the next byte that is not zero, or the end."""
        step = 64
        while at < len(self._data):
            chunk = bytes(self._data[at : at + step])
            rest = chunk.lstrip(b"\0")
            if rest:
                return at + len(chunk) - len(rest)
            at, step = at + len(chunk), 1 << 16
        return at

    def _header(self, at: int) -> Section | None:
        """The section whose header is at ``at``; None (with a problem noted) when there is none."""
        left = len(self._data) - at
        start = bytes(self._data[at : at + len(TOC_MAGIC)])
        if left < SECTION_HEADER.size and (TOC_MAGIC.startswith(start) or CONTENT_MAGIC.startswith(start)):
            self.refuse("truncated", "ends within the header of a section", at)
            return None
        if start not in (TOC_MAGIC, CONTENT_MAGIC):
            self.refuse("garbage", "holds garbage where a section should begin", at)
            return None
        _, _, length, name = SECTION_HEADER.unpack_from(self._data, at)
        if not _REFERENCE.fullmatch(name):
            self.refuse("bad-reference", "has a section that no SHA-1 names", at)
            return None
        if length > self._limits.section_bytes:
            message = f"has a section of {length} bytes, more than {self._limits.section_bytes},"
            self.refuse("too-large", message, at)
            return None
        offset = at + SECTION_HEADER.size
        whole = length <= len(self._data) - offset
        if not whole:
            self.refuse(
                "truncated", f"ends {length - (len(self._data) - offset)} bytes before the end of a section", at
            )
            length = len(self._data) - offset
        kind: Literal["toc", "content"] = "toc" if start == TOC_MAGIC else "content"
        return Section(kind, name.decode("ascii").lower(), offset, length, whole)

    def _next_magic(self, at: int) -> int | None:
        """Where a section may begin again, in a partial read."""
        overlap = len(_MAGIC_START) - 1
        while at < len(self._data):
            chunk = bytes(self._data[at : at + (1 << 16)])
            found = chunk.find(_MAGIC_START)
            if found >= 0:
                return at + found
            at += max(len(chunk) - overlap, 1)
        return None
