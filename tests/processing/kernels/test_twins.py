"""Each native kernel against its NumPy twin, over odd sizes and hostile values."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest

from lfrig.processing.kernels import plane_cost, sgm, spline, warp
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


@pytest.mark.parametrize("shape", [(3, 3), (12, 65), (17, 130)])
@pytest.mark.parametrize("planes", [1, 7])
def test_plane_cost(monkeypatch, shape, planes) -> None:
    rng = np.random.default_rng(2)
    views = rng.integers(0, 256, (3, 3, *shape, 3)).astype(np.uint8)
    grey = plane_cost.grey_views(views)
    keep = np.arange(9) != 4
    offsets = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1], indexing="ij"), -1).reshape(9, 2).astype(float)[keep]

    def call():  # type: ignore[no-untyped-def]
        return plane_cost.plane_cost(grey[keep], grey[4], offsets, -1.3, 0.37, planes, 23.0)

    native, twin = both(monkeypatch, call)
    assert native.shape == (*shape, planes)
    assert np.abs(native - twin).max() < 1 / 16


def test_plane_cost_where_it_is_wanted(monkeypatch) -> None:
    monkeypatch.setenv("LFRIG_NATIVE", "1")  # only the native form skips; the twin computes everything
    rng = np.random.default_rng(3)
    grey = rng.integers(0, 16000, (4, 30, 150)).astype(np.int16)
    offsets = np.array([[0, -1], [0, 1], [-1, 0], [1, 0]], float)
    active = np.zeros((30, 150), bool)
    active[3:9, 60:70] = True
    whole = plane_cost.plane_cost(grey, grey[0], offsets, -0.5, 0.25, 5, 20.0)
    part = plane_cost.plane_cost(grey, grey[0], offsets, -0.5, 0.25, 5, 20.0, active=active)
    assert np.array_equal(part[active], whole[active])
    assert (part[20:] == 0).all(), "the skipped blocks were computed"


def test_plane_cost_finds_a_shift() -> None:
    """Views shifted by a known disparity cost nothing at that plane."""
    rng = np.random.default_rng(4)
    base = rng.integers(0, 256, (20, 30)).astype(np.int16) * 64
    left, right = np.roll(base, -2, 1), np.roll(base, 2, 1)  # (x − dc·δ): δ = 2 at dc = 1 lies 2 px to the left
    offsets = np.array([[0, 1], [0, -1]], float)
    cost = plane_cost.plane_cost(np.stack([left, right]), base, offsets, 0.0, 1.0, 5, 50.0)
    assert (cost[4:-4, 6:-6].argmin(2) == 2).all()


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
