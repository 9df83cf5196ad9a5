"""The curve kernel against its NumPy twin."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest

from lfrig.processing.kernels.curve import curve
from tests.processing.kernels.twins import both

pytestmark = pytest.mark.skipif(
    find_spec("lfrig.processing.kernels._native") is None, reason="no native core here: only the twins exist"
)


@pytest.mark.parametrize("shape", [(0,), (1,), (63,), (3, 70), (2, 5000)])
@pytest.mark.parametrize("points", [2, 24, 257])
def test_curve(monkeypatch: pytest.MonkeyPatch, shape: tuple[int, ...], points: int) -> None:
    rng = np.random.default_rng(12)
    x = np.cumsum(rng.uniform(0.01, 0.2, points))
    y = np.cumsum(rng.normal(0, 0.1, points))
    values = rng.uniform(x[0] - 2, x[-1] + 2, shape).astype(np.float32)
    if values.size > 60:
        values.flat[:5] = [np.nan, np.inf, -np.inf, 1e30, np.float32(x[1])]
    native, twin = both(monkeypatch, lambda: curve(values, x, y, threads=2))
    assert native.shape == shape and native.dtype == twin.dtype == np.float32
    np.testing.assert_allclose(native, twin, rtol=1e-4, atol=2e-4)
    monkeypatch.setenv("LFRIG_NATIVE", "1")
    for threads in (1, 3):
        np.testing.assert_array_equal(curve(values, x, y, threads=threads), native)


def test_it_goes_straight_on_beyond_its_ends() -> None:
    x, y = np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 3.0])
    found = curve(np.array([-2.0, 0.5, 1.5, 4.0], np.float32), x, y)
    np.testing.assert_allclose(found, [-2.0, 0.5, 2.0, 7.0], rtol=1e-6)


@pytest.mark.parametrize("native", "01")
def test_a_curve_goes_from_left_to_right(monkeypatch: pytest.MonkeyPatch, native: str) -> None:
    monkeypatch.setenv("LFRIG_NATIVE", native)
    for x in ([0.0], [0.0, 0.0], [1.0, 0.0], [0.0, 1.0, np.nan]):
        with pytest.raises(ValueError, match="left to right"):
            curve(np.zeros(3, np.float32), np.array(x), np.array(x))
