"""Packed sensor values: both kernels against arithmetic done one value at a time, odd sizes, wrong sizes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfrig.bench.lytro_files import SmallShot, metadata, pack
from lfrig.contracts.errors import BadInput
from lfrig.contracts.lytro import F01, ILLUM, CameraFigures, packed_size
from lfrig.contracts.native import load_native
from lfrig.processing.kernels.unpack import (
    unpack_big12,
    unpack_big12_numpy,
    unpack_little10,
    unpack_little10_numpy,
)
from lfrig.processing.lenslet.metadata import RawMetadata, parse_metadata
from lfrig.processing.lenslet.unpack import check_size, held_values, unpack, unpack_partial


def little10(packed: bytes, count: int) -> list[int]:
    """Value i as the format's table has it."""
    return [packed[i // 4 * 5 + i % 4] << 2 | packed[i // 4 * 5 + 4] >> 2 * (i % 4) & 3 for i in range(count)]


def big12(packed: bytes, count: int) -> list[int]:
    values = []
    for i in range(count):
        b0, b1, b2 = packed[i // 2 * 3 : i // 2 * 3 + 3]
        values.append((b1 & 15) << 8 | b2 if i % 2 else b0 << 4 | b1 >> 4)
    return values


@pytest.mark.parametrize("native", ["0", "1"])
@given(data=st.data())
def test_kernels_do_what_the_format_says(native: str, data: st.DataObject) -> None:
    count = data.draw(st.integers(1, 41))
    kernels: list[tuple[Any, Any, int]] = [
        (unpack_little10 if native == "1" else unpack_little10_numpy, little10, packed_size(count, 10, "little")),
        (unpack_big12 if native == "1" else unpack_big12_numpy, big12, packed_size(count, 12, "big")),
    ]
    for kernel, expected, size in kernels:
        packed = data.draw(st.binary(min_size=size, max_size=size))
        found = kernel(np.frombuffer(packed, np.uint8), count)
        assert found.dtype == np.uint16
        assert found.tolist() == expected(packed, count)


def test_native_and_numpy_agree() -> None:
    if load_native("lfrig.processing.kernels._native") is None:
        assert unpack_little10(np.arange(5, dtype=np.uint8), 4).tolist() == little10(bytes(range(5)), 4)
        return  # only the twin is there, and that is what runs
    packed = np.random.default_rng(1).integers(0, 256, 15_000, dtype=np.uint8)
    for count in (12_000, 11_999, 11_998, 11_997):
        np.testing.assert_array_equal(unpack_little10(packed, count), unpack_little10_numpy(packed, count))
    for count in (10_000, 9_999):
        np.testing.assert_array_equal(unpack_big12(packed, count), unpack_big12_numpy(packed, count))


def test_kernels_refuse_another_number_of_bytes() -> None:
    for kernel in (unpack_little10, unpack_big12):
        with pytest.raises(ValueError, match="bytes"):
            kernel(np.zeros(14, np.uint8), 8)


def described(figures: CameraFigures, width: int, height: int) -> RawMetadata:
    return parse_metadata(metadata(SmallShot(figures=figures, width=width, height=height)), {}, "x")


@pytest.mark.parametrize("figures", [ILLUM, F01])
@pytest.mark.parametrize(("width", "height"), [(20, 18), (17, 19), (19, 17), (21, 21)])
def test_round_trip_at_odd_sizes(figures: CameraFigures, width: int, height: int) -> None:
    shot = SmallShot(figures=figures, width=width, height=height)
    values = shot.values()
    found = unpack(pack(values, figures), described(figures, width, height), "x", "imageRef")
    np.testing.assert_array_equal(found, values)
    assert found.dtype == np.uint16


def test_plain_bytes_of_8_and_16_bits() -> None:
    known = described(ILLUM, 17, 19)
    values = np.arange(17 * 19).reshape(19, 17)
    eight = replace(known, bits=8, packing="big")
    np.testing.assert_array_equal(unpack((values % 251).astype(np.uint8).tobytes(), eight, "x", "f"), values % 251)
    for packing, order in (("big", ">u2"), ("little", "<u2")):
        sixteen = replace(known, bits=16, packing=packing)
        np.testing.assert_array_equal(unpack((values * 7).astype(order).tobytes(), sixteen, "x", "f"), values * 7)


@pytest.mark.parametrize(
    ("size", "hint"),
    [(20 * 18 * 3 // 2, " (as 12 bits would be)"), (20 * 18 * 2, " (as 16 bits would be)"), (449, ""), (0, "")],
)
def test_a_wrong_number_of_bytes_is_named(size: int, hint: str) -> None:
    known = described(ILLUM, 20, 18)
    for refuse in (
        lambda: unpack(bytes(size), known, "a.lfr", "imageRef"),
        lambda: check_size(size, known, "a.lfr", "imageRef"),
    ):
        with pytest.raises(BadInput) as caught:
            refuse()
        assert caught.value.message == f"a.lfr: imageRef: has {size} bytes{hint}, but 20×18 px of 10 bits are 450"
        assert caught.value.code == "wrong-size"


def test_a_torn_payload_gives_the_values_it_holds() -> None:
    shot = SmallShot()
    payload, known = pack(shot.values(), ILLUM), described(ILLUM, 20, 18)
    held = held_values(203, known)
    assert held == 160
    found = unpack_partial(payload[:203], known)
    np.testing.assert_array_equal(found[:8], shot.values()[:8])
    assert not found[8:].any()
    np.testing.assert_array_equal(unpack_partial(payload + bytes(99), known), shot.values())
