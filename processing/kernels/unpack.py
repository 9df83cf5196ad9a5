"""Packed sensor values to 16 bits. C++ form: ``unpack.cpp``.

``little10`` (Lytro Illum): 5 bytes hold 4 values, bytes 0..3 their upper 8 bits, bits 2i and 2i+1 of byte 4 the lower
2 of value i. ``big12`` (F01): 3 bytes hold 2 values, ``b0 << 4 | b1 >> 4`` and ``(b1 & 15) << 8 | b2``. The last group
is complete in the bytes even where fewer values are wanted.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.native import load_native
from lfrig.processing.model import U8

U16 = NDArray[np.uint16]


def unpack_little10(packed: U8, count: int) -> U16:
    """uint8 [5 · ceil(count / 4)] → uint16 [count]; raises `ValueError` for another number of bytes."""
    _check(packed, -(-count // 4) * 5, count)
    native = _native()
    if native is None:
        return unpack_little10_numpy(packed, count)
    out = np.empty(count, np.uint16)
    native.unpack_little10(packed, out)
    return out


def unpack_big12(packed: U8, count: int) -> U16:
    """uint8 [3 · ceil(count / 2)] → uint16 [count]; raises `ValueError` for another number of bytes."""
    _check(packed, -(-count // 2) * 3, count)
    native = _native()
    if native is None:
        return unpack_big12_numpy(packed, count)
    out = np.empty(count, np.uint16)
    native.unpack_big12(packed, out)
    return out


def unpack_little10_numpy(packed: U8, count: int) -> U16:
    """NumPy twin of `unpack_little10`."""
    groups = packed.reshape(-1, 5)
    out = np.empty((len(groups), 4), np.uint16)
    for i in range(4):
        np.left_shift(groups[:, i], 2, out=out[:, i], dtype=np.uint16)
        out[:, i] |= (groups[:, 4] >> (2 * i)) & 3
    return out.reshape(-1)[:count]


def unpack_big12_numpy(packed: U8, count: int) -> U16:
    """NumPy twin of `unpack_big12`."""
    groups = packed.reshape(-1, 3)
    out = np.empty((len(groups), 2), np.uint16)
    np.left_shift(groups[:, 0], 4, out=out[:, 0], dtype=np.uint16)
    out[:, 0] |= groups[:, 1] >> 4
    np.left_shift(groups[:, 1] & 15, 8, out=out[:, 1], dtype=np.uint16)
    out[:, 1] |= groups[:, 2]
    return out.reshape(-1)[:count]


def _check(packed: U8, expected: int, count: int) -> None:
    if packed.shape != (expected,):
        raise ValueError(f"{count} values need {expected} bytes, got {packed.shape}")


def _native() -> Any:
    return load_native("lfrig.processing.kernels._native")
