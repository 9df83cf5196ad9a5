"""The kernels of the refinement against their NumPy twins: odd sizes, one pixel, hostile values."""

from __future__ import annotations

from importlib.util import find_spec
from itertools import pairwise

import numpy as np
import pytest

from lfrig.processing.kernels.band_peak import band_peak
from lfrig.processing.kernels.edge_cost import EdgeRules, EdgeView, edge_cost
from lfrig.processing.kernels.edge_snap import edge_snap
from lfrig.processing.kernels.landing import FAR_OUTSIDE, Way, landing
from lfrig.processing.kernels.layer_mean import layer_mean
from lfrig.processing.kernels.perceptron import Layer, perceptron
from lfrig.processing.kernels.spread import DIAGONAL, STRAIGHT, Seeds, spread
from lfrig.processing.model import ScaleFit
from tests.processing.kernels.twins import both

native_only = pytest.mark.skipif(
    find_spec("lfrig.processing.kernels._native") is None, reason="no native core here: only the twins exist"
)
SHAPES = [(1, 1), (2, 7), (13, 33), (21, 130)]
AHEAD = (np.eye(3), np.zeros(3))


def a_way(shape: tuple[int, int], seed: int = 0) -> Way:
    """Into a source of another size, turned a little, whose own surface is about that of `a_surface`."""
    rng = np.random.default_rng(seed)
    size = (shape[0] + 3, shape[1] + 2)
    matrix = np.array([[1.0, 0.02, 0.3 + seed], [-0.01, 1.0, -0.4], [1e-4, -2e-4, 1.0]])
    scale = ScaleFit(0.7, 1.0)
    disparity = scale.disparity(rng.normal(1.5, 0.1, size).astype(np.float32))
    return Way((matrix, np.array([1.5, 0.4 - seed, 0.05])), size, disparity, scale)


def a_surface(shape: tuple[int, int]) -> np.ndarray:
    return np.random.default_rng(3).normal(1.5, 0.1, shape).astype(np.float32)


def colours(shape: tuple[int, int], seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (*shape, 3)).astype(np.uint8)


def same_for_all_threads(monkeypatch: pytest.MonkeyPatch, native: np.ndarray, call) -> None:  # type: ignore[no-untyped-def]
    monkeypatch.setenv("LFRIG_NATIVE", "1")
    for threads in (1, 2, 5):
        np.testing.assert_array_equal(call(threads), native)


@native_only
@pytest.mark.parametrize("shape", SHAPES)
def test_landing(monkeypatch, shape) -> None:
    surface, way = a_surface(shape), a_way(shape)
    surface.flat[-1] = np.inf
    surface.flat[surface.size // 2] = np.nan
    native, twin = both(monkeypatch, lambda: landing(surface, way))
    for a, b in zip(native, twin, strict=True):
        assert a.dtype == b.dtype and a.shape == shape
        np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-5)
    same_for_all_threads(monkeypatch, native[3], lambda threads: landing(surface, way, threads=threads)[3])


def test_points_behind_a_source_land_far_outside() -> None:
    behind = Way((np.eye(3), np.array([0.0, 0.0, -2.0])), (4, 6), np.zeros((4, 6), np.float32), ScaleFit(1.0, 0.0))
    u, v, inside, ahead = landing(np.array([[0.25, 1.0, np.nan]], np.float32), behind)
    assert inside.tolist() == [[True, False, False]] and np.isfinite(ahead).all()
    assert (u[0, 1:] == FAR_OUTSIDE).all() and (v[0, 1:] == FAR_OUTSIDE).all()
    assert ahead[0, 0] == pytest.approx(-0.5), "0.25 /m is 0.5 /m in the source, whose surface is at 0"


