"""The yardsticks: they must do the work that they are timed for."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest

from lfrig.processing.kernels import stream
from tests.processing.kernels.twins import both

pytestmark = pytest.mark.skipif(
    find_spec("lfrig.processing.kernels._native") is None, reason="no native core here: only the twins exist"
)


@pytest.mark.parametrize("count", [1, 1000, 1 << 16, 200_001])
@pytest.mark.parametrize("threads", [1, 3])
def test_triad(monkeypatch, count, threads) -> None:
    rng = np.random.default_rng(count)
    b, c = (rng.normal(size=count).astype(np.float32) for _ in range(2))

    def call():  # type: ignore[no-untyped-def]
        a = np.full(count, np.nan, np.float32)
        stream.triad(a, b, c, 1.5, threads=threads)
        return a

    native, twin = both(monkeypatch, call)
    assert np.array_equal(native, twin) and np.array_equal(native, b + np.float32(1.5) * c)


@pytest.mark.parametrize(("dtype", "factor", "term"), [(np.uint16, 40503, 12345), (np.float32, 0.75, 0.3)])
@pytest.mark.parametrize("rounds", [0, 1, 37])
def test_multiply_add(monkeypatch, dtype, factor, term, rounds) -> None:
    start = np.arange(2 * stream.CHAIN_BYTES // np.dtype(dtype).itemsize).astype(dtype).reshape(2, -1)

    def call():  # type: ignore[no-untyped-def]
        values = start.copy()
        stream.multiply_add(values, factor, term, rounds)
        return values

    native, twin = both(monkeypatch, call)
    assert np.array_equal(native, twin)
    assert rounds == 0 or not np.array_equal(native, start)


def test_rows_of_another_length_are_refused(monkeypatch) -> None:
    monkeypatch.setenv("LFRIG_NATIVE", "1")
    with pytest.raises(ValueError, match="rows"):
        stream.multiply_add(np.zeros((1, 64), np.float32), 1.0, 0.0, 1)


def test_the_vector_level_is_named(monkeypatch) -> None:
    native, twin = both(monkeypatch, stream.vector_level)
    assert native in {"AVX-512", "AVX2", "baseline"} and twin == "NumPy"
