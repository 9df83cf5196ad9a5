"""Sensor values as Lytro cameras pack them (`lfrig.contracts.lytro.Packing`)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.lytro import Packing


def pack(values: NDArray[np.uint16], bits: int, packing: Packing) -> bytes:
    """Packed bytes of ``values`` uint16 [Hs, Ws].

    Raises
    ------
    ValueError
        No camera packs so, or the last group is not whole.
    """
    flat = values.reshape(-1)
    if (bits, packing) == (10, "little") and flat.size % 4 == 0:
        return _ten_little(flat.reshape(-1, 4))
    if (bits, packing) == (12, "big") and flat.size % 2 == 0:
        return _twelve_big(flat.reshape(-1, 2))
    raise ValueError(f"{flat.size} values of {bits} bits cannot be packed {packing}-endian")


def _ten_little(groups: NDArray[np.uint16]) -> bytes:
    out = np.empty((len(groups), 5), np.uint8)
    out[:, :4] = groups >> 2
    low = (groups & 3).astype(np.uint8)
    out[:, 4] = low[:, 0] | low[:, 1] << 2 | low[:, 2] << 4 | low[:, 3] << 6
    return out.tobytes()


def _twelve_big(pairs: NDArray[np.uint16]) -> bytes:
    out = np.empty((len(pairs), 3), np.uint8)
    out[:, 0] = pairs[:, 0] >> 4
    out[:, 1] = (pairs[:, 0] & 15) << 4 | pairs[:, 1] >> 8
    out[:, 2] = pairs[:, 1] & 255
    return out.tobytes()
