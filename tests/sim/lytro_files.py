"""Lytro files read by a few lines that know the format and nothing of the code."""

from __future__ import annotations

import hashlib
import json
import struct


def sections(data: bytes) -> list[tuple[bytes, bytes, str]]:
    """(kind, data, reference) of every section; checks all that is not data."""
    assert data[:16] == b"\x89LFP\r\n\x1a\n\0\0\0\x01\0\0\0\0"
    found, at = [], 16
    while at < len(data):
        assert data[at] == 0x89
        assert data[at + 4 : at + 12] == b"\r\n\x1a\n\0\0\0\0"
        (length,) = struct.unpack(">I", data[at + 12 : at + 16])
        name, rest = data[at + 16 : at + 61], data[at + 61 : at + 96]
        assert rest == bytes(35)
        content = data[at + 96 : at + 96 + length]
        assert len(content) == length
        assert name == b"sha1-" + hashlib.sha1(content).hexdigest().encode()
        found.append((data[at + 1 : at + 4], content, name.decode()))
        at += 96 + length
        end = at + -at % 16
        assert not any(data[at:end])
        at = end
    return found


def unpacked(data: bytes, bits: int) -> list[int]:
    """By the definition, group by group."""
    values: list[int] = []
    if bits == 10:
        for i in range(0, len(data), 5):
            *high, low = data[i : i + 5]
            values += [h << 2 | low >> 2 * k & 3 for k, h in enumerate(high)]
    else:
        for i in range(0, len(data), 3):
            a, b, c = data[i : i + 3]
            values += [a << 4 | b >> 4, (b & 15) << 8 | c]
    return values


def frame_of(found: list[tuple[bytes, bytes, str]]) -> tuple[dict[str, str], dict[str, bytes]]:
    """The frame's references, and contents by reference."""
    [toc] = [json.loads(content) for kind, content, _ in found if kind == b"LFM"]
    frames = toc["picture"]["frameArray"] if "picture" in toc else toc["frames"]
    return frames[0]["frame"], {name: content for kind, content, name in found if kind == b"LFC"}
