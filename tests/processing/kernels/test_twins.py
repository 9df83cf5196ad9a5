"""Each native kernel against its NumPy twin, over odd sizes and hostile values."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest

from lfrig.processing.kernels import fusion, sgm, spline, warp
from lfrig.processing.model import Evidence, ScaleFit
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


@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 9, 4), (9, 1, 4), (13, 17, 6), (6, 40, 33)])
def test_sgm(monkeypatch, shape) -> None:
    rng = np.random.default_rng(5)
    cost = rng.uniform(0, 20, shape).astype(np.float32)
    guide = rng.integers(0, 256, (*shape[:2], 3)).astype(np.uint8)
    native, twin = both(monkeypatch, lambda: sgm.aggregate(cost, guide, 1.0, 8.0, 20.0))
    np.testing.assert_allclose(native, twin, rtol=2e-5, atol=2e-4)


def test_sgm_does_not_depend_on_threads() -> None:
    rng = np.random.default_rng(6)
    cost = rng.uniform(0, 20, (25, 31, 9)).astype(np.float32)
    guide = rng.integers(0, 256, (25, 31, 3)).astype(np.uint8)
    one, four = (sgm.aggregate(cost, guide, 1.0, 8.0, 20.0, threads=n) for n in (1, 4))
    assert one.tobytes() == four.tobytes()


def test_sgm_smooths_a_lone_outlier_but_keeps_a_step() -> None:
    cost = np.full((15, 20, 8), 5.0, np.float32)
    cost[:, :10, 2] = cost[:, 10:, 6] = 0
    cost[7, 4] = 5.0
    cost[7, 4, 7] = 4.0
    guide = np.zeros((15, 20, 3), np.uint8)
    guide[:, 10:] = 200
    best = sgm.aggregate(cost, guide, 0.5, 6.0, 10.0).argmin(2)
    assert best[7, 4] == 2
    assert (best[:, :10] == 2).all() and (best[:, 10:] == 6).all()


def random_evidence(rng: np.random.Generator, height: int, width: int, planes: int) -> Evidence:
    p = rng.dirichlet(np.ones(planes), (height, width))
    probability = (p * 65535).astype(np.uint16)
    disparity = (-0.5 + 1.0 / (planes - 1) * p.argmax(2)).astype(np.float32)
    return Evidence(probability, (-0.5, 1.0 / (planes - 1)), disparity, p.max(2).astype(np.float32))


@pytest.mark.parametrize("log_pool", [True, False])
@pytest.mark.parametrize("literal", [True, False])
def test_fusion(monkeypatch, log_pool, literal) -> None:
    rng = np.random.default_rng(7)
    evidence = random_evidence(rng, 19, 23, 11)
    angle = 0.1
    matrix = np.array([[1, 0.02, -3], [0.01, 1.1, 1], [angle / 200, 0, 0.95]])
    offset = np.array([2.0, -1.0, 0.03])
    pool = fusion.Pool(log_pool=log_pool, literal=literal)

    def call():  # type: ignore[no-untyped-def]
        volume, mass = np.zeros((15, 27, 9), np.float32), np.zeros((15, 27, 9), np.float32)
        fit = ScaleFit(1.4, 2.0)
        inside = fusion.add_evidence(volume, mass, evidence, fit, matrix, offset, (1.4, 0.15), pool)
        return np.concatenate([volume, mass, np.full((15, 27, 1), inside, np.float32)], 2)

    native, twin = both(monkeypatch, call)
    assert native[0, 0, -1] > 1000, "the test geometry must overlap"
    # float32 rounding may put a voxel on the other side of the frame's edge or of a nearest-pixel tie
    different = np.abs(native - twin) > 1e-3
    different[..., -1] = False
    assert different.mean() < 2e-3


def test_first_surface(monkeypatch) -> None:
    rng = np.random.default_rng(8)
    start = rng.normal(-9, 3, (6, 7, 40)).astype(np.float32)

    def call():  # type: ignore[no-untyped-def]
        volume = start.copy()
        fusion.first_surface(volume, -9.0, 6, 2.0, 4.0, 10.0)
        return volume

    native, twin = both(monkeypatch, call)
    np.testing.assert_allclose(native, twin, atol=1e-5)
    assert (native <= start).all() and (native < start).any()
    assert np.array_equal(native[..., -6:], start[..., -6:]), "the nearest planes have nothing in front"
