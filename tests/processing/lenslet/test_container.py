"""Containers: sections wherever they are, whatever is torn or lies is refused by name, nothing is copied."""

from __future__ import annotations

import hashlib
import json
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfrig.bench.lytro_files import SmallShot, container, encoded, reference, section, shot_file, shot_parts
from lfrig.contracts.errors import BadInput
from lfrig.contracts.lytro import CONTENT_MAGIC, F01, FILE_MAGIC, ILLUM, SECTION_HEADER, TOC_MAGIC, CameraFigures
from lfrig.processing.lenslet.container import Container, ContainerLimits, parse_container, read_container
from lfrig.processing.lenslet.contents import frames, json_part, part, raw_frame

WHERE = Path("shot.lfr")


def parsed(data: bytes, **options: Any) -> Container:
    return parse_container(memoryview(data), WHERE, **options)


def refused(data: bytes, **options: Any) -> BadInput:
    with pytest.raises(BadInput) as caught:
        parsed(data, **options)
    assert caught.value.path == str(WHERE)
    assert caught.value.remedy
    assert "\n" not in caught.value.message
    return caught.value


def two_sections() -> bytes:
    return container(section(CONTENT_MAGIC, b"first", 3), section(CONTENT_MAGIC, b"second"))


@given(
    st.lists(
        st.tuples(st.sampled_from([TOC_MAGIC, CONTENT_MAGIC]), st.binary(max_size=40), st.integers(0, 200)), min_size=1
    )
)
def test_sections_in_any_order_count_and_padding(parts: list[tuple[bytes, bytes, int]]) -> None:
    found = parsed(container(*(section(magic, data, padding) for magic, data, padding in parts)))
    assert [bytes(found.data(item)) for item in found.sections] == [data for _, data, _ in parts]
    assert [item.kind for item in found.sections] == ["toc" if m == TOC_MAGIC else "content" for m, _, _ in parts]
    for _, data, _ in parts:
        named = found.find(reference(data).upper().replace("SHA1", "sha1"))
        assert named is not None
        assert bytes(found.data(named)) == data
    assert found.find("sha1-" + "0" * 40) is None
    assert found.find(None) is None


@pytest.mark.parametrize("figures", [ILLUM, F01])
def test_frames_of_both_layouts(figures: CameraFigures) -> None:
    shot = SmallShot(figures=figures, embedded_white=True, hot_pixels=[(1, 2)])
    found = parsed(shot_file(shot))
    _, parts = shot_parts(shot)
    frame = raw_frame(found)
    assert bytes(part(found, frame.image_ref, "imageRef")) == parts["imageRef"]
    assert bytes(part(found, frame.modulation_ref, "modulationDataRef")) == parts["modulationDataRef"]
    assert bytes(part(found, frame.hot_pixel_ref, "hotPixelRef")) == parts["hotPixelRef"]
    assert json_part(found, frame.private_metadata_ref, "privateMetadataRef")["camera"]["serialNumber"] == shot.serial
    assert frame.geometry_correction_ref == reference(shot.geometry or b"")


def test_a_large_file_is_mapped_not_copied(tmp_path: Path) -> None:
    payload = bytes(8 << 20)
    path = tmp_path / "large.lfr"
    path.write_bytes(container(section(CONTENT_MAGIC, payload, 100_000), section(TOC_MAGIC, b"{}")))
    tracemalloc.start()
    found = read_container(path)
    view = np.frombuffer(found.data(found.sections[0]), np.uint8)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert view.size == len(payload)
    assert not view.flags.owndata
    assert peak < 1 << 20


def test_a_wrong_sha1_is_named_when_the_section_is_asked_for() -> None:
    data = bytearray(two_sections())
    data[data.index(b"second")] ^= 1
    found = parsed(bytes(data))
    assert bytes(found.data(found.sections[0])) == b"first"
    with pytest.raises(BadInput, match="SHA-1") as caught:
        found.data(found.sections[1])
    assert (caught.value.code, caught.value.field) == ("wrong-sha1", reference(b"second"))
    with pytest.raises(BadInput, match="SHA-1"):
        found.check()
    torn = parsed(bytes(data), partial=True)
    assert bytes(torn.data(torn.sections[1])) == b"recond"
    torn.check()
    assert len(torn.problems) == 1
    assert "SHA-1" in torn.problems[0]


@pytest.mark.parametrize(
    ("data", "code", "words"),
    [
        (b"", "not-a-lytro-file", "empty"),
        (b"\xff\xd8\xff\xe0" + bytes(900), "not-a-lytro-file", "JPEG"),
        (b"\x89PNG\r\n\x1a\n" + bytes(900), "not-a-lytro-file", "PNG"),
        (b"hello" * 99, "not-a-lytro-file", "no Lytro file"),
        (FILE_MAGIC[:5], "truncated", "header"),
        (FILE_MAGIC + bytes(3), "truncated", "header"),
        (container(), "no-sections", "no sections"),
        (container(bytes(5000)), "no-sections", "no sections"),
        (two_sections()[:-1], "truncated", "ends 1 bytes before the end of a section at byte"),
        (two_sections()[:-90], "truncated", "header"),
        (two_sections() + b"\x89LF", "truncated", "header of a section"),
        (two_sections() + b"tail" * 99, "garbage", "garbage"),
        (container(section(CONTENT_MAGIC, b"x", length=1 << 31)), "too-large", "2147483648"),
        (container(section(CONTENT_MAGIC, b"x", length=9999)), "truncated", "9998 bytes"),
        (container(section(CONTENT_MAGIC, b"x" * 300, length=4)), "garbage", "garbage"),
        (container(section(CONTENT_MAGIC, b"x", name="sha1-" + "z" * 40)), "bad-reference", "SHA-1"),
        (container(section(b"\x89LFX\r\n\x1a\n", b"x")), "garbage", "garbage"),
    ],
)  # fmt: skip
def test_what_is_refused(data: bytes, code: str, words: str) -> None:
    error = refused(data)
    assert error.code == code
    assert words in error.message


