"""The kernels that compare photo and sources against their NumPy twins: odd sizes, one plane, hostile values."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest

from lfrig.processing.kernels import band_cost, sgm
from tests.processing.kernels.twins import both

pytestmark = pytest.mark.skipif(
    find_spec("lfrig.processing.kernels._native") is None, reason="no native core here: only the twins exist"
)

MATRIX = np.array([[1.0, 0.02, 0.3], [-0.01, 1.0, -0.4], [1e-4, -2e-4, 1.0]])
OFFSET = np.array([3.0, 0.4, 0.05])


def pictures(shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(photo's colours, its grey levels, a source's grey levels); the source has a size of its own."""
    rng = np.random.default_rng(4)
    guide = rng.integers(0, 256, (*shape, 3)).astype(np.uint8)
    source = rng.uniform(0, 255, (shape[0] + 3, shape[1] + 2)).astype(np.float32)
    return guide, guide.mean(2).astype(np.float32), source


@pytest.mark.parametrize("shape", [(1, 1), (5, 9), (13, 33)])
@pytest.mark.parametrize("labels", [1, 7])
@pytest.mark.parametrize("stride", [1, 2])
def test_band_cost(monkeypatch, shape, labels, stride) -> None:
    guide, grey, source = pictures(shape)
    rng = np.random.default_rng(5)
    surface = tuple(rng.normal(m, s, shape).astype(np.float32) for m, s in ((1.0, 0.05), (0, 0.01), (0, 0.01)))
    visible = np.ones(shape, np.float32)
    visible.flat[0] = 0.0
    patch = band_cost.Patch(radius=2, stride=stride)

    def call():  # type: ignore[no-untyped-def]
        return band_cost.band_cost(grey, guide, source, visible, surface, (MATRIX, OFFSET), 0.1, labels, patch)

    native, twin = both(monkeypatch, call)
    assert native.shape == (*shape, labels)
    np.testing.assert_allclose(native, twin, atol=2e-3)
    assert (native.reshape(-1, labels)[0] == patch.cap).all(), "nobody sees the first pixel"


def test_band_cost_of_nonsense_is_the_cap() -> None:
    guide, grey, source = pictures((6, 8))
    bad = np.full((6, 8), np.nan, np.float32)
    bad[3:] = 1e30
    zero = np.zeros_like(bad)
    cost = band_cost.band_cost(
        grey, guide, source, np.ones_like(bad), (bad, zero, zero), (MATRIX, OFFSET), 0.1, 5, band_cost.Patch()
    )
    assert (cost == 1).all()


def test_the_right_label_costs_least() -> None:
    shape = (24, 40)
    rng = np.random.default_rng(6)
    source = rng.uniform(0, 255, (24, 60)).astype(np.float32)
    photo = np.ascontiguousarray(source[:, 7:47])  # the point at x stands at x + 7 in the source
    guide = np.repeat(photo[..., None], 3, 2).astype(np.uint8)
    w, zero = np.full(shape, 5.0, np.float32), np.zeros(shape, np.float32)
    sideways = (np.eye(3), np.array([1.0, 0.0, 0.0]))
    cost = band_cost.band_cost(
        photo, guide, source, np.ones(shape, np.float32), (w, zero, zero), sideways, 1.0, 9,
        band_cost.Patch(sigma_grey=1e3),
    )  # fmt: skip
    inner = cost[6:-6, 6:-6]
    assert (inner.argmin(2) == 9 // 2 + 2).all() and inner.min(2).max() < 0.05


@pytest.mark.parametrize("shape", [(1, 1), (2, 9), (11, 14)])
@pytest.mark.parametrize("planes", [1, 6])
def test_shifted_sgm(monkeypatch, shape, planes) -> None:
    rng = np.random.default_rng(8)
    cost = rng.uniform(0, 3, (*shape, planes)).astype(np.float32)
    guide = rng.integers(0, 256, (*shape, 3)).astype(np.uint8)
    shift = rng.integers(-3, 4, (4, *shape)).astype(np.int16)
    shift.flat[0] = 9999
    native, twin = both(monkeypatch, lambda: sgm.aggregate(cost, guide, 0.3, 2.0, 30.0, shift=shift))
    np.testing.assert_allclose(native, twin, atol=1e-4)
    same, plain = (sgm.aggregate(cost, guide, 0.3, 2.0, 30.0, shift=s) for s in (np.zeros_like(shift), None))
    np.testing.assert_allclose(same, plain, atol=1e-5)


def test_shifts_make_a_ramp_as_cheap_as_a_plane() -> None:
    height, width, planes = 12, 20, 9
    guide = np.zeros((height, width, 3), np.uint8)
    label = np.arange(width) % 3 + 3  # a staircase of labels that the shifts declare to be one plane
    cost = np.full((height, width, planes), 1.0, np.float32)
    cost[:, np.arange(width), label] = 0.0
    cost[6, 10] = 1.0  # nothing known here
    shift = np.zeros((4, height, width), np.int16)
    step = np.diff(label, append=label[-1:])
    shift[0], shift[2] = step, step
    shift[3, :, 1:] = -np.diff(label)
    found = sgm.aggregate(cost, guide, 0.5, 2.0, 30.0, shift=shift).argmin(2)
    assert (found == label).all()
