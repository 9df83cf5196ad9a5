"""Plane fits against their NumPy twin: odd sizes, one pixel, hostile values."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest

from lfrig.processing.kernels import plane_fit
from tests.processing.kernels.twins import both

pytestmark = pytest.mark.skipif(
    find_spec("lfrig.processing.kernels._native") is None, reason="no native core here: only the twins exist"
)


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("shape", [(1, 1), (5, 9), (13, 70), (9, 200)])
@pytest.mark.parametrize("extras", [False, True])
def test_plane_fit(monkeypatch: pytest.MonkeyPatch, shape: tuple[int, int], extras: bool, threads: int) -> None:
    rng = np.random.default_rng(2)
    values = (2 + 0.05 * rng.standard_normal(shape)).astype(np.float32)
    values.flat[-1] = 1e15
    weights = rng.uniform(0, 1, shape).astype(np.float32)
    guide = rng.integers(0, 60, (*shape, 3)).astype(np.uint8)
    at = rng.uniform(size=shape) < (0.4 if extras else 2.0)
    at.flat[0] = True
    slopes = tuple((0.01 * rng.standard_normal(shape)).astype(np.float32) for _ in range(2))

    def fit() -> tuple[np.ndarray, ...]:
        return plane_fit.local_planes(
            values, weights, guide, at, radius=4, stride=2 if extras else 1, sigma_value=0.05, sigma_grey=30.0,
            ridge=0.5, slopes=(slopes[0], slopes[1]) if extras else None,
            ceiling=np.full(shape, 2.02, np.float32) if extras else None, threads=threads,
        )  # fmt: skip

    native, twin = both(monkeypatch, fit)
    last = at.sum() - 1 if at.flat[-1] else at.sum()
    for found, expected in zip(native, twin, strict=True):
        assert found.shape == (at.sum(),)
        np.testing.assert_allclose(found[:last], expected[:last], rtol=1e-4, atol=2e-6)


def test_runs_cover_every_pixel_once_in_order() -> None:
    at = np.random.default_rng(3).uniform(size=(7, 300)) < 0.9
    runs = plane_fit._runs(at)
    pixels = np.concatenate([row * 300 + first + np.arange(length) for row, first, length in runs])
    assert np.array_equal(pixels, np.flatnonzero(at)) and runs[:, 2].max() <= plane_fit.RUN
    assert plane_fit._runs(np.zeros((2, 3), bool)).shape == (0, 3)
