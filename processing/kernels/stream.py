"""What the machine can do at most, to hold kernels against: memory bandwidth, arithmetic, width of its vectors.

The triad is that of STREAM (McCalpin, IEEE TCCA Newsletter 1995), ``a = b + s·c``; arithmetic is ``x = x·f + t`` on
chains that stay in registers, enough of them to hide latencies, on 16-bit integers and on float32 (multiplied, then
added: the kernels are built without contraction). C++ form: ``stream.cpp``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.native import load_native
from lfrig.processing.model import F32

CHAIN_BYTES = 12 * 64
"""What the chains of one thread hold."""
_NATIVE = "lfrig.processing.kernels._native"


def vector_level() -> str:
    """Which versions of the kernels run here: ``AVX-512``, ``AVX2``, ``baseline`` (SSE2, NEON) or ``NumPy``.

    The processor decides when the module is loaded; no variable switches it.
    """
    native = load_native(_NATIVE)
    return "NumPy" if native is None else str(native.vector_level())


def triad(a: F32, b: F32, c: F32, scalar: float, *, threads: int = 0) -> None:
    """``a[:] = b + scalar·c``, float32 [N] each: 12 bytes per element have to move."""
    native = load_native(_NATIVE)
    if native is not None:
        native.stream_triad(a, b, c, scalar, threads)
        return
    np.multiply(c, np.float32(scalar), out=a)
    a += b


def multiply_add(values: NDArray[np.uint16] | F32, factor: float, term: float, rounds: int) -> None:
    """``rounds`` times ``values = values·factor + term`` in place, one thread per row; integers wrap around.

    Parameters
    ----------
    values : uint16 [threads, 384] or float32 [threads, 192]
        `CHAIN_BYTES` per row.
    """
    native = load_native(_NATIVE)
    kind = values.dtype.type
    if native is None:
        for _ in range(rounds):
            values *= kind(factor)
            values += kind(term)
    elif values.dtype == np.uint16:
        native.multiply_add16(values, int(factor), int(term), rounds)
    else:
        native.multiply_add32(values, factor, term, rounds)
