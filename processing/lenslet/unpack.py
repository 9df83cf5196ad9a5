"""Packed payload → sensor values, with the number of bytes checked against what the metadata promise."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.errors import BadInput
from lfrig.contracts.lytro import PACKED_GROUPS, packed_size
from lfrig.processing.kernels.unpack import unpack_big12, unpack_little10
from lfrig.processing.lenslet.metadata import RawMetadata
from lfrig.processing.model import U8

U16 = NDArray[np.uint16]


def unpack(payload: memoryview | bytes, metadata: RawMetadata, path: Path | str, field: str) -> U16:
    """Sensor values, uint16 [Hs, Ws] as recorded (black level not subtracted).

    Raises
    ------
    BadInput
        Code ``wrong-size``: not the number of bytes that size and bit depth need; names ``path`` and ``field``.
    """
    check_size(len(payload), metadata, path, field)
    count = metadata.width * metadata.height
    values = _values(np.frombuffer(payload, np.uint8), count, metadata)
    return values.reshape(metadata.height, metadata.width)


def check_size(size: int, metadata: RawMetadata, path: Path | str, field: str) -> None:
    """Raise as `unpack` where a payload of ``size`` bytes is not the metadata's."""
    count = metadata.width * metadata.height
    expected = packed_size(count, metadata.bits, metadata.packing)
    if size != expected:
        raise BadInput(
            f"has {size} bytes{_other_depth(size, count)}, but {metadata.width}×{metadata.height} px "
            f"of {metadata.bits} bits are {expected}",
            path=path, field=field, code="wrong-size", remedy="copy the file from the camera again",
        )  # fmt: skip


def held_values(size: int, metadata: RawMetadata) -> int:
    """How many sensor values ``size`` bytes hold, at most the sensor's."""
    pixels, group = PACKED_GROUPS[metadata.bits, metadata.packing]
    return min(size // group * pixels, metadata.width * metadata.height)


def unpack_partial(payload: memoryview | bytes, metadata: RawMetadata) -> U16:
    """As `unpack` of a payload of any length; values that it does not hold (see `held_values`) are 0."""
    count, held = metadata.width * metadata.height, held_values(len(payload), metadata)
    packed = np.zeros(packed_size(count, metadata.bits, metadata.packing), np.uint8)
    there = packed_size(held, metadata.bits, metadata.packing)
    packed[:there] = np.frombuffer(payload, np.uint8, there)
    return _values(packed, count, metadata).reshape(metadata.height, metadata.width)


def _values(packed: U8, count: int, metadata: RawMetadata) -> U16:
    if metadata.bits == 10:
        return unpack_little10(packed, count)
    if metadata.bits == 12:
        return unpack_big12(packed, count)
    if metadata.bits == 8:
        return packed.astype(np.uint16)
    order = ">u2" if metadata.packing == "big" else "<u2"
    return packed.view(order).astype(np.uint16)


def _other_depth(size: int, count: int) -> str:
    """What would explain ``size`` bytes."""
    depths = sorted({bits for bits, packing in PACKED_GROUPS if packed_size(count, bits, packing) == size})
    return f" (as {depths[0]} bits would be)" if depths else ""
