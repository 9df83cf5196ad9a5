"""Ways to break a raw file or a calibration: each takes a random generator and gives the broken bytes."""

from __future__ import annotations

import copy
import io
import json
import tarfile
from collections.abc import Callable, Mapping, Sequence
from random import Random
from typing import Any

from lfrig.bench.lytro_files import (
    Json,
    SmallShot,
    container,
    encoded,
    reference,
    section,
    shot_parts,
    tar_bytes,
)
from lfrig.contracts.lytro import CONTENT_MAGIC, FILE_HEADER, SECTION_HEADER, TOC_MAGIC

NASTY_LENGTHS = (0, 1, 4, 95, 96, 255, 1 << 16, 1 << 20, (1 << 28) - 1, 1 << 28, (1 << 31) - 1, 1 << 31, (1 << 32) - 1)
NASTY_VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 3, 7, 9, 10, 12, 14, 16, 17, 255, 65535, 65536, 1 << 31, -(1 << 31), 1 << 63, 10**400,
    0.5, -0.5, 1e-320, 1e300, -1e300, float("nan"), float("inf"), float("-inf"), 8000, 16384, "", "x", "ILLUM", "F01",
    "big", "little", "sha1-" + "0" * 40, "\x1b[31m\ud800\x00", "9" * 300, [], {}, [1] * 9, [float("nan")] * 9, [[]],
    {"x": None}, {"r": 1},
)  # fmt: skip
SECTION_MAGICS = (TOC_MAGIC, CONTENT_MAGIC)


def mutated_shot(rng: Random, shots: Sequence[tuple[SmallShot, bytes]]) -> bytes:
    """A broken one of these shots, given with their files; now and then a whole one."""
    shot, whole = rng.choice(shots)
    if rng.random() < 0.45:
        return _edited_sections(rng, shot)
    data = bytearray(whole)
    for _ in range(rng.randint(0, 3)):
        rng.choice(_BYTES)(rng, data, rng.choice(shots)[1])
    return bytes(data)


def mutated_calibration(rng: Random, files: Mapping[str, bytes]) -> bytes:
    """A broken tar, plain or gzip."""
    changed = dict(files)
    for _ in range(rng.randint(0, 2)):
        _edit_file(rng, changed)
    mode = "w:gz" if rng.random() < 0.1 else "w"
    data = bytearray(tar_bytes(changed, mode=mode) if rng.random() < 0.7 else _odd_tar(rng, changed))
    for _ in range(rng.randint(0, 2)):
        if rng.random() < 0.5:
            _break_tar_header(rng, data)
        else:
            rng.choice(_BYTES)(rng, data, bytes(data))
    return bytes(data)


# -- bytes -------------------------------------------------------------------------------------------------------
def _flip_bits(rng: Random, data: bytearray, other: bytes) -> None:
    for _ in range(rng.randint(1, 8)):
        if data:
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)


def _truncate(rng: Random, data: bytearray, other: bytes) -> None:
    del data[rng.randint(0, len(data)) :]


def _cut(rng: Random, data: bytearray, other: bytes) -> None:
    at = rng.randint(0, len(data))
    del data[at : at + rng.choice((1, 4, 16, 96, 300))]


def _insert(rng: Random, data: bytearray, other: bytes) -> None:
    at = rng.randint(0, len(data))
    data[at:at] = rng.choice((b"\0", b"\x89", b"\x89LF", b"\xff" * 7)) * rng.randint(1, 40)


def _splice(rng: Random, data: bytearray, other: bytes) -> None:
    at, start = rng.randint(0, len(data)), rng.randint(0, len(other))
    data[at:] = other[start:]


def _overwrite(rng: Random, data: bytearray, other: bytes) -> None:
    at = rng.randint(0, len(data))
    data[at : at + 8] = rng.randbytes(8)


def _edit_length(rng: Random, data: bytearray, other: bytes) -> None:
    starts = [at for magic in SECTION_MAGICS for at in _positions(data, magic)]
    if starts:
        at = rng.choice(starts) + 12
        data[at : at + 4] = _length(rng, int.from_bytes(data[at : at + 4], "big")).to_bytes(4, "big")


def _edit_header(rng: Random, data: bytearray, other: bytes) -> None:
    starts = [0, *(at for magic in SECTION_MAGICS for at in _positions(data, magic))]
    at = rng.choice(starts) + rng.randrange(SECTION_HEADER.size)
    if at < len(data):
        data[at] = rng.randrange(256)


_BYTES: tuple[Callable[[Random, bytearray, bytes], None], ...] = (
    _flip_bits, _truncate, _cut, _insert, _splice, _overwrite, _edit_length, _edit_header,
)  # fmt: skip


def _positions(data: bytearray, magic: bytes) -> list[int]:
    found, at = [], data.find(magic, FILE_HEADER.size)
    while at >= 0:
        found.append(at)
        at = data.find(magic, at + 1)
    return found


def _length(rng: Random, length: int) -> int:
    near = min(max(0, length + rng.choice((-96, -4, -1, 1, 4, 96))), (1 << 32) - 1)
    return rng.choice((near, rng.choice(NASTY_LENGTHS), rng.randrange(1 << 32)))