def test_a_partial_read_takes_what_is_whole() -> None:
    first, second = section(CONTENT_MAGIC, b"first"), section(CONTENT_MAGIC, b"second")
    found = parsed(container(first, b"garbage", second), partial=True)
    assert [bytes(found.data(item)) for item in found.sections] == [b"first", b"second"]
    assert len(found.problems) == 1
    torn = parsed(container(first, second)[:-2], partial=True)
    assert [item.whole for item in torn.sections] == [True, False]
    assert bytes(torn.data(torn.sections[1])) == b"seco"
    assert len(torn.problems) == 1
    assert refused(b"\xff\xd8\xff" + bytes(99), partial=True).code == "not-a-lytro-file"


def test_a_partial_read_gives_up_on_endless_garbage() -> None:
    found = parsed(container(section(CONTENT_MAGIC, b"first"), b"\x89LF?" * 50_000), partial=True)
    assert len(found.sections) == 1
    assert len(found.problems) < 100


def test_counts_sizes_and_nesting_are_capped(tmp_path: Path) -> None:
    many = container(*[section(CONTENT_MAGIC, b"x")] * 6)
    assert refused(many, limits=ContainerLimits(sections=5)).code == "too-many-sections"
    assert len(parsed(many, limits=ContainerLimits(sections=5), partial=True).sections) == 5
    path = tmp_path / "big.lfr"
    path.write_bytes(two_sections())
    with pytest.raises(BadInput, match="more than 10") as caught:
        read_container(path, limits=ContainerLimits(file_bytes=10))
    assert caught.value.code == "too-large"
    limits = ContainerLimits(json_bytes=1000, json_depth=8)
    texts = {
        b"[" * 400 + b"]" * 400: "not-json", b'{"a":' * 9 + b"1" + b"}" * 9: "json-too-deep",
        b"{" + b" " * 2000: "too-large", b"{": "not-json", b"\xff{}": "not-json",
        b'{"a":' + b"9" * 900 + b"}": None, b'{"a":' * 8 + b"1" + b"}" * 8: None,
    }  # fmt: skip
    for text, code in texts.items():
        found = parsed(container(section(TOC_MAGIC, text)), limits=limits)
        if code is None:
            assert isinstance(found.json(found.sections[0]), dict)
            continue
        with pytest.raises(BadInput) as caught:
            found.json(found.sections[0])
        assert caught.value.code == code
        assert caught.value.field == reference(text)
    deep = b'{"a":' + b"[" * 500_000 + b"]" * 500_000 + b"}"
    found = parsed(container(section(TOC_MAGIC, deep)))
    with pytest.raises(BadInput, match="nested deeper"):
        found.json(found.sections[0])


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"gone\.lfr") as caught:
        read_container(tmp_path / "gone.lfr")
    assert caught.value.code == "missing-file"
    with pytest.raises(BadInput, match="cannot be read"):
        read_container(tmp_path)


def test_tables_of_contents_that_lead_nowhere() -> None:
    table, parts = shot_parts(SmallShot())
    content = [section(CONTENT_MAGIC, data) for data in parts.values()]
    cases: list[tuple[bytes, str]] = [
        (container(*content), "no-table-of-contents"),
        (container(*content, section(TOC_MAGIC, b"{}")), "no-raw-frame"),
        (container(*content, section(TOC_MAGIC, b'{"frames": [1, {"frame": []}], "picture": 3}')), "no-raw-frame"),
        (container(*content, section(TOC_MAGIC, b'{"frames": [{"frame": {"imageRef": 5}}]}')), "no-raw-frame"),
    ]
    for data, code in cases:
        with pytest.raises(BadInput) as caught:
            raw_frame(parsed(data))
        assert caught.value.code == code
    found = parsed(container(section(TOC_MAGIC, encoded(table))))
    with pytest.raises(BadInput, match="imageRef") as caught:
        part(found, raw_frame(found).image_ref, "imageRef")
    assert caught.value.code == "missing-section"


def test_the_first_table_with_a_raw_frame_counts() -> None:
    table, parts = shot_parts(SmallShot())
    content = [section(CONTENT_MAGIC, data) for data in parts.values()]
    found = parsed(container(section(TOC_MAGIC, b'{"views": []}'), *content, section(TOC_MAGIC, encoded(table))))
    assert raw_frame(found).image_ref == reference(parts["imageRef"])


def test_frames_may_hold_their_metadata_themselves() -> None:
    frame = {"metadata": {"a": 1}, "privateMetadata": {"b": 2}}
    table = json.loads(json.dumps({"master": {"picture": {"frameArray": [{"frame": frame}]}}}))
    [found] = frames(table)
    assert (found.metadata, found.private_metadata, found.image_ref) == ({"a": 1}, {"b": 2}, None)


def test_the_section_header_is_96_bytes_as_the_cameras_write_it() -> None:
    data = section(CONTENT_MAGIC, b"abc")
    assert len(data) == 96 + 3
    assert SECTION_HEADER.size == 96
    assert data[:12] == b"\x89LFC\r\n\x1a\n\0\0\0\0"
    assert data[12:16] == (3).to_bytes(4, "big")
    assert data[16:61] == b"sha1-" + hashlib.sha1(b"abc").hexdigest().encode()
    assert data[61:96] == bytes(35)
