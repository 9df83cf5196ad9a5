"""Matching in a narrow band: the kernel against its twin, and both against patches that are carried one by one."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest

from lfrig.processing.kernels.band_cost import REACH, UNIT, Patch, View, band_cost
from tests.processing.kernels.twins import both

native_only = pytest.mark.skipif(
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


def two_views(shape: tuple[int, int], source: np.ndarray) -> list[View]:
    """Of two sources with different geometry, noise and visibility; none sees the first pixel."""
    rng = np.random.default_rng(5)
    weight = rng.choice([0.0, 0.005, 0.4, 1.0], (2, *shape)).astype(np.float32)
    weight[:, 0, 0] = 0
    other = (MATRIX.T.copy(), np.array([-2.0, 1.0, 0.01]))
    return [View(source, weight[0], (MATRIX, OFFSET)), View(source[:, ::-1].copy(), weight[1], other, noise=9.0)]


def a_surface(shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rough and sloping, with a step that no row reaches over."""
    rng = np.random.default_rng(6)
    w, gx, gy = (rng.normal(m, s, shape).astype(np.float32) for m, s in ((1.0, 0.05), (0, 0.01), (0, 0.01)))
    w[:, shape[1] // 2 :] += np.float32(0.1 * 1.5 * REACH)
    return w, gx, gy


@native_only
@pytest.mark.parametrize("shape", [(1, 1), (5, 9), (13, 33), (70, 131)])
@pytest.mark.parametrize("labels", [1, 7])
@pytest.mark.parametrize("stride", [1, 2])
def test_band_cost(monkeypatch, shape, labels, stride) -> None:
    guide, grey, source = pictures(shape)
    patch = Patch(radius=2, stride=stride)

    def call(threads: int = 0):  # type: ignore[no-untyped-def]
        return band_cost(grey, guide, two_views(shape, source), a_surface(shape), 0.1, labels, patch, threads=threads)

    native, twin = both(monkeypatch, call)
    assert native.shape == (*shape, labels) and native.dtype == np.uint16
    np.testing.assert_allclose(native.astype(float), twin.astype(float), atol=2e-3 * UNIT)
    assert (native.reshape(-1, labels)[0] == UNIT).all(), "nobody sees the first pixel"
    monkeypatch.setenv("LFRIG_NATIVE", "1")
    assert all(np.array_equal(native, call(threads)) for threads in (1, 2, 3))


@native_only
def test_what_hardly_counts_may_be_left_out(monkeypatch) -> None:
    shape = (12, 20)
    guide, grey, source = pictures(shape)

    def call(least: float):  # type: ignore[no-untyped-def]
        return band_cost(grey, guide, two_views(shape, source), a_surface(shape), 0.1, 5, Patch(), least_visible=least)

    everything, twin = both(monkeypatch, lambda: call(-1.0))
    np.testing.assert_allclose(everything.astype(float), twin.astype(float), atol=2e-3 * UNIT)
    monkeypatch.setenv("LFRIG_NATIVE", "1")
    seen = np.max([view.visible for view in two_views(shape, source)], axis=0) > 0.01
    assert np.abs(everything.astype(int) - call(0.01).astype(int))[seen].max() < 0.02 * UNIT
    assert (everything[~seen & (np.max([v.visible for v in two_views(shape, source)], axis=0) > 0)] < UNIT).any()


def test_band_cost_of_nonsense_is_the_cap() -> None:
    guide, grey, source = pictures((6, 8))
    bad = np.full((6, 8), np.nan, np.float32)
    bad[3:] = 1e30
    zero = np.zeros_like(bad)
    view = View(source, np.ones_like(bad), (MATRIX, OFFSET))
    cost = band_cost(grey, guide, [view], (bad, zero, zero), 0.1, 5, Patch())
    assert (cost == UNIT).all()


def test_the_right_label_costs_least() -> None:
    shape = (24, 40)
    rng = np.random.default_rng(6)
    source = rng.uniform(0, 255, (24, 60)).astype(np.float32)
    photo = np.ascontiguousarray(source[:, 7:47])  # the point at x stands at x + 7 in the source
    guide = np.repeat(photo[..., None], 3, 2).astype(np.uint8)
    w, zero = np.full(shape, 5.0, np.float32), np.zeros(shape, np.float32)
    sideways = (np.eye(3), np.array([1.0, 0.0, 0.0]))
    view = View(source, np.ones(shape, np.float32), sideways)
    cost = band_cost(photo, guide, [view], (w, zero, zero), 1.0, 9, Patch(sigma_grey=1e3))
    inner = cost[6:-6, 6:-6]
    assert (inner.argmin(2) == 9 // 2 + 2).all() and inner.min(2).max() < 0.05 * UNIT


def carried_one_by_one(
    photo: np.ndarray, source: np.ndarray, w: np.ndarray, slope: float, shift_px: float, step: float, labels: int
) -> np.ndarray:
    """1 − ZNCC with every patch resampled for every label, float64 [H, W, K]; plane weights, no colour."""
    import cv2

    height, width = photo.shape
    ys, xs = np.mgrid[0:height, 0:width].astype(np.float32)
    taps = [(dx, dy) for dy in range(-4, 5, 2) for dx in range(-4, 5, 2) if (dx + dy) % 4 == 0]
    weight = np.array([np.exp(-(dx * dx + dy * dy) / 24) for dx, dy in taps])
    weight /= weight.sum()
    own = np.stack([np.roll(photo, (-dy, -dx), (0, 1)) for dx, dy in taps], -1).astype(np.float64)
    own -= (own @ weight)[..., None]
    out = []
    for k in range(labels):
        there = [
            cv2.remap(
                source, xs + dx + shift_px * (w + np.float32(slope * dx + (k - labels // 2) * step)), ys + dy,
                cv2.INTER_LINEAR,
            )
            for dx, dy in taps
        ]  # fmt: skip
        other = np.stack(there, -1).astype(np.float64)
        other -= (other @ weight)[..., None]
        power = ((own**2) @ weight + 1) * ((other**2) @ weight + 1)
        out.append(1 - ((own * other) @ weight) / np.sqrt(power))
    return np.minimum(np.stack(out, -1), 1)


def test_rows_of_slots_say_what_carried_patches_say() -> None:
    import cv2

    height, width, labels, shift, step, slope = 40, 60, 16, 10.0, 0.1, 0.02
    rng = np.random.default_rng(9)
    source = cv2.GaussianBlur(rng.uniform(0, 255, (height, width + 60)).astype(np.float32), (0, 0), 1.5) * 2 - 128
    source = np.clip(source, 0, 255)
    ys, xs = np.mgrid[0:height, 0:width].astype(np.float32)
    truth = 1 + np.float32(slope) * xs
    photo = cv2.remap(source, xs + np.float32(shift) * truth, ys, cv2.INTER_CUBIC)
    w = truth + rng.normal(0, 0.03, truth.shape).astype(np.float32)
    # The map is rough, so that neighbours' rows are read between their slots.
    flat = np.zeros_like(w)
    view = View(source, flat + 1, (np.eye(3), np.array([shift, 0, 0])))
    guide = np.zeros((height, width, 3), np.uint8)
    found = band_cost(photo, guide, [view], (w, flat + np.float32(slope), flat), step, labels, Patch()) / UNIT
    exact = carried_one_by_one(photo, source, w, slope, shift, step, labels)
    inner = (slice(6, -6), slice(6, -6))
    assert np.abs(found - exact)[inner].mean() < 0.02
    best = [inner_cost.argmin(2) for inner_cost in (found[inner], exact[inner])]
    assert (np.abs(best[0] - best[1]) <= 1).mean() > 0.999 and (best[0] == best[1]).mean() > 0.9
