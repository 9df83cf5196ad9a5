"""Each native kernel against its NumPy twin, over odd sizes and hostile values."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest

from lfrig.processing.kernels import spline, warp
from tests.processing.kernels.twins import both

pytestmark = pytest.mark.skipif(
    find_spec("lfrig.processing.kernels._native") is None, reason="no native core here: only the twins exist"
)


@pytest.mark.parametrize("shape", [(1, 1), (7, 5), (33, 65), (20, 130)])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_warp(monkeypatch, shape, dtype) -> None:
    rng = np.random.default_rng(1)
    image = rng.integers(0, np.iinfo(dtype).max + 1, (*shape, 3)).astype(dtype)
    fields = rng.normal(0, 2, (4, *shape)).astype(np.float32)
    fields[0].flat[0] = np.nan
    fields[1].flat[-1] = 1e9
    offsets = np.array([[-3, 3], [0, 1], [0.5, -0.5], [2, 0]], np.float32)
    native, twin = both(monkeypatch, lambda: warp.warp_views(image, fields, offsets))
    assert native.dtype == dtype and native.shape == (4, *shape, 3)
    assert np.abs(native.astype(int) - twin.astype(int)).max() <= 1


def test_warp_by_zero_is_the_image() -> None:
    image = np.random.default_rng(0).integers(0, 256, (9, 11, 3)).astype(np.uint8)
    out = warp.warp_views(image, np.ones((1, 9, 11), np.float32), np.zeros((1, 2), np.float32))
    assert np.array_equal(out[0], image)


def test_warp_refuses_wrong_shapes() -> None:
    image = np.zeros((4, 4, 3), np.uint8)
    with pytest.raises(ValueError, match="shapes"):
        warp.warp_views(image, np.zeros((1, 4, 5), np.float32), np.zeros((1, 2), np.float32))


@pytest.mark.parametrize("shape", [(1, 1), (7, 5), (33, 65)])
@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_sample_spline(monkeypatch, shape, channels) -> None:
    rng = np.random.default_rng(4)
    picture = spline.spline(rng.uniform(0, 255, (*shape, channels)).astype(np.float32))
    x = rng.uniform(-30, shape[1] + 30, (3, 5000)).astype(np.float32)
    y = rng.uniform(-30, shape[0] + 30, (3, 5000)).astype(np.float32)
    x[0, 0], y[1, 0], x[2, 0], y[2, 0] = np.nan, np.inf, -np.inf, 1e30
    native, twin = both(monkeypatch, lambda: spline.sample_spline(picture, x, y))
    assert native.shape == (3, 5000, channels) and np.isfinite(twin).all()
    assert np.abs(native - twin).max() < 1e-3
    monkeypatch.setenv("LFRIG_NATIVE", "1")
    assert np.array_equal(spline.sample_spline(picture, x, y, threads=3), native)
