"""The kernels of the scale fit and of the pictures' agreement against their NumPy twins."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest

from lfrig.processing.kernels import correlation, line_fit
from tests.processing.kernels.twins import both

pytestmark = pytest.mark.skipif(
    find_spec("lfrig.processing.kernels._native") is None, reason="no native core here: only the twins exist"
)
PRIOR = line_fit.LinePrior(1.5, 2.0, 1 / 0.01**2, 1 / 0.02**2)


def points(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Of a line, every fourth far from it."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(-0.6, 0.8, count)
    y = 1.43 * x + 2.17 + 0.01 * rng.standard_normal(count)
    y[3::4] = rng.uniform(0, 4, len(y[3::4]))
    return x, y


def fit(x: np.ndarray, y: np.ndarray, prior: line_fit.LinePrior | None = None) -> np.ndarray:
    return line_fit.biweight_line(
        x, y, (1.4, 2.2), share=0.3 if prior else 1.0, floor=1e-9, settled=1e-4, iterations=50, prior=prior
    )


@pytest.mark.parametrize("count", [1, 2, 3, 8, 301, 1400])
def test_the_least_median_of_residuals(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    x, y = points(count)
    rng = np.random.default_rng(count)
    for candidates in (1, 2, 200):
        slopes, offsets = 1.43 + 0.3 * rng.standard_normal(candidates), 2.17 + 0.1 * rng.standard_normal(candidates)
        native, twin = both(monkeypatch, lambda s=slopes, o=offsets: line_fit.least_median_line(x, y, s, o))
        assert native == twin


def test_the_first_of_equal_medians(monkeypatch: pytest.MonkeyPatch) -> None:
    x, y = points(40)
    assert both(monkeypatch, lambda: line_fit.least_median_line(x, y, np.full(5, 1.4), np.full(5, 2.2))) == (0, 0)


@pytest.mark.parametrize("prior", [None, PRIOR])
@pytest.mark.parametrize("count", [2, 3, 8, 301, 1400])
def test_the_biweight(monkeypatch: pytest.MonkeyPatch, count: int, prior: line_fit.LinePrior | None) -> None:
    native, twin = both(monkeypatch, lambda: fit(*points(count), prior))
    np.testing.assert_allclose(native, twin, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("prior", [None, PRIOR])
@pytest.mark.parametrize("value", [np.nan, np.inf, 1e200, -1e308])
def test_lines_survive_nonsense(
    monkeypatch: pytest.MonkeyPatch, value: float, prior: line_fit.LinePrior | None
) -> None:
    x, y = points(60)
    y[5] = value
    ladder = np.linspace(1, 2, 9), np.linspace(2, 2.3, 9)
    native, twin = both(monkeypatch, lambda: line_fit.least_median_line(x, y, *ladder))
    assert native == twin
    x[:], y[:] = value, value
    both(monkeypatch, lambda: fit(x, y, prior))
    both(monkeypatch, lambda: line_fit.least_median_line(x, y, *ladder))


def test_one_point_is_no_line(monkeypatch: pytest.MonkeyPatch) -> None:
    native, twin = both(monkeypatch, lambda: fit(np.array([0.3]), np.array([2.0])))
    np.testing.assert_array_equal(native[:2], [1.4, 2.2])
    np.testing.assert_allclose(native, twin)


@pytest.mark.parametrize("native", "01")
def test_no_points_are_refused(monkeypatch: pytest.MonkeyPatch, native: str) -> None:
    monkeypatch.setenv("LFRIG_NATIVE", native)
    none = np.zeros(0)
    with pytest.raises(ValueError, match="line_fit"):
        fit(none, none)
    with pytest.raises(ValueError, match="line_fit"):
        line_fit.least_median_line(none, none, np.ones(1), np.ones(1))


def picture(height: int, width: int, seed: int = 1) -> np.ndarray:
    import cv2

    noise = np.random.default_rng(seed).standard_normal((height, width)).astype(np.float32)
    return np.asarray(128 + 300 * cv2.GaussianBlur(noise, (0, 0), 2.0), np.float32)


def shifts(count: int) -> np.ndarray:
    """None at all, and three that differ a little from patch to patch."""
    table = np.repeat(np.float32([(0, 0), (12, 0), (-8.5, 8.5), (0, -12.25)])[:, None], count, 1)
    table[1:, :, 0] += 0.1 * np.arange(count, dtype=np.float32) % 1
    return table


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize(("count", "pixels", "shape"), [(1, 1, (5, 5)), (3, 25, (61, 83)), (200, 121, (47, 65))])
def test_correlations(
    monkeypatch: pytest.MonkeyPatch, count: int, pixels: int, shape: tuple[int, int], threads: int
) -> None:
    rng = np.random.default_rng(count)
    seen = picture(*shape)
    # Some places are beyond the border.
    u, v = (rng.uniform(-6, side + 6, (count, pixels)).astype(np.float32) for side in (shape[1], shape[0]))
    patches = rng.uniform(0, 255, (count, pixels)).astype(np.float32)
    patches[0] = 90
    native, twin = both(
        monkeypatch, lambda: correlation.shifted_correlations(patches, seen, u, v, shifts(count), threads=threads)
    )
    assert native.shape == (4, count) and (np.abs(native[:, 0]) < 1e-3).all(), "a plain patch is like nothing"
    np.testing.assert_allclose(native, twin, atol=1e-4)


def test_a_patch_is_like_itself() -> None:
    seen = picture(47, 65)
    v, u = (a.reshape(-1, 25).astype(np.float32) for a in np.mgrid[10:35, 20:40])
    found = correlation.shifted_correlations(seen[v.astype(int), u.astype(int)], seen, u, v, shifts(20))
    np.testing.assert_allclose(found[0], 1, atol=1e-5)
    assert found[1:].max() < 0.9


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1)])
def test_correlations_in_pictures_of_one_pixel_or_row(monkeypatch: pytest.MonkeyPatch, shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(2)
    patches, u, v = rng.uniform(0, 9, (3, 4, 25)).astype(np.float32)
    native, twin = both(
        monkeypatch, lambda: correlation.shifted_correlations(patches, picture(*shape), u, v, shifts(4))
    )
    np.testing.assert_allclose(native, twin, atol=1e-3)


def test_correlations_survive_nonsense(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    seen = picture(40, 50)
    seen[7, 9], seen[20, 30] = np.nan, 1e30
    patches, u, v = rng.uniform(0, 40, (3, 130, 121)).astype(np.float32)
    u[0], u[1], v[2], v[3] = np.nan, 1e12, -1e12, np.inf
    native, twin = both(monkeypatch, lambda: correlation.shifted_correlations(patches, seen, u, v, shifts(130)))
    monkeypatch.setenv("LFRIG_NATIVE", "1")
    four = correlation.shifted_correlations(patches, seen, u, v, shifts(130), threads=4)
    np.testing.assert_array_equal(native, correlation.shifted_correlations(patches, seen, u, v, shifts(130), threads=1))
    np.testing.assert_array_equal(native, four)
    clean = np.abs(twin) <= 1
    np.testing.assert_allclose(native[clean], twin[clean], atol=1e-3)
