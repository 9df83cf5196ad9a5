"""The evidence stage's kernels against their NumPy twins: odd sizes, one plane, one pixel, hostile values."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest

from lfrig.processing.kernels import clipping, grey, plain_cost, plane_cost, sgm, softmax
from lfrig.processing.kernels.grey import GreyViews, with_margin
from lfrig.processing.kernels.plane_cost import COST_UNIT, Halves, PlaneGrid
from tests.processing.kernels.twins import both

pytestmark = pytest.mark.skipif(
    find_spec("lfrig.processing.kernels._native") is None, reason="no native core here: only the twins exist"
)


def array_offsets(side: int) -> np.ndarray:
    """(dr, dc) of a square array of views, float64 [side², 2]."""
    at = np.arange(side) - side // 2
    return np.stack(np.meshgrid(at, at, indexing="ij"), -1).reshape(-1, 2).astype(float)


def random_views(shape: tuple[int, int], side: int = 3, pad: int = 8, seed: int = 2) -> GreyViews:
    pixels = np.random.default_rng(seed).integers(0, 256, (side * side, *shape, 3)).astype(np.uint8)
    return grey.grey_views(pixels, array_offsets(side), side * side // 2, pad)


def random_span(shape: tuple[int, int], planes: int, seed: int = 5) -> np.ndarray:
    rng = np.random.default_rng(seed)
    first = rng.integers(0, planes, (-(-shape[0] // 8), -(-shape[1] // 8)))
    return np.stack([first, np.minimum(first + rng.integers(1, planes + 1, first.shape), planes)], -1).astype(np.int16)


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (7, 5), (33, 70)])
def test_grey_and_half_size(monkeypatch: pytest.MonkeyPatch, shape: tuple[int, int]) -> None:
    native, twin = both(monkeypatch, lambda: random_views(shape))
    assert np.array_equal(native.padded, twin.padded) and native.images.shape == (9, *shape)
    assert native.images.max() <= 255 * 64
    halves = both(monkeypatch, lambda: grey.halved(native, 4, threads=2))
    assert np.array_equal(halves[0].padded, halves[1].padded)
    assert (halves[0].height, halves[0].width) == (max(1, shape[0] // 2), max(1, shape[1] // 2))


def test_grey_is_luma_and_margins_repeat_the_border() -> None:
    picture = np.random.default_rng(1).integers(0, 256, (1, 6, 9, 3)).astype(np.uint8)
    views = grey.grey_views(picture, np.zeros((1, 2)), 0, 5)
    assert np.abs(views.images[0] / 64 - picture[0] @ np.array([0.299, 0.587, 0.114])).max() < 0.6 / 64
    assert (views.padded[0, :5, :5] == views.images[0, 0, 0]).all()
    assert (views.padded[0, 11:, 14:] == views.images[0, -1, -1]).all()


@pytest.mark.parametrize("shape", [(1, 1), (5, 40), (37, 75)])
@pytest.mark.parametrize("blur_px", [0.6, 3.0])
def test_softening_of_clipped_pixels(monkeypatch: pytest.MonkeyPatch, shape: tuple[int, int], blur_px: float) -> None:
    rng = np.random.default_rng(7)
    pixels = rng.integers(0, 255, (3, *shape, 3)).astype(np.uint8)
    pixels[0, : shape[0] // 3 + 1, : shape[1] // 4 + 1] = 255
    pixels[2].reshape(-1, 3)[rng.integers(0, shape[0] * shape[1], 3)] = 254

    def soften(threads: int = 1) -> np.ndarray:
        views = grey.grey_views(pixels, np.zeros((3, 2)), 0, 4)
        clipping.soften_clipped(views, pixels, 254, blur_px, 3, threads=threads)
        return views.padded

    native, twin = both(monkeypatch, soften)
    assert np.abs(native.astype(int) - twin).max() <= 1
    untouched = grey.grey_views(pixels, np.zeros((3, 2)), 0, 4).padded
    assert np.array_equal(native[1], untouched[1]), "a view that does not clip was changed"
    assert shape == (1, 1) or not np.array_equal(native[0], untouched[0])
    monkeypatch.setenv("LFRIG_NATIVE", "1")
    assert np.array_equal(soften(3), native)


@pytest.mark.parametrize("shape", [(1, 1), (3, 3), (12, 65), (17, 130), (40, 31)])
@pytest.mark.parametrize("planes", [1, 7, 37])
def test_plane_cost(monkeypatch: pytest.MonkeyPatch, shape: tuple[int, int], planes: int) -> None:
    views = random_views(shape)
    grid = PlaneGrid(-1.3, 0.07, planes)
    native, twin = both(monkeypatch, lambda: plane_cost.plane_cost(views, grid, 23.0))
    assert native.shape == (*shape, planes)
    assert np.abs(native.astype(int) - twin).max() < COST_UNIT / 16
    monkeypatch.setenv("LFRIG_NATIVE", "1")
    assert np.array_equal(plane_cost.plane_cost(views, grid, 23.0, threads=3, plain=True), native)


@pytest.mark.parametrize("truncation", [0.01, 5.0, 130.0, 255.0, 511.0])
def test_plane_cost_of_any_truncation_and_of_values_beyond_grey(
    monkeypatch: pytest.MonkeyPatch, truncation: float
) -> None:
    views = random_views((19, 44), side=7, pad=9)
    grid = PlaneGrid(-0.5, 0.1, 11)
    native, twin = both(monkeypatch, lambda: plane_cost.plane_cost(views, grid, truncation))
    assert np.abs(native.astype(int) - twin).max() < COST_UNIT / 16 * max(1, truncation / 100)
    huge = np.random.default_rng(0).integers(-32768, 32768, views.padded.shape).astype(np.int16)
    wild = GreyViews(huge, views.offsets, views.centre, views.pad, views.height, views.width)
    monkeypatch.setenv("LFRIG_NATIVE", "1")
    one, other = (plane_cost.plane_cost(wild, grid, truncation, plain=plain) for plain in (False, True))
    assert np.array_equal(one, other)


def test_plane_cost_of_halves_of_the_aperture(monkeypatch: pytest.MonkeyPatch) -> None:
    views = random_views((35, 70), side=5, pad=10)
    grid = PlaneGrid(-0.7, 0.09, 19)
    edges = np.random.default_rng(4).uniform(size=(35, 70)) < 0.1
    edges[:, 40:] = False

    def sweep(**more: object) -> np.ndarray:
        return plane_cost.plane_cost(views, grid, 23.0, halves=Halves(edges, 0.25), **more)  # type: ignore[arg-type]

    native, twin = both(monkeypatch, sweep)
    assert np.abs(native.astype(int) - twin).max() < COST_UNIT / 16
    monkeypatch.setenv("LFRIG_NATIVE", "1")
    plain = plane_cost.plane_cost(views, grid, 23.0)
    assert np.array_equal(native[~edges], plain[~edges]) and (native[edges] < plain[edges]).any()
    assert np.array_equal(sweep(out=plain, threads=3), native)


def test_plane_cost_where_it_is_wanted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LFRIG_NATIVE", "1")
    views = random_views((50, 150))
    grid = PlaneGrid(-0.5, 0.05, 40)
    span = random_span((50, 150), 40)
    active = softmax.in_span(span, (50, 150, 40))
    whole = plane_cost.plane_cost(views, grid, 20.0)
    part = plane_cost.plane_cost(views, grid, 20.0, span=span, threads=2)
    assert np.array_equal(part[active], whole[active])
    span[...] = [3, 5]
    assert not plane_cost.plane_cost(views, grid, 20.0, span=span)[..., 5:].any(), "skipped planes were computed"


def test_plane_cost_refuses_what_it_cannot_do() -> None:
    views = random_views((9, 9), pad=4)
    with pytest.raises(ValueError, match="margin"):
        plane_cost.plane_cost(views, PlaneGrid(0.0, 1.0, 4), 23.0)
    row = np.array([3, 5], np.int32)
    with pytest.raises(ValueError, match="half of the aperture"):
        plane_cost.plane_cost(
            views, PlaneGrid(0.0, 0.1, 4), 23.0, chosen=row, halves=Halves(np.ones((9, 9), bool), 0.0)
        )


def test_plane_cost_finds_a_shift() -> None:
    """Views shifted by a known disparity cost nothing at that plane."""
    rng = np.random.default_rng(4)
    base = rng.integers(0, 256, (20, 30)).astype(np.int16) * 64
    left, right = np.roll(base, -2, 1), np.roll(base, 2, 1)  # (x − dc·δ): δ = 2 at dc = 1 lies 2 px to the left
    offsets = np.array([[0, 1], [0, 0], [0, -1]], float)
    views = GreyViews(with_margin(np.stack([left, base, right]), 8), offsets, 1, 8, 20, 30)
    cost = plane_cost.plane_cost(views, PlaneGrid(0.0, 1.0, 5), 50.0)
    assert (cost[4:-4, 6:-6].argmin(2) == 2).all()


def free_penalties(shape: tuple[int, int]) -> sgm.Penalties:
    """Of changes of label that cost nothing: the sum of a pixel's paths is `sgm.PATHS` times its own cost."""
    return sgm.Penalties(0, np.zeros((4, *shape), np.uint16), sgm.PATH_LIMIT)