# -- sections and JSON, with the right SHA-1 so that they are believed -------------------------------------------------
def _edited_sections(rng: Random, shot: SmallShot) -> bytes:
    """A file whose sections are intact and whose content is not."""
    table, parts = shot_parts(shot)
    renamed = dict(parts)
    for name in rng.sample(sorted(parts), rng.randint(0, 2)):
        renamed[name] = _edited_content(rng, parts[name], is_json=name.endswith("etadataRef"))
    text = encoded(table).decode()
    for name, data in parts.items():
        text = text.replace(reference(data), reference(renamed[name]))
    toc = text.encode()
    if rng.random() < 0.3:
        toc = _edited_json(rng, toc)
    sections = [section(CONTENT_MAGIC, data, rng.choice((0, 3, 200))) for data in renamed.values()]
    for _ in range(rng.choice((1, 1, 1, 0, 2))):
        sections.append(section(TOC_MAGIC, toc))
    if rng.random() < 0.3:
        sections.pop(rng.randrange(len(sections)))
    if rng.random() < 0.3:
        sections += [rng.choice(sections)] * rng.randint(1, 5) if sections else []
    rng.shuffle(sections)
    return container(*sections)


def _edited_content(rng: Random, data: bytes, *, is_json: bool) -> bytes:
    if is_json and rng.random() < 0.9:
        return _edited_json(rng, data)
    changed = bytearray(data)
    rng.choice((_flip_bits, _truncate, _cut, _insert, _overwrite))(rng, changed, data)
    return bytes(changed)


def _edited_json(rng: Random, data: bytes) -> bytes:
    document: Json = json.loads(data)
    for _ in range(rng.randint(1, 3)):
        holder, key = rng.choice(list(_places(document)))
        if rng.random() < 0.2:
            del holder[key]
        else:
            holder[key] = copy.deepcopy(rng.choice(NASTY_VALUES))
        if not document:
            break
    text = json.dumps(document)
    if rng.random() < 0.05:
        depth = rng.choice((10, 63, 64, 65, 1500))
        text = '{"image":' + "[" * depth + "]" * depth + "," + text[1:]
    return text.encode("utf-8", "surrogatepass")


def _places(value: Any) -> list[tuple[Any, Any]]:
    """Every (object or list, key or index) of a document."""
    found: list[tuple[Any, Any]] = []
    stack = [value]
    while stack:
        item = stack.pop()
        keys = list(item) if isinstance(item, dict) else range(len(item))
        for key in keys:
            found.append((item, key))
            if isinstance(item[key], dict | list):
                stack.append(item[key])
    return found or [({"": None}, "")]


# -- calibrations --------------------------------------------------------------------------------------------------
def _edit_file(rng: Random, files: dict[str, bytes]) -> None:
    if not files:
        return
    name = rng.choice(sorted(files))
    if rng.random() < 0.2:
        del files[name]
    elif name.endswith((".TXT", ".json")) and rng.random() < 0.8:
        try:
            files[name] = _edited_json(rng, files[name])
        except (ValueError, RecursionError):  # an edit before left no JSON, or too deep a one
            files[name] = b"{"
    else:
        files[name] = _edited_content(rng, files[name], is_json=False)


def _odd_tar(rng: Random, files: Mapping[str, bytes]) -> bytes:
    """A tar with a member that does not belong there."""
    kinds = (
        tarfile.SYMTYPE,
        tarfile.LNKTYPE,
        tarfile.CHRTYPE,
        tarfile.FIFOTYPE,
        tarfile.DIRTYPE,
        tarfile.GNUTYPE_SPARSE,
    )
    names = (
        "../x",
        "/etc/x",
        "a/../../x",
        "C:\\x",
        "x" * 99,
        "._MOD_0000.RAW",
        "y" * 300,
        "MOD_0000.RAW",
        "\x1b[2J",
        "",
    )
    stream = io.BytesIO()
    form = rng.choice((tarfile.PAX_FORMAT, tarfile.GNU_FORMAT))
    with tarfile.open(fileobj=stream, mode="w", format=form) as archive:
        for name, data in files.items():
            entry = tarfile.TarInfo(name)
            entry.size = len(data)
            archive.addfile(entry, io.BytesIO(data))
            if rng.random() < 0.15:
                odd = tarfile.TarInfo(rng.choice(names))
                odd.type = rng.choice((*kinds, tarfile.REGTYPE))
                odd.linkname = "elsewhere"
                archive.addfile(odd)
    return stream.getvalue()


def _break_tar_header(rng: Random, data: bytearray) -> None:
    """Change a header's byte or size and make its checksum right again."""
    starts = [at for at in range(0, len(data) - 511, 512) if data[at + 257 : at + 262] == b"ustar"]
    if not starts:
        return
    at = rng.choice(starts)
    if rng.random() < 0.4:
        size = rng.choice(
            (b"77777777777\0", b"00000000001\0", b"\x80" + b"\xff" * 11, b"-0000000001\0", b"            ")
        )
        data[at + 124 : at + 136] = size
    else:
        data[at + rng.randrange(512)] = rng.randrange(256)
    data[at + 148 : at + 156] = b" " * 8
    data[at + 148 : at + 156] = f"{sum(data[at : at + 512]):06o}\0 ".encode()
