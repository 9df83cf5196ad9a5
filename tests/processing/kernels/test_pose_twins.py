"""The kernels of the pose stage against their NumPy twins: odd sizes, one point, one pixel, hostile values."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest

from lfrig.processing.kernels import bundle, corner_disparity, patches, rig_chain
from tests.processing.kernels.twins import both

pytestmark = pytest.mark.skipif(
    find_spec("lfrig.processing.kernels._native") is None, reason="no native core here: only the twins exist"
)


def views(count: int, rng: np.random.Generator) -> np.ndarray:
    """Cameras on an arc that look at the origin from about half a metre."""
    turn = rig_chain.rotation_matrix(np.c_[np.zeros(count), 0.2 * np.arange(count), 0.01 * rng.standard_normal(count)])
    shift = np.c_[0.01 * rng.standard_normal((count, 2)), 0.5 + 0.02 * rng.standard_normal(count)]
    focal, principal = 1000 + 10 * rng.standard_normal(count), np.tile([270.0, 187.5], (count, 1))
    line = np.tile([7e-4, 2.2], (count, 1))
    return bundle.view_table(turn, shift, focal, principal, line)


def sightings(table: np.ndarray, points: np.ndarray, rng: np.random.Generator, noise: float = 0.5) -> bundle.Sightings:
    """Three quarters of all points in all views, a third of those with a disparity and some with nothing else."""
    n, count = len(points), len(table)
    point, view = np.divmod(np.arange(n * count), count)
    kept = rng.uniform(size=n * count) < 0.75
    kept[0] = True
    point, view = point[kept].astype(np.int32), view[kept].astype(np.int32)
    inverse_sigma = np.c_[np.full(len(point), 4.0), np.where(rng.uniform(size=len(point)) < 0.3, 80.0, 0.0)]
    inverse_sigma[::11, 0] = 0
    empty = bundle.Sightings(point, view, np.zeros((len(point), 3)), np.ones((len(point), 2)))
    exact = bundle.linearise(table, points, empty).residual
    return bundle.Sightings(point, view, exact + noise * rng.standard_normal(exact.shape) * [1, 1, 0.02], inverse_sigma)


@pytest.mark.parametrize(("count", "n"), [(1, 1), (2, 1), (3, 7), (6, 200)])
@pytest.mark.parametrize("damping", [0.0, 1e-3])
def test_bundle(monkeypatch: pytest.MonkeyPatch, count: int, n: int, damping: float) -> None:
    rng = np.random.default_rng(count)
    table, points = views(count, rng), rng.uniform(-0.05, 0.05, (n, 3))
    seen = sightings(table, points, rng)
    native, twin = both(monkeypatch, lambda: bundle.reduced_system(table, points, seen, damping))
    # One view, or two of one point, leave the point's depth to the ridge alone: digits are lost there.
    loose = 1e-9 if n > 2 else 1e-4
    scale = np.abs(twin.system).max() + 1
    np.testing.assert_allclose(native.system, twin.system, rtol=loose, atol=loose * scale)
    np.testing.assert_allclose(native.right, twin.right, rtol=loose, atol=loose * (np.abs(twin.right).max() + 1))
    np.testing.assert_array_equal(native.system, native.system.T)

    costs = both(monkeypatch, lambda: bundle.robust_cost(table, points, seen))
    assert costs[0] == pytest.approx(costs[1], rel=1e-12)
    if n > 2:
        step = 1e-3 * rng.standard_normal(9 * count)
        steps = both(monkeypatch, lambda: bundle.point_steps(table, points, seen, twin, step))
        # Among few points there are some that one view alone sees.
        np.testing.assert_allclose(steps[0], steps[1], rtol=1e-7 if n > 50 else 1e-3, atol=1e-12)


def test_bundle_keeps_hostile_points_to_themselves(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    table, points = views(3, rng), rng.uniform(-0.05, 0.05, (40, 3))
    seen = sightings(table, points, rng)
    points[3] = 1e8  # far away
    points[7] = [0, 0, -5]  # behind
    native, twin = both(monkeypatch, lambda: bundle.robust_cost(table, points, seen))
    assert np.isfinite(native) and native == pytest.approx(twin, rel=1e-9)
    systems = both(monkeypatch, lambda: bundle.reduced_system(table, points, seen, 1e-4).system)
    np.testing.assert_allclose(systems[0], systems[1], rtol=1e-6, atol=1e-6 * np.abs(systems[1]).max())


def test_points_that_nobody_sees_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(4)
    table, points = views(3, rng), rng.uniform(-0.05, 0.05, (20, 3))
    seen = sightings(table, points, rng)
    gone = seen.point == 5
    seen = bundle.Sightings(seen.point[~gone], seen.view[~gone], seen.measured[~gone], seen.inverse_sigma[~gone])
    for native in ("0", "1"):
        monkeypatch.setenv("LFRIG_NATIVE", native)
        reduced = bundle.reduced_system(table, points, seen, 1e-4)
        assert (bundle.point_steps(table, points, seen, reduced, np.full(27, 1e-3))[5] == 0).all()
        assert (bundle.triangulate(table, seen, 20)[5] == 0).all()


@pytest.mark.parametrize("native", "01")
def test_sightings_must_be_in_order_and_in_range(monkeypatch: pytest.MonkeyPatch, native: str) -> None:
    monkeypatch.setenv("LFRIG_NATIVE", native)
    rng = np.random.default_rng(4)
    table, points = views(2, rng), np.zeros((3, 3))
    seen = bundle.Sightings(np.int32([1, 0]), np.int32([0, 1]), np.zeros((2, 3)), np.ones((2, 2)))
    with pytest.raises(ValueError, match="sorted"):
        bundle.robust_cost(table, points, seen)
    assert np.isfinite(bundle.robust_cost(table, points, seen.sorted()))
    with pytest.raises(ValueError, match="range"):
        bundle.robust_cost(table[:1], points, seen.sorted())


@pytest.mark.parametrize(("count", "n"), [(2, 1), (3, 7), (5, 100)])
def test_triangulation(monkeypatch: pytest.MonkeyPatch, count: int, n: int) -> None:
    rng = np.random.default_rng(n)
    table, points = views(count, rng), rng.uniform(-0.05, 0.05, (n, 3))
    point, view = (a.astype(np.int32) for a in np.divmod(np.arange(n * count), count))
    empty = bundle.Sightings(point, view, np.zeros((len(point), 3)), np.ones((len(point), 2)))
    seen = bundle.Sightings(point, view, bundle.linearise(table, points, empty).residual, empty.inverse_sigma)
    native, twin = both(monkeypatch, lambda: bundle.triangulate(table, seen, n))
    np.testing.assert_allclose(native, points, atol=1e-8)
    np.testing.assert_allclose(native, twin, atol=1e-10)


@pytest.mark.parametrize("mounts", [1, 2])
def test_rig_chain(monkeypatch: pytest.MonkeyPatch, mounts: int) -> None:
    rng = np.random.default_rng(mounts)
    turn = rig_chain.rotation_matrix(rng.standard_normal((mounts, 3)))
    table = np.c_[turn.reshape(mounts, 9), rng.standard_normal((mounts, 3))]
    fixed = np.c_[rng.standard_normal(3), np.full(3, 900.0), np.full((3, 2), 80.0), [1e-3, 0, 2e-3], [2.0, 0, 2.2]]
    rig = rig_chain.Rig(table, np.int32([0, 0, mounts - 1]), fixed)
    for x in (np.zeros(rig.size), 1e-6 * rng.standard_normal(rig.size), 0.2 * rng.standard_normal(rig.size)):
        native, twin = both(monkeypatch, lambda x=x: rig_chain.rig_chain(rig, x))
        np.testing.assert_allclose(native[0], twin[0], rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(native[1], twin[1], rtol=1e-11, atol=1e-11)


def picture(shape: tuple[int, int], seed: int) -> np.ndarray:
    import cv2

    noise = np.random.default_rng(seed).standard_normal(shape).astype(np.float32)
    return np.asarray(128 + 300 * cv2.GaussianBlur(noise, (0, 0), 2.0), np.float32)


def square(half: int) -> patches.Window:
    g = np.arange(-half, half + 1, dtype=np.float32)
    dx, dy = (np.ascontiguousarray(m.ravel()) for m in np.meshgrid(g, g))
    weight = np.exp(-(dx**2 + dy**2) / (2 * half**2 + 1e-9)).astype(np.float32)
    return patches.Window(dx, dy, weight / weight.sum())


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize(("half", "n"), [(0, 1), (3, 1), (6, 200), (7, 65)])
def test_alignment(monkeypatch: pytest.MonkeyPatch, half: int, n: int, threads: int) -> None:
    rng = np.random.default_rng(half)
    grey = picture((61, 83), 1)
    first, second = patches.with_slopes(grey), patches.with_slopes(0.8 * np.roll(grey, (1, 2), (0, 1)) + 9)
    # Some of them beyond the border, and well inside.
    here = rng.uniform([-3, -3], [86, 64], (n, 2))
    start = here + [2, 1] + 0.5 * rng.standard_normal((n, 2))
    affine = np.eye(2) + 0.05 * rng.standard_normal((n, 2, 2))
    along = np.tile([0.8, 0.6], (n, 1))
    passes = patches.Alignment(2, 3, 1.5)

    def align() -> tuple[np.ndarray, np.ndarray]:
        return patches.align_patches(first, second, here, start, affine, along, square(half), passes, threads=threads)

    native, twin = both(monkeypatch, align)
    # Flat patches have no place of their own: rounding decides where they go.
    told = twin[1] > 0.5
    assert told.any() or half == 0
    np.testing.assert_allclose(native[0][told], twin[0][told], atol=5e-3)
    np.testing.assert_allclose(native[1][told], twin[1][told], atol=2e-3)


@pytest.mark.parametrize("native", "01")
def test_alignment_is_the_same_for_any_thread_count_and_survives_nonsense(
    monkeypatch: pytest.MonkeyPatch, native: str
) -> None:
    monkeypatch.setenv("LFRIG_NATIVE", native)
    rng = np.random.default_rng(5)
    first, second = (patches.with_slopes(picture((40, 50), seed)) for seed in (1, 2))
    second[7, 9] = np.nan
    second[20, 30] = 1e30
    here, start = rng.uniform(0, 40, (2, 300, 2))
    start[0], start[1], start[2] = np.nan, 1e12, -1e12
    affine, along = np.tile(np.eye(2), (300, 1, 1)), np.tile([1.0, 0.0], (300, 1))
    one, four = (
        patches.align_patches(
            first, second, here, start, affine, along, square(6), patches.Alignment(2, 3, 1.5), threads=threads
        )
        for threads in (1, 4)
    )
    for a, b in zip(one, four, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1)])
def test_alignment_in_pictures_of_one_pixel_or_row(monkeypatch: pytest.MonkeyPatch, shape: tuple[int, int]) -> None:
    flat = np.zeros((*shape, 4), np.float32)
    flat[..., 0] = 50
    points, unit = np.zeros((1, 2)), np.array([[1.0, 0.0]])
    native, twin = both(
        monkeypatch,
        lambda: patches.align_patches(
            flat, flat, points, points, np.eye(2)[None], unit, square(3), patches.Alignment(2, 3, 1.5)
        ),
    )
    np.testing.assert_allclose(native[0], twin[0], atol=1e-4)
    assert abs(native[1][0]) < 1e-3 and abs(twin[1][0]) < 1e-3


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("n", [1, 90])
def test_disparities(monkeypatch: pytest.MonkeyPatch, n: int, threads: int) -> None:
    import cv2

    rng = np.random.default_rng(n)
    grey = picture((47, 65), 3).clip(0, 255)
    offsets = np.array([(-4.0, -4), (0, 4), (4, 0), (3, -3)])
    # A surface of disparity 0.3: a view at (ox, oy) shows at p − o δ what the centre view has at p.
    moved = [
        cv2.warpAffine(
            grey, np.float32([[1, 0, -0.3 * ox], [0, 1, -0.3 * oy]]), (65, 47), borderMode=cv2.BORDER_REFLECT
        )
        for ox, oy in offsets
    ]
    window, xy = square(4), np.round(rng.uniform([-2, -2], [66, 48], (n, 2)))
    if n == 1:
        xy = np.array([[30.0, 20.0]])
    reference = tuple(
        np.stack([layer[np.clip(xy[:, 1, None] + window.dy, 0, 46).astype(int),
                        np.clip(xy[:, 0, None] + window.dx, 0, 64).astype(int)]], 0)[0].astype(np.float32)
        for layer in np.moveaxis(patches.with_slopes(grey.astype(np.float32)), -1, 0)[:3]
    )  # fmt: skip

    def follow() -> tuple[np.ndarray, np.ndarray]:
        return corner_disparity.follow_disparities(
            np.stack(moved).round().astype(np.uint8), offsets, (reference[0], reference[1], reference[2]), window, xy,
            np.full(n, 0.25), passes=4, max_step_px=0.05, robust_grey=6.0, threads=threads,
        )  # fmt: skip

    native, twin = both(monkeypatch, follow)
    np.testing.assert_allclose(native[0], twin[0], atol=2e-4)
    np.testing.assert_allclose(native[1], twin[1], atol=2e-3)
    inside = ((xy > 8) & (xy < [56, 38])).all(1)
    assert np.median(np.abs(native[0][inside] - 0.3)) < 0.02


@pytest.mark.parametrize("threads", [1, 4])
@pytest.mark.parametrize("shape", [(1, 1), (23, 37)])
def test_disparities_survive_nonsense(monkeypatch: pytest.MonkeyPatch, shape: tuple[int, int], threads: int) -> None:
    rng = np.random.default_rng(6)
    window, n = square(3), 150
    grey, slope_x, slope_y = (rng.normal(0, 40, (n, len(window.dx))).astype(np.float32) for _ in range(3))
    slope_y[4], grey[5] = 1e30, np.nan
    xy, start = rng.uniform(-5, 40, (n, 2)), np.zeros(n)
    xy[0], xy[1], xy[2], start[3] = np.nan, 1e12, -1e12, np.nan
    pictures = rng.integers(0, 256, (4, *shape)).astype(np.uint8)
    offsets = np.array([(-4.0, -4), (0, 4), (4, 0), (3, -3)])

    def follow() -> tuple[np.ndarray, np.ndarray]:
        with np.errstate(over="ignore", invalid="ignore"):
            return corner_disparity.follow_disparities(
                pictures, offsets, (grey, slope_x, slope_y), window, xy, start, passes=1, max_step_px=0.05,
                robust_grey=6.0, threads=threads,
            )  # fmt: skip

    native, twin = both(monkeypatch, follow)
    for found, expected in zip(native, twin, strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-4)
    assert np.isfinite(np.delete(native[0], [0, 3, 4, 5])).all()