@pytest.mark.parametrize("shape", [(1, 1, 1), (3, 5, 2), (4, 7, 16), (25, 18, 83)])
@pytest.mark.parametrize("spans", [False, True])
def test_softmax_and_summary(monkeypatch: pytest.MonkeyPatch, shape: tuple[int, int, int], spans: bool) -> None:
    cost = np.random.default_rng(1).integers(0, 20_000, shape).astype(np.uint16)
    cost.flat[0] = 65535  # as the aggregation leaves where nothing is known
    span = random_span(shape[:2], shape[2]) if spans else None
    native, twin = both(
        monkeypatch,
        lambda: softmax.sgm_softmax(cost // sgm.PATHS, free_penalties(shape[:2]), 1 / 500, 3, span=span, threads=2),
    )
    assert np.abs(native[0].astype(int) - twin[0]).max() <= 1
    for found, expected in zip(native[1:], twin[1:], strict=True):
        np.testing.assert_allclose(found, expected, atol=2e-5)
    assert np.abs(native[0].sum(2, dtype=np.int64) - 65535).max() <= shape[2]
    assert not native[0][~softmax.in_span(span, shape)].any()
    for every in (1, 2):
        found, expected = both(monkeypatch, lambda n=every: softmax.summarise(cost, span=span, margin=2000, every=n))
        for name in ("lowest", "mean", "best", "first", "past"):
            assert np.array_equal(getattr(found, name), getattr(expected, name)), name


@pytest.mark.parametrize("shape", [(1, 1, 1), (9, 21, 16), (17, 30, 45)])
@pytest.mark.parametrize("spans", [False, True])
def test_softmax_of_sums_that_are_never_written(
    monkeypatch: pytest.MonkeyPatch, shape: tuple[int, int, int], spans: bool
) -> None:
    rng = np.random.default_rng(6)
    cost = rng.integers(0, 3000, shape).astype(np.uint16)
    cost.flat[0] = 65535
    guide = rng.integers(0, 256, (*shape[:2], 3)).astype(np.uint8)
    span = random_span(shape[:2], shape[2]) if spans else None
    if span is not None:
        span[-1, -1] = [3, 2]  # no plane is active

    def call(threads: int = 2) -> tuple[np.ndarray, ...]:
        penalties = sgm.Penalties.of(guide, 40.0, 300.0, 12.0)
        return softmax.sgm_softmax(cost, penalties, 1 / 500, 3, span=span, threads=threads)

    native, twin = both(monkeypatch, call)
    assert np.abs(native[0].astype(int) - twin[0]).max() <= 1
    for found, expected in zip(native[1:], twin[1:], strict=True):
        np.testing.assert_allclose(found, expected, atol=2e-5)
    monkeypatch.setenv("LFRIG_NATIVE", "1")
    for threads in (1, 3):
        assert all(np.array_equal(a, b) for a, b in zip(call(threads), native, strict=True))


@pytest.mark.parametrize("shape", [(1, 1, 1), (9, 21, 16), (17, 30, 45)])
@pytest.mark.parametrize("spans", [False, True])
def test_softmax_is_that_of_the_aggregated_sums(
    monkeypatch: pytest.MonkeyPatch, shape: tuple[int, int, int], spans: bool
) -> None:
    monkeypatch.setenv("LFRIG_NATIVE", "1")
    rng = np.random.default_rng(6)
    cost = rng.integers(0, 600, shape).astype(np.uint16)
    guide = rng.integers(0, 256, (*shape[:2], 3)).astype(np.uint8)
    span = random_span(shape[:2], shape[2]) if spans else None
    at_once = softmax.sgm_softmax(cost, sgm.Penalties.of(guide, 40.0, 300.0, 12.0), 1 / 500, 3, span=span)
    total = sgm.aggregate(cost, guide, 40.0, 300.0, 12.0, span=span)
    assert total[softmax.in_span(span, shape)].max() <= sgm.PATH_LIMIT, "not taken as it is"
    # Eight times a cost at an eighth of the sharpness: the same numbers, only their exponents differ.
    two_steps = softmax.sgm_softmax(total, free_penalties(shape[:2]), 1 / 500 / sgm.PATHS, 3, span=span)
    assert all(np.array_equal(a, b) for a, b in zip(two_steps, at_once, strict=True))


@pytest.mark.parametrize("native", "01")
@pytest.mark.parametrize("cost", [0, 65535])
def test_softmax_of_equal_costs_takes_the_first_peak(monkeypatch: pytest.MonkeyPatch, native: str, cost: int) -> None:
    monkeypatch.setenv("LFRIG_NATIVE", native)
    equal = np.full((2, 3, 40), cost, np.uint16)
    penalties = sgm.Penalties.of(np.zeros((2, 3, 3), np.uint8), 40.0, 300.0, 12.0)
    for threads in (1, 3):
        _, index, mass = softmax.sgm_softmax(equal, penalties, 4.0, 3, threads=threads)
        assert index == pytest.approx(1.5) and mass == pytest.approx(0.1)


@pytest.mark.parametrize("shape", [(1, 1), (19, 33), (5, 150)])
def test_sums_over_views(monkeypatch: pytest.MonkeyPatch, shape: tuple[int, int]) -> None:
    views = random_views(shape, side=5)
    everywhere = np.ones(shape, bool)
    native, twin = both(monkeypatch, lambda: plain_cost.view_moments(views, everywhere, threads=2))
    assert all(np.array_equal(a, b) for a, b in zip(native, twin, strict=True))
    monkeypatch.setenv("LFRIG_NATIVE", "1")
    part = np.random.default_rng(2).random(shape) > 0.97
    some = plain_cost.view_moments(views, part, threads=1)
    assert all(np.array_equal(a[part], b[part]) for a, b in zip(some, native, strict=True))
    assert not np.any(plain_cost.view_moments(views, ~everywhere))


@pytest.mark.parametrize("shape", [(1, 1), (19, 33), (40, 70)])
@pytest.mark.parametrize("blur_px", [0.1, 1.0, 7.0])
def test_power_of_differences(monkeypatch: pytest.MonkeyPatch, shape: tuple[int, int], blur_px: float) -> None:
    views = random_views(shape, side=3)
    everywhere = np.ones(shape, bool)
    native, twin = both(monkeypatch, lambda: plain_cost.difference_power(views, blur_px, everywhere, threads=2))
    np.testing.assert_allclose(native, twin, rtol=1e-4, atol=1e-2)
    monkeypatch.setenv("LFRIG_NATIVE", "1")
    part = np.random.default_rng(2).random(shape) > 0.99
    some = plain_cost.difference_power(views, blur_px, part, threads=1)
    assert np.array_equal(some[part], native[part])
    assert not plain_cost.difference_power(views, blur_px, ~everywhere).any()


def test_costs_of_plain_pixels(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    shape = (19, 34)
    grid = PlaneGrid(-0.4, 0.05, 17)
    cost = rng.integers(0, 3000, (*shape, 17)).astype(np.uint16)
    disparity = rng.normal(0, 0.3, shape).astype(np.float32)
    steepness = rng.uniform(0, 1e6, shape).astype(np.float32)
    weight = np.clip(rng.uniform(-1, 1.2, shape), 0, 1).astype(np.float32)
    disparity.flat[0], weight.flat[0] = 1e18, 1.0
    span = random_span(shape, 17)

    def blend(threads: int = 1) -> np.ndarray:
        out = cost.copy()
        plain_cost.blend_plain(out, grid, disparity, steepness, weight, 90.0, span=span, threads=threads)
        return out

    native, twin = both(monkeypatch, blend)
    assert np.abs(native.astype(int) - twin).max() <= 1
    left = (weight == 0)[..., None] | ~softmax.in_span(span, (*shape, 17))
    assert np.array_equal(native[left], cost[left]) and (native != cost).any()
    monkeypatch.setenv("LFRIG_NATIVE", "1")
    assert np.array_equal(blend(3), native)
