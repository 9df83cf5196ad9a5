"""Where a TIFF file keeps its pixels, so that one which lost some of them is told from a whole one.

LibRaw gives whatever its memory held, without an error, where compressed pixels should begin and do not: beyond the end
of the file, or in a part of it that was lost.
"""

from __future__ import annotations

import mmap
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

_STRIP_OFFSETS, _STRIP_BYTES, _TILE_OFFSETS, _TILE_BYTES = 273, 279, 324, 325
_COMPRESSION, _SUB_DIRECTORIES, _DNG_VERSION = 259, 330, 50706
_JPEG, _JPEG_START = (7,), b"\xff\xd8"
_FORMATS = {3: "H", 4: "I", 13: "I"}
_MAX_DIRECTORIES = 64
_ENTRY_BYTES = 12


@dataclass
class _Directory:
    """One image file directory: numbers by tag, tags of other kinds without numbers; ``next`` is 0 at the end."""

    next: int = 0
    numbers: dict[int, tuple[int, ...]] = field(default_factory=dict)


def fault_of_blocks(path: Path) -> Literal["torn", "damaged"] | None:
    """What is wrong with the blocks of pixels that a TIFF file names, if anything.

    ``"torn"``: the file ends before them. Of a DNG all bytes count; of other raw formats, whose byte counts are not
    always to be trusted, the first of each block. ``"damaged"``: a JPEG block of a DNG does not begin like one. None
    also for what is no TIFF file, or too broken to say.
    """
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        order = {b"II*\0": "<", b"MM\0*": ">"}.get(data[:4])
        if order is None or len(data) < 8:
            return None
        directories = _directories(data, order)
        is_dng = bool(directories) and _DNG_VERSION in directories[0].numbers
        if any(_ends_beyond(directory, len(data), whole=is_dng) for directory in directories):
            return "torn"
        return "damaged" if is_dng and not all(_begins_well(part, data) for part in directories) else None


def _directories(data: mmap.mmap, order: str) -> list[_Directory]:
    """All directories that can be read, the first one first."""
    waiting = [struct.unpack_from(f"{order}I", data, 4)[0]]
    seen: set[int] = set()
    found = []
    while waiting and len(seen) < _MAX_DIRECTORIES:
        at = waiting.pop(0)
        if at == 0 or at in seen:
            continue
        seen.add(at)
        try:
            directory = _directory(data, order, at)
        except struct.error:
            continue
        found.append(directory)
        waiting += [directory.next, *directory.numbers.get(_SUB_DIRECTORIES, ())[:_MAX_DIRECTORIES]]
    return found


def _directory(data: mmap.mmap, order: str, at: int) -> _Directory:
    (count,) = struct.unpack_from(f"{order}H", data, at)
    found = _Directory()
    for place in range(at + 2, at + 2 + count * _ENTRY_BYTES, _ENTRY_BYTES):
        tag, kind, length = struct.unpack_from(f"{order}HHI", data, place)
        found.numbers[tag] = _numbers(data, order, place + 8, kind, length)
    (found.next,) = struct.unpack_from(f"{order}I", data, at + 2 + count * _ENTRY_BYTES)
    return found


def _numbers(data: mmap.mmap, order: str, place: int, kind: int, length: int) -> tuple[int, ...]:
    """Values of an entry; none of a type that is no place in a file, or that is beyond its end."""
    letter = _FORMATS.get(kind)
    if letter is None:
        return ()
    size = length * struct.calcsize(letter)
    if size > 4:
        (place,) = struct.unpack_from(f"{order}I", data, place)
    if place + size > len(data):
        return ()
    return struct.unpack_from(f"{order}{length}{letter}", data, place)


def _ends_beyond(directory: _Directory, size: int, *, whole: bool) -> bool:
    for offsets, counts in ((_STRIP_OFFSETS, _STRIP_BYTES), (_TILE_OFFSETS, _TILE_BYTES)):
        begins = directory.numbers.get(offsets, ())
        lengths = directory.numbers.get(counts, ())
        if any(begin >= size for begin in begins):
            return True
        # Not strict: a file may name fewer lengths than blocks.
        if whole and any(begin + length > size for begin, length in zip(begins, lengths, strict=False)):
            return True
    return False


def _begins_well(directory: _Directory, data: mmap.mmap) -> bool:
    if directory.numbers.get(_COMPRESSION) != _JPEG:
        return True
    begins = directory.numbers.get(_TILE_OFFSETS) or directory.numbers.get(_STRIP_OFFSETS, ())
    return all(data[at : at + 2] == _JPEG_START for at in begins)