def some_seeds(shape: tuple[int, int], count: int) -> Seeds:
    rng = np.random.default_rng(2)
    at = rng.permutation(shape[0] * shape[1])[:count]
    value, gx, gy = (rng.normal(m, s, len(at)).astype(np.float32) for m, s in ((1.5, 0.1), (0, 0.01), (0, 0.01)))
    return Seeds(at % shape[1], at // shape[1], value, gx, gy)


@native_only
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("longest", [3, 1000])
def test_spread(monkeypatch, shape, longest) -> None:
    domain = np.random.default_rng(5).uniform(size=shape) < 0.8
    seeds = some_seeds(shape, 1 + shape[0] * shape[1] // 40)
    domain[seeds.y, seeds.x] = False
    ways = [a_way(shape), a_way(shape, 1)]

    def call():  # type: ignore[no-untyped-def]
        return spread(seeds, domain, colours(shape), ways, step_grey=30, reach=9, most_ahead=0.3, longest=longest)

    native, twin = both(monkeypatch, call)
    np.testing.assert_array_equal(native, twin)
    assert (native[seeds.y, seeds.x] == np.arange(len(seeds.x))).all()
    rest = ~domain
    rest[seeds.y, seeds.x] = False
    assert (native[rest] == -1).all()


def test_paths_are_the_shortest_and_equal_ones_go_to_the_first_seed() -> None:
    domain = np.zeros((3, 9), bool)
    domain[1, 1:8] = True
    flat = np.zeros(2, np.float32)
    picture = np.zeros((3, 9, 3), np.uint8)
    for x, y in (([0, 8], [1, 1]), ([8, 0], [1, 1])):
        seeds = Seeds(np.array(x), np.array(y), flat + 1, flat, flat)
        found = spread(seeds, domain, picture, [], step_grey=30, reach=9, most_ahead=0.1, longest=99)
        first, second = (0, 1) if x[0] == 0 else (1, 0)
        assert found[1].tolist() == [first] * 4 + [0] + [second] * 4
    picture[1, 2:] = 100  # a step of colour near the left seed: ten steps' worth to cross
    seeds = Seeds(np.array([0, 8]), np.array([1, 1]), flat + 1, flat, flat)
    found = spread(seeds, domain, picture, [], step_grey=30, reach=9, most_ahead=0.1, longest=99)
    assert found[1].tolist() == [0, 0] + [1] * 7
    assert abs(DIAGONAL / STRAIGHT - 2**0.5) < 1e-4


def test_a_plane_stops_where_it_would_float() -> None:
    domain = np.ones((1, 10), bool)
    domain[0, 0] = False
    sees = np.full((1, 10), 1.0, np.float32)
    sees[0, 6:] = 0.0
    one = np.ones(1, np.float32)
    seeds = Seeds(np.array([0]), np.array([0]), one, 0 * one, 0 * one)
    way = Way(AHEAD, (1, 10), sees, ScaleFit(1.0, 0.0))
    picture = np.zeros((1, 10, 3), np.uint8)
    found = spread(seeds, domain, picture, [way], step_grey=30, reach=9, most_ahead=0.5, longest=99)
    assert found[0].tolist() == [0] * 6 + [-1] * 4


@native_only
@pytest.mark.parametrize("native", "01")
def test_seeds_beside_the_map_are_refused(monkeypatch, native) -> None:
    monkeypatch.setenv("LFRIG_NATIVE", native)
    one = np.ones(1, np.float32)
    with pytest.raises(ValueError, match="outside"):
        spread(
            Seeds(np.array([9]), np.array([0]), one, one, one), np.ones((2, 3), bool), colours((2, 3)), [],
            step_grey=30, reach=9, most_ahead=0.5, longest=9,
        )  # fmt: skip


@native_only
@pytest.mark.parametrize("shape", SHAPES)
def test_edge_snap(monkeypatch, shape) -> None:
    rng = np.random.default_rng(7)
    values = np.where(rng.uniform(size=shape) < 0.4, 1, 2) + rng.normal(0, 0.05, shape)
    values = values.astype(np.float32)
    values.flat[values.size // 2] = np.nan if values.size > 1 else 1.0
    guide = (rng.integers(0, 2, (*shape, 1)) * 60 + rng.integers(0, 9, (*shape, 3))).astype(np.uint8)
    at = rng.uniform(size=shape) < 0.02

    def call(threads: int = 0):  # type: ignore[no-untyped-def]
        return edge_snap(
            values, guide, at, radius=2, search=3, sigma_grey=20.0, threshold=0.2, per_step=1e-3, threads=threads
        )

    native, twin = both(monkeypatch, call)
    np.testing.assert_array_equal(native, twin)
    same_for_all_threads(monkeypatch, native, call)


def test_snap_takes_single_pixels_back_and_leaves_the_rest() -> None:
    values = np.full((12, 16), 1.0, np.float32)
    values[:, 8:] = 2.0
    guide = np.zeros((12, 16, 3), np.uint8)
    guide[:, 8:] = 200
    values[5, 6] = 2.0  # of the other side, but of this side's colour
    clean = values.copy()
    clean[5, 6] = 1.0
    everywhere = np.ones(values.shape, bool)
    knobs = {"radius": 2, "search": 3, "sigma_grey": 20.0, "threshold": 0.2, "per_step": 1e-3}
    assert np.array_equal(edge_snap(values, guide, everywhere, **knobs), clean)
    assert np.array_equal(edge_snap(values, guide, ~everywhere, **knobs), values)


@native_only
@pytest.mark.parametrize("shape", [(2, 7), (13, 33), (21, 130)])
def test_edge_cost(monkeypatch, shape) -> None:
    near, at = a_surface(shape), np.random.default_rng(8).uniform(size=shape) < 0.5
    far = near - np.float32(0.2)
    far.flat[0], at.flat[0] = np.nan, True
    photo = colours(shape).astype(np.float32)
    views = [
        EdgeView(way, colours((shape[0] + 3, shape[1] + 2), 5 + i).astype(np.float32))
        for i, way in enumerate((a_way(shape), a_way(shape, 1)))
    ]
    rules = EdgeRules(cap=30.0, contradiction=30.0, contradiction_px=0.12, margin_px=0.08)

    def call(threads: int = 0):  # type: ignore[no-untyped-def]
        return edge_cost(near, far, at, photo, views, rules, threads=threads)

    native, twin = both(monkeypatch, call)
    np.testing.assert_allclose(native, twin, atol=2e-2)
    assert np.isfinite(native).all() and (native[~at] == 0).all() and (native[at] != 0).any()
    same_for_all_threads(monkeypatch, native, call)


def test_the_right_depth_has_the_photos_colour() -> None:
    shape = (6, 20)
    picture = np.zeros((6, 40, 3), np.float32)
    picture[:, 20:] = 200  # photo pixels x stand at x + 10 w
    photo = np.zeros((*shape, 3), np.float32)
    photo[:, 10:] = 200
    way = Way((np.eye(3), np.array([10.0, 0, 0])), (6, 40), np.full((6, 40), 1.0, np.float32), ScaleFit(1.0, 0.0))
    right, wrong = np.full(shape, 1.0, np.float32), np.full(shape, 0.5, np.float32)
    sees_through = Way(way.projection, way.size, np.full((6, 40), -9.0, np.float32), way.scale)
    rules = EdgeRules(cap=30.0, contradiction=30.0, contradiction_px=0.12, margin_px=0.8)
    everywhere = np.ones(shape, bool)
    cost = edge_cost(right, wrong, everywhere, photo, [EdgeView(way, picture)], rules)
    assert (cost[:, 10:15] == 30).all() and (cost[:, :10] == 0).all() and (cost[:, 16:] == 0).all()
    charged = edge_cost(right, wrong, everywhere, photo, [EdgeView(sees_through, picture)], rules)
    assert (charged == 0).all(), "both float in the air and cost the cap"


@native_only
@pytest.mark.parametrize("count", [1, 63, 64, 1000])
@pytest.mark.parametrize("units", [(1, 1), (5, 1), (36, 32, 7, 1)])
def test_perceptron(monkeypatch, count, units) -> None:
    rng = np.random.default_rng(9)
    features = rng.normal(0, 3, (units[0], count)).astype(np.float32)
    features.flat[0] = 1e30
    mean, spread_ = rng.normal(size=units[0]).astype(np.float32), rng.uniform(1, 2, units[0]).astype(np.float32)
    layers = [
        Layer(rng.normal(0, 0.4, (o, i)).astype(np.float32), rng.normal(size=o).astype(np.float32))
        for i, o in pairwise(units)
    ]

    def call(threads: int = 0):  # type: ignore[no-untyped-def]
        return perceptron(features, mean, spread_, layers, limit=4.0, leak=0.05, threads=threads)

    native, twin = both(monkeypatch, call)
    np.testing.assert_allclose(native, twin, atol=1e-4)
    assert native.shape == (count,)
    same_for_all_threads(monkeypatch, native, call)


@native_only
@pytest.mark.parametrize("native", "01")
def test_a_perceptron_needs_layers_that_fit(monkeypatch, native) -> None:
    monkeypatch.setenv("LFRIG_NATIVE", native)
    one, two = np.ones((1, 2), np.float32), np.ones((2, 2), np.float32)
    with pytest.raises(ValueError, match="fit"):
        perceptron([one[0]], one[0, :1], one[0, :1], [Layer(two, two[0])], limit=4.0, leak=0.05)


@native_only
@pytest.mark.parametrize("shape", [(1, 1, 1), (3, 5, 2), (4, 9, 7), (5, 21, 128)])
def test_band_peak(monkeypatch, shape) -> None:
    rng = np.random.default_rng(10)
    cost = rng.integers(0, 2049, shape).astype(np.uint16)
    total = rng.choice([0, 7, 500, 40_000, 65_535], shape).astype(np.uint16)

    def call(threads: int = 0):  # type: ignore[no-untyped-def]
        return np.stack(band_peak(cost, total, threads=threads))

    native, twin = both(monkeypatch, call)
    np.testing.assert_array_equal(native, twin)
    same_for_all_threads(monkeypatch, native, call)


def test_a_peak_is_found_to_a_fraction_and_known_by_its_rivals() -> None:
    total = np.full((1, 1, 12), 900, np.uint16)
    total[0, 0, 3:7] = [400, 100, 200, 700]  # a parabola's least value lies at 4.25
    total[0, 0, 10] = 350
    label, least, margin, curvature = band_peak(np.full((1, 1, 12), 5, np.uint16), total)
    assert label[0, 0] == pytest.approx(4.25) and least[0, 0] == 5
    assert margin[0, 0] == 250 and curvature[0, 0] == 800 + 600


@native_only
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("window", [1, 9])
def test_layer_mean(monkeypatch, shape, window) -> None:
    rng = np.random.default_rng(11)
    values, layer = (rng.normal(1, 0.3, shape).astype(np.float32) for _ in range(2))
    layer.flat[0] = 1e30

    def call(threads: int = 0):  # type: ignore[no-untyped-def]
        return layer_mean(values, layer, sigma=0.2, window=window, threads=threads)

    with np.errstate(over="ignore"):
        native, twin = both(monkeypatch, call)
    np.testing.assert_allclose(native, twin, rtol=1e-5)
    same_for_all_threads(monkeypatch, native, call)


def test_the_mean_stays_on_its_layer() -> None:
    layer = np.where(np.arange(20) < 10, 1.0, 2.0).astype(np.float32)[None].repeat(9, 0)
    values = 10 * layer
    assert np.abs(layer_mean(values, layer, sigma=0.1, window=9) - values).max() < 1e-4
